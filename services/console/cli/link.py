"""``he3 link show`` and ``he3 link set``: conditions between Earth and Moon, seen and changed while they hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from schemas.link import LinkStatus

EXAMPLES = """\b
Examples:
  he3 link show
  he3 link set --light-time 3 --jitter 0.1
  he3 link set --direction down --bit-rate 256000 --loss 0.05
  he3 link set --contact off              black-out, from now on
  he3 link set --contact scheduled        windows or duty cycle again
  he3 link set --preset farside-relay
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command(epilog=EXAMPLES)
def show(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Conditions, counts, and every message that is under way with its arrival."""
    from schemas.link import LinkChange
    from schemas.topics import LINK_SET
    from services.console.client.session import join

    with join(mission, earth) as client:
        status: LinkStatus = client.query(LINK_SET, LinkChange())
    _print(status, json)


@app.command("set", epilog=EXAMPLES)
def change(
    mission: Mission = None,
    earth: Earth = None,
    preset: Annotated[str | None, typer.Option(metavar="NAME", help="nominal, zero, csa-10s, lossy, mars, ...")] = None,
    direction: Annotated[str | None, typer.Option(metavar="up|down", help="Only that way; else both.")] = None,
    light_time: Annotated[float | None, typer.Option(metavar="S", help="One-way light time [s].")] = None,
    jitter: Annotated[float | None, typer.Option(metavar="S", help="Half width of its variation [s].")] = None,
    bit_rate: Annotated[str | None, typer.Option(metavar="B", help="Data rate [bit/s], or 'unlimited'.")] = None,
    loss: Annotated[float | None, typer.Option(metavar="P", help="Share of messages that is lost.")] = None,
    duplicate: Annotated[float | None, typer.Option(metavar="P", help="Share that comes twice.")] = None,
    reorder: Annotated[float | None, typer.Option(metavar="P", help="Share that comes out of order.")] = None,
    corrupt: Annotated[float | None, typer.Option(metavar="P", help="Share that is damaged.")] = None,
    contact: Annotated[str | None, typer.Option(metavar="on|off|scheduled", help="Contact from now on.")] = None,
    at_edge: Annotated[str | None, typer.Option(metavar="hold|drop", help="What becomes of what cannot leave.")] = None,
    json: AsJson = False,
) -> None:
    """Change what is named, for what is sent from now on; everything else stays."""
    from he3.errors import InvalidInput
    from schemas.topics import LINK_SET
    from services.console.client.session import join

    values: dict[str, Any] = {
        "direction": direction,
        "one_way_light_time_s": light_time,
        "jitter_s": jitter,
        "loss": loss,
        "duplicate": duplicate,
        "reorder": reorder,
        "corrupt": corrupt,
        "at_edge": at_edge,
        **_contact(contact),
        **_bit_rate(bit_rate),
    }
    given = {key: value for key, value in values.items() if value is not None}
    if not given and preset is None:
        raise InvalidInput("link set: expected something to change, such as --loss 0.1 or --preset lossy")
    request = _checked(given, preset)
    with join(mission, earth) as client:
        status: LinkStatus = client.query(LINK_SET, request)
    _print(status, json)


def _contact(word: str | None) -> dict[str, Any]:
    from he3.errors import InvalidInput

    known: dict[str | None, dict[str, Any]] = {
        None: {},
        "on": {"contact": True},
        "off": {"contact": False},
        "scheduled": {"contact_as_scheduled": True},
    }
    if word not in known:
        raise InvalidInput(f"--contact: expected on, off or scheduled, got '{word}'")
    return known[word]


def _bit_rate(word: str | None) -> dict[str, Any]:
    from he3.errors import InvalidInput

    if word is None:
        return {}
    if word == "unlimited":
        return {"unlimited_rate": True}
    try:
        return {"rate_bit_s": float(word)}
    except ValueError:
        raise InvalidInput(f"--bit-rate: expected a number of bit/s or 'unlimited', got '{word}'") from None


def _checked(given: dict[str, Any], preset: str | None) -> Any:
    import json as json_format

    from pydantic import ValidationError

    from he3.errors import InvalidInput
    from schemas.codec import one_line
    from schemas.link import LinkChange

    if preset is not None:
        from services.mission.link_presets import preset as conditions_of

        given = {"conditions": conditions_of(preset).model_dump(mode="json"), **given}
    try:
        return LinkChange.model_validate_json(json_format.dumps(given))
    except ValidationError as error:
        raise InvalidInput(f"link set: {one_line(error)}") from None


def _print(status: LinkStatus, json: bool) -> None:
    typer.echo(status.model_dump_json(indent=2) if json else "\n".join(link_lines(status)))


def link_lines(status: LinkStatus) -> list[str]:
    """The link's status in aligned lines of plain text."""
    forced = "" if status.contact_forced is None else " (decided by an operator)"
    lines = [
        f"contact        {'yes' if status.contact else 'NO'}{forced}, at the edge: {status.conditions.at_edge.value}"
    ]
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
        lines.append("under way:")
    for message in status.in_flight:
        end = "waits to leave" if message.arrives_at is None else f"arrives {clock_text(message.arrives_at)}"
        lines.append(
            f"  {message.direction.value:<5} {message.topic:<12} {message.source}/{message.sequence:<6} "
            f"{message.size_bytes:>7} bytes  {end}"
        )
    for dropped in status.dropped[-5:]:
        what = f"{dropped.direction.value:<5} {dropped.topic:<12} {dropped.source}/{dropped.sequence:<6}"
        lines.append(f"  gone {what} {dropped.why} at {clock_text(dropped.at)}")
    return lines


def _value(value: float | None) -> str:
    return "unlimited" if value is None else f"{value:g}"


def clock_text(at_ns: int) -> str:
    """A mission time [ns] as date and time, to the millisecond."""
    from datetime import UTC, datetime

    return datetime.fromtimestamp(at_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]
