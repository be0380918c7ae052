"""The contract of a node: a service is a state machine that sees events and returns effects.

A node owns no socket, clock, file, thread or global random generator. Time is an argument; randomness is a seeded
generator, given to its constructor. So the same node runs in a process of its own over Zenoh, in one simulated process
with all others, and under thousands of random faults. Given the same events at the same times, it does the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from schemas.refusal import RefusalCode

if TYPE_CHECKING:
    from schemas.topics import Side, Topic
    from schemas.wire import Header, Wire
    from services.mission.mission_time import MissionTime

# --- events: what a node sees -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Started:
    """The process runs; `incarnation` counts its starts from 1. Timers and queries of earlier starts still stand."""

    incarnation: int


@dataclass(frozen=True, slots=True)
class Received:
    """A message, checked against its schema."""

    topic: Topic
    header: Header
    body: Any


@dataclass(frozen=True, slots=True)
class ReceivedRaw:
    """A message on a topic of `Interface.receives_raw`, as it arrived."""

    topic: Topic
    payload: bytes


@dataclass(frozen=True, slots=True)
class QueryReceived:
    """A query on a topic that the node serves. `SendReply` or `RefuseQuery` with its token answers it, now or later."""

    topic: Topic
    request: Any
    token: int


class NoReply(Enum):
    """Why a query has no reply."""

    NO_ROUTE = "no service answers"
    TIMEOUT = "no answer in time"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class ReplyReceived:
    """The reply to this node's query of that name."""

    topic: Topic
    query: str
    reply: Any


@dataclass(frozen=True, slots=True)
class QueryFailed:
    """This node's query of that name has ended without a reply; `detail` is the text of a refusal."""

    topic: Topic
    query: str
    why: NoReply
    detail: str = ""


@dataclass(frozen=True, slots=True)
class TimerFired:
    """The time that was set for that timer with `SetTimer` has come."""

    timer: str


@dataclass(frozen=True, slots=True)
class Computed:
    """The computation of that name has ended: with a result, or with the error that it raised."""

    job: str
    result: Any
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class QueueDepthChanged:
    """Now `depth` messages of this node await the other side's acknowledgement.

    Earlier events determine it, so it is neither counted nor written to the event log.
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
    """Publish a message; the host makes its header."""

    topic: Topic
    body: Wire


@dataclass(frozen=True, slots=True)
class SendIfHeard:
    """Publish a message that is made at once if anyone receives it, and else not: for what costs much to make.

    Its topic is not under custody. It counts in the topic's sequence either way.
    """

    topic: Topic
    make: Callable[[], Wire]


@dataclass(frozen=True, slots=True)
class Forward:
    """Publish a message on one side, byte for byte as it arrived (the link only)."""

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
    """Refuse a `QueryReceived`: with one line of the form "expected ..., got ...", and a code for programs."""

    token: int
    why: str
    code: RefusalCode = RefusalCode.INVALID_INPUT


@dataclass(frozen=True, slots=True)
class SetTimer:
    """Request `TimerFired(timer)` at that time. The same name again moves the timer; None cancels it."""

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
    """Answer operators' queries from this immutable snapshot from now on, in place of an earlier one."""

    snapshot: object
    awaited: bool = False
    """Whether later effects wait until queries are answered from it, so that a client that sees them can query it."""


@dataclass(frozen=True, slots=True)
class Keep:
    """Keep this for the next start of the process, in place of what was kept earlier: for a node without a journal.

    Effects that follow wait until it is on the disk. Without a folder for journals nothing is kept.
    """

    value: Wire


class Level(Enum):
    """Severity of a log record."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Cause:
    """What others sent that led to a log line, which they can repeat at will: the log limits the lines of one cause."""

    kind: str
    """One of few texts of the program's own, such as the topic and what was wrong."""
    source: str
    """The sender that the message names, which is not proven."""


@dataclass(frozen=True, slots=True)
class LogRecord:
    """A line for the structured log."""

    level: Level
    text: str
    fields: dict[str, Any] = field(default_factory=dict)
    cause: Cause | None = None
    """None: the line does not follow from what others send, and is always written."""


@dataclass(frozen=True, slots=True)
class Finish:
    """The node has nothing left to do; a run that waits for it may end."""

    ok: bool
    why: str


Effect = (
    Send
    | SendIfHeard
    | Forward
    | SendQuery
    | SendReply
    | RefuseQuery
    | SetTimer
    | Compute
    | PublishSnapshot
    | Keep
    | LogRecord
    | Finish
)


class Node(Protocol):
    """A service's state machine."""

    @property
    def interface(self) -> Interface:
        """Its subscriptions and the queries that it serves; constant."""

    def handle(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        """Effects of the event, in order. Never blocks, and never raises because of input from outside."""


SavedState = dict[str, Any]
"""The state of an object: named parts, each of which the codec can encode."""


class Stateful(Protocol):
    """An object whose state can be saved and restored."""

    def checkpoint(self) -> SavedState:
        """The state, from which `restore` makes an equal object out of a newly built one."""

    def restore(self, state: SavedState) -> None:
        """Restore the object from this state."""


@runtime_checkable
class DurableNode(Node, Stateful, Protocol):
    """A node that outlives its process: its inputs are kept in a journal, and its state in checkpoints."""

    @property
    def state_types(self) -> tuple[type, ...]:
        """The types in its state, its computations and their results, beside plain values."""

    @property
    def functions(self) -> Mapping[str, Callable[..., Any]]:
        """The functions that its computations run, by name."""


@dataclass(frozen=True, slots=True)
class Interface:
    """A node's name, its sides of the link, and the topics that it subscribes to and serves."""

    name: str
    sides: tuple[Side, ...]
    subscribes: tuple[Topic, ...] = ()
    receives_raw: tuple[Topic, ...] = ()
    """Topics whose messages the node receives undecoded, on each of its sides where they are made: see `Forward`."""
    serves: tuple[Topic, ...] = ()
    custody: bool = True
    """Whether the node acknowledges the messages under custody that it subscribes to."""
    reports_queue_depth: bool = False
    """Whether this node sees `QueueDepthChanged`."""
