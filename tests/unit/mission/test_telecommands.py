"""Telecommands from issue to end: rover, link and ground together, in every case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error
from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import decode, encode
from schemas.commands import (
    CommandKind,
    CommandList,
    CommandPreview,
    CommandStage,
    CommandStatus,
    NoParameters,
    Telecommand,
)
from schemas.ground import MissionPhase
from schemas.link import AtEdge, LinkChange
from schemas.telemetry import EventKind, RoverMode, RoverState
from schemas.topics import (
    COMMAND,
    EVENT,
    ISSUE_COMMAND,
    LINK_SET,
    LIST_COMMANDS,
    PREVIEW_COMMAND,
    STATE,
    TRACK,
    Side,
    Topic,
)
from schemas.wire import Header
from services.console.cli.command import command_lines
from services.field.node import build_node as build_field
from services.ground.map.snapshot import MapSnapshot
from services.ground.node import build_node as build_ground
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.link.node import build_node as build_link
from services.mission.in_process import InProcessMission
from services.mission.mission_time import SECOND
from services.mission.scenario import Scenario, checked_scenario
from services.rover.node import build_node as build_rover
from services.runtime.host import EventSink
from services.runtime.journal import identity_of

LIGHT_TIME_S = 1.282
WIDE = 80
CORNERS = ((12.0, 12.0), (68.0, 12.0), (68.0, 68.0), (12.0, 68.0))
ALL_GOES_WELL = ["queued", "released", "radiated", "received", "accepted", "started", "completed"]


def around(request: PlanningRequest) -> PlannedRound:
    """Straight to the corner of the site that is farthest from all samples."""
    known = request.observed_m if len(request.observed_m) else np.array([request.start_m])
    corner = max(CORNERS, key=lambda place: (np.hypot(*(known - place).T).min(), place))
    path = np.array([request.start_m, corner])
    shares = np.arange(1, request.samples + 1) / request.samples
    return PlannedRound(path, path[0] + shares[:, None] * (path[1] - path[0]), 1.0)


def flat_region(closed: tuple[slice, slice] | None = None) -> Region:
    """A square of 80 m without a slope; `closed`: rows and columns that a rover may not enter."""
    grid = SiteGrid(WIDE, WIDE, 1.0)
    east = np.linspace(4.0, 9.0, WIDE)[None, :].repeat(WIDE, axis=0)
    open_cells = np.ones(grid.shape, dtype=bool)
    if closed is not None:
        open_cells[closed] = False
    flat = np.zeros(grid.shape)
    return Region(
        name="flat", title="flat", provenance="made by a test", grid=grid, he3_ppb=east, orbital_ppb=east,
        elevation_m=flat, slope_deg=flat.copy(), traversable=open_cells,
    )  # fmt: skip


class Flown:
    """A mission in virtual time that receives commands; its reports are recorded."""

    def __init__(
        self,
        truth: Region | None = None,
        known: Region | None = None,
        unknown_keep_outs: Sequence[Sequence[tuple[float, float]]] = (),
        event_sink: EventSink | None = None,
        **sections: Any,
    ) -> None:
        """truth: the real terrain; known: the ground's map of it; unknown_keep_outs: those that only the rover has."""
        self.scenario: Scenario = checked_scenario(
            {
                "name": "commanded", "region": "t1", "rounds": 3, "samples_per_round": 2, "start_m": [40.0, 40.0],
                "ground": {"kernel": "matern52", **sections.pop("ground", {})}, **sections,
            },
            "test",
        )  # fmt: skip
        truth = truth or flat_region()
        ground = self.scenario.ground.model_copy(update={"keep_outs_m": tuple(unknown_keep_outs)})
        on_board = self.scenario.model_copy(update={"ground": ground}) if unknown_keep_outs else self.scenario
        self._builds: dict[str, Callable[[], Any]] = {
            "field": lambda: build_field(self.scenario, truth),
            "rover": lambda: build_rover(on_board, truth.grid),
            "link": lambda: build_link(self.scenario),
            "ground": lambda: build_ground(self.scenario, known or truth, around),
        }
        self.mission = InProcessMission(
            self.scenario, event_sink=event_sink, nodes=[build() for build in self._builds.values()]
        )
        self.simulation = self.mission.simulation
        self.simulation.keep_journals(("rover", "ground"), identity_of(self.scenario))
        self.events: list[EventKind] = []
        self.sent_up: list[bytes] = []
        self.state: RoverState | None = None
        self.simulation.tap(self._listen)

    def _listen(self, topic: Topic, side: Side, payload: bytes, _now: int) -> None:
        if topic is COMMAND and side is Side.EARTH:
            self.sent_up.append(payload)
        elif topic is EVENT and side is Side.MOON:
            header, body = decode(topic, payload, "commanded")
            self._heard_once(header, body.kind)
        elif topic is STATE and side is Side.MOON:
            self.state = decode(topic, payload, "commanded")[1]

    def _heard_once(self, header: Header, kind: EventKind) -> None:
        name = (header.incarnation, header.sequence)
        self._numbers = getattr(self, "_numbers", set())
        if name not in self._numbers:
            self._numbers.add(name)
            self.events.append(kind)

    def until(self, mode: RoverMode) -> None:
        """Step until the rover is in that mode."""
        bound = self.simulation.now + 20_000 * SECOND
        self.simulation.run(until=bound, stop=lambda: self.state is not None and self.state.mode is mode)
        assert self.state is not None
        assert self.state.mode is mode

    def command(self, kind: str, name: str = "c1", expires_in_s: float | None = None, **more: Any) -> CommandStatus:
        expires_at = None if expires_in_s is None else self.simulation.now + round(expires_in_s * SECOND)
        asked = Telecommand(command_id=name, kind=CommandKind(kind), expires_at=expires_at, **more)
        status: CommandStatus = self.simulation.ask(ISSUE_COMMAND, asked)
        return status

    def link(self, **change: Any) -> None:
        self.simulation.ask(LINK_SET, LinkChange(**change))

    def status(self, name: str = "c1") -> CommandStatus:
        listed: CommandList = self.simulation.ask(LIST_COMMANDS, NoParameters())
        return next(status for status in listed.commands if status.command.command_id == name)

    def stages(self, name: str = "c1") -> list[str]:
        return [report.stage.value for report in self.status(name).stages]

    def told(self, name: str = "c1") -> str:
        """The output of `he3 commands`."""
        return "\n".join(command_lines([self.status(name)]))

    def restart(self, name: str) -> None:
        self.simulation.kill(name)
        self.simulation.restart(self._builds[name]())

    def completes(self) -> None:
        """The mission continues to its end, with every sample once."""
        if self.state is not None and self.state.mode in (RoverMode.PAUSED, RoverMode.SAFE):
            self.command("resume", "the-last-resume")
        assert self.mission.run(until_s=40 * 3600.0) is MissionPhase.COMPLETED, self.mission.why()
        taken = [sample.sample_id for sample in self.simulation.ask(TRACK, NoParameters()).samples]
        assert len(set(taken)) == len(taken) == self.scenario.samples


def at(status: CommandStatus, stage: CommandStage) -> int:
    return next(report.at for report in status.stages if report.stage is stage)


SQUARE = ((5.0, 60.0), (9.0, 60.0), (9.0, 64.0), (5.0, 64.0))


# --- what goes well -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("pause", {}),
        ("abort_round", {}),
        ("go_to", {"target_m": (30.0, 20.0)}),
        ("return_to_start", {}),
        ("set_keep_out", {"area_id": "a", "polygon_m": SQUARE}),
        ("safe", {}),
    ],
)
def test_every_command_passes_all_its_stages_and_the_mission_goes_on(kind: str, more: dict[str, Any]) -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command(kind, **more)
    flown.simulation.run_for(2000.0)

    assert flown.stages() == ALL_GOES_WELL
    flown.completes()


def test_resume_passes_all_its_stages_after_a_pause_and_after_safe_mode() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    for number, hold in enumerate(("pause", "safe")):
        flown.command(hold, f"hold{number}")
        flown.simulation.run_for(1000.0)
        flown.command("resume", f"go{number}")
        flown.simulation.run_for(1000.0)
        assert flown.stages(f"go{number}") == ALL_GOES_WELL
    flown.completes()


def test_each_stage_is_known_on_earth_when_light_can_have_brought_it() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.simulation.run_for(0.5)
    issued = flown.simulation.now
    assert [report.stage.value for report in flown.command("pause").stages] == ["queued", "released"]
    flown.simulation.run_for(0.001)
    assert flown.stages() == ["queued", "released", "radiated"]
    flown.simulation.run(until=issued + round(2 * LIGHT_TIME_S * SECOND) - 1)
    assert flown.stages() == ["queued", "released", "radiated"]
    flown.simulation.run(until=issued + round(2 * LIGHT_TIME_S * SECOND))
    assert flown.stages()[:5] == ["queued", "released", "radiated", "received", "accepted"]
    status = flown.status()
    assert at(status, CommandStage.RADIATED) == issued
    assert at(status, CommandStage.RECEIVED) == issued + round(LIGHT_TIME_S * SECOND)


def test_a_command_that_waits_for_contact_is_radiated_when_contact_begins() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.link(contact=False, at_edge=AtEdge.HOLD)
    flown.command("pause")
    flown.simulation.run_for(1800.0)
    assert flown.stages() == ["queued", "released"]
    flown.link(contact=True)
    opened = flown.simulation.now
    flown.simulation.run_for(1000.0)

    assert flown.stages() == ALL_GOES_WELL
    assert at(flown.status(), CommandStage.RADIATED) == opened
    flown.completes()


# --- rejected -----------------------------------------------------------------------------------------------------


Orders = list[tuple[str, dict[str, Any]]]
WIDE_AREA = ((8.0, 50.0), (30.0, 50.0), (30.0, 70.0), (8.0, 70.0))


def rejections() -> list[tuple[str, Orders, str, dict[str, Any], str, tuple[Any, ...]]]:
    """Name of the case, commands before it, the command, the reason, and keep-outs that the ground does not know."""
    return [
        ("nothing held", [], "resume", {}, "neither", ()),
        ("safe already", [("safe", {})], "pause", {}, "in safe mode already", ()),
        ("target in a keep-out", [], "go_to", {"target_m": (7.0, 62.0)}, "within a keep-out", (SQUARE,)),
        ("way through a keep-out", [("pause", {})], "go_to", {"target_m": (2.0, 68.0)}, "keep-out scenario-1",
         (WIDE_AREA,)),
        ("no such keep-out", [], "set_keep_out", {"area_id": "c"}, "there is no keep-out c to remove", ()),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("before", "kind", "more", "why", "unknown"), [row[1:] for row in rejections()], ids=lambda _: ""
)
def test_a_command_that_makes_no_sense_on_the_moon_is_rejected_and_says_why(
    before: Orders, kind: str, more: dict[str, Any], why: str, unknown: tuple[Any, ...]
) -> None:
    flown = Flown(unknown_keep_outs=unknown)
    flown.until(RoverMode.DRIVING)
    for number, (first, its) in enumerate(before):
        flown.command(first, f"before{number}", **its)
        flown.simulation.run_for(1000.0)
    flown.command(kind, **more)
    flown.simulation.run_for(10.0)

    assert flown.stages() == ["queued", "released", "radiated", "received", "rejected"]
    assert why in flown.told()
    flown.completes()


def test_the_rover_knows_the_scenarios_keep_outs_under_the_ids_that_the_ground_gives_them() -> None:
    far_off = ((70.0, 2.0), (76.0, 2.0), (76.0, 8.0))
    flown = Flown(unknown_keep_outs=(far_off, SQUARE))
    flown.until(RoverMode.DRIVING)
    flown.command("go_to", target_m=(7.0, 62.0))
    flown.command("set_keep_out", "open", area_id="scenario-2")
    flown.simulation.run_for(10.0)
    flown.command("go_to", "again", target_m=(7.0, 62.0))
    flown.simulation.run_for(10.0)

    assert flown.stages()[-1] == "rejected"
    assert "within a keep-out" in flown.told()
    assert flown.stages("open")[-1] == "completed"
    assert "rejected" not in flown.stages("again")
    flown.completes()


def closed_on_the_ground(flown: Flown) -> bool:
    shown = flown.simulation.snapshots["ground"]
    assert isinstance(shown, MapSnapshot)
    return not shown.traversable[62, 7]


def test_a_keep_out_is_open_on_the_ground_when_the_rover_has_removed_it_and_not_before() -> None:
    flown = Flown(ground={"keep_outs_m": [SQUARE]})
    flown.until(RoverMode.DRIVING)
    assert closed_on_the_ground(flown)
    flown.command("set_keep_out", area_id="scenario-1")
    flown.simulation.run_for(LIGHT_TIME_S)
    assert closed_on_the_ground(flown)
    flown.simulation.run_for(10.0)
    assert flown.stages() == ALL_GOES_WELL
    assert not closed_on_the_ground(flown)
    flown.completes()


def test_a_removal_that_comes_after_its_time_leaves_the_area_closed_on_the_ground() -> None:
    flown = Flown(ground={"keep_outs_m": [SQUARE]})
    flown.until(RoverMode.DRIVING)
    flown.link(one_way_light_time_s=20.0)
    flown.command("set_keep_out", expires_in_s=10.0, area_id="scenario-1")
    flown.simulation.run_for(100.0)
    assert flown.stages()[-1] == "expired"
    assert closed_on_the_ground(flown)


def test_a_removal_that_the_rover_rejects_leaves_the_area_closed_on_the_ground() -> None:
    flown = Flown(ground={"keep_outs_m": [SQUARE]})
    flown.until(RoverMode.DRIVING)
    flown.command("safe")
    flown.simulation.run_for(10.0)
    header, _ = decode(COMMAND, flown.sent_up[0], "commanded")
    word = Telecommand(command_id="w", kind=CommandKind.SET_KEEP_OUT, area_id="scenario-1", polygon_m=SQUARE)
    flown.command("set_keep_out", "removed", area_id="scenario-1")
    flown.simulation.run_for(0.5)
    newer = header.model_copy(update={"incarnation": 0, "made_at": flown.simulation.now})
    flown.simulation.inject(COMMAND, Side.MOON, encode(newer, word))
    flown.simulation.run_for(100.0)
    assert flown.stages("removed")[-1] == "rejected"
    assert closed_on_the_ground(flown)


def test_a_restarted_rover_keeps_what_became_of_the_scenarios_keep_outs() -> None:
    flown = Flown(unknown_keep_outs=(((70.0, 2.0), (76.0, 2.0), (76.0, 8.0)), SQUARE))
    flown.until(RoverMode.DRIVING)
    flown.command("set_keep_out", "open", area_id="scenario-1")
    flown.simulation.run_for(10.0)
    flown.restart("rover")
    flown.command("set_keep_out", "twice", area_id="scenario-1")
    flown.command("go_to", target_m=(7.0, 62.0))
    flown.simulation.run_for(10.0)

    assert "no keep-out scenario-1" in flown.told("twice")
    assert "within a keep-out" in flown.told()
    flown.completes()


def test_no_round_can_be_aborted_before_the_first() -> None:
    flown = Flown()
    flown.simulation.run_for(1.0)
    flown.command("abort_round")
    flown.simulation.run_for(10.0)

    assert flown.stages()[-1] == "rejected"
    assert "no round is under way" in flown.told()
    flown.completes()


def test_what_can_be_seen_to_be_wrong_on_earth_is_refused_there_and_never_goes_up() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    with pytest.raises(He3Error, match="expected a target within"):
        flown.command("go_to", target_m=(500.0, 10.0))
    with pytest.raises(He3Error, match="expected an expiry ahead"):
        flown.command("pause", expires_in_s=-5.0)
    flown.simulation.run_for(100.0)

    assert flown.sent_up == []


# --- previewed -----------------------------------------------------------------------------------------------------


def previewed(flown: Flown, kind: str, **more: Any) -> CommandPreview:
    asked = Telecommand(command_id="what-if", kind=CommandKind(kind), **more)
    preview: CommandPreview = flown.simulation.ask(PREVIEW_COMMAND, asked)
    return preview


def test_a_preview_says_what_then_happens() -> None:
    flown = Flown()
    flown.until(RoverMode.DRILLING)
    flown.simulation.run_for(LIGHT_TIME_S + 1.0)
    said = previewed(flown, "go_to", target_m=(30.0, 20.0))
    before = flown.mission.status
    assert before is not None
    assert before.rover is not None
    assert said.path_m == ((before.rover.x_m, before.rover.y_m), (30.0, 20.0))
    assert (said.objection, said.warning, said.closed_cells) == ("", "", 0)
    assert said.rounds_given_up == (1,)
    assert said.samples_given_up == 2
    flown.command("go_to", target_m=(30.0, 20.0))
    flown.simulation.run(until=flown.simulation.now + 20_000 * SECOND, stop=lambda: "completed" in flown.stages())
    status = flown.status()
    took_s = (at(status, CommandStage.COMPLETED) - at(status, CommandStage.STARTED)) / SECOND
    assert said.drive_s is not None
    assert took_s == pytest.approx(said.drive_s, rel=0.02)
    assert EventKind.ROUND_ABORTED in flown.events
    assert flown.mission.status is not None
    assert flown.mission.status.driven_m - before.driven_m == pytest.approx(said.drive_m, abs=0.01)
    flown.completes()


def test_a_preview_names_objections_of_the_ground_and_doubts_about_the_rover() -> None:
    flown = Flown(ground={"keep_outs_m": [SQUARE]})
    assert "nothing was heard of the rover yet" in previewed(flown, "resume").warning
    flown.until(RoverMode.DRIVING)
    flown.simulation.run_for(100.0)
    assert "expected a target on open ground" in previewed(flown, "go_to", target_m=(7.0, 62.0)).objection
    assert "expected a target within" in previewed(flown, "go_to", target_m=(500.0, 1.0)).objection
    assert "expected a rover that is paused" in previewed(flown, "resume").warning
    assert "no keep-out c to remove" in previewed(flown, "set_keep_out", area_id="c").warning
    removal = previewed(flown, "set_keep_out", area_id="scenario-1")
    assert (removal.warning, removal.cells_to_close, removal.cells_to_open) == ("", 0, 25)
    ahead = previewed(flown, "set_keep_out", area_id="a", polygon_m=((60.0, 60.0), (64.0, 60.0), (64.0, 64.0)))
    assert (ahead.rounds_given_up, ahead.cells_to_close) == ((1,), 15)
    home = previewed(flown, "return_to_start")
    assert home.path_m[-1] == (40.0, 40.0)
    assert home.drive_m == pytest.approx(np.hypot(*(np.subtract(home.path_m[0], home.path_m[-1]))))


def test_previews_leave_no_trace_in_the_mission() -> None:
    def log(asks: bool) -> list[str]:
        lines: list[str] = []
        flown = Flown(event_sink=lambda now, node, what: lines.append(f"{now} {node} {what}"))
        flown.until(RoverMode.DRIVING)
        for kind in ("pause", "safe", "return_to_start", "abort_round") if asks else ():
            previewed(flown, kind)
        flown.completes()
        return lines

    undisturbed = log(asks=False)
    assert undisturbed
    assert log(asks=True) == undisturbed


# --- expired, late, lost ------------------------------------------------------------------------------------------


def test_a_command_that_comes_after_its_time_expires_and_is_not_executed() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("pause", expires_in_s=1.0)
    flown.simulation.run_for(1000.0)

    assert flown.stages() == ["queued", "released", "radiated", "received", "expired"]
    assert "it came after its time" in flown.told()
    assert EventKind.PAUSED not in flown.events
    flown.completes()


def test_an_accepted_command_expires_when_no_safe_point_comes_in_time() -> None:
    flown = Flown()
    flown.until(RoverMode.DRILLING)
    flown.command("pause", expires_in_s=20.0)
    flown.simulation.run_for(2000.0)

    assert flown.stages() == ["queued", "released", "radiated", "received", "accepted", "expired"]
    assert "no safe point came in time" in flown.told()
    assert EventKind.PAUSED not in flown.events
    flown.completes()


@pytest.mark.parametrize("edge", [AtEdge.HOLD, AtEdge.DROP])
def test_a_command_whose_window_passes_without_contact_is_lost_and_never_executed(edge: AtEdge) -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.link(contact=False, at_edge=edge)
    flown.command("safe", expires_in_s=300.0)
    flown.simulation.run_for(3600.0)
    assert flown.stages() == ["queued", "released", "lost"]
    assert "without a report from the rover" in flown.told()

    flown.link(contact=True)
    flown.simulation.run_for(3600.0)
    assert flown.stages()[-1] == "expired"
    assert EventKind.SAFE_MODE_ENTERED not in flown.events
    flown.completes()


def test_a_command_that_comes_late_but_in_time_is_carried_out() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.link(contact=False, at_edge=AtEdge.DROP)
    flown.command("pause", expires_in_s=10_000.0)
    flown.simulation.run_for(3600.0)
    assert flown.stages() == ["queued", "released"]
    flown.link(contact=True)
    flown.simulation.run_for(4000.0)

    assert [stage for stage in flown.stages() if stage != "radiated"] == [
        stage for stage in ALL_GOES_WELL if stage != "radiated"
    ]
    assert flown.events.count(EventKind.PAUSED) == 1
    flown.completes()


# --- duplicated, out of order ---------------------------------------------------------------------------------------


def test_a_command_that_the_link_doubles_and_loses_is_executed_once() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.link(duplicate=1.0, loss=0.5)
    for number in range(4):
        flown.command("pause", f"hold{number}")
        flown.simulation.run_for(1500.0)
        flown.command("resume", f"go{number}")
        flown.simulation.run_for(1500.0)

    for name in ("hold", "go"):
        for number in range(4):
            assert flown.stages(f"{name}{number}")[-1] == "completed"
    assert flown.events.count(EventKind.PAUSED) == flown.events.count(EventKind.RESUMED) == 4
    flown.completes()


def test_an_operator_who_repeats_a_command_gets_its_status_and_sends_nothing() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("pause")
    flown.simulation.run_for(1000.0)
    sent = len(flown.sent_up)
    assert [report.stage.value for report in flown.command("pause").stages] == ALL_GOES_WELL
    with pytest.raises(He3Error, match="expected a new id, got that of another command"):
        flown.command("safe")
    flown.simulation.run_for(1000.0)

    assert len(flown.sent_up) == sent
    assert flown.events.count(EventKind.PAUSED) == 1
    flown.completes()


def test_a_command_that_somebody_plays_again_on_the_moon_is_reported_on_and_not_executed() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("pause")
    flown.simulation.run_for(1000.0)
    flown.command("resume", "c2")
    flown.simulation.run_for(1000.0)
    header, body = decode(COMMAND, flown.sent_up[0], "commanded")
    again = header.model_copy(update={"incarnation": 9, "sequence": 0, "held_from": 0, "checksum": None})
    flown.simulation.inject(COMMAND, Side.MOON, encode(again, body))
    flown.simulation.run_for(1000.0)

    assert flown.stages() == ALL_GOES_WELL
    assert flown.events.count(EventKind.PAUSED) == 1
    flown.completes()


def test_commands_that_overtake_each_other_on_the_link_are_executed_in_the_order_of_the_operators_words() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.link(reorder=0.7, one_way_light_time_s=30.0)
    for number in range(6):
        flown.command("pause" if number % 2 == 0 else "resume", f"c{number}")
        flown.simulation.run_for(1.0)
    flown.simulation.run_for(2000.0)

    started = [at(flown.status(f"c{number}"), CommandStage.RECEIVED) for number in range(6)]
    assert started == sorted(started)
    assert {flown.stages(f"c{number}")[-1] for number in range(6)} == {"completed"}
    assert flown.state is not None
    assert flown.state.mode is not RoverMode.PAUSED
    flown.completes()


def test_a_command_that_comes_after_one_made_later_is_rejected() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("pause", "c2")
    flown.simulation.run_for(1000.0)
    header, _ = decode(COMMAND, flown.sent_up[0], "commanded")
    old = header.model_copy(update={"source": "ground", "incarnation": 0, "made_at": header.made_at - SECOND})
    late = Telecommand(command_id="old", kind=CommandKind.RESUME)
    flown.simulation.inject(COMMAND, Side.MOON, encode(old, late))
    flown.simulation.run_for(100.0)

    assert flown.state is not None
    assert flown.state.mode is RoverMode.PAUSED
    flown.completes()


# --- failed, restarted ----------------------------------------------------------------------------------------------


def test_an_errand_that_meets_closed_ground_fails_and_the_ground_plans_around_it() -> None:
    wall = (slice(20, 24), slice(20, 60))
    flown = Flown(truth=flat_region(wall), known=flat_region())
    flown.until(RoverMode.DRIVING)
    flown.command("go_to", target_m=(40.0, 5.0))
    flown.simulation.run_for(3000.0)

    assert flown.stages() == [*ALL_GOES_WELL[:-1], "failed"]
    assert "closed terrain ahead" in flown.told()


def test_an_errand_fails_when_the_operator_sends_the_rover_elsewhere() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("go_to", "first", target_m=(70.0, 70.0))
    flown.simulation.run_for(200.0)
    flown.command("go_to", "second", target_m=(20.0, 20.0))
    flown.simulation.run_for(3000.0)

    assert flown.stages("first")[-1] == "failed"
    assert "go_to second" in flown.told("first")
    assert flown.stages("second") == ALL_GOES_WELL
    flown.completes()


@pytest.mark.parametrize("name", ["ground", "rover", "link"])
def test_a_command_under_way_outlives_the_restart_of_any_process_and_is_executed_once(name: str) -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("pause")
    flown.simulation.run_for(0.6)
    flown.restart(name)
    flown.simulation.run_for(3000.0)

    ends = [stage for stage in flown.stages() if stage != "radiated"]
    assert ends == [stage for stage in ALL_GOES_WELL if stage != "radiated"]
    assert flown.events.count(EventKind.PAUSED) == 1
    flown.completes()


def test_waiting_for_a_stage_ends_with_it_with_a_later_one_and_with_any_end() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    status = flown.command("pause")
    assert status.has_reached(CommandStage.RELEASED)
    assert not status.has_reached(CommandStage.RADIATED)
    flown.simulation.run_for(1000.0)
    seen = flown.status()
    unseen = seen.model_copy(update={"stages": tuple(r for r in seen.stages if r.stage is not CommandStage.RADIATED)})
    assert unseen.has_reached(CommandStage.RADIATED)
    assert unseen.has_reached(CommandStage.COMPLETED)


def test_what_became_of_a_command_can_be_read_without_a_log() -> None:
    flown = Flown()
    flown.until(RoverMode.DRIVING)
    flown.command("pause", "hold-it", expires_in_s=3600.0)
    flown.simulation.run_for(1000.0)
    lines = flown.told("hold-it").splitlines()

    assert lines[0].startswith("hold-it  pause, expires 2030-01-01")
    assert [line.split()[-1] for line in lines[1:]] == ALL_GOES_WELL
