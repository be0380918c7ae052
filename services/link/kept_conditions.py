"""The conditions that survive a restart of the link: what operators have set holds until they set it otherwise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.link import LinkConditions  # of a model's field: pydantic reads it
from schemas.wire import Text, Wire
from services.runtime.files.input import read_own
from services.runtime.files.output import failed

if TYPE_CHECKING:
    from pathlib import Path


class KeptConditions(Wire):
    """The conditions after the latest change of them."""

    mission: Text
    of_scenario: LinkConditions
    """The scenario's own, from which the changes began."""
    conditions: LinkConditions
    contact_forced: bool | None = None
    """Contact as set by an operator; None: as scheduled."""

    @property
    def changed(self) -> bool:
        """Whether they differ from those of the scenario."""
        return self.conditions != self.of_scenario or self.contact_forced is not None


def kept_conditions(path: Path, mission: str, of_scenario: LinkConditions) -> KeptConditions | None:
    """The conditions that an earlier start of the link has kept in that file; None if there is no such file.

    Raises InvalidInput if the file holds none, or those of another mission or scenario; He3Error if it cannot be read.
    """
    advice = "restore the file, or remove it: the conditions are those of the scenario then"
    try:
        kept = KeptConditions.model_validate_json(read_own(path))
    except FileNotFoundError:
        return None
    except ValidationError:
        raise InvalidInput(
            f"{path}: expected the conditions that an earlier start of the link kept, got other data; {advice}"
        ) from None
    except OSError as error:
        raise failed(f"{path}: cannot read the kept conditions of the link", error) from None
    if kept.mission != mission:
        raise InvalidInput(
            f"{path}: expected the link's conditions of mission {mission}, got those of {kept.mission}; {advice}"
        )
    if kept.of_scenario != of_scenario:
        raise InvalidInput(
            f"{path}: expected conditions that were set from those of this scenario, got some that were set from "
            f"others; {advice}"
        )
    return kept
