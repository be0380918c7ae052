"""Telecommands, and the stages that each passes."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final

from pydantic import Field, model_validator

from schemas.wire import CommonName, Identifier, MissionTimeNs, PositionM, Signature, Text, Wire


class CommandKind(StrEnum):
    PAUSE = "pause"
    RESUME = "resume"
    ABORT_ROUND = "abort_round"
    GO_TO = "go_to"
    SET_KEEP_OUT = "set_keep_out"
    RETURN_TO_START = "return_to_start"
    SAFE = "safe"


class CommandStage(StrEnum):
    """The stages, in the order in which a command passes them; those in `ENDS` end it."""

    QUEUED = "queued"
    RELEASED = "released"
    RADIATED = "radiated"
    RECEIVED = "received"
    ACCEPTED = "accepted"
    STARTED = "started"
    REJECTED = "rejected"
    COMPLETED = "completed"
    FAILED = "failed"
    EXPIRED = "expired"
    LOST = "lost"


ENDS: Final = frozenset(
    {CommandStage.REJECTED, CommandStage.COMPLETED, CommandStage.FAILED, CommandStage.EXPIRED, CommandStage.LOST}
)
"""Stages that end a command; after LOST, which the ground assumes, a report of the real end may still arrive."""

_ORDER: Final = {stage: number for number, stage in enumerate(CommandStage)}


class Authorization(Wire):
    """A person's signed consent to one command. A process that forwards the command cannot make, alter or renew it."""

    signer: CommonName
    instance: Identifier
    """The run of the mission for which it counts."""
    made_at: MissionTimeNs
    expires_at: MissionTimeNs
    """The command is refused when it arrives later."""
    signature: Signature


def _is_none(value: object) -> bool:
    return value is None


class Telecommand(Wire):
    """A command to the rover, executed at most once and not after it expires."""

    command_id: Identifier
    kind: CommandKind
    expires_at: MissionTimeNs | None = None
    target_m: tuple[PositionM, PositionM] | None = None
    """Where to drive (`go_to` only)."""
    polygon_m: Annotated[tuple[tuple[PositionM, PositionM], ...], Field(max_length=256)] | None = None
    """Corners of the area that the rover may not enter (`set_keep_out` only); None removes the area."""
    area_id: Identifier | None = None
    """The keep-out area that is set or removed (`set_keep_out` only)."""
    issued_by: Text | None = Field(default=None, exclude_if=_is_none)
    """The name that the sender gives, which nothing proves: a user and a machine. None where there is an identity."""
    authorization: Authorization | None = Field(default=None, exclude_if=_is_none)
    """The signed consent of the person who issued it; None in a mission without keys."""
    objection: Text | None = Field(default=None, exclude_if=_is_none)
    """Why the receiver must not carry it out, as its own check of signatures found; a sender has no use for it."""

    @model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Telecommand:
        if (self.kind is CommandKind.GO_TO) != (self.target_m is not None):
            raise ValueError(f"expected target_m with go_to and only there, got kind {self.kind.value}")
        keep_out = self.kind is CommandKind.SET_KEEP_OUT
        if keep_out != (self.area_id is not None) or (self.polygon_m is not None and not keep_out):
            raise ValueError(f"expected area_id and polygon_m with set_keep_out only, got kind {self.kind.value}")
        if self.polygon_m is not None and len(self.polygon_m) < 3:
            raise ValueError(f"expected a polygon of at least 3 corners, got {len(self.polygon_m)}")
        return self

    @property
    def order(self) -> Telecommand:
        """The command without who issued it: what is to be done. Equal orders of the same id are one command."""
        return self.model_copy(update={"issued_by": None, "authorization": None, "objection": None})

    @property
    def by(self) -> str:
        """Who issued it, for people to read: a verified name, or one that is marked as unverified; empty if unnamed."""
        if self.authorization is not None:
            return self.authorization.signer
        return "" if self.issued_by is None else f"{self.issued_by} (unverified)"


class CommandReport(Wire):
    """Report that a command passed a stage."""

    command_id: Identifier
    stage: CommandStage
    at: MissionTimeNs
    why: Text = ""


class CommandStatus(Wire):
    """A command and the reports of all stages that it has passed, oldest first."""

    command: Telecommand
    stages: tuple[CommandReport, ...]

    @property
    def end(self) -> CommandReport | None:
        """The report that ended the command; None while it is under way. A reported end counts before LOST."""
        ends = [report for report in self.stages if report.stage in ENDS]
        return next((report for report in ends if report.stage is not CommandStage.LOST), ends[-1] if ends else None)

    def has_reached(self, stage: CommandStage) -> bool:
        """Whether the command has passed that stage or a later one, or has ended in any way."""
        return self.end is not None or any(_ORDER[report.stage] >= _ORDER[stage] for report in self.stages)


class CommandList(Wire):
    commands: tuple[CommandStatus, ...]


class NoParameters(Wire):
    """The body of a query without parameters."""
