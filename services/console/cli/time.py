"""``he3 time``: where mission time stands, and how it goes on."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer

from he3.errors import InvalidInput
from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from schemas.link import ClockState
    from schemas.lockstep import TimeStatus
    from services.runtime.transport.client import Client

EXAMPLES = """\b
Examples, for a mission that runs in lockstep (he3 up t1 --lockstep):
  he3 time show
  he3 time pause
  he3 time step               to the next instant at which something happens
  he3 time step 10
  he3 time until 2h           two hours after the mission's beginning, then pause
  he3 time until 2030-01-02T00:00:00
  he3 time rate 100           no faster than 100 mission seconds a second
  he3 time unlimited          as fast as the machine allows
  he3 time resume
On the wall clock there are show, pause, resume (at the pace of life) and rate.
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

UNITS_S = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


@app.command()
def show(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """What mission time it is, what it waits for, and who is to blame if it stands."""
    _change(mission, earth, json)


@app.command()
def pause(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Let mission time stand; what is asked or commanded is still taken in."""
    _change(mission, earth, json, clock_rate=0.0, paused=True)


@app.command()
def resume(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Let mission time go on."""
    _change(mission, earth, json, clock_rate=1.0, paused=False)


@app.command()
def step(
    count: Annotated[int, typer.Argument(metavar="[N]", min=1, max=1_000_000)] = 1,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """Go on to the next instant, or the next N, at which something happens; then pause."""
    _change(mission, earth, json, steps=count)


@app.command()
def until(
    when: Annotated[str, typer.Argument(metavar="TIME", help="90, 15min, 2h, 3d after the beginning, or a UTC time.")],
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """Go on until that mission time, then pause."""
    _change(mission, earth, json, until=when)


@app.command()
def rate(
    factor: Annotated[float, typer.Argument(metavar="R", help="Mission seconds a wall second.")],
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """Go no faster than that from now on."""
    if not factor > 0:
        raise InvalidInput(f"rate: expected a number over 0, got {factor:g} (he3 time pause lets time stand)")
    _change(mission, earth, json, clock_rate=factor, rate=factor)


@app.command()
def unlimited(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Go as fast as the machine allows again."""
    _change(mission, earth, json, unlimited=True)


def _change(mission: str | None, earth: str | None, json: bool, clock_rate: float | None = None, **wanted: Any) -> None:
    from schemas.link import ClockMode
    from schemas.topics import EARTH_CLOCK
    from services.console.client.session import join

    with join(mission, earth) as client:
        clock: ClockState = client.latest(EARTH_CLOCK)[1]
        if clock.mode is ClockMode.LOCKSTEP:
            status = _in_lockstep(client, clock.start_ns, wanted)
            typer.echo(status.model_dump_json(indent=2) if json else "\n".join(_lines(status)))
            return
        if wanted and clock_rate is None:
            raise InvalidInput("expected a mission in lockstep, got one on the wall clock (he3 up --lockstep)")
        clock = _on_the_wall_clock(client, clock, clock_rate)
    typer.echo(clock.model_dump_json(indent=2) if json else _wall_clock_line(clock))


def _in_lockstep(client: Client, start_ns: int, wanted: dict[str, Any]) -> TimeStatus:
    from pydantic import ValidationError

    from schemas.codec import one_line
    from schemas.lockstep import TimeControl
    from schemas.topics import TIME_CONTROL

    if "until" in wanted:
        wanted = {"until": moment(wanted["until"], start_ns)}
    try:
        control = TimeControl(**wanted)
    except ValidationError as error:
        raise InvalidInput(one_line(error)) from None
    status: TimeStatus = client.query(TIME_CONTROL, control)
    return status


def _on_the_wall_clock(client: Client, clock: ClockState, clock_rate: float | None) -> ClockState:
    from schemas.link import ClockChange
    from schemas.topics import CLOCK_SET

    if clock_rate is None:
        return clock
    if clock_rate > 100_000:
        raise InvalidInput(f"rate: expected at most 100000 on the wall clock, got {clock_rate:g}")
    changed: ClockState = client.query(CLOCK_SET, ClockChange(rate=clock_rate))
    return changed


def moment(text: str, start_ns: int) -> int:
    """Mission time [ns] of a duration since the beginning (90, 15min, 2h, 3d) or of a UTC time; raises InvalidInput."""
    duration = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|min|h|d|)", text.strip())
    if duration is not None:
        return start_ns + round(float(duration[1]) * UNITS_S[duration[2]] * 1e9)
    try:
        at = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        raise InvalidInput(
            f"expected 90, 15min, 2h or 3d after the mission's beginning, or a time such as 2030-01-01T12:00:00, "
            f"got '{text}'"
        ) from None
    at = at.replace(tzinfo=UTC) if at.tzinfo is None else at.astimezone(UTC)
    since = at - datetime(1970, 1, 1, tzinfo=UTC)
    return ((since.days * 86_400 + since.seconds) * 1_000_000 + since.microseconds) * 1_000


def _lines(status: TimeStatus) -> list[str]:
    rows = [
        ("time", f"{_utc(status.now)}, {_since(status.now, status.start_ns)}"),
        ("pace", _pace(status)),
        ("next", _next(status)),
        ("with", ", ".join(status.members)),
    ]
    if status.waits_for:
        rows.append(("waits for", ", ".join(status.waits_for)))
    if status.detail:
        rows.append(("trouble", status.detail))
    rows += [(name, f"finished: {why}") for name, why in sorted(status.finished.items())]
    return [f"{name:<10} {text}" for name, text in rows]


def _pace(status: TimeStatus) -> str:
    pace = "as fast as it goes" if status.rate is None else f"at most {status.rate:g} times as fast as life"
    if status.paused:
        return f"paused; else {pace}"
    if status.steps_left is not None:
        return f"{pace}, for {status.steps_left} more instants"
    return pace if status.until is None else f"{pace}, until {_utc(status.until)}"


def _next(status: TimeStatus) -> str:
    if status.next_at is not None:
        return f"{_utc(status.next_at)}, in {(status.next_at - status.now) / 1e9:.9g} s"
    return "a step is under way" if status.waits_for else "nothing, ever"


def _wall_clock_line(clock: ClockState) -> str:
    import time

    from services.runtime.clock import mission_time

    now = mission_time(clock, time.time_ns())
    pace = "paused" if clock.rate == 0 else f"{clock.rate:g} times as fast as life"
    return f"{'time':<10} {_utc(now)}, {_since(now, clock.start_ns)}\n{'pace':<10} wall clock, {pace}"


def _utc(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"


def _since(now_ns: int, start_ns: int) -> str:
    from services.console.report.progress import duration

    return f"{duration((now_ns - start_ns) / 1e9)} since the mission's beginning"
