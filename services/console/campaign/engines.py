"""Engines: what computes the tasks. One small seam, submit and results as they come, and two engines behind it.

``local`` is the standard library's pool of threads, each with a worker process. ``dask`` is a cluster: one that is made
here, or one at an address, whose scheduler does scheduling, retry and the dashboard. Both call the same worker process.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

from he3.errors import He3Error, InvalidInput
from services.console.campaign.task import FAILED, LOST, REFUSED, Reply, Task, reply_of
from services.console.campaign.worker_process import Crew, computed

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

AHEAD: Final = 2
"""Tasks that are submitted for each worker, so that it never waits for the next."""
CONNECT_S: Final = 10.0
"""Longest time [s] to connect to a cluster's scheduler."""
CLOSE_S: Final = 1.0
"""Longest time [s] to close a cluster that was made here, when something else ends the campaign."""
END_S: Final = 20.0
"""The same when the campaign is over."""
NEEDS: Final = "expected Dask for this engine, which is not installed: pip install 'he3-seeker[cluster]'"


class Engine(Protocol):
    """Computes tasks. One thread uses it; the end of its `with` statement ends it at once, whatever it computes."""

    @property
    def about(self) -> str:
        """What it is, in one line."""
        ...

    @property
    def workers(self) -> int:
        """Number of tasks that it computes at once."""
        ...

    def submit(self, task: Task) -> None:
        """Have that task computed; its reply comes from `replies`."""
        ...

    def replies(self, timeout_s: float) -> list[tuple[Task, Reply]]:
        """Tasks with their replies, as they come: at least one, or none after that time."""
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def engine_named(name: str, workers: int | None = None) -> Engine:
    """The engine ``local``, ``dask`` or ``dask:ADDRESS``, such as ``dask:tcp://10.0.0.2:8786``.

    workers: at once; None: one for each processor. A cluster at an address has its own, and takes no number. Raises
    InvalidInput for another name, and if Dask is not installed; He3Error if the cluster cannot be reached.
    """
    kind, _, address = name.partition(":")
    if kind not in ("local", "dask") or (kind == "local" and address) or name == "dask:":
        raise InvalidInput(f"--engine: expected local, dask or dask:ADDRESS, got '{name}'")
    if address and workers is not None:
        raise InvalidInput("--workers: expected it without a cluster's address, as a cluster has its own workers")
    if workers is not None and workers < 1:
        raise InvalidInput(f"--workers: expected one at least, got {workers}")
    count = workers or len(os.sched_getaffinity(0))
    return LocalEngine(count) if kind == "local" else DaskEngine(address or None, count)


class _Replies:
    """The part that both engines share: replies of futures in a queue."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[tuple[Task, Reply]] = queue.SimpleQueue()

    def replies(self, timeout_s: float) -> list[tuple[Task, Reply]]:
        """Tasks with their replies: at least one, or none after that time."""
        found = []
        with suppress(queue.Empty):
            found.append(self._queue.get(timeout=timeout_s))
            while True:
                found.append(self._queue.get_nowait())
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        raise NotImplementedError


class LocalEngine(_Replies):
    """Worker processes of this host."""

    def __init__(self, workers: int) -> None:
        super().__init__()
        self.workers = workers
        self.about = f"{workers} worker process{'es' * (workers > 1)} of this host"
        self._crew = Crew()
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="campaign")

    def submit(self, task: Task) -> None:
        """Have that task computed."""
        self._pool.submit(self._crew.computed, task.request()).add_done_callback(
            lambda future: self._queue.put((task, _reply(future)))
        )

    def close(self) -> None:
        """Kill the worker processes; returns when their threads have ended."""
        self._crew.end()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._crew.close()


def _reply(future: Future[Reply]) -> Reply:
    return Reply(LOST, error="cancelled") if future.cancelled() else future.result()


class DaskEngine(_Replies):
    """A Dask cluster: made here, or an existing one at an address."""

    def __init__(self, address: str | None, workers: int) -> None:
        super().__init__()
        try:
            from distributed import Client, LocalCluster, Security
        except ImportError:
            raise InvalidInput(NEEDS) from None
        for name in ("distributed", "distributed.client", "tornado", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # Dask gives each its own; errors come with the replies
        self._cluster: LocalCluster | None = None
        self._pending: dict[str, tuple[Task, Any]] = {}
        self._over = False
        security: Security | None = None
        if address is None:
            # A program that may connect to a scheduler may run code as its user. So this one has keys that exist in its
            # own processes alone, and both ends of each connection show theirs.
            security = Security.temporary()
            self._cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", protocol="tls://",
                security=security, dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL,
            )  # fmt: skip
            address = self._cluster.scheduler_address
        self._address = address
        try:
            self._client: Client = Client(address, timeout=CONNECT_S, set_as_default=False, security=security)
        except (OSError, ValueError) as error:
            self._close_cluster()
            raise He3Error(f"--engine dask: expected a scheduler at {address}, got: {error}") from None

    @property
    def about(self) -> str:
        """Where it is."""
        services = self._client.scheduler_info().get("services", {})
        dashboard = f", dashboard at {self._client.dashboard_link}" if "dashboard" in services else ""
        return f"Dask cluster at {self._address}{dashboard}"

    @property
    def workers(self) -> int:
        """Threads of the cluster's workers at present; at least one, as workers may come later."""
        try:
            return max(1, int(sum(self._client.nthreads().values())))
        except (OSError, ValueError):
            return 1

    def submit(self, task: Task) -> None:
        """Have that task computed."""
        future = self._client.submit(computed, task.request(), key=f"he3-{task.key}", pure=False)
        self._pending[task.key] = task, future
        future.add_done_callback(lambda done: self._queue.put((task, self._reply_of(done))))

    def replies(self, timeout_s: float) -> list[tuple[Task, Reply]]:
        """Tasks with their replies: at least one, or none after that time.

        What a scheduler that was gone has forgotten is submitted to the one that came in its place, if one did.
        """
        found = []
        for task, reply in super().replies(timeout_s):
            if self._pending.pop(task.key, None) is not None:
                found.append((task, reply))
        if not found and self._client.status in ("running", "closed"):
            forgotten = [task for task, future in self._pending.values() if future.status in ("lost", "cancelled")]
            for task in forgotten:
                if self._client.status == "running":
                    self.submit(task)
                else:
                    found.append((self._pending.pop(task.key)[0], self._gone()))
        return found

    def _reply_of(self, future: Any) -> Reply:
        if future.status == "finished":
            try:
                return reply_of(future.result(timeout=CONNECT_S))
            except Exception as error:  # noqa: BLE001 - whatever the cluster raises, the task has no reply
                return Reply(LOST, error=f"{type(error).__name__}: {error}")
            finally:
                future.release()
        if future.status == "error":
            raised = future.exception()
            # A worker of other software may not even know the function.
            kind = REFUSED if isinstance(raised, (ImportError, AttributeError)) else FAILED
            return Reply(kind, error=f"{type(raised).__name__}: {raised}".splitlines()[0])
        return self._gone()

    def _gone(self) -> Reply:
        return Reply(LOST, error=f"the cluster at {self._address} is gone")

    def close(self) -> None:
        """Give up what is computed, and end a cluster that was made here; returns soon, whatever the scheduler does."""
        closing = threading.Thread(target=self._close, daemon=True)
        closing.start()
        closing.join(END_S if self._over else CLOSE_S)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over = kind is None
        self.close()

    def _close(self) -> None:
        with suppress(Exception):
            self._client.close(timeout=CLOSE_S / 2)
        self._close_cluster()

    def _close_cluster(self) -> None:
        if self._cluster is not None:
            with suppress(Exception):
                self._cluster.close(timeout=END_S)
