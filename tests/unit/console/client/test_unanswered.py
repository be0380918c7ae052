"""A query without an answer: what was asked may have been done, and the error says so, with the command's id."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from he3.errors import OutcomeUnknown, PeerUnreachable
from schemas.topics import ISSUE_COMMAND, LINK_SET, LIST_COMMANDS, MAP_POINT, SET_INTEREST, Side, Topic
from schemas.wire import Wire
from services.console.client.commands import Commanding
from services.runtime.node import NoReply
from services.runtime.transport.client import Client
from services.runtime.transport.session import NotReplied

ASKED = 5.0


def client_of(reason: NoReply) -> Client:
    """A client whose every query ends without a reply, for that reason."""

    def query(topic: Topic, payload: bytes, timeout_s: float, on_end: Callable[[Any], None], **_: Any) -> None:
        on_end(NotReplied(reason, f"within {timeout_s:g} s", None))

    client = Client.__new__(Client)
    vars(client).update(_session=SimpleNamespace(query=query), _mission="m", _identity=None, _side=Side.EARTH)
    return client


@pytest.mark.parametrize("topic", [ISSUE_COMMAND, SET_INTEREST, LINK_SET])
def test_a_process_that_was_reached_and_is_silent_may_have_done_what_was_asked(topic: Topic) -> None:
    with pytest.raises(OutcomeUnknown, match=r"has not answered within 5 s, and may have done what was asked$"):
        client_of(NoReply.TIMEOUT)._reply(topic, b"", ASKED)


def test_a_process_that_was_not_reached_has_done_nothing() -> None:
    with pytest.raises(PeerUnreachable, match=r"^mission 'm': the ground does not answer$") as found:
        client_of(NoReply.NO_ROUTE)._reply(ISSUE_COMMAND, b"", ASKED)
    assert not isinstance(found.value, OutcomeUnknown)


@pytest.mark.parametrize("topic", [LIST_COMMANDS, MAP_POINT])
def test_a_question_that_changes_nothing_is_only_not_answered(topic: Topic) -> None:
    with pytest.raises(PeerUnreachable, match=r"^mission 'm': the ground has not answered within 5 s$") as found:
        client_of(NoReply.TIMEOUT)._reply(topic, b"", ASKED)
    assert not isinstance(found.value, OutcomeUnknown)


def test_a_command_that_may_have_been_sent_is_named_so_that_it_is_not_sent_twice() -> None:
    class Silent:
        def query(self, topic: Topic, request: Wire) -> Wire:
            raise OutcomeUnknown(
                "mission 'm': the ground has not answered within 30 s, and may have done what was asked"
            )

    commanding = Commanding.__new__(Commanding)
    vars(commanding).update(_session=Silent(), identity=None, person="anna")
    with pytest.raises(
        OutcomeUnknown, match=r"^command mine: mission 'm': the ground has not answered within 30 s, and"
    ):
        commanding.command("pause", command_id="mine")
