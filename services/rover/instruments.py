"""Questions to the instruments: one at a time, asked again while there is no answer, outdated answers told apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from schemas.topics import Topic
from schemas.wire import Wire
from services.runtime.node import Effect, MissionTime, SendQuery, SetTimer, seconds

RETRY: Final = "retry"


@dataclass(slots=True)
class Instruments:
    """The question that stands, if any, and which instruments are known to be silent."""

    retry_s: float
    _asked: int = 0
    _question: str | None = None
    _silent: set[str] = field(default_factory=set)

    @property
    def waiting(self) -> bool:
        """Whether a question stands."""
        return self._question is not None

    def ask(self, topic: Topic, request: Wire) -> Effect:
        """Asks; any answer to an earlier question is outdated with that."""
        self._asked += 1
        self._question = f"{topic.name.rsplit('/', 1)[-1]}-{self._asked}"
        return SendQuery(topic, request, self._question)

    def expects(self, query: str) -> bool:
        """Whether that is the question that stands."""
        return query == self._question

    def answered(self, topic: Topic) -> None:
        """The question that stands is answered: the instrument is not silent."""
        self._question = None
        self._silent.discard(topic.name)

    def withdraw(self) -> list[Effect]:
        """Takes the question back that stands, and any intention to repeat it."""
        if self._question is None:
            return []
        self._question = None
        return [SetTimer(RETRY, None)]

    def failed(self, topic: Topic, now: MissionTime) -> tuple[bool, Effect]:
        """Whether this instrument had answered until now, and the wait until it is asked again."""
        first = topic.name not in self._silent
        self._silent.add(topic.name)
        return first, SetTimer(RETRY, now + seconds(self.retry_s))
