"""The requests that name the person who makes them; in a mission with keys that is the signer, or they are refused."""

from __future__ import annotations

from typing import Final

from schemas.authority import AuthorityChange
from schemas.ground import InterestChange
from schemas.link import LinkChange
from schemas.mission_log import AlarmMark
from schemas.plans import PlanDecision

NAMING: Final = (AlarmMark, AuthorityChange, InterestChange, LinkChange, PlanDecision)
"""Types with a field `by`; None in it stands for a person who gave no name."""
