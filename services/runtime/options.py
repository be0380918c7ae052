"""The command line that every service understands: ``python -m services.NAME SCENARIO [options]``."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from he3.errors import InvalidInput
from schemas.roles import Role
from schemas.topics import SIDES, Side
from services.mission.deployment import find_scenario
from services.mission.scenario import Scenario, load_scenario
from services.runtime.node import Level
from services.runtime.trust.endpoint_policy import check_endpoint

if TYPE_CHECKING:
    from services.runtime.trust.identity import Identity

EXAMPLES = """examples:
  python -m services.{name} t1
  python -m services.{name} deploy/scenarios/t1.toml --seed 7 --set ground.planner=tour
"""


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a service's process."""

    scenario: Scenario
    level: Level
    log_json: bool
    wait_for: tuple[str, ...]
    """The link holds mission time until these processes take part; empty: it starts at once."""
    out: Path | None
    """File that the recorder writes."""
    journal: Path | None
    """Folder of the journals; None: nothing survives a restart."""
    lockstep: bool
    stop_when: str | None
    """The link in lockstep: mission time is paused when this process has nothing left to do."""
    pace: float | None
    """The link in lockstep: mission seconds per wall second at most, until an operator changes it; None: no limit."""
    events: Path | None
    """File that gets a line for each event handled."""
    identity: Identity | None = None
    """The identity of this process; None on loopback without keys."""
    instance: str | None = None
    """The run of the mission, for signatures; None: as the identity's authority has it."""
    audit: Path | None = None
    """File of the audit log."""
    insecure: tuple[str, ...] = ()
    """A warning for each endpoint that others can reach without TLS, which the user has asked for."""


class _Parser(argparse.ArgumentParser):
    """Reports an error in one line, without the usage text."""

    def error(self, message: str) -> NoReturn:
        raise InvalidInput(f"{self.prog}: {message} (see --help)")


def parse_options(name: str, arguments: Sequence[str]) -> Options:
    """The options of a service; raises InvalidInput with one line. ``--help`` prints and exits."""
    parser = _Parser(
        prog=f"python -m services.{name}",
        description=f"The {name} service of a helium-3 mission, as a separate process.",
        epilog=EXAMPLES.format(name=name),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file, or the name of a shipped one")
    parser.add_argument("--seed", type=int, metavar="N", help="seed, instead of the scenario's")
    parser.add_argument(
        "--rate", type=float, metavar="R", help="mission seconds per wall second; the link's value counts"
    )
    parser.add_argument("--moon", metavar="ENDPOINT", help="the Moon router, e.g. tcp/127.0.0.1:7447")
    parser.add_argument("--earth", metavar="ENDPOINT", help="the Earth router, e.g. tcp/127.0.0.1:7448")
    parser.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[], help="another value, such as ground.pipeline=2"
    )
    parser.add_argument(
        "--allow-plugin", action="store_true", help="import the planner module:function that the scenario's file names"
    )
    parser.add_argument("--log-level", choices=[level.value for level in Level], default="info")
    parser.add_argument("--log-json", action="store_true", help="write log lines as JSON")
    parser.add_argument(
        "--wait-for", metavar="NAMES", default="", help="link: hold mission time until these processes take part"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="recorder: file to write (default: mission.mcap)")
    parser.add_argument(
        "--journal", type=Path, metavar="DIR", help="keep a journal in this folder, and continue from it"
    )
    parser.add_argument("--lockstep", action="store_true", help="run in virtual time, which the link grants")
    parser.add_argument(
        "--stop-when", metavar="NAME", help="link in lockstep: pause time when this process is finished"
    )
    parser.add_argument(
        "--pace", type=float, metavar="R", help="link in lockstep: mission seconds per wall second at most"
    )
    parser.add_argument("--events", type=Path, metavar="FILE", help="write a line for each event handled")
    parser.add_argument("--identity", type=Path, metavar="DIR", help="folder of this process's identity (he3 keys)")
    parser.add_argument(
        "--instance",
        metavar="ID",
        help="with --identity: the run of the mission; others do not count",
    )
    parser.add_argument("--audit", type=Path, metavar="FILE", help="append commands, changes and refusals to this file")
    parser.add_argument(
        "--insecure", action="store_true", help="allow endpoints off loopback without TLS: anyone may command"
    )
    given = parser.parse_args(arguments)
    if given.pace is not None and not 0 < given.pace <= 1e9:
        parser.error(f"--pace: expected a number over 0 and up to 1e9, got {given.pace:g}")
    if given.instance is not None and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}", given.instance):
        parser.error(f"--instance: expected at most 64 letters, digits and '_.:-', got '{given.instance[:80]}'")
    path = find_scenario(given.scenario)
    changes = [parse_setting(text) for text in given.set]
    for key, value in (("seed", given.seed), ("rate", given.rate)):
        if value is not None:
            changes.append(("top", key, value))
    scenario = load_scenario(path)
    require_plugin_allowed(scenario, changes, given.allow_plugin)
    endpoints = (("moon", given.moon), ("earth", given.earth))
    changes += [("network", key, endpoint) for key, endpoint in endpoints if endpoint is not None]
    scenario = with_settings(scenario, changes)
    identity = None if given.identity is None else _identity(name, given.identity)
    return Options(
        scenario=scenario,
        level=Level(given.log_level),
        log_json=given.log_json,
        wait_for=tuple(part for part in given.wait_for.split(",") if part),
        out=given.out,
        journal=given.journal,
        lockstep=given.lockstep,
        stop_when=given.stop_when,
        pace=given.pace,
        events=given.events,
        identity=identity,
        instance=given.instance,
        audit=given.audit,
        insecure=_warnings(name, scenario, identity is not None, given.insecure),
    )


def require_plugin_allowed(scenario: Scenario, settings: Sequence[tuple[str, str, Any]], allowed: bool) -> None:
    """Raise InvalidInput if the file of a scenario names a plug-in planner, whose code would run, and no user asked.

    settings: those of the user; one that names a planner has asked for it.
    """
    if ":" not in scenario.ground.planner or allowed:
        return
    if not any(section == "ground" and key == "planner" for section, key, _ in settings):
        raise InvalidInput(
            f"scenario '{scenario.name}': names the plug-in planner '{scenario.ground.planner}', which is code that "
            "would run: expected --allow-plugin, or another planner with --planner"
        )


def _identity(name: str, folder: Path) -> Identity:
    """The identity of that folder, which must have the role of the service of that name."""
    from services.runtime.trust.identity import load_identity

    identity = load_identity(folder)
    identity.require_role(Role(name))
    return identity


def _warnings(name: str, scenario: Scenario, identified: bool, insecure: bool) -> tuple[str, ...]:
    """A warning for each insecure endpoint that the service uses; raises InvalidInput for one that it may not use."""
    sides = SIDES[Role(name)] if name in set(Role) else tuple(Side)
    endpoints = {Side.MOON: scenario.network.moon, Side.EARTH: scenario.network.earth}
    found = [check_endpoint(endpoints[side], identified=identified, insecure=insecure) for side in sides]
    return tuple(warning for warning in found if warning is not None)


def parse_setting(text: str) -> tuple[str, str, Any]:
    """Section, key and value of ``section.key=value`` (``key=value`` at the top); raises InvalidInput.

    The value is parsed as JSON if possible, else it is text; nested keys are joined by dots: ``link.up.loss=0.3``.
    """
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InvalidInput(f"--set {text}: expected KEY=VALUE, such as ground.pipeline=2")
    section, dot, rest = key.partition(".")
    try:
        parsed = json.loads(value)
    except ValueError:
        parsed = value
    return (section, rest, parsed) if dot else ("top", section, parsed)


def with_settings(scenario: Scenario, settings: Sequence[tuple[str, str, Any]]) -> Scenario:
    """The scenario with those values, checked again; raises InvalidInput for keys or values it does not know."""
    document = scenario.model_dump(mode="json")
    for section, key, value in settings:
        place = document if section == "top" else document.get(section)
        parts = key.split(".")
        for part in parts[:-1]:
            place = place.get(part) if isinstance(place, dict) else None
        if not isinstance(place, dict) or parts[-1] not in place:
            name = key if section == "top" else f"{section}.{key}"
            raise InvalidInput(f"expected a key of the scenario, got '{name}', which it does not have")
        place[parts[-1]] = value
    changed = {(section, key) for section, key, _ in settings}
    return scenario.replaced(document, sets_kernel=bool(changed & {("ground", "kernel"), ("top", "ground")}))
