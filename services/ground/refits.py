"""When the hyperparameters are fitted: once a round, in their order, each time on the rounds up to that one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from he3.gp import Hyperparameters
from services.ground.fitting import due, fit
from services.runtime.node import Compute, Effect, Level, LogRecord

if TYPE_CHECKING:
    from services.ground.belief import Belief
    from services.ground.round_log import RoundLog
    from services.runtime.node import SavedState

_SEED = 1  # tells the seeds of fits from those of plans


class RefitSchedule:
    """Requests one fit for each closed round, one at a time, and passes the result to the belief."""

    def __init__(self, belief: Belief, round_log: RoundLog, seed: int, samples: int) -> None:
        """samples: of the whole mission; 0 infers all alternatives after every round (`fitting.due`)."""
        self._belief = belief
        self._round_log = round_log
        self._seed = seed
        self._samples = samples
        self._job: str | None = None
        self._asked = 0
        self._inferred_from = 0
        self.rounds = 0
        """Number of rounds that the hyperparameters are fitted to."""

    @property
    def busy(self) -> bool:
        """Whether a fit is being computed."""
        return self._job is not None

    def next(self) -> Compute | None:
        """The fit request for the next closed round; None if there is none. A round without samples is skipped."""
        chain = self._round_log.chain
        while self.rounds < len(chain) and chain[self.rounds].closed:
            number, record = self.rounds + 1, chain[self.rounds]
            request = self._belief.fit_request(record.number, (self._seed, _SEED, number)) if record.arrived else None
            if request is not None:
                self._job = f"fit:{number}"
                known = len(request.values_ppb)
                whole = due(known, self._inferred_from, self._samples)
                self._asked = known if whole else self._inferred_from
                return Compute(self._job, fit, (replace(request, whole=whole),))
            self.rounds += 1
        return None

    def waits_for(self, job: str) -> bool:
        """Whether that computation is the fit being computed."""
        return job == self._job

    def finish(self, result: Any, error: Exception | None) -> list[Effect]:
        """End the fit: the belief adopts its result; if it failed, the hyperparameters are unchanged."""
        job, self._job = self._job, None
        self.rounds += 1
        if isinstance(result, Hyperparameters):
            self._inferred_from = self._asked
            self._belief.adopt(result)
            return []
        return [LogRecord(Level.WARNING, f"{job}: the hyperparameters are unchanged: {error}")]

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "job": self._job,
            "asked": self._asked,
            "inferred_from": self._inferred_from,
            "rounds": self.rounds,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the schedule from this state."""
        self._job, self._asked, self._inferred_from = state["job"], state["asked"], state["inferred_from"]
        self.rounds = state["rounds"]
