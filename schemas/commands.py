"""Telecommands, and the stages that each passes."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final

from pydantic import Field, model_validator

from schemas.plans import Waypoint
from schemas.wire import CommonName, Count, Identifier, MissionTimeNs, PositionM, Signature, Text, Wire, is_none


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
    issued_by: Text | None = Field(default=None, exclude_if=is_none)
    """The name that the sender gives, which nothing proves: a user and a machine. None where there is an identity."""
    authorization: Authorization | None = Field(default=None, exclude_if=is_none)
    """The signed consent of the person who issued it; None in a mission without keys."""
    objection: Text | None = Field(default=None, exclude_if=is_none)
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


MAX_PREVIEW_VERTICES: Final = 4096
"""Most vertices of a way in a preview."""


class CommandPreview(Wire):
    """What a command would do, by the ground's knowledge. It is not sent, and nothing changes.

    The ground does not know the present link: when the rover would have the command follows from the link's status.
    """

    command: Telecommand
    at: MissionTimeNs
    """Mission time for which it holds."""
    objection: Text = ""
    """Why the ground would refuse it; empty if it would send it."""
    warning: Text = ""
    """Why the rover, by its last report, would reject it or not complete it; empty if nothing speaks against it."""
    effect: Text
    """What the rover does, in one line."""
    path_m: Annotated[tuple[Waypoint, ...], Field(max_length=MAX_PREVIEW_VERTICES)] = ()
    """The way that the rover takes, from where it was last heard of; empty if it does not move."""
    drive_m: Annotated[float, Field(ge=0)] = 0.0
    drive_s: Annotated[float, Field(ge=0)] | None = 0.0
    """Expected duration [s], charging included; None: the sun never charges the rover enough."""
    energy_wh: Annotated[float, Field(ge=0)] = 0.0
    """Energy that the drive takes, without the base load [Wh]."""
    charge_wh: Annotated[float, Field(ge=0)]
    """Expected charge of the battery afterwards [Wh]; of a command without a drive, the last reported one."""
    closed_cells: Count = 0
    """Cells on the way that the ground's map knows as closed."""
    cells_to_close: Count = 0
    """Cells that are open now and that a keep-out closes."""
    cells_to_open: Count = 0
    """Cells of the keep-out that is removed."""
    rounds_given_up: tuple[Count, ...] = ()
    """Numbers of the rounds under way that end early."""
    samples_given_up: Count = 0
    """Samples of those rounds that are not taken yet; the ground plans as many elsewhere."""
    rounds_planned_anew: tuple[Count, ...] = ()
    """Numbers of the rounds that are planned, have not begun, and are planned again."""


class CommandList(Wire):
    commands: tuple[CommandStatus, ...]


class NoParameters(Wire):
    """The body of a query without parameters."""
