"""Hosts with keys: what is forged changes nothing, what is genuine passes, and both are written down."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from he3.errors import InvalidInput
from schemas.codec import body_of, decode, encode
from schemas.commands import CommandKind, Telecommand
from schemas.link import Acknowledgement, DirectionCounts, LinkChange, LinkConditions, LinkStatus
from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.roles import Role
from schemas.signing import Part
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import ACK_UP, COMMAND, EVENT, ISSUE_COMMAND, LINK_SET, LINK_STATUS, MEASURE, Side
from schemas.wire import Header
from services.mission.mission_time import SECOND
from services.runtime.actions import Publish, PutQuery, Reply, ReplyError
from services.runtime.audit_trail import AuditTrail, RefusalCounter
from services.runtime.host import Host
from services.runtime.input_codec import decode_input, encode_input
from services.runtime.inputs import (
    CheckedQueryArrived,
    MessageArrived,
    ProcessStarted,
    QueryArrived,
    QueryUnanswered,
    ReplyArrived,
    TimerElapsed,
)
from services.runtime.node import Cause, Interface, LogRecord, NoReply, Received, Send, SendQuery, SendReply
from services.runtime.scheduler import InlineExecutor, NodeScheduler
from services.runtime.scheduler import Kind as Order
from services.runtime.trust.audit import AuditLog, file_lines, rows, verify
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject, utc_now
from services.runtime.trust.gate import MAX_SEEN, Gate, Requests, RosterFile, default_instance
from services.runtime.trust.identity import load_identity
from services.runtime.trust.signing import Signer, Verifier

NOW = 10**18
HOUR = 3600 * SECOND
PAUSE = Telecommand(command_id="c-12", kind=CommandKind.PAUSE)
PEOPLE = (("operator", "anna"), ("operator", "ben"), ("viewer", "anna"), ("controller", "ben"))


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    authority = Authority.create(tmp_path_factory.mktemp("gate") / "keys")
    for role in (Role.GROUND, Role.ROVER, Role.FIELD, Role.LINK):
        authority.issue(subject(role.value, "main"))
    for role, name in PEOPLE:
        authority.issue(subject(role, name))
    return authority


def signer(authority, common_name, instance="run-1"):
    identity = load_identity(authority.folder_of(subject(*common_name.split("."))))
    return Signer(identity.common_name, identity.key, instance)


def gate(authority, common_name, instance="run-1", mission="short"):
    roster = authority.roster
    return Gate(signer(authority, common_name, instance), Verifier(lambda: roster, mission, instance, utc_now))


class Scripted:
    """A node that stores its events and returns scripted effects."""

    def __init__(self, **interface):
        self.interface = Interface(**{"name": "rover", "sides": (Side.MOON,), "custody": True, **interface})
        self.seen = []
        self.next = []

    def handle(self, event, now):
        self.seen.append(event)
        effects, self.next = self.next, []
        return effects


class Process:
    """A node with its host and scheduler, as a process has them, and its audit log."""

    def __init__(self, authority, common_name, path, mission="short", instance="run-1", **interface):
        self.path = path / f"{common_name}.jsonl"
        self.node = Scripted(**interface)
        self.log = AuditLog(self.path, lambda: datetime.now(UTC))
        trail = AuditTrail(self.log, pytest.fail)
        self.host = Host(self.node, mission, gate=gate(authority, common_name, instance, mission), audit=trail)
        self.scheduler = NodeScheduler(self.host, InlineExecutor())
        self.run(ProcessStarted(1))
        self.node.seen.clear()

    def run(self, given, now=NOW):
        self.scheduler.put((Order.MESSAGE, "", 0), given)
        return self.scheduler.run(now)

    def sends(self, *effects, now=NOW):
        """The messages that the node sends."""
        self.node.next = list(effects)
        actions = self.run(TimerElapsed("t"), now)
        return [action for action in actions if isinstance(action, Publish | PutQuery | Reply)]

    @property
    def bodies(self):
        return [event.body for event in self.node.seen if isinstance(event, Received)]

    @property
    def written(self):
        lines = list(file_lines(self.path))
        assert verify(lines).fault is None
        return [row for row in rows(lines) if row["kind"] != "opened"]


@pytest.fixture
def process(authority, tmp_path):
    """Makes processes; their files are closed at the end."""
    made = []

    def make(common_name, folder="", **rest):
        made.append(Process(authority, common_name, tmp_path / folder, **rest))
        return made[-1]

    yield make
    for each in made:
        each.log.close()


@pytest.fixture
def ground(process):
    return process(
        "ground.main", name="ground", sides=(Side.EARTH,), subscribes=(EVENT,),
        serves=(ISSUE_COMMAND,),
    )  # fmt: skip


@pytest.fixture
def rover(process):
    return process("rover.main", subscribes=(COMMAND,))


def consented(authority, common_name="operator.anna", order=PAUSE, mission="short", instance="run-1", made_at=NOW):
    return signer(authority, common_name, instance).authorized(order, mission, made_at, made_at + HOUR)


def uplink(ground, command, now=NOW):
    (published,) = ground.sends(Send(COMMAND, command), now=now)
    return published.payload


def text_of(actions):
    return [action.text for action in actions if isinstance(action, LogRecord)]


# --- commands -----------------------------------------------------------------------------------------------------


def test_a_signed_command_reaches_the_rover_and_is_written_down_with_its_person(authority, ground, rover):
    rover.run(MessageArrived(COMMAND, uplink(ground, consented(authority))))
    assert [body.objection for body in rover.bodies] == [None]
    (line,) = rover.written
    assert (line["kind"], line["by"], line["verified"], line["what"]) == (
        "command", "operator.anna", True, "pause c-12",
    )  # fmt: skip


def test_a_command_altered_by_one_bit_in_the_link_changes_nothing(authority, ground, rover):
    payload = uplink(ground, consented(authority))
    header, _ = decode(COMMAND, payload, "short")
    altered = body_of(payload).replace(b"c-12", b"c-13")  # one bit
    forged = encode(header.model_copy(update={"checksum": None}), Telecommand.model_validate_json(altered))
    actions = rover.run(MessageArrived(COMMAND, forged))
    assert rover.bodies == []
    assert not [action for action in actions if isinstance(action, Publish)], "nothing is acknowledged"
    assert "altered, or forged" in text_of(actions)[0]
    (line,) = rover.written
    assert (line["kind"], line["by"], line["verified"]) == ("refusal", "ground.main", False)


def test_a_command_that_the_ground_alters_is_refused_by_the_rover_and_says_whose_it_was(authority, ground, rover):
    altered = consented(authority).model_copy(update={"kind": CommandKind.RESUME})
    rover.run(MessageArrived(COMMAND, uplink(ground, altered)))
    assert "expected the signature of operator.anna over this very message" in rover.bodies[0].objection
    assert [(line["kind"], line["by"]) for line in rover.written] == [("refusal", "operator.anna")]


def test_a_command_that_the_ground_makes_up_is_refused_by_the_rover(authority, ground, rover):
    rover.run(MessageArrived(COMMAND, uplink(ground, PAUSE)))
    assert rover.bodies[0].objection == "command c-12: expected the signature of role operator, got none"


def test_each_of_the_first_twenty_refused_commands_is_in_the_audit_log_and_of_a_flood_few(authority, ground, rover):
    altered = consented(authority).model_copy(update={"kind": CommandKind.RESUME})
    for _ in range(120):
        rover.run(MessageArrived(COMMAND, uplink(ground, altered)))
    assert [line["number_of_sender"] for line in rover.written] == [*range(1, 21), 100]
    assert rover.host.refused == 120


def test_a_command_of_a_viewer_is_refused_with_role_and_name(authority, ground, rover):
    rover.run(MessageArrived(COMMAND, uplink(ground, consented(authority, "viewer.anna"))))
    assert rover.bodies[0].objection == "command c-12 of viewer anna: expected role operator"
    assert [line["why"] for line in rover.written] == ["command c-12 of viewer anna: expected role operator"]


def test_a_command_replayed_after_an_hour_is_refused_and_its_custody_goes_on(authority, ground, rover):
    late = NOW + HOUR + SECOND
    actions = rover.run(MessageArrived(COMMAND, uplink(ground, consented(authority), now=late)), now=late)
    assert rover.bodies[0].objection == "command c-12 of operator anna: expired 1 s ago: late, or replayed"
    rover.host.admit(TimerElapsed("t"), late)
    assert [line["kind"] for line in rover.written] == ["refusal"]
    assert not any("expected" in text for text in text_of(actions))


def test_a_command_that_the_rover_has_had_is_not_executed_again(authority, ground, rover):
    payload = uplink(ground, consented(authority))
    for _ in range(3):
        rover.run(MessageArrived(COMMAND, payload))
    assert len(rover.bodies) == 1
    assert len(rover.written) == 1


def test_a_message_of_another_mission_or_run_is_refused(authority, ground, process):
    payload = uplink(ground, consented(authority))
    other_run = process("rover.main", "a", instance="run-2", subscribes=(COMMAND,))
    actions = other_run.run(MessageArrived(COMMAND, payload))
    assert "expected mission 'short', run run-2, got mission 'short', run run-1" in text_of(actions)[0]
    other = process("rover.main", "b", mission="other", subscribes=(COMMAND,))
    actions = other.run(MessageArrived(COMMAND, payload))
    assert "expected mission 'other', got 'short'" in text_of(actions)[0]
    assert other_run.bodies == other.bodies == []
    assert [line["kind"] for line in other_run.written + other.written] == ["refusal", "refusal"]


def test_what_a_sender_writes_as_an_objection_does_not_count(authority, ground, rover):
    command = consented(authority).model_copy(update={"objection": "no"})
    rover.run(MessageArrived(COMMAND, uplink(ground, command)))
    assert rover.bodies[0].objection is None


def test_a_journal_keeps_the_objection(rover, ground, authority):
    given = MessageArrived(COMMAND, uplink(ground, PAUSE), "line one\nline two")
    assert decode_input(*encode_input(given, None), None) == given


# --- what else crosses --------------------------------------------------------------------------------------------


def test_forged_telemetry_and_acknowledgements_change_nothing(authority, ground):
    event = RoverEvent(kind=EventKind.PARKED, at=0, x_m=0.0, y_m=0.0, round=1)
    header = Header(mission="short", source="mallory", incarnation=1, sequence=0, made_at=NOW)
    ack = Acknowledgement(stream=COMMAND.name, source="ground", incarnation=1, next_sequence=1)
    ground.sends(Send(COMMAND, consented(authority)))
    topic = ground.host._custody.ack_topic
    for forged in (MessageArrived(EVENT, encode(header, event)), MessageArrived(topic, encode(header, ack))):
        ground.run(forged)
    assert ground.bodies == []
    assert ground.host._custody.depth == 1, "the command is still kept"


def test_the_acknowledgements_of_the_other_side_are_signed_and_count(authority, ground, rover):
    payload = uplink(ground, consented(authority))
    actions = rover.run(MessageArrived(COMMAND, payload))
    actions += rover.run(TimerElapsed("@custody"), NOW + 3600 * SECOND)
    acks = [action for action in actions if isinstance(action, Publish)]
    for ack in acks:
        ground.run(MessageArrived(ack.topic, ack.payload), NOW + 3600 * SECOND)
    assert acks
    assert ground.host._custody.depth == 0
    assert ACK_UP.signed


def test_refusals_of_one_sender_are_in_the_audit_log_the_first_and_the_tenth_time(ground):
    header = Header(mission="short", source="mallory", incarnation=1, sequence=0, made_at=NOW)
    forged = MessageArrived(EVENT, encode(header, RoverEvent(kind=EventKind.PARKED, at=0, x_m=0, y_m=0, round=1)))
    records = [action for _ in range(25) for action in ground.run(forged) if isinstance(action, LogRecord)]
    assert {record.cause for record in records} == {Cause("tm/event: foreign", "mallory")}
    assert ground.host.refused == len(records) == 25
    assert [line["number_of_sender"] for line in ground.written] == [1, 10]


def test_a_flood_of_invented_senders_is_counted_in_bounded_memory():
    counter = RefusalCounter()
    reported = sum(counter.count(f"m{number}")[1] for number in range(100_000))
    assert reported < 300
    assert len(counter._counts) < 300


# --- queries ------------------------------------------------------------------------------------------------------


def request(process, authority, common_name, topic, body, expires_at=NOW + HOUR, sequence=0):
    who = signer(authority, common_name)
    header = Header(
        mission="short", source=common_name, incarnation=0, sequence=sequence, made_at=NOW, expires_at=expires_at,
        start=process.host._gate.start,
    )  # fmt: skip
    return encode(header, body, lambda head, content: who.signed(Part.QUERY, topic.name, head, content))


def test_the_ground_takes_a_command_of_an_operator_and_refuses_what_is_not(authority, ground):
    good = request(ground, authority, "operator.anna", ISSUE_COMMAND, consented(authority))
    assert not [action for action in ground.run(QueryArrived(ISSUE_COMMAND, good, 1)) if isinstance(action, ReplyError)]
    for number, bad in enumerate(
        (
            good,
            encode(Header(mission="short", source="x", incarnation=0, sequence=0, made_at=0), PAUSE),
            request(ground, authority, "viewer.anna", ISSUE_COMMAND, consented(authority, "viewer.anna")),
            request(ground, authority, "operator.ben", ISSUE_COMMAND, consented(authority)),
            request(ground, authority, "operator.anna", ISSUE_COMMAND, PAUSE),
            request(ground, authority, "operator.anna", ISSUE_COMMAND, consented(authority), expires_at=NOW - 1),
            request(ground, authority, "operator.anna", ISSUE_COMMAND, consented(authority), expires_at=None),
        ),
        start=2,
    ):
        actions = ground.run(QueryArrived(ISSUE_COMMAND, bad, number))
        (answer,) = [action for action in actions if isinstance(action, ReplyError)]
        assert answer.token == number
    assert len(ground.node.seen) == 1
    assert ground.written[0]["by"] == "operator.anna"


def test_a_request_does_not_count_again_after_a_restart_that_has_forgotten_it(authority, ground, process):
    good = request(ground, authority, "operator.anna", ISSUE_COMMAND, consented(authority))
    ground.run(QueryArrived(ISSUE_COMMAND, good, 1))
    again = process("ground.main", "again", name="ground", sides=(Side.EARTH,), serves=(ISSUE_COMMAND,), custody=False)
    (*_, answer) = again.run(QueryArrived(ISSUE_COMMAND, good, 1))
    assert "expected a request to this start of the process, got one to another: replayed, or late" in answer.why
    assert again.node.seen == []
    new = request(again, authority, "operator.anna", ISSUE_COMMAND, consented(authority))
    assert again.run(QueryArrived(ISSUE_COMMAND, new, 2)) == []


def test_the_start_cannot_be_exchanged_in_a_request(authority, ground, process):
    good = request(ground, authority, "operator.anna", ISSUE_COMMAND, consented(authority))
    again = process("ground.main", "again", name="ground", sides=(Side.EARTH,), serves=(ISSUE_COMMAND,), custody=False)
    moved = good.replace(ground.host._gate.start.encode(), again.host._gate.start.encode())
    header, body = decode(ISSUE_COMMAND, encode_unsealed(moved), "short")
    assert header.start == again.host._gate.start
    (*_, answer) = again.run(QueryArrived(ISSUE_COMMAND, encode(header, body), 1))
    assert "altered, or forged" in answer.why


def encode_unsealed(payload):
    """The message without its checksum."""
    tree = json.loads(payload)
    del tree["header"]["checksum"]
    return json.dumps(tree).encode()


def test_a_status_names_the_start_and_other_messages_do_not(authority, process):
    link = process("link.main", name="link", sides=(Side.MOON, Side.EARTH), custody=False)
    status = LinkStatus(
        conditions=LinkConditions(), contact=True, contact_changes_at=None, up=DirectionCounts(),
        down=DirectionCounts(), in_flight=(), incarnation=1,
    )  # fmt: skip
    (published,) = link.sends(Send(LINK_STATUS, status))
    assert decode(LINK_STATUS, published.payload, "short")[0].start == link.host._gate.start
    rover = process("rover.main", "rover", custody=False)
    (published,) = rover.sends(Send(EVENT, RoverEvent(kind=EventKind.PARKED, at=0, x_m=0, y_m=0, round=1)))
    assert decode(EVENT, published.payload, "short")[0].start is None


def test_requests_that_are_forgotten_do_not_count_again_and_other_signers_are_not_affected():
    requests = Requests()
    assert all(requests.is_new(f"{number:x}", number) for number in range(MAX_SEEN + 10))
    assert not any(requests.is_new(f"{number:x}", number) for number in range(MAX_SEEN + 10))
    assert len(requests._made_at) == MAX_SEEN
    assert requests.is_new("new", MAX_SEEN + 10)
    assert Requests().is_new("0", 0)


def test_a_change_by_selector_parameters_is_refused_where_there_are_keys(authority, process):
    link = process("link.main", name="link", sides=(Side.MOON, Side.EARTH), serves=(LINK_SET,), custody=False)
    (*_, answer) = link.run(CheckedQueryArrived(LINK_SET, LinkChange(), 1))
    assert "expected a signed message, got selector parameters" in answer.why
    change = request(link, authority, "controller.ben", LINK_SET, LinkChange())
    assert link.run(QueryArrived(LINK_SET, change, 2)) == []
    assert [(line["kind"], line["by"]) for line in link.written] == [("refusal", ""), ("change", "controller.ben")]


def test_a_fake_instruments_reply_counts_as_no_reply(authority, rover, process):
    field = process("field.main", name="field", serves=(MEASURE,), custody=False)
    question = MeasurementRequest(sample_id="s1", x_m=1.0, y_m=2.0, depth_m=0.1)
    answer = MeasurementReply(sample_id="s1", x_m=1.0, y_m=2.0, helium3_ppb=9.0, noise_std_ppb=1.0)
    (query,) = rover.sends(SendQuery(MEASURE, question, "q1", 9.0))
    field.run(QueryArrived(MEASURE, query.payload, 1))
    (reply,) = field.sends(SendReply(1, answer))
    forged = encode(Header(mission="short", source="field", incarnation=1, sequence=0, made_at=NOW), answer)
    counts = rover.host.reply_check(MEASURE, NOW)
    assert (counts(forged), counts(b"nonsense"), counts(reply.payload)) == (False, False, True)
    kept, actions = rover.host.admit(ReplyArrived("q1", forged), NOW)
    assert isinstance(kept, QueryUnanswered)
    assert kept.why is NoReply.REFUSED
    assert text_of(actions)
    assert rover.host.admit(ReplyArrived("q1", reply.payload), NOW) == (ReplyArrived("q1", reply.payload), [])


# --- the roster's file --------------------------------------------------------------------------------------------


def test_a_revocation_counts_while_the_process_runs_and_an_older_roster_does_not(tmp_path):
    authority = Authority.create(tmp_path / "keys")
    identity = load_identity(authority.issue(subject("rover", "main")))
    authority.issue(subject("operator", "anna"))
    older = identity.roster_path.read_bytes()
    now_s, reported = [0.0], []
    newest = RosterFile(load_identity(identity.folder), lambda: now_s[0], reported.append)
    assert newest().trusted("operator.anna", utc_now())
    authority.revoke(subject("operator", "anna"))
    now_s[0] = 2.0
    revoked = newest().document.revision
    assert [entry.revoked_at is not None for entry in newest().entries if entry.name == "anna"] == [True]
    identity.roster_path.write_bytes(older)
    now_s[0] = 4.0
    assert newest().document.revision == revoked
    assert "expected revision" in reported[0]
    assert default_instance(identity).startswith("keys-")


def test_a_roster_that_came_with_a_mode_that_others_may_use_counts_once_that_is_mended(tmp_path):
    authority = Authority.create(tmp_path / "keys")
    authority.issue(subject("ground", "main"))
    identity = load_identity(authority.folder_of(subject("ground", "main")))
    authority.issue(subject("operator", "anna"))
    now_s, reported = [0.0], []
    newest = RosterFile(load_identity(identity.folder), lambda: now_s[0], reported.append)
    authority.revoke(subject("operator", "anna"))
    identity.roster_path.chmod(0o644)
    for now_s[0] in (2.0, 4.0):
        assert newest().trusted("operator.anna", utc_now())
    assert ["expected mode 0600" in line for line in reported] == [True], "it is said once"
    identity.roster_path.chmod(0o600)
    now_s[0] = 6.0
    with pytest.raises(InvalidInput, match="revoked"):
        newest().trusted("operator.anna", utc_now())
