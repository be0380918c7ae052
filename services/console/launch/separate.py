"""A whole mission in separate processes over Zenoh, from the start of the services to the report."""

from __future__ import annotations

import re
import secrets
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import He3Error, InvalidInput
from services.console.client.mission_client import MissionClient
from services.console.client.run_file import RunningMission, announced
from services.console.launch.endpoints import Endpoints, endpoints_near, endpoints_of
from services.console.launch.launcher import Launcher
from services.console.launch.terrain_facts import terrain_facts
from services.console.report.mission_report import Outcome, Run, gather
from services.console.report.outputs import Outputs, Written, claimed, make_folder, write_outcome
from services.console.report.progress import Progress, moment_now
from services.mission.in_process import build_nodes
from services.mission.processes import GROUND, LINK, PROCESSES, RECORDER, ROVER, VITAL
from services.mission.regions import load_region
from services.runtime.event_log import lacks_of_merged
from services.runtime.files.output import replace_output

if TYPE_CHECKING:
    from he3.reference import Region
    from schemas.ground import GroundStatus
    from services.console.client.mission_state import MissionState
    from services.console.launch.scenarios import Chosen
    from services.mission.scenario import Scenario

DISPLAYS_WITHIN_S = 5.0
"""Longest wall time [s] for which the services outlast the mission so that displays get the last map."""
LOOK_EVERY_S = 0.1
"""Wall time [s] within which the end of a service or of the mission is noticed."""


def run_separate(
    chosen: Chosen, where: Outputs, progress: Progress, lockstep: bool = False, events: Path | None = None
) -> Written:
    """The report of the mission, run to its end in separate processes, and the files written.

    events: where the merged event logs of all services go.
    A mission that fails has a report too. Raises InvalidInput before anything is started or removed, He3Error when a
    service dies.
    """
    region = checked_region(chosen.scenario)
    with claimed(where, events):
        if events is None:
            outcome, problems, _ = _run_separate(chosen, region, where, progress, lockstep, None)
        else:
            with tempfile.TemporaryDirectory(prefix="he3-events-") as parts:
                outcome, problems, lacks = _run_separate(chosen, region, where, progress, lockstep, Path(parts))
                lacks = [f"{events}: not written, as a part of it is not whole: {each}" for each in lacks]
                problems += lacks_of_merged(Path(parts).iterdir(), events, lacks)
        return write_outcome(outcome, region, where, events, problems)


def _run_separate(
    chosen: Chosen, region: Region, where: Outputs, progress: Progress, lockstep: bool, events: Path | None
) -> tuple[Outcome, list[str], list[str]]:
    """The outcome of the mission, and one line on a recording and on each event log that could not be written whole."""
    scenario = chosen.scenario
    began = time.monotonic()
    wanted = endpoints_of(chosen)
    viewer = None if chosen.keys is None else chosen.keys.viewer
    with (  # noqa: SIM117 - two things end apart
        endpoints_near(wanted) as near,
        services_of(chosen, where, near, lockstep=lockstep, events=events) as (launcher, endpoints),
    ):
        with (
            MissionClient.when_up(
                endpoints.earth, scenario.name, launcher.check, identity=viewer, insecure=chosen.insecure
            ) as client,
            progress,
        ):
            try:
                displays = client.displays()
                state = client.state(start_ns=scenario.start_ns)
                status = _watched_to_its_end(state, launcher, progress)
                outcome = outcome_of(client, state, status, scenario, region, began, lockstep)
                displays.wait_until_gone(DISPLAYS_WITHIN_S)
            finally:
                launcher.tell_to_end()  # they end while this session closes, which takes a second without a router
    problem = launcher.failure("recorder")
    problems = []
    if problem is not None:
        problems = [problem if str(where.recording) in problem else f"{where.recording}: not complete: {problem}"]
    if events is None:
        return outcome, problems, []
    failures = [launcher.failure(each.name) for each in PROCESSES if each is not RECORDER]
    return outcome, problems, [each for each in failures if each is not None]


def outcome_of(
    client: MissionClient,
    state: MissionState,
    status: GroundStatus,
    scenario: Scenario,
    region: Region,
    began: float,
    lockstep: bool,
) -> Outcome:
    """The outcome of a mission that is over, as its ground has it; began: by `time.monotonic`."""
    driver, rate = ("lockstep", None) if lockstep else ("zenoh", scenario.rate)
    wall_time_s = time.monotonic() - began
    run = Run(
        driver,
        rate,
        region.provenance,
        state.status_time_s,
        wall_time_s,
        region.layers,
        *terrain_facts(scenario, region),
    )
    return gather(client, scenario, status, run)


def checked_region(scenario: Scenario) -> Region:
    """The region of that scenario, after a check that builds its nodes here as the services will.

    Raises InvalidInput, in one line, for a scenario that one of the services would refuse.
    """
    region = load_region(scenario.region, scenario.field.field_seed)
    build_nodes(scenario, region=region)
    return region


@contextmanager
def services_of(
    chosen: Chosen,
    where: Outputs,
    endpoints: Endpoints,
    *,
    lockstep: bool = False,
    pace: float | None = None,
    events: Path | None = None,
    journal: Path | None = None,
    log_to_terminal: bool = False,
) -> Iterator[tuple[Launcher, Endpoints]]:
    """All services of the scenario, running and announced on this machine; all gone afterwards.

    pace: in lockstep, mission seconds per wall second at most. Their logs go to the terminal, beside the other files,
    or into a temporary folder that an error's line quotes from.
    """
    with ExitStack() as stack:
        logs: Path | None
        if log_to_terminal:
            logs = None
        elif where.folder is None:
            logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="he3-logs-")))
        else:
            logs = make_folder(where.folder / "logs")
            for old in logs.glob("*.log"):
                old.unlink()
        flags = (
            *chosen.flags,
            *(("--lockstep",) if lockstep else ()),
            *(("--insecure",) if chosen.insecure else ()),
        )
        audit = None if where.folder is None else make_folder(where.folder / "audit")
        service_flags = _service_flags(chosen, lockstep, pace, events, journal, audit)
        launcher = stack.enter_context(
            Launcher(chosen.path, endpoints, flags, recording=where.recording, logs=logs, service_flags=service_flags)
        )
        running = RunningMission(
            chosen.scenario.name,
            str(chosen.path),
            endpoints.moon,
            endpoints.earth,
            launcher.own_pid,
            launcher.pids,
            "" if chosen.keys is None else str(chosen.keys.viewer.absolute()),
            chosen.insecure,
        )
        stack.enter_context(announced(running))
        yield launcher, endpoints


def _service_flags(
    chosen: Chosen,
    lockstep: bool,
    pace: float | None,
    events: Path | None,
    journal: Path | None,
    audit: Path | None,
) -> dict[str, Sequence[str]]:
    """Flags that differ from service to service: identity, end of the mission in lockstep, event log, journal."""
    flags: dict[str, list[str]] = {each.name: [] for each in PROCESSES}
    if chosen.keys is not None:
        instance = _instance(journal)
        for name, identity in chosen.keys.processes.items():
            flags[name] += ["--identity", str(identity), "--instance", instance]
    if lockstep:
        flags[LINK.name] += ["--stop-when", GROUND.name]
    if lockstep and pace is not None:
        flags[LINK.name] += ["--pace", str(pace)]
    if events is not None:
        for name in VITAL:
            flags[name] += ["--events", str(events / f"{name}.log")]
    if journal is not None:
        for name in VITAL:
            flags[name] += ["--journal", str(journal)]
    if audit is not None:
        for name in (LINK.name, ROVER.name, GROUND.name):
            flags[name] += ["--audit", str(audit / f"{name}.jsonl")]
    return dict(flags)


def _instance(journal: Path | None) -> str:
    """A name for this run of the mission, for signatures: a new one, or that of the run which the journals continue."""
    new = f"run-{secrets.token_hex(8)}"
    if journal is None:
        return new
    path = make_folder(journal) / "instance"
    try:
        if not path.exists():
            replace_output(path, new.encode())
        kept = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise He3Error(f"{path}: cannot read or write the name of the run: {error}") from None
    if not re.fullmatch(r"run-[0-9a-f]{16}", kept):
        raise InvalidInput(f"{path}: expected the name of a run, got something else")
    return kept


def _watched_to_its_end(state: MissionState, launcher: Launcher, progress: Progress) -> GroundStatus:
    while True:
        status = state.status
        if status is not None and status.is_over:
            return status
        if state.time.elapsed_s():
            for line in launcher.check_vital():
                print(f"he3: {line}", file=sys.stderr)
        else:
            launcher.check()
        progress.show(partial(moment_now, state))
        state.changed.wait(LOOK_EVERY_S)
        state.changed.clear()
