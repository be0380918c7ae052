"""The listener keeps a bounded number of connections: the oldest that asks nothing makes room for a new one."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest

from services.console.web.address import listening
from services.console.web.connections import BoundedListener
from tests.waiting import PATIENCE_S


@pytest.fixture
def listener() -> Iterator[BoundedListener]:
    with closing(BoundedListener(listening("127.0.0.1", 0), limit=3)) as made:
        yield made


def connected(listener: BoundedListener, stack: ExitStack) -> tuple[socket.socket, socket.socket]:
    """The two ends of a new connection, the client's first."""
    client = stack.enter_context(socket.create_connection(listener.getsockname(), timeout=PATIENCE_S))
    return client, stack.enter_context(listener.accept()[0])


def test_the_oldest_idle_connection_is_closed_for_a_new_one(listener: BoundedListener) -> None:
    with ExitStack() as stack:
        clients = [connected(listener, stack)[0] for _ in range(4)]
        assert clients[0].recv(1) == b""
        for client in clients[1:]:
            client.setblocking(False)
            with pytest.raises(BlockingIOError):
                client.recv(1)


def test_a_connection_that_waits_for_its_answer_is_kept(listener: BoundedListener) -> None:
    with ExitStack() as stack:
        pairs = [connected(listener, stack) for _ in range(3)]
        listener.busy.add(pairs[0][1].fileno())
        connected(listener, stack)
        assert pairs[1][0].recv(1) == b""
        pairs[0][0].setblocking(False)
        with pytest.raises(BlockingIOError):
            pairs[0][0].recv(1)


def test_where_all_wait_for_answers_a_new_connection_is_closed(listener: BoundedListener) -> None:
    with ExitStack() as stack:
        listener.busy |= {connected(listener, stack)[1].fileno() for _ in range(3)}
        client = stack.enter_context(socket.create_connection(listener.getsockname(), timeout=PATIENCE_S))
        with pytest.raises(BlockingIOError):
            listener.accept()
        assert client.recv(1) == b""


def test_a_closed_connection_makes_room(listener: BoundedListener) -> None:
    with ExitStack() as stack:
        first, *_ = [connected(listener, stack) for _ in range(3)]
        first[1].close()
        listener.busy |= set(range(1000))
        connected(listener, stack)
