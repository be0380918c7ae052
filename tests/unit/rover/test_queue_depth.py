"""The rover's state says how many messages wait for the ground's acknowledgement."""

from __future__ import annotations

from collections import defaultdict

from he3.frames import SiteGrid
from schemas.codec import decode, encode
from schemas.commands import CommandKind, Telecommand
from schemas.link import Acknowledgement
from schemas.telemetry import RoverState
from schemas.topics import ACK_UP, COMMAND, STATE, Side, Topic, under_custody
from schemas.wire import Header, Wire
from services.mission.scenario import RoverConfig
from services.rover.node import RoverNode
from services.runtime.drivers.simulation import Simulation

PERIOD_S = 60.0


def rover() -> RoverNode:
    return RoverNode(RoverConfig(state_period_s=PERIOD_S), SiteGrid(60, 60), (5.5, 5.5), 0)


class OutOfContact:
    """A rover on the Moon without a link; commands are put into its network by hand."""

    def __init__(self) -> None:
        self.simulation = Simulation([rover()], "m", 0)
        self.simulation.tap(self._listen)
        self.states: list[RoverState] = []
        self.sent: defaultdict[tuple[str, int], set[int]] = defaultdict(set)
        """Sequences of the messages under custody, by topic and incarnation; a repetition counts once."""

    def _listen(self, topic: Topic, _side: Side, payload: bytes, _now: int) -> None:
        if topic in (COMMAND, ACK_UP):
            return
        header, body = decode(topic, payload, "m")
        if topic is STATE:
            self.states.append(body)
        elif under_custody(topic):
            self.sent[topic.name, header.incarnation].add(header.sequence)

    def from_earth(self, topic: Topic, sequence: int, body: Wire) -> None:
        header = Header(mission="m", source="ground", incarnation=1, sequence=sequence, made_at=self.simulation.now)
        self.simulation.inject(topic, Side.MOON, encode(header, body))

    def reported(self) -> int:
        """The depth of the queue in the next periodic state."""
        self.simulation.run_for(PERIOD_S)
        return self.states[-1].queue_depth


def test_a_rover_out_of_contact_reports_how_many_messages_wait() -> None:
    moon = OutOfContact()
    assert moon.reported() == 0
    for number in range(3):
        moon.from_earth(COMMAND, number, Telecommand(command_id=f"c{number}", kind=CommandKind.PAUSE))
    waiting = moon.reported()

    assert waiting == sum(len(sequences) for sequences in moon.sent.values())
    assert waiting >= 3, "each command is reported at least once"


def test_an_acknowledgement_lowers_the_reported_depth() -> None:
    moon = OutOfContact()
    moon.from_earth(COMMAND, 0, Telecommand(command_id="c0", kind=CommandKind.PAUSE))
    assert moon.reported() > 0
    for number, ((stream, incarnation), sequences) in enumerate(moon.sent.items()):
        ack = Acknowledgement(stream=stream, source="rover", incarnation=incarnation, next_sequence=max(sequences) + 1)
        moon.from_earth(ACK_UP, number, ack)

    assert moon.reported() == 0


def test_a_rover_restarted_from_its_journal_reports_the_depth_that_it_had() -> None:
    moon = OutOfContact()
    moon.simulation.keep_journals(["rover"], {"mission": "m"})
    moon.from_earth(COMMAND, 0, Telecommand(command_id="c0", kind=CommandKind.PAUSE))
    before = moon.reported()
    moon.simulation.kill("rover")
    moon.simulation.restart(rover())
    moon.simulation.run_for(0.0)

    assert before > 0
    assert moon.states[-1].queue_depth == before
    assert moon.reported() == sum(len(sequences) for sequences in moon.sent.values())
