"""The roles of a mission: what a process or a person may do follows from its role."""

from __future__ import annotations

from enum import StrEnum


class Role(StrEnum):
    """A role; `schemas.topics` says for each topic which roles publish, subscribe, query and answer."""

    FIELD = "field"
    ROVER = "rover"
    LINK = "link"
    GROUND = "ground"
    RECORDER = "recorder"
    VIEWER = "viewer"
    """A person or a page that reads."""
    OPERATOR = "operator"
    """A person who commands the rover and sets areas of interest."""
    CONTROLLER = "controller"
    """A person who changes the link and the clock."""


PROCESS_ROLES: tuple[Role, ...] = (Role.LINK, Role.FIELD, Role.ROVER, Role.GROUND, Role.RECORDER)
"""Roles of the processes that a launcher starts; each has the name of its process."""
PERSON_ROLES: tuple[Role, ...] = (Role.VIEWER, Role.OPERATOR, Role.CONTROLLER)
"""Roles of people, and of programs that act for them."""
