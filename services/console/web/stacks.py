"""The command stack of the page: checked, then sent by the page's server with the client's own code.

One stack is under way at a time. It belongs to no browser: a page that is reloaded, or another one, shows it and can
stop it. It ends with the server; nothing is sent after that.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from he3.errors import He3Error, InvalidInput
from services.console.client.stacks import LOOK_EVERY_S, MissionDesk, StackRun, parse_stack

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient
    from services.console.client.previews import CommandOutlook
    from services.console.client.stacks import StackDesk, StackLine


class StackStopped(He3Error):
    """A person has stopped the stack."""


@dataclass(eq=False)
class _UnderWay:
    """The stack that is sent, or that was sent last."""

    number: int
    run: StackRun
    by: str
    step: bool
    asks: tuple[StackLine, CommandOutlook] | None = None
    """The command that waits for a person's answer."""
    answer: bool | None = None
    stopped_by: str | None = None
    ended: bool = False
    failure: str = ""

    def expect_not_stopped(self) -> None:
        """Raise StackStopped if a person has stopped it."""
        if self.stopped_by is not None:
            count, whole = len(self.run.sent), len(self.run.lines)
            raise StackStopped(
                f"stack: stopped by {self.stopped_by}; {count} of {whole} commands sent, nothing is sent after it"
            )


class PageStacks:
    """The stack that is under way, for every page of this server."""

    def __init__(
        self, desk: Callable[[], StackDesk], start_ns: Callable[[], int], tell: Callable[[], None], first: int = 1
    ) -> None:
        """desk: of the mission. start_ns: the mission's beginning. tell: called, in any thread, after each change.

        first: the number of the first stack.
        """
        self._desk = desk
        self._start_ns = start_ns
        self._tell = tell
        self._changed = threading.Condition()
        self._under_way: _UnderWay | None = None
        self._next = first
        self._told = 0
        self._closed = False

    @classmethod
    def of(cls, mission: MissionClient, tell: Callable[[], None], first: int = 1) -> PageStacks:
        """The stacks of that mission. first: the number of the first one."""
        return cls(lambda: MissionDesk(mission), lambda: mission.clock().start_ns, tell, first)

    def check(self, text: str) -> dict[str, Any]:
        """What each command of that stack would do, up to the first that would be refused; nothing is sent."""
        lines: list[dict[str, Any]] = []
        try:
            run = StackRun(parse_stack(text, self._start_ns()), self._desk())
            for line, outlook in run.check():
                lines.append({**_line(line), "rows": [list(row) for row in run.rows(line, outlook)]})
        except InvalidInput as error:
            return {"lines": lines, "error": str(error)}
        return {"lines": lines, "error": ""}

    def start(self, text: str, step: bool, by: str) -> None:
        """Check the stack once more, and begin to send it; step: each command waits for an answer.

        Raises InvalidInput, and sends nothing, if a command would be refused, if a stack is under way, or if the server
        ends.
        """
        with self._changed:
            self._expect_none()
        run = StackRun(parse_stack(text, self._start_ns()), _StoppableDesk(self._desk(), self._pause))
        for _ in run.check():
            pass
        with self._changed:
            self._expect_none()
            begun = self._under_way = _UnderWay(self._next, run, by, step)
            self._next += 1
        self._tell()
        threading.Thread(target=self._send, args=(begun,), name="web-stack", daemon=True).start()

    def answer(self, number: int, line: int, send: bool) -> None:
        """Send the command that waits, or none any more. Raises InvalidInput if another one waits, or none."""
        with self._changed:
            under_way = self._expect(number)
            asks = under_way.asks
            if asks is None or asks[0].number != line:
                waits = "none" if asks is None else asks[0].name
                raise InvalidInput(
                    f"stack: expected an answer on the command that waits ({waits}), got one on line {line}"
                )
            under_way.answer, under_way.asks = send, None  # the first answer counts
            self._changed.notify_all()

    def stop(self, number: int, by: str) -> None:
        """Send nothing any more of that stack. Raises InvalidInput if it is not under way."""
        with self._changed:
            under_way = self._expect(number)
            under_way.stopped_by, under_way.asks = under_way.stopped_by or by, None
            self._changed.notify_all()

    def close(self) -> None:
        """Send nothing any more: the server ends."""
        with self._changed:
            self._closed = True
            if self._under_way is not None:
                self._under_way.stopped_by = self._under_way.stopped_by or "the end of the page's server"
            self._changed.notify_all()

    def document(self) -> dict[str, Any] | None:
        """The stack that is under way, or that was last, as JSON values; None if there was none.

        A later one has a higher `serial`: a reply may arrive after what the stream has told meanwhile.
        """
        with self._changed:
            under_way = self._under_way
            if under_way is None:
                return None
            self._told += 1
            run, asks = under_way.run, under_way.asks
            names = {line.number: name for name, line in dict(run.sent).items()}  # its thread goes on
            return {
                "number": under_way.number,
                "serial": self._told,
                "by": under_way.by,
                "step": under_way.step,
                "ended": under_way.ended,
                "failure": under_way.failure,
                "lines": [{**_line(line), **self._stage(run, names.get(line.number))} for line in run.lines],
                "asks": None
                if asks is None
                else {
                    "line": asks[0].number,
                    "rows": [list(row) for row in asks[1].rows()],
                    "path_m": _path(asks[1]),
                },
            }

    @staticmethod
    def _stage(run: StackRun, name: str | None) -> dict[str, Any]:
        """What has become of a command; name: its id, None if it was not sent."""
        status = None if name is None else run.statuses.get(name)
        if status is None:
            return {"command_id": name, "stage": None if name is None else "sent", "ended": False}
        return {"command_id": name, "stage": status.stages[-1].stage.value, "ended": status.end is not None}

    # --- the thread that sends --------------------------------------------------------------------------------------

    def _send(self, begun: _UnderWay) -> None:
        failure = "stack: stopped by a defect of the page's server"
        try:
            for _ in begun.run.run(lambda line, outlook: self._may_send(begun, line, outlook)):
                self._tell()
            failure = ""
        except He3Error as error:
            failure = str(error)
        finally:
            with self._changed:
                begun.asks, begun.failure, begun.ended = None, failure, True
            self._tell()

    def _may_send(self, begun: _UnderWay, line: StackLine, outlook: CommandOutlook) -> bool:
        begun.expect_not_stopped()
        if not begun.step:
            return True
        with self._changed:
            begun.asks, begun.answer = (line, outlook), None
        self._tell()
        with self._changed:
            self._changed.wait_for(lambda: begun.answer is not None or begun.stopped_by is not None)
            begun.expect_not_stopped()
            sends = begun.answer is True
        self._tell()
        return sends

    def _pause(self) -> None:
        """Let some time pass between two looks at the mission. Raises StackStopped if the stack is to stop."""
        with self._changed:
            begun = self._under_way
            assert begun is not None, "called by the stack that is under way"
            self._changed.wait_for(lambda: begun.stopped_by is not None, LOOK_EVERY_S)
            begun.expect_not_stopped()

    def _expect(self, number: int) -> _UnderWay:
        under_way = self._under_way
        if under_way is None or under_way.ended or under_way.number != number:
            raise InvalidInput(f"stack: expected the stack that is under way, got number {number}")
        return under_way

    def _expect_none(self) -> None:
        if self._closed:
            raise InvalidInput("stack: expected a server that goes on, got one that ends; nothing was sent")
        if self._under_way is not None and not self._under_way.ended:
            raise InvalidInput(f"stack: expected none under way, got one that {self._under_way.by} has begun")


class _StoppableDesk:
    """A desk whose pauses are another's."""

    def __init__(self, desk: StackDesk, pause: Callable[[], None]) -> None:
        self._desk = desk
        self.pause = pause
        self.now, self.in_contact, self.rover_mode = desk.now, desk.in_contact, desk.rover_mode
        self.outlook, self.send, self.stages = desk.outlook, desk.send, desk.stages


def _line(line: StackLine) -> dict[str, Any]:
    return {"line": line.number, "command": line.text, "waits_for": line.waits_for}


def _path(outlook: CommandOutlook) -> list[list[float]]:
    return [list(place) for place in outlook.preview.path_m]
