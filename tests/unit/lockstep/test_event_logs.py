"""In-process and lockstep drivers, side by side: the same nodes have the same history, however messages travel."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from itertools import count, pairwise
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.lockstep import Grant, Joined, StepDone
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.drivers.simulation import Simulation
from services.runtime.host import Host
from services.runtime.inputs import Input, MessageArrived, QueryArrived, QueryUnanswered, ReplyArrived
from services.runtime.lockstep.participant import Participant
from services.runtime.lockstep.time_manager import TimeManager
from services.runtime.node import Node, NoReply
from services.runtime.scheduler import NodeScheduler
from services.runtime.stamp import Stamp, read_stamp

_SPEC = importlib.util.spec_from_file_location("chatter", Path(__file__).parents[2] / "chatter.py")
chatter = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(chatter)

EventSink = list[tuple[int, str, str]]


class LateExecutor:
    """Computations end when the network's turn comes, in any order."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def submit(self, function: Callable[..., object], /, *arguments: object) -> Future[object]:
        future: Future[object] = Future()
        self._network.compute(lambda: future.set_result(function(*arguments)))
        return future


class Network:
    """Carries everything, later, in an order that is drawn at random: worse than any network that keeps order."""

    def __init__(self, nodes: list[Node], mission: str, start: int, trace: EventSink, dice: Random) -> None:
        self._required = frozenset(node.interface.name for node in nodes)
        self._managers = count(1)
        self.manager = self._new_manager(start)
        self.parts: dict[str, Participant] = {}
        self.queries: dict[int, tuple[Participant, str, PutQuery, Stamp]] = {}
        self.steps = 0
        self._mission = mission
        self._trace = trace
        self._dice = dice
        self._under_way: list[Callable[[], None]] = []
        self._computations: list[Callable[[], None]] = []
        self._starts: Counter[str] = Counter()
        self._connections: Counter[str] = Counter()
        for node in dice.sample(nodes, len(nodes)):
            self.begin(node)

    def _new_manager(self, start: int) -> TimeManager:
        return TimeManager(start, self._required, f"manager.{next(self._managers)}")

    def lose_time_manager(self) -> None:
        """End the time manager, and the router with it: what is under way is lost; all processes ask a new one."""
        self._under_way = [task for task in self._under_way if task in self._computations]
        self.manager = self._new_manager(1000)
        for token in list(self.queries):
            asker, _, query, asked = self.queries.pop(token)
            self.end_without_reply(asker, query, asked)
        for part in self.parts.values():
            self._ask_to_join(part)

    def _ask_to_join(self, part: Participant) -> None:
        """The time manager answers at once that the process has to obey another term, or later that it takes part."""
        joining = part.join()

        def arrive() -> None:
            if self.parts.get(part.name) is part and not self.manager.join(joining):
                answer = self.manager.answer(joining, admitted=False)
                self.later(lambda: self._obey(part, answer))

        self.later(arrive)

    def _obey(self, part: Participant, answer: Joined) -> None:
        part.obey(answer.term)
        self._ask_to_join(part)

    def begin(self, node: Node) -> None:
        """Start a process for that node; it asks to take part."""
        host = Host(node, self._mission, lambda now, name, what: self._trace.append((now, name, what)))
        name = host.interface.name
        self._starts[name] += 1
        part = Participant(NodeScheduler(host, LateExecutor(self)), f"{name}.{self._starts[name]}")
        part.start(self._starts[name])
        self.parts[part.name] = part
        self._ask_to_join(part)

    def kill(self, name: str) -> None:
        """End a process: what it sent is under way, what is sent to it is lost, queries to it end without a reply."""
        part = self.parts.pop(name)
        self.later(lambda: self.manager.leave(part.process) and None)
        for token in [token for token, (_, server, _, _) in self.queries.items() if server == part.process]:
            asker, _, query, asked = self.queries.pop(token)
            self.end_without_reply(asker, query, asked)

    def cut_off(self, name: str) -> None:
        """Lose the connection of a process that lives on: all that is under way to it, and its queries both ways."""
        part = self.parts[name]
        self._connections[part.process] += 1
        for token, (asker, server, query, asked) in list(self.queries.items()):
            if server == part.process or asker is part:
                del self.queries[token]
                self.end_without_reply(asker, query, asked)
        self.manager.leave(part.process)  # the router notices before anything comes over a new connection
        self._ask_to_join(part)

    def later(self, happen: Callable[[], None]) -> None:
        self._under_way.append(happen)

    def compute(self, end: Callable[[], None]) -> None:
        self._computations.append(end)
        self.later(end)

    def to(self, part: Participant, take: Callable[[], bool]) -> None:
        """Let something reach a process, if it still runs then; poke the time manager if the process says so."""

        connection = self._connections[part.process]

        def arrive() -> None:
            connected = self.parts.get(part.name) is part and self._connections[part.process] == connection
            if connected and take():
                self.later(lambda: self.manager.poke(part.name, part.process))

        self.later(arrive)

    def end_without_reply(self, asker: Participant, query: PutQuery, asked: Stamp) -> None:
        given = QueryUnanswered(query.query, NoReply.NO_ROUTE, "")
        self.to(asker, lambda: asker.take_outcome(given, asked, None))

    def run(self, fault: Callable[[], None] = lambda: None) -> None:
        """Run until nothing is under way and no process wants to act again; `fault` may do harm before each move."""
        for _ in range(200_000):
            fault()
            if self._under_way:
                self._under_way.pop(self._dice.randrange(len(self._under_way)))()
                for part in list(self.parts.values()):
                    if part.ready():
                        self._report(part.act(Carrier(self, part)))
            elif not self._step():
                return
        raise AssertionError("it never ends")

    def _step(self) -> bool:
        before = self.manager.now
        for joining in self.manager.admit():
            self._welcome(self.parts.get(joining.name), self.manager.answer(joining, admitted=True))
        instant = self.manager.next_instant()
        if instant is None:
            waits = {name: part.lacks() for name, part in self.parts.items() if part.granted is not None}
            assert not self.manager.outstanding, f"a process waits for what never comes: {waits}"
            return False
        assert instant >= before
        self.steps += 1
        for name, grant in self.manager.grant(instant).items():
            part = self.parts.get(name)
            if part is not None:
                self._grant(part, Grant.model_validate_json(grant.model_dump_json()))
        return True

    def _welcome(self, part: Participant | None, answer: Joined) -> None:
        if part is not None:
            self.later(lambda: part.joined(answer))

    def _grant(self, part: Participant, grant: Grant) -> None:
        self.to(part, lambda: part.grant(grant) or False)

    def _report(self, done: StepDone) -> None:
        told = StepDone.model_validate_json(done.model_dump_json())
        self.later(lambda: self.manager.done(told) and None)


class Carrier:
    """What one participant sends."""

    def __init__(self, network: Network, sender: Participant) -> None:
        self._network = network
        self._sender = sender

    def publish(self, action: Publish, stamp: Stamp) -> None:
        came = read_stamp(stamp.encode())
        given = MessageArrived(action.topic, action.payload)
        for part in self._network.parts.values():
            if part.scheduler.host.receives(action.topic, action.side):  # the sender too: some transports echo
                self._network.to(part, lambda part=part: part.take_message(given, came))

    def query(self, action: PutQuery, stamp: Stamp) -> None:
        network = self._network
        wanted = (action.topic, action.side)
        taking_part = [part for name, part in network.parts.items() if name in network.manager.members]
        server = next((part for part in taking_part if wanted in part.scheduler.host.served_topics()), None)
        if server is None:
            network.end_without_reply(self._sender, action, stamp)
            return
        token = next(_TOKENS)
        network.queries[token] = (self._sender, server.process, action, stamp)
        given = QueryArrived(action.topic, action.payload, token)
        network.to(server, lambda: server.take_query(given, token, stamp))

    def reply(self, action: Reply | ReplyError, stamp: Stamp) -> None:
        if action.token not in self._network.queries:
            return  # asked through a router that is gone
        asker, _, query, asked = self._network.queries.pop(action.token)
        if isinstance(action, Reply):
            given = ReplyArrived(query.query, action.payload)
        else:
            given = QueryUnanswered(query.query, NoReply.REFUSED, action.why)
        self._network.to(asker, lambda: asker.take_outcome(given, asked, stamp))

    def perform(self, action: Action) -> None:
        pass


_TOKENS = count(1)


def canonical(trace: EventSink) -> EventSink:
    return sorted(trace, key=lambda entry: entry[:2])


def in_process(seed: int, start: int = 1000) -> EventSink:
    trace: EventSink = []
    nodes = chatter.chatters(seed)
    Simulation(nodes, "m", start, event_sink=lambda now, name, what: trace.append((now, name, what))).run()
    return canonical(trace)


def in_lockstep(seed: int, dice: Random, start: int = 1000) -> EventSink:
    trace: EventSink = []
    Network(chatter.chatters(seed), "m", start, trace, dice).run()
    return canonical(trace)


@given(st.integers(0, 10**6), st.integers(0, 10**6))
@settings(max_examples=200)
def test_random_nodes_have_the_same_history_in_one_process_and_in_lockstep(seed: int, order: int) -> None:
    assert in_lockstep(seed, Random(order)) == in_process(seed)


def test_random_nodes_do_enough_for_the_comparison_to_mean_something() -> None:
    kinds = {what.split()[0] for seed in range(20) for _, _, what in in_process(seed)}
    assert kinds == {"started", "received", "asked", "answered", "unanswered", "due", "computed"}
    assert sum(len(in_process(seed)) for seed in range(20)) > 2000


@given(st.integers(0, 10**6), st.integers(0, 10**6))
@settings(max_examples=200)
def test_processes_that_die_at_any_moment_stop_time_until_they_are_back_and_no_longer(seed: int, order: int) -> None:
    dice = Random(order)
    trace: EventSink = []
    network = Network(chatter.chatters(seed), "m", 1000, trace, dice)
    interfaces = {interface.name: interface for interface in chatter.interfaces(seed)}
    kills = {dice.randrange(400): dice.choice(list(interfaces)) for _ in range(5)}
    gone: dict[str, int] = {}
    moves = count()

    def back(name: str, move: int) -> None:
        network.begin(chatter.Chatter(interfaces[name], f"{seed}/{name}/{move}", 20))

    def fault() -> None:
        move = next(moves)
        for name in [name for name, since in gone.items() if move > since + 30]:
            del gone[name]
            back(name, move)
        name = kills.get(move)
        if name in network.parts and dice.random() < 0.3:
            network.cut_off(name)
        elif name in network.parts:
            network.kill(name)
            gone[name] = move

    network.run(fault)
    for name in gone:
        assert name in network.manager.missing(), "time went on without a required process"
        back(name, 0)
    network.run()
    assert not network.manager.missing()
    assert all(now <= later for (now, _, _), (later, _, _) in pairwise(trace)), "time ran backwards"


@given(st.integers(0, 10**6), st.integers(0, 10**6))
@settings(max_examples=200)
def test_a_time_manager_that_dies_at_any_moment_is_replaced_and_time_goes_on_from_where_it_stood(
    seed: int, order: int
) -> None:
    dice = Random(order)
    trace: EventSink = []
    network = Network(chatter.chatters(seed), "m", 1000, trace, dice)
    deaths = {dice.randrange(400) for _ in range(4)}
    moves = count()
    network.run(lambda: network.lose_time_manager() if next(moves) in deaths else None)
    assert not network.manager.missing()
    for name in network.parts:
        times = [now for now, who, _ in trace if who == name]
        assert times == sorted(times), "time ran backwards"


@pytest.mark.parametrize("seed", range(3))
def test_a_driver_that_mixes_up_two_inputs_of_one_instant_would_be_found(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = Participant._keep

    def mixed_up(self: Participant, kind: object, given: Input, stamp: Stamp | None) -> bool:
        swapped = stamp and Stamp(stamp.sender, stamp.process, -stamp.number, stamp.step, stamp.at)
        return genuine(self, kind, given, swapped)

    monkeypatch.setattr(Participant, "_keep", mixed_up)
    assert any(in_lockstep(each, Random(0)) != in_process(each) for each in range(seed * 10, seed * 10 + 10))
