"""The link between Earth and Moon, seen and changed by an operator."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.link import LinkChange, LinkStatus
from schemas.topics import LINK_SET, LINK_SHOW
from schemas.validation import one_line
from services.console.client.person import Acting

if TYPE_CHECKING:
    from services.runtime.transport.client import Client


class LinkControl(Acting):
    """The part of `MissionClient` that concerns the link."""

    _session: Client

    def link(self) -> LinkStatus:
        """The present status of the link, with the messages in flight."""
        status: LinkStatus = self._session.query(LINK_SHOW, NoParameters())
        return status

    def set_link(self, **change: Any) -> LinkStatus:
        """Change conditions, such as ``one_way_light_time_s=3`` or ``loss=0.1``; returns the link's status after it."""
        return self.change_link(link_change(change))

    def change_link(self, change: LinkChange) -> LinkStatus:
        """Change conditions by a validated `LinkChange`; returns the link's status after it."""
        change = change.model_copy(update={"by": self.person})
        status: LinkStatus = self._session.query(LINK_SET, change)
        return status


def link_change(values: dict[str, Any]) -> LinkChange:
    """The link change from JSON values, enumerations as words; raises InvalidInput with one line."""
    try:
        return LinkChange.model_validate_json(json.dumps(values))
    except ValidationError as error:
        raise InvalidInput(f"link: {one_line(error)}") from None
