"""The properties of one service's process, as its `__main__` declares them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from services.runtime.scheduler import Executor

if TYPE_CHECKING:
    from schemas.topics import Topic
    from services.runtime.node import Node
    from services.runtime.options import Options


class OwnedExecutor(Executor, Protocol):
    """An executor that owns a process and ends it."""

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class QueryModule:
    """The query process of a service."""

    module: str
    """Run as a program with side, endpoint and mission; see `services.runtime.queries.process`."""
    topics: tuple[Topic, ...]
    """The queries that it answers in the node's place."""


@dataclass(frozen=True, slots=True)
class Service:
    """A service's process."""

    name: str
    build: Callable[[Options], Node]
    executor: Callable[[], OwnedExecutor] | None = None
    """Where computations run; None: in the main loop."""
    queries: QueryModule | None = None
    journals: bool = False
    """Whether it continues from a journal after a restart; a service without a journal has no state to restore."""
    onlooker: bool = False
    """Whether it only subscribes: in lockstep, virtual time never waits for it."""
    completes_file: bool = False
    """Whether it completes a file when it is told to stop, and so is given more time."""
