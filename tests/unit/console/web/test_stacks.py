"""The page's command stack: one at a time, whole or step by step, stopped at the first failure or by a person."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from he3.errors import InvalidInput
from schemas.commands import CommandStage
from services.console.web.stacks import PageStacks
from tests.unit.console.client.test_stacks import START, Desk
from tests.waiting import PATIENCE_S

TEXT = "pause\nresume"


class Page:
    """A page of a mission whose time passes only while `flows` is set."""

    def __init__(self, desk: Desk | None = None) -> None:
        self.desk = desk or Desk()
        self.flows = threading.Event()
        self.flows.set()
        stages, desk_of = self.desk.stages, self.desk
        self._told = threading.Condition()
        self.stacks = PageStacks(lambda: desk_of, lambda: START, self._tell)

        def passing() -> Any:
            if self.flows.is_set():
                self.desk.pause()
            return stages()

        self.desk.stages = passing  # type: ignore[method-assign]

    def _tell(self) -> None:
        with self._told:
            self._told.notify_all()

    def until(self, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The document once that holds of it."""
        document = self.stacks.document
        with self._told:
            assert self._told.wait_for(lambda: (it := document()) is not None and true(it), PATIENCE_S), document()
        found = document()
        assert found is not None
        return found


def ended(document: dict[str, Any]) -> bool:
    return bool(document["ended"])


def test_of_two_documents_of_a_stack_the_later_one_has_the_higher_serial() -> None:
    page = Page()
    page.stacks.start("pause", step=False, by="anna")
    first, last = page.until(lambda it: True), page.until(ended)
    assert (first["number"], first["serial"] < last["serial"]) == (last["number"], True)


def test_a_check_says_what_each_command_would_do_and_sends_nothing() -> None:
    page = Page()
    found = page.stacks.check(TEXT)
    assert [(line["line"], line["waits_for"]) for line in found["lines"]] == [(1, "at once"), (2, "after completed")]
    assert ["does", "it does"] in found["lines"][0]["rows"]
    assert (found["error"], page.desk.sent, page.stacks.document()) == ("", [], None)


def test_a_warning_that_commands_before_it_may_make_void_is_told_as_what_holds_now() -> None:
    page = Page()
    page.desk.warnings["resume"] = "it is driving"
    found = page.stacks.check(TEXT)
    assert found["error"] == ""
    assert ["now", "it is driving; what comes before it may change that"] in found["lines"][1]["rows"]


def test_a_check_shows_the_commands_before_the_one_that_would_be_refused() -> None:
    page = Page()
    page.desk.objections["go_to"] = "closed ground"
    found = page.stacks.check("pause\ngo-to 1 2\nsafe")
    assert [line["line"] for line in found["lines"]] == [1, 2]
    assert found["error"] == "stack: line 2 (go-to 1 2): closed ground; nothing was sent"


def test_a_stack_is_sent_to_its_end_and_tells_the_stage_of_every_command() -> None:
    page = Page()
    page.stacks.start(TEXT, step=False, by="anna")
    document = page.until(ended)
    assert [kind for kind, _ in page.desk.sent] == ["pause", "resume"]
    assert [(line["stage"], line["ended"]) for line in document["lines"]] == [("completed", True)] * 2
    assert (document["by"], document["failure"]) == ("anna", "")


def test_after_the_first_failure_nothing_is_sent() -> None:
    page = Page(Desk({"pause": (CommandStage.REJECTED, "not now")}))
    page.stacks.start(TEXT, step=False, by="anna")
    document = page.until(ended)
    assert [kind for kind, _ in page.desk.sent] == ["pause"]
    assert document["failure"].startswith("stack: line 1 (pause): rejected: not now; 1 of 2 commands sent")


def test_step_by_step_each_command_waits_for_its_answer() -> None:
    page = Page()
    page.stacks.start(TEXT, step=True, by="anna")
    asks = page.until(lambda it: it["asks"] is not None)["asks"]
    assert (asks["line"], page.desk.sent) == (1, [])
    with pytest.raises(InvalidInput, match=r"the command that waits \(line 1 \(pause\)\), got one on line 2"):
        page.stacks.answer(1, 2, send=True)
    page.stacks.answer(1, 1, send=True)
    page.until(lambda it: it["asks"] is not None and it["asks"]["line"] == 2)
    page.stacks.answer(1, 2, send=False)
    with pytest.raises(InvalidInput, match=r"on the command that waits \(none\)|the stack that is under way"):
        page.stacks.answer(1, 2, send=True)  # of another browser, a moment later
    assert "line 2 (resume): not sent, as the operator decided" in page.until(ended)["failure"]
    assert [kind for kind, _ in page.desk.sent] == ["pause"]


@pytest.mark.parametrize("step", [True, False])
def test_a_stack_that_a_person_stops_sends_nothing_any_more(step: bool) -> None:
    page = Page()
    page.flows.clear()
    page.stacks.start(TEXT, step, by="anna")
    page.until(lambda it: it["asks"] is not None or it["lines"][0]["stage"] is not None)
    with pytest.raises(InvalidInput, match="expected none under way, got one that anna has begun"):
        page.stacks.start(TEXT, step, by="ben")
    page.stacks.stop(1, by="ben")
    document = page.until(ended)
    sent = 0 if step else 1
    assert document["failure"] == f"stack: stopped by ben; {sent} of 2 commands sent, nothing is sent after it"
    assert len(page.desk.sent) == sent
    with pytest.raises(InvalidInput, match="expected the stack that is under way, got number 1"):
        page.stacks.stop(1, by="ben")
    page.flows.set()
    page.stacks.start(TEXT, step=False, by="ben")
    assert page.until(ended)["number"] == 2


@pytest.mark.parametrize("step", [True, False])
def test_when_the_server_ends_nothing_more_of_a_stack_is_sent(step: bool) -> None:
    Page().stacks.close()  # where there is none
    page = Page()
    page.flows.clear()
    page.stacks.start(TEXT, step, by="anna")
    page.until(lambda it: it["asks"] is not None or it["lines"][0]["stage"] is not None)
    page.stacks.close()
    assert "stopped by the end of the page's server" in page.until(ended)["failure"]
    with pytest.raises(InvalidInput, match="expected a server that goes on, got one that ends"):
        page.stacks.start(TEXT, step, by="anna")
    assert len(page.desk.sent) == (0 if step else 1)


def test_a_stack_that_would_be_refused_does_not_begin() -> None:
    page = Page()
    page.desk.objections["resume"] = "no"
    with pytest.raises(InvalidInput, match="line 2"):
        page.stacks.start(TEXT, step=False, by="anna")
    assert (page.stacks.document(), page.desk.sent) == (None, [])
