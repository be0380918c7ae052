"""The rule that everything follows from: a service is a node, a state machine that sees events and returns effects.

A node owns no socket, clock, file, thread or global random generator. Time is an argument, randomness a seeded
generator handed in at its making. The same node runs in its own process over Zenoh, in one simulated process with
all others, and under thousands of random faults; given the same events at the same times, it does the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol, runtime_checkable

from schemas.refusal import RefusalCode
from schemas.topics import Side, Topic
from schemas.wire import Header, Wire
from services.runtime.state_codec import Stateful

MissionTime = int
"""Nanoseconds of mission time (UTC) since 1970-01-01T00:00:00Z."""

SECOND: MissionTime = 1_000_000_000


def seconds(value: float) -> MissionTime:
    """A duration [ns] from seconds, to the nearest nanosecond."""
    return round(value * SECOND)


# --- events: what a node sees -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Started:
    """The process runs; `incarnation` counts its starts from 1. Timers and questions of earlier starts still stand."""

    incarnation: int


@dataclass(frozen=True, slots=True)
class Received:
    """A message came, checked against its schema."""

    topic: Topic
    header: Header
    body: Any


@dataclass(frozen=True, slots=True)
class ReceivedRaw:
    """A message came on a topic that this node handles unread (the link carries sealed letters)."""

    topic: Topic
    payload: bytes


@dataclass(frozen=True, slots=True)
class QueryReceived:
    """Someone asks; answer it with `SendReply` or `RefuseQuery` and the same token, now or later."""

    topic: Topic
    request: Any
    token: int


class NoReply(Enum):
    """Why a question has no answer."""

    NO_ROUTE = "nobody is there to answer"
    TIMEOUT = "no answer in time"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class ReplyReceived:
    """The answer to this node's question of that name."""

    topic: Topic
    query: str
    reply: Any


@dataclass(frozen=True, slots=True)
class QueryFailed:
    """This node's question of that name has no answer; `detail` is what a refusal said."""

    topic: Topic
    query: str
    why: NoReply
    detail: str = ""


@dataclass(frozen=True, slots=True)
class TimerFired:
    """The time asked for with `SetTimer` under that name has come."""

    timer: str


@dataclass(frozen=True, slots=True)
class Computed:
    """The computation of that name has ended: with a result, or with the error that it raised."""

    job: str
    result: Any
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class QueueDepthChanged:
    """`depth` messages of this node now wait for the other side's acknowledgement.

    It follows from the events before it, so it is neither counted nor written to the event log.
    """

    depth: int


Event = (
    Started
    | Received
    | ReceivedRaw
    | QueryReceived
    | ReplyReceived
    | QueryFailed
    | TimerFired
    | Computed
    | QueueDepthChanged
)

# --- effects: what a node wants done ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Send:
    """Publish a message; the header is stamped on the way out."""

    topic: Topic
    body: Wire


@dataclass(frozen=True, slots=True)
class Forward:
    """Publish a sealed letter, as it came, on one side (the link only)."""

    topic: Topic
    payload: bytes
    side: Side


@dataclass(frozen=True, slots=True)
class SendQuery:
    """Send a query to the server of the topic on this side; `ReplyReceived` or `QueryFailed` follows, exactly once."""

    topic: Topic
    request: Wire
    query: str
    timeout_s: float = 60.0


@dataclass(frozen=True, slots=True)
class SendReply:
    """Reply to a `QueryReceived`."""

    token: int
    reply: Wire


@dataclass(frozen=True, slots=True)
class RefuseQuery:
    """Refuse a `QueryReceived`: in one line what was expected and what came, and a code for programs."""

    token: int
    why: str
    code: RefusalCode = RefusalCode.INVALID_INPUT


@dataclass(frozen=True, slots=True)
class SetTimer:
    """Request `TimerFired(timer)` at that time. The same name again moves the timer, None cancels it."""

    timer: str
    at: MissionTime | None


@dataclass(frozen=True, slots=True)
class Compute:
    """Run a pure, picklable function elsewhere; `Computed(job)` follows, `takes_s` of mission time later or more.

    The result must be a function of the arguments alone. In virtual time it comes exactly `takes_s` later.
    """

    job: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    takes_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PublishSnapshot:
    """Hand a new immutable snapshot to those who answer operators' queries; the old one is dropped."""

    snapshot: object
    awaited: bool = False
    """What follows is said only when questions are answered from it: whoever hears it and asks finds no older one."""


class Level(Enum):
    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class LogRecord:
    """A line for the structured log."""

    level: Level
    text: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Finish:
    """This node has nothing left to do; a run that waits for it may end."""

    ok: bool
    why: str


Effect = (
    Send | Forward | SendQuery | SendReply | RefuseQuery | SetTimer | Compute | PublishSnapshot | LogRecord | Finish
)


class Node(Protocol):
    """A service's state machine."""

    @property
    def interface(self) -> Interface:
        """What it listens to and serves; fixed for its life."""

    def handle(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        """Effects of the event, in order. Never blocks, never raises for anything that came from outside."""


@runtime_checkable
class DurableNode(Node, Stateful, Protocol):
    """A node that outlives its process: its inputs are kept in a journal, and its state in checkpoints."""

    @property
    def state_types(self) -> tuple[type, ...]:
        """What its state, its computations and their results are made of, beside plain values."""

    @property
    def functions(self) -> Mapping[str, Callable[..., Any]]:
        """The functions that its computations run, by name."""


@dataclass(frozen=True, slots=True)
class Interface:
    """What a node is called, where it stands, and what it wants to hear."""

    name: str
    sides: tuple[Side, ...]
    subscribes: tuple[Topic, ...] = ()
    receives_raw: tuple[Topic, ...] = ()
    """Topics taken unread, on every side the node stands on where they are not its own output: see `Forward`."""
    serves: tuple[Topic, ...] = ()
    custody: bool = True
    """Whether topics of custody service are acknowledged by this node when it subscribes to them."""
    reports_queue_depth: bool = False
    """Whether this node sees `QueueDepthChanged`."""
