"""The ground's log for operators, read from a session, and what an operator does about an alarm."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.mission_log import AlarmAction, AlarmKind, AlarmMark, LogEntry, MissionLog
from schemas.topics import SET_ALARM, SHOW_LOG
from schemas.validation import one_line
from services.console.client.person import Acting

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.runtime.transport.client import Client


class Operations(Acting):
    """The part of `MissionClient` that concerns the log and the alarms."""

    _session: Client

    def log(self) -> MissionLog:
        """What the ground has logged: events and modes of the rover, plans with their times, what people changed."""
        log: MissionLog = self._session.query(SHOW_LOG, NoParameters())
        return log

    def acknowledge_alarm(self, kind: AlarmKind | str, why: str = "") -> LogEntry:
        """Note that the alarm of that kind was seen. Raises InvalidInput for a kind that does not exist."""
        return self._mark(kind, AlarmAction.ACKNOWLEDGE, why)

    def shelve_alarm(self, kind: AlarmKind | str, until: MissionTime, why: str = "") -> LogEntry:
        """Let the alarm of that kind need no attention until that mission time. Raises InvalidInput as above."""
        return self._mark(kind, AlarmAction.SHELVE, why, until)

    def unshelve_alarm(self, kind: AlarmKind | str, why: str = "") -> LogEntry:
        """Let a shelved alarm count again. Raises InvalidInput as above."""
        return self._mark(kind, AlarmAction.UNSHELVE, why)

    def _mark(self, kind: str, action: AlarmAction, why: str, until: MissionTime | None = None) -> LogEntry:
        try:
            known = AlarmKind(str(kind).replace("-", "_"))
            mark = AlarmMark(kind=known, action=action, by=self.person, until=until, why=why)
        except ValidationError as error:
            raise InvalidInput(f"alarm: {one_line(error)}") from None
        except ValueError:
            kinds = ", ".join(each.value for each in AlarmKind)
            raise InvalidInput(f"alarm: expected one of {kinds}; got '{str(kind)[:80]}'") from None
        entry: LogEntry = self._session.query(SET_ALARM, mark)
        return entry
