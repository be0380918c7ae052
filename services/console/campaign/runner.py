"""The runner: tasks of a study to an engine, replies into the store, until every task has its row.

What has a row is not computed again. Whatever ends the runner, the rows stay, and the same command continues.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from he3.errors import He3Error, InvalidInput
from services.console.campaign.engines import AHEAD, Engine
from services.console.campaign.store import Store
from services.console.campaign.table import kind_of
from services.console.campaign.task import DONE, FAILED, LOST, REFUSED, Reply, Task
from services.console.client.time_format import duration

WAIT_S: Final = 0.5
"""Longest wait for a reply [s], so that progress is shown in between."""
MAX_SHOWN: Final = 4


@dataclass(slots=True)
class Progress:
    """What a campaign has come to."""

    total: int
    kept: int = 0
    """Tasks that had their row before."""
    done: int = 0
    """Tasks that got a result in this run."""
    failed: int = 0
    """Tasks that got an error in this run."""
    failed_before: int = 0
    """Tasks whose row of an earlier run is an error, which is not tried again."""
    computed_s: float = 0.0
    """Time that workers computed [s], all together."""
    elapsed_s: float = 0.0
    workers: int = 1
    sums: dict[str, tuple[int, float]] = field(default_factory=dict)
    """Count and sum of each number in the results of this run."""
    last_error: str = ""

    @property
    def left(self) -> int:
        """Tasks without a row."""
        return self.total - self.kept - self.done - self.failed

    @property
    def time_left_s(self) -> float | None:
        """Expected time [s] until the last row; None before the first."""
        flown = self.done + self.failed
        return None if flown == 0 else self.elapsed_s * self.left / flown

    @property
    def busy(self) -> float:
        """Share of the workers' time in which they computed."""
        return self.computed_s / (self.elapsed_s * self.workers) if self.elapsed_s > 0 else 0.0

    def means(self, names: Sequence[str]) -> dict[str, float]:
        """Running means of those figures, as far as there are any."""
        return {name: self.sums[name][1] / self.sums[name][0] for name in names if name in self.sums}

    def add(self, reply: Reply) -> None:
        """Count a reply of this run."""
        self.computed_s += reply.wall_s
        if reply.status != DONE:
            self.failed += 1
            self.last_error = reply.error
            return
        self.done += 1
        for name, value in (reply.result or {}).items():
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                count, total = self.sums.get(name, (0, 0.0))
                self.sums[name] = (count + 1, total + value)

    def line(self, names: Sequence[str] = ()) -> str:
        """The progress on one line."""
        rate = (self.done + self.failed) / self.elapsed_s if self.elapsed_s > 0 else 0.0
        left = self.time_left_s
        parts = [f"{self.total - self.left}/{self.total}"]
        if rate:
            parts.append(f"{rate * 60:.1f} a minute" if rate < 10 else f"{rate:.1f} a second")
        if left is not None and self.left:
            parts.append(f"{duration(left)} left")
        failed = self.failed + self.failed_before
        parts.append(f"{failed} failed" if failed else "none failed")
        parts += [kind_of(name).words(mean) for name, mean in self.means(names).items()][:MAX_SHOWN]
        return "  ".join(parts)


def run(
    tasks: Sequence[Task],
    store: Store,
    engine: Engine,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    *,
    retry_failed: bool = False,
) -> Progress:
    """Compute every task that has no row, and write its row as it comes; returns what it came to.

    on_progress: called with each reply, and twice a second. For the rest see `replies`.
    """
    progress = Progress(len({task.key for task in tasks}), workers=engine.workers)
    on_progress(progress)
    for _ in replies(tasks, store, engine, progress, retry_failed=retry_failed):
        on_progress(progress)
    return progress


def replies(
    tasks: Sequence[Task], store: Store, engine: Engine, progress: Progress, *, retry_failed: bool = False
) -> Iterator[tuple[Task, Reply] | None]:
    """Each task that had no row with its reply, whose row is written; None while there is nothing new.

    retry_failed: compute those, too, whose row is an error. progress: is kept up to date. Raises InvalidInput when a
    worker refuses a task because of its software, He3Error when the engine is gone; the rows until then stay.
    """
    began = time.monotonic()
    known = store.begin(tasks)
    again = {key for key, status in known.items() if status == FAILED and retry_failed}
    waiting = deque(_once(task for task in tasks if task.key not in known or task.key in again))
    progress.kept = len(known) - len(again)
    progress.failed_before = sum(status == FAILED for status in known.values()) - len(again)
    running = 0
    while waiting or running:
        progress.workers = max(progress.workers, engine.workers)
        while waiting and running < AHEAD * progress.workers:
            engine.submit(waiting.popleft())
            running += 1
        came = engine.replies(WAIT_S)
        progress.elapsed_s = time.monotonic() - began
        for task, reply in came:
            running -= 1
            if reply.status == REFUSED:
                raise InvalidInput(f"refused: {reply.error}")
            if reply.status == LOST:
                raise He3Error(
                    f"{reply.error}; {progress.total - progress.left} of {progress.total} are in the store: "
                    "the same command continues"
                )
            store.write(task, reply)
            progress.add(reply)
            yield task, reply
        if not came:
            yield None


def _once(tasks: Iterable[Task]) -> Iterator[Task]:
    """Each task once: two with the same content are one."""
    seen: set[str] = set()
    for task in tasks:
        key = task.key
        if key not in seen:
            seen.add(key)
            yield task
