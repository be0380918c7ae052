"""The table of processes agrees with the processes, and everything that names them follows from it."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from benchmarks import fault_schedules, journalled_mission
from schemas.topics import Side
from services.mission.deployment import find_scenario
from services.mission.in_process import build_nodes
from services.mission.processes import CONSOLE, LINK, PROCESSES, RECORDER, VITAL, process_table, vital_on, waited_for
from services.mission.scenario import load_scenario
from services.recorder.node import build_node as build_recorder

ROOT = Path(__file__).resolve().parents[3]


class NoSink:
    def write(self, *_: object) -> None: ...

    def flush(self) -> None: ...


def test_each_process_has_the_name_and_the_sides_of_its_node():
    scenario = load_scenario(find_scenario("short"))
    nodes = (*build_nodes(scenario), build_recorder(scenario, NoSink()))
    interfaces = {node.interface.name: node.interface.sides for node in nodes}
    assert {each.name: each.sides for each in PROCESSES} == interfaces


def test_each_process_is_a_module_that_can_be_run():
    for each in (*PROCESSES, CONSOLE):
        assert find_spec(f"{each.module}.__main__") is not None


def test_each_process_is_started_after_those_that_it_needs():
    started: set[str] = set()
    for each in (*PROCESSES, CONSOLE):
        assert set(each.needs) <= started
        started.add(each.name)
    assert PROCESSES[0] is LINK


def test_no_process_needs_one_that_is_not_vital():
    assert {name for each in PROCESSES for name in each.needs} <= set(VITAL)
    assert [each for each in PROCESSES if not each.vital] == [RECORDER]


def test_the_link_waits_for_all_that_are_started_but_itself():
    assert waited_for(VITAL) == ("field", "rover", "ground")
    assert waited_for(each.name for each in PROCESSES) == ("field", "rover", "ground", "recorder")
    assert vital_on(Side.EARTH) == {"link", "ground"}


def test_benchmarks_that_choose_a_victim_choose_among_the_vital_processes():
    assert set(journalled_mission.SERVICES) == set(fault_schedules.SERVICES) == set(VITAL)


def test_the_page_on_architecture_shows_the_table_as_it_is():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    shown = page.split("<!-- processes: begin -->\n")[1].split("<!-- processes: end -->")[0]
    assert shown == process_table(), "expected the output of `python -m services.mission` between the marks"


def test_two_machines_are_told_to_wait_for_processes_of_the_table():
    page = (ROOT / "docs" / "two-machines.md").read_text(encoding="utf-8")
    waits = [line.split("--wait-for ")[1].split()[0] for line in page.splitlines() if "--wait-for " in line]
    assert waits
    for names in waits:
        assert names in {",".join(waited_for(VITAL)), ",".join(waited_for(each.name for each in PROCESSES))}
