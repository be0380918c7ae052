"""The cost of light time and black-outs in mission time and map error, stop-and-wait compared with pipelined.

The same mission, from the same seed, for each light time (0 s, the Moon at 1.28 s, studied relays at 3 and 5 s, Mars at
20 min) and for each share of the time without contact; each run twice: stop-and-wait, where every round waits for the
samples of the last to be in the map, and pipelined, where the next rounds are on board before it ends. All in virtual
time, with the real nodes, custody and link, so that light time is exact.

    mission_time_s   until the last sample is in the map
    rmse_ppb         of the final map against the reference, all cells
    blackout         share of the time without contact, in periods of four hours; messages sent in it wait
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.flights import written
from benchmarks.tasks import Tasks, progress
from he3.errors import He3Error, InvalidInput
from schemas.ground import MissionPhase
from services.ground.planner_process import PlannerProcess
from services.mission.in_process import InProcessMission
from services.mission.scenario import Scenario, checked_scenario
from services.runtime.scheduler import Executor

MOON_S = 1.282
"""Light time of the black-out rows: the Moon at its mean distance."""
LIGHT_TIMES_S = (0.0, MOON_S, 3.0, 5.0, 1200.0)
BLACKOUTS = (0.25, 0.5)
PERIOD_S = 4 * 3600.0
"""A black-out of half the time lasts two hours."""
SLACK_S = 60 * 86400.0
WAITING, AHEAD = "#c2410c", "#1d4ed8"
"""Colours of stop-and-wait and of the pipeline."""

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """One mission of the study."""

    light_time_s: float
    blackout: float
    pipeline: int
    planner: str
    region: str
    seed: int
    rounds: int


def run(
    json: Path | None = None,
    out: Path | None = None,
    light_times: Sequence[float] = LIGHT_TIMES_S,
    blackouts: Sequence[float] = BLACKOUTS,
    pipeline: int = 2,
    planner: str = "rrtstar",
    region: str = "t1",
    seed: int = 1,
    rounds: int = 30,
    jobs: int = 2,
    engine: str = "local",
    store: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """A row for each light time and black-out, stop-and-wait and pipelined; printed, written, and drawn as `delay.png`.

    engine, store: as `he3 campaign run` takes them; with a store, a run that was ended goes on. Raises InvalidInput for
    a depth that is no pipeline, a black-out that never ends, or no light time to compare.
    """
    if pipeline < 1 or jobs < 1:
        raise InvalidInput(f"expected a pipeline of one round and one job at least, got {pipeline} and {jobs}")
    if any(not 0 <= share < 1 for share in blackouts):
        raise InvalidInput(f"expected black-outs from 0 to below 1 of the time, got {', '.join(map(str, blackouts))}")
    if 0.0 not in light_times:
        raise InvalidInput(f"expected a light time of 0 to compare with, got {', '.join(map(str, light_times))}")
    conditions = [(light_time, 0.0) for light_time in light_times] + [(MOON_S, share) for share in blackouts if share]
    cases = [
        Case(light_time, share, depth, planner, region, seed, rounds)
        for light_time, share in conditions
        for depth in (0, pipeline)
    ]
    cases.sort(key=lambda case: case.pipeline)  # neighbours share plans
    found: dict[Case, Row] = {}
    with Tasks(jobs, engine, store) as pool:
        for case, row in pool.results(flown, cases):
            found[case] = row
            progress(f"  {len(found):>3}/{len(cases)}  {_line(row)}")
        rows = [found[case] for case in sorted(cases, key=lambda case: case.pipeline) if case in found]
        say(
            f"{'light time':>10} {'black-out':>9} {'pipeline':>8} {'mission time':>13} {'RMSE':>8} {'samples':>7} "
            f"{'ratio':>8}"
        )
        for row in rows:
            base = next(each for each in rows if each["pipeline"] == row["pipeline"])
            say(f"{_line(row)} {row['mission_time_s'] / base['mission_time_s']:>8.4f}")
        written(rows, json, say, pool)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        say(str(_drawn(rows, out / "delay.png")))
    return rows


def _line(row: Row) -> str:
    return (
        f"{row['light_time_s']:>8g} s {row['blackout']:>9.0%} {row['pipeline']:>8} "
        f"{row['mission_time_s'] / 3600:>11.3f} h {row['rmse_ppb']:>8.4f} {row['samples']:>7}"
    )


def scenario_of(case: Case) -> Scenario:
    """The mission of that case: missions differ only in light time, contact and pipeline."""
    link: dict[str, Any] = {way: {"one_way_light_time_s": case.light_time_s} for way in ("up", "down")}
    if case.blackout:
        link["duty_cycle"] = {"period_s": PERIOD_S, "contact_s": round(PERIOD_S * (1 - case.blackout), 3)}
    return checked_scenario(
        {
            "name": "delay",
            "region": case.region,
            "seed": case.seed,
            "rounds": case.rounds,
            "samples_per_round": 5,
            # Reported once an hour: what is of no use here need not be simulated.
            "rover": {"state_period_s": 3600.0},
            "ground": {"planner": case.planner, "pipeline": case.pipeline, "status_period_s": 3600.0},
            "link": link,
        },
        "delay",
    )


class Remembering:
    """An executor that caches results, because a result is a function of the arguments alone.

    Light time changes the time of a planning request, not its content, so the missions of a study share most plans.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._known: dict[bytes, Future[Any]] = {}

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        query = sha256(pickle.dumps((function, arguments))).digest()
        if query not in self._known:
            self._known[query] = self._executor.submit(function, *arguments)
        return self._known[query]


def flown(case: Case) -> Row:
    """The row of that case. The missions that one worker process flies share their plans."""
    return fly(case, _remembering())


@cache
def _remembering() -> Remembering:
    return Remembering(PlannerProcess(parallel=1))


def fly(case: Case, executor: Executor) -> Row:
    """The figures of that case's mission; raises He3Error if it does not end with all samples."""
    scenario = scenario_of(case)
    began = time.monotonic()
    mission = InProcessMission(scenario, executor)
    end = mission.run(until_s=SLACK_S)
    status = mission.status
    assert status is not None, "the ground has reported the end of the mission"
    if end is not MissionPhase.COMPLETED or status.samples != scenario.samples or status.score is None:
        raise He3Error(f"light time {case.light_time_s:g} s, pipeline {case.pipeline}: {end.value}: {mission.why()}")
    return {
        "light_time_s": case.light_time_s,
        "blackout": case.blackout,
        "pipeline": case.pipeline,
        "mission_time_s": mission.mission_time_s,
        "rmse_ppb": status.score.rmse_ppb,
        "samples": status.samples,
        "path_length_m": status.driven_m,
        "planner": case.planner,
        "region": case.region,
        "seed": case.seed,
        "wall_time_s": time.monotonic() - began,
    }


# --- the picture ------------------------------------------------------------------------------------------------


def _drawn(rows: Sequence[Row], path: Path) -> Path:
    """The picture file: mission hours and error over light time, and over the share without contact."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9.0, "axes.titlesize": 10.0, "legend.frameon": False}):
        figure = Figure(figsize=(9.2, 5.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 2, sharex="col", sharey="row", gridspec_kw={"width_ratios": [3, 2]})
        by_light_time = [row for row in rows if not row["blackout"]]
        by_blackout = [row for row in rows if row["light_time_s"] == MOON_S]
        for column, (some, key) in enumerate(((by_light_time, "light_time_s"), (by_blackout, "blackout"))):
            for style, few in _kinds(some):
                few = sorted(few, key=lambda row: float(row[key]))
                places = range(len(few)) if column == 0 else [100 * row["blackout"] for row in few]
                axes[0][column].plot(places, [row["mission_time_s"] / 3600 for row in few], **style)
                axes[1][column].plot(places, [row["rmse_ppb"] for row in few], **style)
        fastest = min(row["mission_time_s"] for row in rows)
        longest = max(row["mission_time_s"] for row in rows)
        for column, (some, key) in enumerate(((by_light_time, "light_time_s"), (by_blackout, "blackout"))):
            places = sorted({float(row[key]) for row in some})
            for row in some:
                place = places.index(row[key]) if column == 0 else 100 * row["blackout"]
                more = row["mission_time_s"] / fastest - 1
                axes[0][column].annotate(
                    f"+{more:.3%}" if 1e-6 < more < 1e-4 else f"+{more:.2%}" if more > 1e-6 else "fastest",
                    (place, row["mission_time_s"] / 3600),
                    xytext=(0, -15 if row["pipeline"] else 9),
                    textcoords="offset points",
                    ha="center",
                    color=AHEAD if row["pipeline"] else WAITING,
                    fontsize=8,
                )
            axes[0][column].margins(x=0.16)
        axes[0][0].set_ylim(0, 1.15 * longest / 3600)
        times = sorted({row["light_time_s"] for row in by_light_time})
        axes[1][0].set_xticks(range(len(times)), [_duration(seconds) for seconds in times])
        axes[1][0].set_xlabel("one-way light time")
        axes[1][1].set_xlabel(f"share of the time without contact [%], periods of {PERIOD_S / 3600:g} h")
        axes[0][0].set_ylabel("mission time [h]")
        axes[1][0].set_ylabel("RMSE [ppb]")
        axes[0][0].set_title("Light time, always in contact")
        axes[0][1].set_title(f"Black-outs at {MOON_S:g} s")
        axes[1][0].set_ylim(bottom=0)
        for row in axes:
            for axis in row:
                axis.grid(color="#d9dde2", linewidth=0.6)
                axis.spines[["top", "right"]].set_visible(False)
        axes[0][0].legend(loc="lower left")
        figure.suptitle(f"{rows[0]['samples']} samples on {rows[0]['region']}, planner {rows[0]['planner']}")
        figure.savefig(path, dpi=150)
    return path


def _kinds(rows: Iterable[Row]) -> Iterator[tuple[dict[str, Any], list[Row]]]:
    waiting = [row for row in rows if not row["pipeline"]]
    ahead = [row for row in rows if row["pipeline"]]
    if waiting:
        hollow = {"markerfacecolor": "white", "markersize": 9.0}
        yield {"color": WAITING, "marker": "s", "linestyle": "--", "label": "stop-and-wait", **hollow}, waiting
    if ahead:
        depth = ahead[0]["pipeline"]
        label = f"pipelined, {depth} round{'s' * (depth > 1)} on board"
        yield {"color": AHEAD, "marker": "o", "linestyle": "-", "label": label}, ahead


def _duration(seconds: float) -> str:
    return f"{seconds / 60:g} min" if seconds >= 60 else f"{seconds:g} s"


if __name__ == "__main__":
    run()
