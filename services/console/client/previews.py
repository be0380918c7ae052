"""What a command would do, and when the rover would have it: asked before it is sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from schemas.commands import CommandKind
from schemas.topics import PREVIEW_COMMAND
from services.console.client.commands import Commanding, telecommand, without_id
from services.console.client.link import LinkControl
from services.console.client.time_format import duration, utc
from services.link.contact import Contact
from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from schemas.commands import CommandPreview
    from schemas.link import DirectionConditions, LinkStatus
    from services.console.client.map_queries import Polygon

HEADER_BITS: Final = 8 * 400
"""About the size of a message without its body."""


@dataclass(frozen=True, slots=True)
class Passage:
    """When the rover would have a command that is sent now, and when its word is back: the earliest times.

    Nothing is lost on the way, and no other message is ahead. None: no contact is to come.
    """

    received_at: MissionTime | None
    word_back_at: MissionTime | None


@dataclass(frozen=True, slots=True)
class CommandOutlook:
    """What a command would do, by the ground's knowledge, and when."""

    preview: CommandPreview
    passage: Passage

    @property
    def sound(self) -> bool:
        """Whether the ground would send it."""
        return not self.preview.objection

    def document(self) -> dict[str, Any]:
        """The outlook as JSON values."""
        passage = {"received_at": self.passage.received_at, "word_back_at": self.passage.word_back_at}
        return {**self.preview.model_dump(mode="json"), **passage, "lines": [list(row) for row in self.rows()]}

    def rows(self) -> list[tuple[str, str]]:
        """The outlook as names and texts for people; what does not apply is left out."""
        preview = self.preview
        rows = [("does", preview.effect)]
        if preview.objection:
            rows.append(("REFUSED", preview.objection))
        if preview.warning:
            rows.append(("WARNING", preview.warning))
        if preview.path_m:
            lasts = "never: the sun does not charge the rover enough"
            if preview.drive_s is not None:
                lasts = duration(preview.drive_s)
            rows += [
                ("drive", f"{preview.drive_m:,.1f} m in {lasts}"),
                (
                    "energy",
                    f"{preview.energy_wh:,.0f} Wh for the drive; battery at {preview.charge_wh:,.0f} Wh after it",
                ),
                ("closed", f"{_count(preview.closed_cells, 'closed cell')} on the way"),
            ]
        if preview.cells_to_close or (preview.command.polygon_m is not None):
            rows.append(("closes", f"{_count(preview.cells_to_close, 'open cell')}"))
        if preview.cells_to_open:
            rows.append(("opens", f"{_count(preview.cells_to_open, 'cell')}"))
        rows.append(("rounds", self._rounds()))
        at, received, back = preview.at, self.passage.received_at, self.passage.word_back_at
        rows.append(("on rover", "not before contact returns" if received is None else _at(received, at)))
        rows.append(("word back", "not before contact returns" if back is None else _at(back, at)))
        return rows

    def _rounds(self) -> str:
        preview = self.preview
        given_up = (
            f"round {', '.join(map(str, preview.rounds_given_up))} given up with {preview.samples_given_up} samples"
        )
        parts = [given_up if preview.rounds_given_up else "none lost"]
        if preview.rounds_planned_anew:
            parts.append(f"{_count(len(preview.rounds_planned_anew), 'round')} planned anew")
        return ", ".join(parts)


class Previewing(Commanding, LinkControl):
    """The part of `MissionClient` that asks what a command would do."""

    def preview(
        self,
        kind: CommandKind | str,
        *,
        target_m: tuple[float, float] | None = None,
        area_id: str | None = None,
        polygon_m: Polygon | None = None,
    ) -> CommandOutlook:
        """What that command would do if it were sent now; nothing is sent.

        Raises InvalidInput, in one line, for a command that is none.
        """
        command = telecommand(kind, target_m=target_m, area_id=area_id, polygon_m=polygon_m)
        preview: CommandPreview = self._session.query(PREVIEW_COMMAND, command)
        preview = preview.model_copy(update={"objection": without_id(preview.objection, command)})
        bits = HEADER_BITS + 8 * len(command.model_dump_json())
        return CommandOutlook(preview, passage(self.link(), self.clock().start_ns, preview.at, bits))


def passage(link: LinkStatus, start: MissionTime, now: MissionTime, up_bits: int) -> Passage:
    """The earliest times of a command of that size that is sent now; start: of the mission."""
    contact = Contact.of(link.conditions, start, link.contact_forced)
    received = _arrives(contact, link.conditions.up, now, up_bits)
    back = None if received is None else _arrives(contact, link.conditions.down, received, HEADER_BITS)
    return Passage(received, back)


def _arrives(contact: Contact, way: DirectionConditions, offered: MissionTime, bits: int) -> MissionTime | None:
    """When a message that is offered then has arrived whole; None without further contact."""
    lasts = 0 if way.rate_bit_s is None else round(bits / way.rate_bit_s * SECOND)
    span = contact.span_from(offered)
    if span is not None and not span.fits(max(offered, span.opens), lasts) and span.closes is not None:
        offered = span.closes
        span = contact.span_from(offered)
    if span is None:
        return None
    return max(offered, span.opens) + lasts + seconds(way.one_way_light_time_s)


def _at(when: MissionTime, now: MissionTime) -> str:
    wait_s = (when - now) / SECOND
    wait = f"{wait_s:.1f} s" if wait_s < 60 else duration(wait_s)
    return f"in {wait} at the earliest ({utc(when, 0)})"


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
