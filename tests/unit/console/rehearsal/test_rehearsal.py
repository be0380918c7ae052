"""Rehearsals: what they begin from, what they draw, and what they foretell of a mission that then goes on."""

from __future__ import annotations

import re
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error, InvalidInput
from he3.frames import SiteGrid
from he3.gp import GaussianProcess
from he3.hyperparameters import Hyperparameters
from he3.kernels import kernel_from
from he3.reference import Region
from he3.warping import Warp
from schemas.commands import CommandKind, NoParameters, Telecommand
from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.telemetry import EventKind, RoverMode
from schemas.topics import EVENT, FORK, ISSUE_COMMAND, LINK_SHOW, LIST_COMMANDS, MEASURE, Side
from services.console.rehearsal.alternative import parse_alternative
from services.console.rehearsal.drawn_field import DrawnField
from services.console.rehearsal.flight import Flight, Start, assumptions, fly, scenario_of
from services.console.rehearsal.forecast import Band, Forecast, compared
from services.field.node import FieldNode
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.mission_time import SECOND
from services.mission.scenario import Scenario, checked_scenario
from services.runtime.node import QueryReceived, SendReply

WIDE = 60
NOISE_PPB = 0.3


def flat_region() -> Region:
    """A square of 60 m without a slope."""
    grid = SiteGrid(WIDE, WIDE, 1.0)
    east = np.linspace(4.0, 9.0, WIDE)[None, :].repeat(WIDE, axis=0)
    flat = np.zeros(grid.shape)
    return Region(
        name="flat", title="flat", provenance="made by a test", grid=grid, he3_ppb=east, orbital_ppb=east,
        elevation_m=flat, slope_deg=flat.copy(), traversable=np.ones(grid.shape, dtype=bool),
    )  # fmt: skip


def scenario(**ground: Any) -> Scenario:
    return checked_scenario(
        {
            "name": "rehearsed", "region": "t1", "rounds": 4, "samples_per_round": 2, "start_m": [30.0, 30.0],
            "ground": {"kernel": "matern52", "clearance_m": 5.0, **ground},
        },
        "test",
    )  # fmt: skip


class Live:
    """A mission in virtual time, of which copies are made."""

    def __init__(self, **ground: Any) -> None:
        self.region = flat_region()
        plan = scenario(**ground)
        self.lines: list[str] = []
        self.mission = InProcessMission(
            plan,
            event_sink=lambda now, node, what: self.lines.append(f"{now} {node} {what}"),
            nodes=build_nodes(plan, self.region),
        )
        self.rounds_at: dict[int, int] = {}
        self.mission.simulation.tap(self._listen)

    def _listen(self, topic: Any, side: Side, payload: bytes, now: int) -> None:
        from schemas.codec import decode

        if topic is EVENT and side is Side.MOON:
            event = decode(topic, payload, "rehearsed")[1]
            if event.kind is EventKind.ROUND_COMPLETED:
                self.rounds_at.setdefault(event.round, now)

    def until_samples(self, count: int) -> None:
        while self.mission.status is None or self.mission.status.samples < count:
            assert self.mission.simulation.step()

    def start(self) -> Start:
        ask = self.mission.ask
        listed = ask(LIST_COMMANDS, NoParameters()).commands
        under_way = tuple(status.command for status in listed if status.end is None)
        return Start(ask(FORK, NoParameters()), ask(LINK_SHOW, NoParameters()), under_way)


def test_a_rehearsal_foretells_the_round_that_follows_and_ends_with_every_sample() -> None:
    live = Live()
    live.until_samples(4)
    start = live.start()
    before_m = start.fork.rover.driven_m if start.fork.rover is not None else 0.0
    flights = [fly(start, live.region, draw) for draw in range(3)]
    assert flights[0] == fly(start, live.region, 0)
    live.mission.run()

    assert live.mission.status is not None
    assert [(flight.completed, flight.samples) for flight in flights] == [(True, 8)] * 3
    assert len({flight.mean_std_ppb for flight in flights}) == 3
    for flight in flights:
        # The round was being planned, and planning begins anew in the copy.
        ahead_s = (live.rounds_at[3] - start.fork.at) / SECOND
        assert flight.rounds_s[3] == pytest.approx(ahead_s, abs=live.mission.scenario.ground.planning_s + 1.0)
        assert sorted(flight.rounds_s) == [3, 4]
        real_m = live.mission.status.driven_m - before_m
        assert 0.3 * real_m < flight.driven_m < 3.0 * real_m


def test_how_far_the_rover_looks_ahead_in_a_rehearsal_changes_nothing_where_nothing_is_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    live = Live(planner="tour")
    live.until_samples(4)
    start = live.start()
    far = fly(start, live.region, 0)
    monkeypatch.setattr("services.console.rehearsal.flight.LOOK_AHEAD_M", 1.0)
    near = fly(start, live.region, 0)
    assert near.driven_m == pytest.approx(far.driven_m, rel=1e-9)
    assert near.lasts_s == pytest.approx(far.lasts_s, rel=1e-9)
    assert near.mean_std_ppb == pytest.approx(far.mean_std_ppb, rel=1e-6)


def test_a_rehearsal_from_the_middle_of_a_round_takes_what_is_left_of_it() -> None:
    live = Live(pipeline=1)
    live.until_samples(3)
    start = live.start()
    assert start.fork.plan is not None
    under_way = start.fork.plan.rounds[0]
    assert (under_way.round, len(under_way.samples)) == (2, 1)
    assert len(start.fork.measured) == 3
    flight = fly(start, live.region, 0)
    assert (flight.completed, flight.samples, min(flight.rounds_s)) == (True, 8, 2)
    assert flight.driven_m > 0
    assert flight.track_m[0][1:] == pytest.approx((start.fork.rover.x_m, start.fork.rover.y_m))  # type: ignore[union-attr]


def test_copies_leave_no_trace_in_the_mission() -> None:
    asked, left_alone = Live(), Live()
    asked.until_samples(2)
    asked.start()
    asked.until_samples(5)
    fly(asked.start(), asked.region, 0)
    asked.mission.run()
    left_alone.mission.run()
    assert asked.lines == left_alone.lines


def test_of_a_mission_that_has_ended_nothing_is_rehearsed_and_the_ground_says_so() -> None:
    live = Live()
    live.mission.run()
    with pytest.raises(He3Error, match=r"^rehearsal: the mission has ended, completed: nothing of it lies ahead$"):
        live.start()


def test_a_rehearsal_says_what_it_takes_for_granted() -> None:
    live = Live(approval="auto")
    live.until_samples(2)
    assert assumptions(live.start()) == []
    live.mission.ask(ISSUE_COMMAND, Telecommand(command_id="p", kind=CommandKind.PAUSE))
    assert assumptions(live.start()) == ["a command on its way would hold the rover: it does not"]
    while live.start().fork.rover.mode is not RoverMode.PAUSED:  # type: ignore[union-attr]
        live.mission.simulation.run_for(600.0)
    start = live.start()
    assert assumptions(start) == ["the rover is in the mode paused: it resumes now"]
    assert fly(start, live.region, 0).completed


def test_a_mission_with_a_plug_in_planner_is_not_rehearsed() -> None:
    live = Live()
    live.until_samples(1)
    fork = live.start().fork
    foreign = fork.model_copy(update={"scenario_json": fork.scenario_json.replace('"rrtstar"', '"os:system"')})
    with pytest.raises(InvalidInput, match="expected a built-in planner, got the plug-in os:system"):
        scenario_of(foreign)


@pytest.mark.parametrize("warp", [None, Warp(8.0, 1.5, 1.0, 0.3, NOISE_PPB)], ids=["normal", "skewed"])
def test_draws_at_several_places_have_the_joint_distribution_of_the_posterior(warp: Warp | None) -> None:
    hyperparameters = Hyperparameters(kernel_from("matern52"), NOISE_PPB, 8.0, 1.5, warp=warp)
    belief = GaussianProcess(hyperparameters).condition([(20.0, 20.0)], [9.0])
    places = [(24.0, 20.0), (25.0, 24.0), (24.0, 20.0)]
    region = flat_region()
    truth = FieldNode(region, scenario().field, 1, (30.0, 30.0))

    def drawn(seed: int) -> list[float]:
        field = DrawnField(truth, belief, NOISE_PPB, np.random.default_rng(seed))
        values = []
        for number, (x, y) in enumerate(places):
            request = MeasurementRequest(sample_id=f"s{number}", x_m=x, y_m=y, depth_m=1.0)
            for _ in range(2):  # asked again, a sample has the same value
                (effect,) = field.handle(QueryReceived(MEASURE, request, 1), 0)
                assert isinstance(effect, SendReply)
            assert isinstance(effect.reply, MeasurementReply)
            values.append(effect.reply.helium3_ppb)
        return values

    values = np.array([drawn(seed) for seed in range(3000)])
    mean = belief.predict(places)[0]
    covariance = belief.posterior_covariance(places) + NOISE_PPB**2 * np.eye(3)
    assert values.mean(axis=0) == pytest.approx(mean, abs=5 * np.sqrt(covariance.max() / len(values)))
    assert np.cov(values.T) == pytest.approx(covariance, abs=0.12 * covariance.max())


@pytest.mark.parametrize("draws", [2, 3, 10, 38, 39, 100])
def test_the_next_flight_lies_in_the_bands_as_often_as_they_say(draws: int) -> None:
    random = np.random.default_rng(draws)
    flights = random.normal(1000.0, 10.0, (4000, draws + 1))
    bands = [Band.of(values[:-1]) for values in flights]
    for level, low, high in ((0.68, "low_68", "high_68"), (0.95, "low_95", "high_95")):
        inside = np.mean(
            [
                getattr(band, low) <= last <= getattr(band, high)
                for band, last in zip(bands, flights[:, -1], strict=True)
            ]
        )
        assert inside == pytest.approx(level, abs=0.035)


def test_a_forecast_has_the_median_of_its_flights_and_bands_half_as_wide_again_as_theirs() -> None:
    flights = tuple(
        Flight(n, True, "", 3600.0 * n, 1000.0 + 10.0 * n, 8, 4.3297, 100.0, 50.0, rounds_s={3: 60.0 * n})
        for n in range(101)
    )
    forecast = Forecast("as planned", 0, ("a thing",), flights, 2.0)
    assert astuple(forecast.band("driven_m")) == pytest.approx((1500.0, 979.8, 2020.2, 773.25, 2226.75))
    ((number, done),) = forecast.rounds().items()
    assert number == 3
    assert astuple(done) == pytest.approx((3000.0, 0.0, 6121.2, 0.0, 7360.5))
    rows = dict(forecast.rows())
    assert rows["drives"] == "1,500 m; 68 %: 980 m to 2,020 m; 95 %: 773 m to 2,227 m"
    assert rows["samples"] == "8"
    assert rows["mean std"] == "4.33 ppb"
    assert rows["assumes"] == "a thing"
    assert "NOT DONE" not in rows
    failed = Flight(101, False, "no route", 1.0, 1.0, 4, 0.9, 1.0, 1.0)
    assert (
        dict(Forecast("as planned", 0, (), (*flights, failed), 1.0).rows())["NOT DONE"]
        == "1 of 102, for example: no route"
    )


def test_a_band_of_few_flights_has_all_of_them() -> None:
    same_but_one = Band.of([2946.0] * 19 + [2990.0])
    assert same_but_one.median == 2946.0
    assert same_but_one.high_68 < 2990.0 <= same_but_one.high_95


def test_two_forecasts_stand_side_by_side_and_differ_draw_by_draw() -> None:
    def forecast(name: str, further_m: float, *, fails: bool = False) -> Forecast:
        flights = [
            Flight(
                n,
                not fails,
                "no route",
                3600.0,
                100.0 * n + further_m,
                8,
                0.5,
                9.0,
                5.0,
                {},
                [],
                [(0.0, 9.0), (1.0, 7.0)],
            )
            for n in range(20)
        ]
        return Forecast(name, 0, (), tuple(flights), 1.0)

    one, other = forecast("as planned", 0.0), forecast("planner informative", 30.0, fails=True)
    assert astuple(other.minus(one, "driven_m")) == (30.0,) * 5
    rows = {name: texts for name, *texts in compared(one, other)}
    assert rows[""] == ["as planned", "planner informative", "difference"]
    assert rows["drives"] == ["950 m", "980 m", "+30 m"]
    assert rows["ends in"] == ["1 h 00 min", "1 h 00 min", "0 s"]
    assert rows["mean std"] == ["0.500 ppb", "0.500 ppb", "0.000 ppb"]
    assert {name: texts for name, *texts in compared(other, one)}["drives"][-1] == "-30 m"
    assert rows["NOT DONE"] == ["", "20 of 20, for example: no route", ""]
    at_s, charge = one.charges()[-1]
    assert (at_s, charge.median) == (3600.0, 7.0)


def test_an_alternative_is_a_planner_commands_or_both() -> None:
    both = parse_alternative("planner  rrtstar; abort-round\nkeep-out a 1,1 2,1 2,2")
    assert both.planner == "rrtstar"
    assert [command.kind for command in both.commands] == [CommandKind.ABORT_ROUND, CommandKind.SET_KEEP_OUT]
    assert both.name == "planner rrtstar; abort-round keep-out a 1,1 2,1 2,2"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "expected 'planner NAME' or a command such as 'abort-round', got ''"),
        ("planner x", "expected a planner among rrt, rrtstar, informative, tour; got 'x'"),
        ("pause", "expected a command after which the mission goes on, got 'pause'"),
        ("at 2h: resume", "expected a command without conditions and expiry"),
        ("resume --expires-in 9", "expected a command without conditions and expiry"),
        ("go-to 3", "go-to: expected X Y in metres, got 1 values"),
        ("x" * 2001, "expected at most 2000 characters, got 2001"),
        ("; ".join(["abort-round"] * 21), "expected at most 20 commands, got 21"),
    ],
)
def test_what_is_no_alternative_is_refused_in_one_line(text: str, why: str) -> None:
    with pytest.raises(InvalidInput, match=re.escape(why)):
        parse_alternative(text)


def test_a_rehearsed_alternative_begins_with_its_commands_and_its_planner() -> None:
    live = Live()
    live.until_samples(7)
    start = live.start()
    as_planned = fly(start, live.region, 0)
    otherwise = fly(start, live.region, 0, alternative=parse_alternative("planner informative; go-to 55 55"))
    assert otherwise.completed
    assert otherwise.driven_m > as_planned.driven_m
    assert min(np.hypot(x - 55.0, y - 55.0) for _, x, y in otherwise.track_m) < 1.0
    with pytest.raises(InvalidInput, match=r"^rehearsal: expected a target within 0\.\.60 m east"):
        fly(start, live.region, 0, alternative=parse_alternative("go-to 500 55"))
    assert live.start() == start
