"""``he3 link show`` and ``he3 link set``: the conditions between Earth and Moon, shown and changed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson, checked, within
from services.console.cli.session import Session

if TYPE_CHECKING:
    from schemas.link import LinkStatus

EXAMPLES = """\b
Examples:
  he3 link show
  he3 link set --light-time 3 --jitter 0.1
  he3 link set --direction down --bit-rate 256000 --loss 0.05
  he3 link set --contact off              # black-out from now on
  he3 link set --contact scheduled        # back to windows or duty cycle
  he3 link set --preset farside-relay
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

MAX_DELAY_S = 86_400.0
MIN_BIT_RATE, MAX_BIT_RATE = 1.0, 1e12

_CONTACTS: dict[str, dict[str, Any]] = {
    "on": {"contact": True},
    "off": {"contact": False},
    "scheduled": {"contact_as_scheduled": True},
}


def _one_of(*words: str) -> Any:
    def check(word: str) -> str:
        if word not in words:
            raise typer.BadParameter(f"expected one of {', '.join(words)}; got '{word}'")
        return word

    return checked(check)


def _bit_rate(word: str) -> str:
    try:
        rate = MIN_BIT_RATE if word == "unlimited" else float(word)
    except ValueError:
        rate = float("nan")
    if not MIN_BIT_RATE <= rate <= MAX_BIT_RATE:
        raise typer.BadParameter(f"expected {MIN_BIT_RATE:g} to {MAX_BIT_RATE:g} bit/s or 'unlimited', got '{word}'")
    return word


def _preset(word: str) -> str:
    from services.mission.link_presets import preset

    preset(word)
    return word


def _share(flag: str, what: str) -> Any:
    return typer.Option(flag, metavar="P", help=f"Share of the messages that {what} (0 to 1).", callback=within(0, 1))


_seconds = within(0, MAX_DELAY_S)


@app.command(short_help="Show conditions, counts and messages in flight.", epilog=EXAMPLES)
@with_flags
def show(
    session: Session,
    json: AsJson = False,
) -> None:
    """Conditions, counts, and every message in flight with its arrival time."""

    with session.join() as client:
        status = client.link()
    _print(status, json)


@app.command("set", short_help="Change conditions.", epilog=EXAMPLES)
@with_flags
def change(
    session: Session,
    preset: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Replace all conditions: nominal, zero, csa-10s, lossy, mars, ...",
                     callback=checked(_preset)),
    ] = None,
    direction: Annotated[
        str | None,
        typer.Option(metavar="up|down", help="Only that direction; else both.", callback=_one_of("up", "down")),
    ] = None,
    light_time: Annotated[
        float | None, typer.Option(metavar="S", help="One-way light time [s], up to 86400.", callback=_seconds)
    ] = None,
    jitter: Annotated[
        float | None, typer.Option(metavar="S", help="Half width of the light time's variation [s].", callback=_seconds)
    ] = None,
    bit_rate: Annotated[
        str | None,
        typer.Option(metavar="B", help="Data rate [bit/s], or 'unlimited'.", callback=checked(_bit_rate)),
    ] = None,
    loss: Annotated[float | None, _share("--loss", "are lost")] = None,
    duplicate: Annotated[float | None, _share("--duplicate", "arrive twice")] = None,
    reorder: Annotated[float | None, _share("--reorder", "arrive out of order")] = None,
    corrupt: Annotated[float | None, _share("--corrupt", "are damaged")] = None,
    contact: Annotated[
        str | None,
        typer.Option(metavar="on|off|scheduled", help="Contact from now on.", callback=_one_of(*_CONTACTS)),
    ] = None,
    at_edge: Annotated[
        str | None,
        typer.Option(metavar="hold|drop", help="Whether messages without contact wait or are lost.",
                     callback=_one_of("hold", "drop")),
    ] = None,
    json: AsJson = False,
) -> None:  # fmt: skip
    """Change the given conditions for messages sent from now on; the others keep their values."""
    from he3.errors import InvalidInput
    from services.console.client.link import link_change

    values: dict[str, Any] = {
        "direction": direction,
        "one_way_light_time_s": light_time,
        "jitter_s": jitter,
        "loss": loss,
        "duplicate": duplicate,
        "reorder": reorder,
        "corrupt": corrupt,
        "at_edge": at_edge,
        "rate_bit_s": None if bit_rate in (None, "unlimited") else float(bit_rate),
        "unlimited_rate": True if bit_rate == "unlimited" else None,
        **({} if contact is None else _CONTACTS[contact]),
    }
    given = {key: value for key, value in values.items() if value is not None}
    if preset is not None:
        from services.mission.link_presets import preset as conditions_of

        given = {"conditions": conditions_of(preset).model_dump(mode="json"), **given}
    if not given.keys() - {"direction"}:
        raise InvalidInput("link set: expected something to change, such as --loss 0.1 or --preset lossy")
    request = link_change(given)
    with session.join() as client:
        status = client.change_link(request)
    if not json:
        typer.echo(f"mission '{client.mission}'")
    _print(status, json)


def _print(status: LinkStatus, json: bool) -> None:
    typer.echo(status.model_dump_json(indent=2) if json else "\n".join(link_lines(status)))


def link_lines(status: LinkStatus) -> list[str]:
    """The link's status in aligned lines of plain text."""
    from services.console.client.time_format import utc

    forced = "" if status.contact_forced is None else " (set by an operator)"
    edge = "messages wait" if status.conditions.at_edge.value == "hold" else "messages are lost"
    lines = [f"contact        {'yes' if status.contact else 'NO'}{forced}; without contact {edge}"]
    if status.conditions.duty_cycle is not None:
        cycle = status.conditions.duty_cycle
        lines.append(f"duty cycle     {cycle.contact_s:g} s of every {cycle.period_s:g} s, offset {cycle.offset_s:g} s")
    lines += [f"window         {window.opens_s:g} s to {window.closes_s:g} s" for window in status.conditions.windows]
    names = ("light time [s]", "jitter [s]", "rate [bit/s]", "loss", "duplicate", "reorder", "corrupt")
    fields = ("one_way_light_time_s", "jitter_s", "rate_bit_s", "loss", "duplicate", "reorder", "corrupt")
    up, down = status.conditions.up, status.conditions.down
    lines.append(f"{'':<22} {'up':>12} {'down':>12}")
    for name, key in zip(names, fields, strict=True):
        lines.append(f"{name:<22} {_value(getattr(up, key)):>12} {_value(getattr(down, key)):>12}")
    for key in type(status.up).model_fields:
        lines.append(f"{key.replace('_', ' '):<22} {getattr(status.up, key):>12} {getattr(status.down, key):>12}")
    if status.in_flight:
        lines.append("in flight:")
    for message in status.in_flight:
        end = "waits for contact" if message.arrives_at is None else f"arrives {utc(message.arrives_at)}"
        lines.append(
            f"  {message.direction.value:<5} {message.topic:<12} {message.source}/{message.sequence:<6} "
            f"{message.size_bytes:>7} bytes  {end}"
        )
    if status.dropped:
        lines.append("lost of late:")
    for dropped in status.dropped[-5:]:
        what = f"{dropped.direction.value:<5} {dropped.topic:<12} {dropped.source}/{dropped.sequence:<6}"
        lines.append(f"  {what} {dropped.why} at {utc(dropped.at)}")
    return lines


def _value(value: float | None) -> str:
    return "unlimited" if value is None else f"{value:g}"
