"""The requests of the page to its server, each a model; anything else is refused with one line."""

from __future__ import annotations

import json
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from he3.errors import InvalidInput
from schemas.commands import CommandKind  # of a model's field: pydantic reads it
from schemas.mission_log import AlarmAction, AlarmKind
from schemas.plans import PlanVerdict
from schemas.validation import one_line
from schemas.wire import MAX_COUNT, Identifier, PositionM
from services.console.client.commands import MAX_EXPIRY_S

MAX_SHELVED_S = 30 * 86_400.0
"""Longest time for which an alarm may be shelved [s]."""

MAX_DRAWS = 100
"""Most draws of a rehearsal for the page."""

Place = tuple[PositionM, PositionM]
Corners = Annotated[tuple[Place, ...], Field(min_length=3, max_length=256)]
Request = TypeVar("Request", bound="PageRequest")


class PageRequest(BaseModel):
    """Root of the page's requests: no unknown fields, finite numbers, no conversion between types."""

    # JSON has arrays where the models have tuples, and words where they have enumerations: `model_validate_json`.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class CommandRequest(PageRequest):
    """A telecommand, and how long it stays valid."""

    kind: CommandKind
    target_m: Place | None = None
    area_id: Identifier | None = None
    polygon_m: Corners | None = None
    expires_in_s: Annotated[float, Field(gt=0, le=MAX_EXPIRY_S)] | None = None
    replace: bool = False
    """Whether a keep-out area of that name may be replaced."""


class InterestRequest(PageRequest):
    """An area of interest with its weight, or its removal."""

    area_id: Identifier | None = None
    polygon_m: Corners | None = None
    weight: Annotated[float, Field(ge=0, le=1000)] = 2.0
    replace: bool = False
    """Whether an area of interest of that name may be replaced."""


class PlanRequest(PageRequest):
    """A decision on the plan that waits for approval."""

    proposal: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    verdict: PlanVerdict
    drop: Annotated[tuple[Identifier, ...], Field(max_length=256)] = ()
    """Samples that are not taken."""
    places_m: Annotated[tuple[Place, ...], Field(max_length=256)] = ()
    """Places to sample in place of those proposed (`revise` only)."""


class StackRequest(PageRequest):
    """A command stack that is checked, or sent."""

    text: Annotated[str, Field(max_length=60_000)]
    step: bool = False
    """Whether each command waits for an answer."""


class StackAnswer(PageRequest):
    """The answer on a command that waits for one."""

    number: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    """Of the stack."""
    line: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    send: bool


class StackStop(PageRequest):
    """No further command of that stack is sent."""

    number: Annotated[int, Field(ge=1, lt=MAX_COUNT)]


class AlarmRequest(PageRequest):
    """What a person does about an alarm."""

    kind: AlarmKind
    action: AlarmAction
    shelve_s: Annotated[float, Field(gt=0, le=MAX_SHELVED_S)] | None = None
    """For how long it is shelved, in mission time (`shelve` only)."""
    why: Annotated[str, Field(max_length=200)] = ""

    @model_validator(mode="after")
    def _says_for_how_long_it_is_shelved(self) -> Self:
        if (self.action is AlarmAction.SHELVE) != (self.shelve_s is not None):
            raise ValueError(f"expected shelve_s with shelve and only there, got {self.action.value}")
        return self


class PlayRequest(PageRequest):
    """Another time of the recording that is shown, or another pace at which it goes on."""

    at_s: Annotated[float, Field(ge=0, le=1e10)] | None = None
    """Seconds since its beginning."""
    pace: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """Mission seconds a second; 0 stops it."""


class RehearsalRequest(PageRequest):
    """A rehearsal of the rest of the mission."""

    draws: Annotated[int, Field(ge=2, le=MAX_DRAWS)]
    against: Annotated[str, Field(min_length=1, max_length=2_000)] | None = None
    """An alternative that is rehearsed beside it, in words."""


class RehearsalStop(PageRequest):
    """The end of a rehearsal."""

    number: Annotated[int, Field(ge=1, lt=MAX_COUNT)]


def parsed(kind: type[Request], body: bytes) -> Request:
    """The request in that JSON; raises InvalidInput with one line for anything else."""
    document(body)
    try:
        return kind.model_validate_json(body)
    except ValidationError as error:
        raise InvalidInput(one_line(error)) from None


def document(body: bytes) -> dict[str, Any]:
    """The JSON object of a request's body; raises InvalidInput for anything else."""
    try:
        found = json.loads(body, parse_constant=_no_constant)
        json.dumps(found, ensure_ascii=False).encode()  # half a surrogate pair is no text
    except (ValueError, RecursionError):
        raise InvalidInput("expected a JSON object in UTF-8, got something else") from None
    if not isinstance(found, dict):
        raise InvalidInput(f"expected a JSON object, got {type(found).__name__}")
    return found


def _no_constant(name: str) -> Any:
    raise ValueError(name)
