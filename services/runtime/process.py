"""One service's process, from its command line to its exit code.

It builds the node, replays its journal, opens a session on each side that the node stands on, and hands everything to a
driver, which decides when the node acts. Zenoh's threads only put what arrived into the inbox. Operators' queries are
answered in another process, from snapshots, and never wait for the node.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, closing
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

from he3.errors import He3Error, InvalidInput
from schemas.topics import ONLOOKERS, Side, Topic
from services.runtime.audit_trail import AuditTrail
from services.runtime.child import BAD_INPUT
from services.runtime.context import Driver, ProcessContext
from services.runtime.custody.endpoint import custody_config
from services.runtime.drivers.wall_clock import WallClockDriver
from services.runtime.event_log import open_event_log
from services.runtime.files.lock import lock_beside
from services.runtime.heartbeat import Heartbeat
from services.runtime.host import Host
from services.runtime.inbox import Inbox
from services.runtime.journal import History, JournalFolder, identity_of
from services.runtime.kept_file import KeptFile, kept_file
from services.runtime.lockstep.driver import LockstepDriver
from services.runtime.log import Log
from services.runtime.options import Options, parse_options
from services.runtime.process_clock import ProcessClock
from services.runtime.queries.process import QueryProcess
from services.runtime.role_claim import ClaimedRole
from services.runtime.scheduler import Executor, InlineExecutor, NodeScheduler
from services.runtime.set_aside import SetAsideFile
from services.runtime.transport.opening import connect_client
from services.runtime.transport.session import Session, close_all
from services.runtime.trust.audit import AuditLog
from services.runtime.trust.certificates import utc_now
from services.runtime.trust.gate import Gate, RosterFile, default_instance
from services.runtime.trust.signing import Signer, Verifier

if TYPE_CHECKING:
    from services.runtime.service import Service
    from services.runtime.trust.identity import Identity

ENDS_WITHIN_S = 1.4
"""Time from the signal to the forced end of a process that hangs in a network call."""
COMPLETES_WITHIN_S = 20.0
"""This time for a process that completes a file."""
EXPIRES_SOON = timedelta(days=7)
"""An identity that expires within this time is reported."""
SWITCH_INTERVAL_S = 0.0005
"""Python's thread switch interval: a query waits for a computing thread no longer than for the network."""

MakeDriver = Callable[[ProcessContext], Driver]
OpenSide = Callable[[ProcessContext, Side, str], Session | None]
"""Opens the session of a side at that endpoint; None if the process was stopped first."""


def connect_side(context: ProcessContext, side: Side, endpoint: str) -> Session | None:
    """A client session on that side, once its router answers and this process holds its role."""
    identity = context.options.identity
    session = connect_client(side, endpoint, context.mission, context.inbox.stopped, context.log.warning, identity)
    if session is None:
        return None
    context.sessions[side] = session
    context.role = ClaimedRole(
        context.name, context.mission, side, session, context.inbox, lambda: context.clock.latest
    )
    return session if context.role.take(context.log.warning) else None


def serve(
    service: Service,
    arguments: Sequence[str] | None = None,
    on_wall_clock: MakeDriver = WallClockDriver,
    in_lockstep: MakeDriver = LockstepDriver,
    open_side: OpenSide = connect_side,
) -> int:
    """Run the service until it is told to stop; the process's exit code. One line on standard error if it cannot.

    2 is bad input, which the same command meets again; 1 is a failure, such as a full disk, that a restart may mend.
    """
    inbox = Inbox()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, inbox.stop)
    _end_in_time(COMPLETES_WITHIN_S if service.completes_file else ENDS_WITHIN_S)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        options = parse_options(service.name, sys.argv[1:] if arguments is None else arguments)
        make_driver = in_lockstep if options.lockstep and not service.onlooker else on_wall_clock
        run_process(service, options, inbox, make_driver, open_side)
    except He3Error as error:
        sys.stderr.write(f"he3 {service.name}: {error}\n")
        return BAD_INPUT if isinstance(error, InvalidInput) else 1
    return 0


def run_process(
    service: Service, options: Options, inbox: Inbox, make_driver: MakeDriver, open_side: OpenSide = connect_side
) -> None:
    """Run the service until it is told to stop; every open session and file is closed at the end. Raises He3Error."""
    with ExitStack() as stack:
        context = _context(service, options, inbox, stack)
        driver = make_driver(context)
        if _join(service, context, driver, open_side):
            context.manager.ready()
            driver.run()
        context.manager.stopping()


def _context(service: Service, options: Options, inbox: Inbox, stack: ExitStack) -> ProcessContext:
    """The parts of the process; `stack` closes them at the end."""
    clock = ProcessClock()
    log = Log(service.name, clock.now_or_none, options.level, options.log_json)
    for warning in options.insecure:
        log.warning(warning)
    if options.identity is not None:
        _report_identity(options.identity, log)
    sessions: dict[Side, Session] = {}
    query_process = _query_process(service, options, log)  # it starts while the node is built
    executor = _executor(service, inbox, stack)
    # The last to be registered is the first to be closed: the event log, which must be whole.
    stack.callback(lambda: close_all(sessions.values()))
    if query_process is not None:
        stack.callback(query_process.close)
    if options.journal is not None:
        # Before the node is built: from what it reads there, an earlier process may still be going on.
        expected = f"--journal {options.journal}: expected a folder that no other {service.name} uses"
        stack.enter_context(lock_beside(options.journal / service.name, expected))
    node = service.build(options)
    events = stack.enter_context(open_event_log(options.events)) if options.events else None
    host = Host(
        node,
        options.scenario.name,
        events,
        custody_config(options.scenario.link, node.interface),
        contains_defects=True,
        gate=_gate(options, log),
        audit=_audit_trail(options, log, stack),
    )
    folder = history = None
    if options.journal is not None and service.journals:
        folder = JournalFolder(options.journal, service.name, identity_of(options.scenario), host.codec)
        history = folder.history()
    scheduler = NodeScheduler(host, executor, None if folder is None else folder.begin(history, log.warning))

    def publish(topic: Topic, side: Side, payload: bytes) -> None:
        sessions[side].publish_best_effort(topic, payload)

    heartbeat = Heartbeat(host, publish, bool(options.insecure))
    context = ProcessContext(options, inbox, sessions, clock, log, scheduler, heartbeat, events, query_process)
    stack.callback(context.close_log)
    if options.journal is not None:
        context.set_aside = SetAsideFile(options.journal / f"{service.name}.set-aside.jsonl")
        context.kept = KeptFile(kept_file(options.journal, service.name), log.warning)
    if history is not None:
        _go_on(context, history)
    elif not options.lockstep:
        # Without a journal a start must still differ from an earlier one: the other side remembers what it received.
        context.incarnation = int(time.time())
    return context


def _report_identity(identity: Identity, log: Log) -> None:
    """Say who this process is, and warn when that ends soon: TLS closes its connections then."""
    until = f"{identity.expires:%Y-%m-%d %H:%M} UTC"
    log.info("identity", name=identity.common_name, expires=until)
    if identity.expires - datetime.now(UTC) < EXPIRES_SOON:
        log.warning(f"the certificate of {identity.common_name} expires at {until}, and its connections end then")


def _gate(options: Options, log: Log) -> Gate | None:
    """The gate of a process with an identity."""
    identity = options.identity
    if identity is None:
        return None
    instance = options.instance or default_instance(identity)
    log.info("signs its messages", run=instance)
    roster = RosterFile(identity, time.monotonic, log.warning)
    verifier = Verifier(roster, options.scenario.name, instance, utc_now)
    return Gate(Signer(identity.common_name, identity.key, instance), verifier)


def _audit_trail(options: Options, log: Log, stack: ExitStack) -> AuditTrail | None:
    if options.audit is None:
        return None
    identity = options.identity
    signer = None if identity is None else (identity.common_name, identity.key)
    return AuditTrail(stack.enter_context(closing(AuditLog(options.audit, utc_now, signer))), log.error)


def _query_process(service: Service, options: Options, log: Log) -> QueryProcess | None:
    if service.queries is None:
        return None
    scenario = options.scenario
    identity = None if options.identity is None else options.identity.folder
    network = scenario.network
    return QueryProcess(service.queries.module, Side.EARTH, network.earth, scenario.name, log.warning, identity)


def _executor(service: Service, inbox: Inbox, stack: ExitStack) -> Executor:
    if service.executor is None:
        return InlineExecutor()
    return _WakingExecutor(stack.enter_context(closing(service.executor())), inbox)


def _go_on(context: ProcessContext, history: History) -> None:
    """Replay the journal of earlier starts."""
    if history.notice:
        context.log.warning(history.notice)
    began = time.monotonic()
    context.resume = context.scheduler.replay(history.inputs, history.state)
    context.incarnation = history.starts + 1
    if history.starts:
        context.clock.latest = context.scheduler.last
        context.log.info(
            "restarted from its journal",
            inputs=len(history.inputs),
            torn_bytes=history.torn_bytes,
            seconds=f"{time.monotonic() - began:.3f}",
        )


def _join(service: Service, context: ProcessContext, driver: Driver, open_side: OpenSide) -> bool:
    """Open the sessions, learn the time, and declare the process alive; False if it was stopped first."""
    interface = context.scheduler.host.interface
    network = context.options.scenario.network
    endpoints = {Side.MOON: network.moon, Side.EARTH: network.earth}
    for side in interface.sides:
        session = open_side(context, side, endpoints[side])
        if session is None:
            return False
        context.sessions[side] = session
        _subscribe(service, context, driver, side)
    if context.query_process is not None:
        context.query_process.begin()
    if not driver.begin():
        return False
    if context.query_process is not None and not context.resume:
        # A new mission waits until operators can query it; a process that continues does not keep its mission waiting.
        context.query_process.wait_until_ready(context.inbox.stopped)
    for side, session in context.sessions.items():
        session.declare_alive(interface.name, side)
        if service.onlooker:
            session.declare_alive(interface.name, side, ONLOOKERS)
    context.log.info("ready", sides="+".join(side.value for side in interface.sides), pid=os.getpid())
    return True


def _subscribe(service: Service, context: ProcessContext, driver: Driver, side: Side) -> None:
    """Subscribe to the node's topics on that side, and serve the queries that it answers itself."""
    host, session, traffic = context.scheduler.host, context.sessions[side], driver.traffic
    elsewhere = () if service.queries is None else service.queries.topics
    for topic, where in host.received_topics():
        if where is side:
            session.subscribe(traffic.received_as(topic), partial(traffic.on_message, topic))
    for topic, where in host.served_topics():
        if where is side and topic not in elsewhere:
            session.serve(topic, partial(traffic.on_query, topic))


class _WakingExecutor:
    """An executor that wakes the main loop when a computation ends."""

    def __init__(self, executor: Executor, inbox: Inbox) -> None:
        self._executor = executor
        self._inbox = inbox

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future = self._executor.submit(function, *arguments)
        future.add_done_callback(self._inbox.wake)
        return future


def _end_in_time(within_s: float) -> None:
    """Start a thread that ends a stopped process in time, even if it hangs in a call that no signal interrupts."""
    told, tell = socket.socketpair()
    tell.setblocking(False)
    signal.set_wakeup_fd(tell.fileno(), warn_on_full_buffer=False)

    def wait(_tell: socket.socket = tell) -> None:
        told.recv(1)
        time.sleep(within_s)
        os._exit(0)

    threading.Thread(target=wait, name="ending", daemon=True).start()
