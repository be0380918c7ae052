"""``he3 time``: shows and controls mission time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson, checked, within
from services.console.cli.session import Session

if TYPE_CHECKING:
    from schemas.link import ClockState
    from schemas.lockstep import TimeStatus

EXAMPLES = """\b
Examples, for a mission that runs in lockstep (he3 up t1 --lockstep):
  he3 time show
  he3 time pause
  he3 time step               # to the next instant at which something happens
  he3 time step 10
  he3 time until 2h           # two hours after the mission's beginning, then pause
  he3 time until 2030-01-02T00:00:00
  he3 time rate 100           # at most 100 mission seconds per second
  he3 time unlimited          # as fast as the machine allows
  he3 time resume
On the wall clock there are show, pause, resume (in real time) and rate.
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

MAX_PACE = 1e9
"""Mission seconds per wall second that a mission in lockstep accepts as a limit."""


def _moment(text: str) -> str:
    from services.console.client.time_format import parse_moment

    parse_moment(text, 0)
    return text


@app.command(short_help="Show mission time.", epilog=EXAMPLES)
@with_flags
def show(
    session: Session,
    json: AsJson = False,
) -> None:
    """Show the mission time, its speed limit or pause, and the processes it waits for."""
    _change(session, json)


@app.command(epilog=EXAMPLES)
@with_flags
def pause(
    session: Session,
    json: AsJson = False,
) -> None:
    """Stop mission time; queries and commands are still accepted."""
    _change(session, json, clock_rate=0.0, paused=True)


@app.command(epilog=EXAMPLES)
@with_flags
def resume(
    session: Session,
    json: AsJson = False,
) -> None:
    """Resume mission time."""
    _change(session, json, clock_rate=1.0, paused=False)


@app.command(short_help="Advance to the next instant, then pause.", epilog=EXAMPLES)
@with_flags
def step(
    session: Session,
    count: Annotated[
        int, typer.Argument(metavar="[N]", help="How many instants (1 to 1000000).", callback=within(1, 1_000_000))
    ] = 1,
    json: AsJson = False,
) -> None:
    """Advance to the next instant, or the next N instants, at which something happens; then pause."""
    _change(session, json, steps=count)


@app.command(epilog=EXAMPLES)
@with_flags
def until(
    session: Session,
    when: Annotated[
        str,
        typer.Argument(metavar="TIME", help="90, 15min, 2h, 3d after the beginning, or a UTC time.",
                       callback=checked(_moment)),
    ],
    json: AsJson = False,
) -> None:  # fmt: skip
    """Run until that mission time, then pause."""
    _change(session, json, until=when)


@app.command(short_help="Limit the simulation speed.", epilog=EXAMPLES)
@with_flags
def rate(
    session: Session,
    factor: Annotated[
        float,
        typer.Argument(metavar="R", help="Mission seconds per wall second.", callback=within(0, MAX_PACE, above=True)),
    ],
    json: AsJson = False,
) -> None:
    """Limit the simulation speed to R mission seconds per wall second."""
    _change(session, json, clock_rate=factor, rate=factor)


@app.command(epilog=EXAMPLES)
@with_flags
def unlimited(
    session: Session,
    json: AsJson = False,
) -> None:
    """Run as fast as the machine allows."""
    _change(session, json, unlimited=True)


def _change(
    session: Session,
    json: bool,
    clock_rate: float | None = None,
    **wanted: Any,
) -> None:
    from he3.errors import InvalidInput
    from schemas.link import ClockMode
    from services.console.client.time_format import parse_moment

    with session.join() as client:
        clock = client.clock()
        if clock.mode is ClockMode.LOCKSTEP:
            if "until" in wanted:
                wanted["until"] = parse_moment(wanted["until"], clock.start_ns)
            status = client.control_time(**wanted)
            typer.echo(status.model_dump_json(indent=2) if json else "\n".join(_lines(status)))
            return
        if wanted and clock_rate is None:
            raise InvalidInput("expected a mission in lockstep, got one on the wall clock (he3 up --lockstep)")
        if clock_rate is not None:
            clock = client.set_clock_rate(clock_rate)
    typer.echo(clock.model_dump_json(indent=2) if json else _wall_clock_lines(clock))


def _lines(status: TimeStatus) -> list[str]:
    from services.console.client.time_format import utc

    rows = [
        ("time", f"{utc(status.now, 9)}, {_since(status.now, status.start_ns)}"),
        ("speed", _speed(status)),
        ("next", _next(status)),
        ("processes", ", ".join(status.members)),
    ]
    if status.waits_for:
        rows.append(("waits for", ", ".join(status.waits_for)))
    if status.detail:
        rows.append(("problem", status.detail))
    rows += [(name, f"finished: {why}") for name, why in sorted(status.finished.items())]
    return [f"{name:<10} {text}" for name, text in rows]


def _speed(status: TimeStatus) -> str:
    from services.console.client.time_format import speed, utc

    pace = "as fast as possible" if status.rate is None else f"at most {speed(status.rate)}"
    if status.paused:
        return f"paused; else {pace}"
    if status.steps_left is not None:
        return f"{pace}, for {status.steps_left} more instant{'s' * (status.steps_left != 1)}"
    return pace if status.until is None else f"{pace}, until {utc(status.until, 9)}"


def _next(status: TimeStatus) -> str:
    from services.console.client.time_format import utc

    if status.next_at is not None:
        return f"{utc(status.next_at, 9)}, in {(status.next_at - status.now) / 1e9:.9g} s"
    return "a step is under way" if status.waits_for else "nothing"


def _wall_clock_lines(clock: ClockState) -> str:
    import time

    from services.console.client.time_format import speed, utc
    from services.runtime.clock import mission_time

    now = mission_time(clock, time.time_ns())
    return f"{'time':<10} {utc(now, 9)}, {_since(now, clock.start_ns)}\n{'speed':<10} {speed(clock.rate)}, wall clock"


def _since(now_ns: int, start_ns: int) -> str:
    from services.console.client.time_format import duration

    return f"{duration((now_ns - start_ns) / 1e9)} since the mission's beginning"
