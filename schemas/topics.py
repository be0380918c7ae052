"""The table of topics: payload, direction, class of service, recording. No other module spells a key."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from enum import Enum, StrEnum

from schemas.authority import AuthorityChange, AuthorityState
from schemas.claims import RoleClaim, RoleHolder
from schemas.commands import CommandList, CommandPreview, CommandReport, CommandStatus, NoParameters, Telecommand
from schemas.fork import MissionFork
from schemas.ground import GroundStatus, InterestChange, InterestList, MapOverview, MissionTrack, Presence
from schemas.link import Acknowledgement, ClockChange, ClockState, Direction, LinkChange, LinkStatus
from schemas.lockstep import Grant, Join, Joined, Poke, StepBusy, StepDone, TimeControl, TimeStatus
from schemas.maps import (
    CrossValidation,
    CrossValidationQuery,
    GradeTonnage,
    GradeTonnageQuery,
    MapBoxQuery,
    MapFrame,
    MapHistory,
    MapLayerQuery,
    MapPoint,
    MapPointQuery,
    MapRaster,
    MapRealisations,
    MapRegion,
    MapScore,
    MapTrackQuery,
    RealisationsQuery,
    ResourceEstimate,
    ResourceQuery,
)
from schemas.measurement import MeasurementReply, MeasurementRequest, TerrainReply, TerrainRequest
from schemas.mission_log import AlarmMark, LogEntry, MissionLog
from schemas.plans import MissionPlan, PlanDecision, PlanReview
from schemas.roles import PERSON_ROLES, Role
from schemas.telemetry import RoverEvent, RoverState, SampleReport
from schemas.wire import Wire

KEY_ROOT = "he3"


class Side(StrEnum):
    MOON = "moon"
    EARTH = "earth"


SIDES: dict[Role, tuple[Side, ...]] = {
    Role.FIELD: (Side.MOON,),
    Role.ROVER: (Side.MOON,),
    Role.LINK: (Side.MOON, Side.EARTH),
    Role.GROUND: (Side.EARTH,),
    Role.RECORDER: (Side.EARTH,),
    **dict.fromkeys(PERSON_ROLES, (Side.EARTH,)),
}
"""The networks that each role may use."""


class Crosses(Enum):
    """Whether a topic crosses the link, and in which direction."""

    UP = "tc"
    DOWN = "tm"
    NEVER = None


@dataclass(frozen=True, slots=True)
class Custody:
    """Delivered exactly once, end to end, despite loss and black-outs; lower priority values go first."""

    priority: int


@dataclass(frozen=True, slots=True)
class Latest:
    """Only the newest message counts: it is not repeated, and it replaces an older one that waits."""

    priority: int = 9
    distinct: tuple[str, ...] = ()
    """Fields of the body that separate subjects; of each subject the newest message counts."""


@dataclass(frozen=True, slots=True)
class Query:
    """A query and its reply on one side; they never cross the link."""

    observes: bool = False
    """Whether only observers ask it. Its answer changes nothing, so event logs leave it out."""


@dataclass(frozen=True, slots=True)
class Access:
    """Which roles may do what with a topic; every other role may not."""

    publish: tuple[Role, ...] = ()
    subscribe: tuple[Role, ...] = ()
    query: tuple[Role, ...] = ()
    answer: tuple[Role, ...] = ()


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table."""

    name: str
    payload: type[Wire]
    access: Access = Access()
    """Access end to end; the link's right to carry crossing topics is not listed."""
    crosses: Crosses = Crosses.NEVER
    service: Custody | Latest | Query = Latest()
    recorded: bool = False
    kept: bool = False
    """Whether the last message can be queried on the same key, for late subscribers."""
    reply: type[Wire] | None = None
    signed: bool = False
    """Whether, in a mission with keys, its messages (of a query: request and reply) count only if they are signed."""
    per_process: bool = False
    """Whether each subscriber has a key of its own, which ends with its name; see `addressed`."""
    max_bytes: int = 16_384
    max_reply_bytes: int = 1_048_576
    sources: frozenset[str] | None = field(init=False, repr=False, compare=False)
    """The names of the processes that make its messages, or its queries; None: people do, under names of their own.

    The role of a process has the name of the process. It holds end to end: the link that carries a message does not
    become its source.
    """
    reply_sources: frozenset[str] | None = field(init=False, repr=False, compare=False)
    """The names of the processes that reply to its queries."""
    direction: Direction | None = field(init=False, repr=False, compare=False)
    """Direction in which it crosses the link; None for a topic that stays on its side."""
    sides: tuple[Side, ...] = field(init=False, repr=False, compare=False)
    """The sides on which the key exists: both for a topic that crosses."""

    def __post_init__(self) -> None:
        # Every message asks for these, so they are worked out once.
        by = self.access.query if isinstance(self.service, Query) else self.access.publish
        object.__setattr__(self, "sources", _process_names(by))
        object.__setattr__(self, "reply_sources", _process_names(self.access.answer))
        direction = {Crosses.UP: Direction.UP, Crosses.DOWN: Direction.DOWN, Crosses.NEVER: None}[self.crosses]
        object.__setattr__(self, "direction", direction)
        both = Side.MOON, Side.EARTH
        object.__setattr__(self, "sides", (Side(self.name.split("/", 1)[0]),) if direction is None else both)

    def __hash__(self) -> int:
        return hash(self.name)  # the names differ, and topics are looked up with every message

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, Topic):
            return self is other
        return self.name == other.name and astuple(self) == astuple(other)

    def key(self, mission: str) -> str:
        """The Zenoh key expression of this topic in that mission."""
        return f"{KEY_ROOT}/{mission}/{self.name}"

    def access_on(self, side: Side) -> Access:
        """Which roles may do what with the topic on that side's network, the link as the carrier included."""
        given = self.access
        here = Access(
            *(_standing_on(side, roles) for roles in (given.publish, given.subscribe, given.query, given.answer))
        )
        if self.crosses is Crosses.NEVER:
            return here
        departs = Side.EARTH if self.crosses is Crosses.UP else Side.MOON
        if side is departs:
            return replace(here, subscribe=(Role.LINK, *here.subscribe))
        return replace(here, publish=(Role.LINK, *here.publish))


def _process_names(roles: tuple[Role, ...]) -> frozenset[str] | None:
    people = not roles or any(role in PERSON_ROLES for role in roles)
    return None if people else frozenset(role.value for role in roles)


def _standing_on(side: Side, roles: tuple[Role, ...]) -> tuple[Role, ...]:
    return tuple(role for role in roles if side in SIDES[role])


def _published(by: Role | tuple[Role, ...], to: tuple[Role, ...]) -> Access:
    return Access(publish=by if isinstance(by, tuple) else (by,), subscribe=to)


def _kept(by: Role, to: tuple[Role, ...], queried_by: tuple[Role, ...]) -> Access:
    """Access to a topic that its publisher also serves: queries on the same key return the last message."""
    return Access(publish=(by,), subscribe=to, query=queried_by, answer=(by,))


def _queried(by: tuple[Role, ...], of: Role) -> Access:
    return Access(query=by, answer=(of,))


_READERS = PERSON_ROLES
_RECORDED_AND_READ = (Role.RECORDER, *_READERS)
_DOWNLINK = _published(Role.ROVER, (Role.GROUND, *_RECORDED_AND_READ))
_UPLINK = _published(Role.GROUND, (Role.ROVER, Role.RECORDER))
_MAP = _queried(_READERS, Role.GROUND)
_ON_MOON = (Role.FIELD, Role.ROVER)
_TO_TIME_MANAGER = {Side.MOON: _published(_ON_MOON, (Role.LINK,)), Side.EARTH: _published(Role.GROUND, (Role.LINK,))}


_OF_A_STREAM = Latest(priority=0, distinct=("stream", "source", "incarnation"))

PLAN = Topic(
    "tc/plan", MissionPlan, _UPLINK, Crosses.UP, Custody(priority=1), recorded=True, max_bytes=1_048_576, signed=True
)
COMMAND = Topic("tc/command", Telecommand, _UPLINK, Crosses.UP, Custody(priority=0), recorded=True, signed=True)
ACK_UP = Topic("tc/ack", Acknowledgement, _UPLINK, Crosses.UP, _OF_A_STREAM, recorded=True, signed=True)

SAMPLE = Topic("tm/sample", SampleReport, _DOWNLINK, Crosses.DOWN, Custody(priority=2), recorded=True, signed=True)
EVENT = Topic("tm/event", RoverEvent, _DOWNLINK, Crosses.DOWN, Custody(priority=1), recorded=True, signed=True)
COMMAND_REPORT = Topic(
    "tm/command", CommandReport, _DOWNLINK, Crosses.DOWN, Custody(priority=0), recorded=True, signed=True
)
STATE = Topic("tm/state", RoverState, _DOWNLINK, Crosses.DOWN, Latest(), recorded=True, signed=True)
ACK_DOWN = Topic(
    "tm/ack",
    Acknowledgement,
    _published(Role.ROVER, (Role.GROUND, Role.RECORDER)),
    Crosses.DOWN,
    _OF_A_STREAM,
    recorded=True,
    signed=True,
)

MEASURE = Topic(
    "moon/field/measure",
    MeasurementRequest,
    _queried((Role.ROVER,), Role.FIELD),
    service=Query(),
    reply=MeasurementReply,
    signed=True,
)
TERRAIN = Topic(
    "moon/field/terrain",
    TerrainRequest,
    _queried((Role.ROVER,), Role.FIELD),
    service=Query(),
    reply=TerrainReply,
    max_bytes=65_536,
    signed=True,
)
MOON_CLOCK = Topic("moon/clock", ClockState, _kept(Role.LINK, _ON_MOON, _ON_MOON))
MOON_PRESENCE = Topic("moon/presence", Presence, _published((Role.LINK, *_ON_MOON), (Role.LINK,)))
MOON_CLAIM = Topic(
    "moon/claim", RoleClaim, _queried(_ON_MOON, Role.LINK), service=Query(observes=True), reply=RoleHolder
)

EARTH_CLOCK = Topic(
    "earth/clock",
    ClockState,
    _kept(Role.LINK, (Role.GROUND, *_RECORDED_AND_READ), (Role.GROUND, *_RECORDED_AND_READ)),
    recorded=True,
)
EARTH_PRESENCE = Topic(
    "earth/presence", Presence, _published((Role.LINK, Role.GROUND, Role.RECORDER), (Role.LINK, *_READERS))
)
EARTH_CLAIM = Topic(
    "earth/claim",
    RoleClaim,
    _queried((Role.GROUND, Role.RECORDER), Role.LINK),
    service=Query(observes=True),
    reply=RoleHolder,
)
CLOCK_SET = Topic(
    "earth/clock/set",
    ClockChange,
    _queried((Role.CONTROLLER,), Role.LINK),
    service=Query(),
    reply=ClockState,
    signed=True,
)
LINK_STATUS = Topic(
    "earth/link/status",
    LinkStatus,
    _kept(Role.LINK, _RECORDED_AND_READ, _READERS),
    recorded=True,
    kept=True,
    max_bytes=262_144,
    signed=True,
)
LINK_SET = Topic(
    "earth/link/set",
    LinkChange,
    _queried((Role.CONTROLLER,), Role.LINK),
    service=Query(),
    reply=LinkStatus,
    signed=True,
)
LINK_SHOW = Topic(
    "earth/link/show",
    NoParameters,
    _queried((Role.GROUND, *_READERS), Role.LINK),
    service=Query(observes=True),
    reply=LinkStatus,
)
GROUND_STATUS = Topic(
    "earth/ground/status",
    GroundStatus,
    _kept(Role.GROUND, _RECORDED_AND_READ, _READERS),
    recorded=True,
    kept=True,
    max_bytes=65_536,
    signed=True,
)
ISSUE_COMMAND = Topic(
    "earth/ground/command",
    Telecommand,
    _queried((Role.OPERATOR,), Role.GROUND),
    service=Query(),
    reply=CommandStatus,
    signed=True,
)
PREVIEW_COMMAND = Topic(
    "earth/ground/preview",
    Telecommand,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=CommandPreview,
)
LIST_COMMANDS = Topic(
    "earth/ground/commands",
    NoParameters,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=CommandList,
    max_reply_bytes=4_194_304,
)
SET_INTEREST = Topic(
    "earth/ground/interest",
    InterestChange,
    _queried((Role.OPERATOR,), Role.GROUND),
    service=Query(),
    reply=InterestList,
    max_reply_bytes=4_194_304,
    signed=True,
)
LIST_INTERESTS = Topic(
    "earth/ground/interests",
    NoParameters,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=InterestList,
    max_reply_bytes=4_194_304,
)
INTERESTS = Topic(
    "earth/ground/interests-in-force",
    InterestList,
    _published(Role.GROUND, _RECORDED_AND_READ),
    recorded=True,
    max_bytes=4_194_304,
    signed=True,
)
"""Published with every change of the areas of interest, and once when the ground begins with some."""
SET_AUTHORITY = Topic(
    "earth/ground/authority",
    AuthorityChange,
    _queried((Role.OPERATOR,), Role.GROUND),
    service=Query(),
    reply=AuthorityState,
    signed=True,
)
SHOW_AUTHORITY = Topic(
    "earth/ground/authority/show",
    NoParameters,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=AuthorityState,
)
DECIDE_PLAN = Topic(
    "earth/ground/plan/decide",
    PlanDecision,
    _queried((Role.OPERATOR,), Role.GROUND),
    service=Query(),
    reply=PlanReview,
    signed=True,
)
SHOW_PLAN = Topic(
    "earth/ground/plan/show",
    NoParameters,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=PlanReview,
)
FORK = Topic(
    "earth/ground/fork",
    NoParameters,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=MissionFork,
    max_reply_bytes=33_554_432,
)
SET_ALARM = Topic(
    "earth/ground/alarm",
    AlarmMark,
    _queried((Role.OPERATOR, Role.CONTROLLER), Role.GROUND),
    service=Query(),
    reply=LogEntry,
    signed=True,
)
SHOW_LOG = Topic(
    "earth/ground/log",
    NoParameters,
    _queried(_READERS, Role.GROUND),
    service=Query(observes=True),
    reply=MissionLog,
    max_reply_bytes=4_194_304,
)
LOG_ENTRY = Topic(
    "earth/ground/log-entry",
    LogEntry,
    _published(Role.GROUND, _RECORDED_AND_READ),
    service=Latest(distinct=("number",)),
    recorded=True,
)
COMMAND_STATUS = Topic(
    "earth/ground/command-status",
    CommandStatus,
    _published(Role.GROUND, _RECORDED_AND_READ),
    recorded=True,
    max_bytes=65_536,
)
MAP_POINT = Topic("earth/map/point", MapPointQuery, _MAP, service=Query(observes=True), reply=MapPoint)
MAP_LAYER = Topic(
    "earth/map/layer", MapLayerQuery, _MAP, service=Query(observes=True), reply=MapRaster, max_reply_bytes=33_554_432
)
MAP_SCORE = Topic("earth/map/score", NoParameters, _MAP, service=Query(observes=True), reply=MapScore)
MAP_CROSS_VALIDATION = Topic(
    "earth/map/cross-validation",
    CrossValidationQuery,
    _MAP,
    service=Query(observes=True),
    reply=CrossValidation,
    max_reply_bytes=4_194_304,
)
MAP_GRADE_TONNAGE = Topic(
    "earth/map/grade-tonnage", GradeTonnageQuery, _MAP, service=Query(observes=True), reply=GradeTonnage
)
MAP_REALISATIONS = Topic(
    "earth/map/realisations",
    RealisationsQuery,
    _MAP,
    service=Query(observes=True),
    reply=MapRealisations,
    max_reply_bytes=33_554_432,
)
TRACK = Topic(
    "earth/map/track", MapTrackQuery, _MAP, service=Query(observes=True), reply=MissionTrack, max_reply_bytes=33_554_432
)
MAP_BOX = Topic(
    "earth/map/box", MapBoxQuery, _MAP, service=Query(observes=True), reply=MapRaster, max_reply_bytes=33_554_432
)
MAP_RESOURCE = Topic("earth/map/resource", ResourceQuery, _MAP, service=Query(observes=True), reply=ResourceEstimate)
MAP_HISTORY = Topic("earth/map/history", NoParameters, _MAP, service=Query(observes=True), reply=MapHistory)
MAP_REGION = Topic("earth/map/region", NoParameters, _MAP, service=Query(observes=True), reply=MapRegion)
MAP_FEED = Topic("earth/map/feed", MapFrame, _kept(Role.GROUND, _READERS, _READERS), max_bytes=67_108_864)
"""Not an envelope: head and numbers, see services/ground/map/feed.py. A query on the same key returns a key frame."""
MAP_OVERVIEW = Topic(
    "earth/map/overview",
    MapOverview,
    _kept(Role.GROUND, _RECORDED_AND_READ, _READERS),
    recorded=True,
    kept=True,
    max_bytes=524_288,
)

MOON_JOIN = Topic(
    "moon/time/join", Join, _queried(_ON_MOON, Role.LINK), service=Query(), reply=Joined, max_bytes=65_536
)
MOON_GRANT = Topic("moon/time/grant", Grant, _published(Role.LINK, _ON_MOON), per_process=True)
MOON_DONE = Topic("moon/time/done", StepDone, _TO_TIME_MANAGER[Side.MOON])
MOON_BUSY = Topic("moon/time/busy", StepBusy, _TO_TIME_MANAGER[Side.MOON])
MOON_POKE = Topic("moon/time/poke", Poke, _TO_TIME_MANAGER[Side.MOON])
EARTH_JOIN = Topic(
    "earth/time/join", Join, _queried((Role.GROUND,), Role.LINK), service=Query(), reply=Joined, max_bytes=65_536
)
EARTH_GRANT = Topic("earth/time/grant", Grant, _published(Role.LINK, (Role.GROUND,)), per_process=True)
EARTH_DONE = Topic("earth/time/done", StepDone, _TO_TIME_MANAGER[Side.EARTH])
EARTH_BUSY = Topic("earth/time/busy", StepBusy, _TO_TIME_MANAGER[Side.EARTH])
EARTH_POKE = Topic("earth/time/poke", Poke, _TO_TIME_MANAGER[Side.EARTH])
TIME_CONTROL = Topic(
    "earth/time/control",
    TimeControl,
    _queried((Role.CONTROLLER,), Role.LINK),
    service=Query(),
    reply=TimeStatus,
    signed=True,
)
TIME_SHOW = Topic(
    "earth/time/show", NoParameters, _queried(_READERS, Role.LINK), service=Query(observes=True), reply=TimeStatus
)

TOPICS: tuple[Topic, ...] = (
    PLAN,
    COMMAND,
    ACK_UP,
    SAMPLE,
    EVENT,
    COMMAND_REPORT,
    STATE,
    ACK_DOWN,
    MEASURE,
    TERRAIN,
    MOON_CLOCK,
    MOON_PRESENCE,
    MOON_CLAIM,
    EARTH_CLOCK,
    EARTH_PRESENCE,
    EARTH_CLAIM,
    CLOCK_SET,
    LINK_STATUS,
    LINK_SET,
    LINK_SHOW,
    GROUND_STATUS,
    ISSUE_COMMAND,
    PREVIEW_COMMAND,
    LIST_COMMANDS,
    SET_INTEREST,
    LIST_INTERESTS,
    INTERESTS,
    SET_AUTHORITY,
    SHOW_AUTHORITY,
    DECIDE_PLAN,
    SHOW_PLAN,
    FORK,
    SET_ALARM,
    SHOW_LOG,
    LOG_ENTRY,
    COMMAND_STATUS,
    MAP_POINT,
    MAP_LAYER,
    MAP_SCORE,
    MAP_CROSS_VALIDATION,
    MAP_GRADE_TONNAGE,
    MAP_REALISATIONS,
    TRACK,
    MAP_BOX,
    MAP_RESOURCE,
    MAP_HISTORY,
    MAP_REGION,
    MAP_FEED,
    MAP_OVERVIEW,
    MOON_JOIN,
    MOON_GRANT,
    MOON_DONE,
    MOON_BUSY,
    MOON_POKE,
    EARTH_JOIN,
    EARTH_GRANT,
    EARTH_DONE,
    EARTH_BUSY,
    EARTH_POKE,
    TIME_CONTROL,
    TIME_SHOW,
)

BY_NAME: dict[str, Topic] = {topic.name: topic for topic in TOPICS}
"""Every topic, by its name (the key without root and mission)."""


def counted(topic: Topic) -> Topic:
    """The topic on which a topic's messages go to the processes in lockstep, which wait for each message.

    Wildcards do not match a chunk that begins with '@', so an observer, on `he3/**` for example, is not waited for.
    """
    return replace(topic, name=f"{topic.name}/@counted", kept=False)


def addressed(topic: Topic, name: str) -> Topic:
    """The topic on which a topic's messages go to one process, with a key that ends in its name."""
    return replace(topic, name=f"{topic.name}/{name}")


ALIVE = "alive"
"""Liveliness group of all processes."""
MEMBERS = "member"
"""Liveliness group of the participants in lockstep; each start of a process has a token of its own."""
ONLOOKERS = "onlooker"
"""Liveliness group of the processes for which virtual time never waits."""

HOLDERS = "holder"
"""Liveliness group of the processes that claim the role of their name; each start has a token of its own."""
DISPLAYS = "display"
"""Liveliness group of the displays that follow a mission to its end; a token ends once its display has the last map."""


def liveliness_key(mission: str, side: Side, name: str, group: str = ALIVE) -> str:
    """Key of a process's liveliness token; the one key that is not a topic, as it carries no message."""
    return f"{KEY_ROOT}/{mission}/{side.value}/{group}/{name}"


def crossing(direction: Direction) -> tuple[Topic, ...]:
    """The topics that cross the link in that direction."""
    return tuple(topic for topic in TOPICS if topic.direction is direction)


def under_custody(topic: Topic) -> bool:
    """Whether messages of that topic are kept until they are acknowledged."""
    return isinstance(topic.service, Custody) and topic.direction is not None
