"""The messages by which a process claims its role in a mission: one process of each role takes part."""

from __future__ import annotations

from schemas.wire import Count, Identifier, Wire


class RoleClaim(Wire):
    """A process asks for the role of its name, or says that it still holds it."""

    name: Identifier
    process: Identifier
    """Identifies one start of a process: NAME.PID.RANDOM.MACHINE."""


class RoleHolder(Wire):
    """The process that holds a role."""

    process: Identifier | None
    """None: the claimant's liveliness token has not been seen yet; it asks again."""
    renewals: Count
    """How often the holder has said that it still holds the role: if it grows, the holder works."""
