"""Shares of drives, staged by the workers of a Dask cluster.

A thread here hands out the shares, few more than the workers have threads, and keeps the parts that
come back. A worker needs this package and the recordings; the scheduler needs Dask alone.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

from fieldgrid.build.answering import check_scheduler
from fieldgrid.build.executor import DriveOrder, Event, Failed, Moved, Shared
from fieldgrid.build.parts import Share, keep_part
from fieldgrid.build.remote import Made, Place, packed, place_of, versions
from fieldgrid.closing import Closing
from fieldgrid.errors import ClusterError, ConfigError, FieldgridError, RecordingError

if TYPE_CHECKING:
    from distributed import Client, Future

RETRIES = 2
"""How often Dask does a share again that failed for the worker's disk or memory. One whose worker
dies is done again as often as the scheduler's `allowed-failures` says, 3 times by default."""

CONNECT_S = 10.0
NO_WORKERS_S = 60.0
"""How long a scheduler may take to answer, and may be without a worker."""

_NO_SCHEDULER = (OSError, ValueError, TypeError, OverflowError, AssertionError, MemoryError)
"""What connecting raises: on a loaded machine Dask asserts that its own thread has begun in time,
and what a server of another kind says it takes for the size of a message."""

_AHEAD = 2
"""Shares that are handed out for each thread of a worker: one to work at, one to go on with."""

_TICK_S = 1.0


@contextmanager
def connected(scheduler: str | Client) -> Iterator[Client]:
    """A client of the scheduler at an address, closed at the end of the block, or the client that
    is given. ClusterError when none or another program answers, ConfigError without Dask."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "A build on a cluster needs Dask, which is not installed; "
            "run: pip install 'fieldgrid[dask]'"
        ) from error
    if isinstance(scheduler, Client):
        if scheduler.asynchronous:
            raise ConfigError("The Dask client is asynchronous; give the scheduler's address.")
        yield scheduler
        return
    try:
        check_scheduler(scheduler, CONNECT_S)
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False, name="fieldgrid")
    except _NO_SCHEDULER as error:
        raise ClusterError(
            f"No Dask scheduler answers at {scheduler} ({_first_line(error)}); start one there "
            "with: dask scheduler, or check address and firewall."
        ) from error
    with client:
        yield client


class _Task(NamedTuple):
    drive: int
    share: Share


class _Drive(NamedTuple):
    name: str
    work: Future
    place: Place
    folder: Path


class Cluster(Closing):
    """The workers of a Dask cluster (a :class:`~fieldgrid.build.executor.Executor`).

    Dask suspects every share that a worker had when it died. One that it gives up is done once
    more with nothing beside it: only when workers die then, too, its drive is left out.
    """

    def __init__(self, client: Client) -> None:
        self.events: SimpleQueue[Event] = SimpleQueue()
        self._client = client
        self._lock = threading.Lock()
        self._drives: dict[int, _Drive] = {}
        self._tasks: deque[_Task] = deque()
        self._suspects: deque[_Task] = deque()
        self._alone: _Task | None = None
        self._running: dict[str, tuple[Future, _Task]] = {}
        self._ended: SimpleQueue[str | None] = SimpleQueue()
        self._error: BaseException | None = None
        self._closed = False
        self._threads, self._asked_s, self._worked_s = 0, -_TICK_S, time.monotonic()
        self._thread = threading.Thread(target=self._serve, name="fieldgrid-cluster", daemon=True)
        self._thread.start()

    def add(self, order: DriveOrder) -> None:
        """Stage these shares of a drive, after those that were added before."""
        # A task of its own: when the worker that has it dies, Dask makes it again.
        work = self._client.submit(bytes, packed(order.work), key=_key("work"), pure=False)
        with self._lock:
            self._drives[order.drive] = _Drive(
                order.name, work, place_of(order.recording), order.folder
            )
            self._tasks += [_Task(order.drive, share) for share in order.shares]
            if self._error is not None:
                self.events.put(Failed(order.drive, self._error))

    def drop(self, drive: int) -> None:
        """Stage no more shares of a drive."""
        with self._lock:
            for tasks in (self._tasks, self._suspects):
                kept = [task for task in tasks if task.drive != drive]
                tasks.clear()
                tasks += kept
            dropped = [key for key, (_, task) in self._running.items() if task.drive == drive]
            self._cancel([self._running.pop(key)[0] for key in dropped])
            if self._alone is not None and self._alone.drive == drive:
                self._alone = None

    def close(self) -> None:
        """Take back all that is not done; what a worker is at it does to the end of the share."""
        with self._lock:
            self._closed = True
            works = [drive.work for drive in self._drives.values()]
            self._cancel([future for future, _ in self._running.values()] + works)
            self._running.clear()
            self._drives.clear()
        self._ended.put(None)
        self._thread.join()

    def _cancel(self, futures: list[Future]) -> None:
        if futures and self._client.status == "running":
            with suppress(OSError, RuntimeError):  # the scheduler is gone, and the tasks with it
                self._client.cancel(futures)

    def _serve(self) -> None:
        """The life of the thread."""
        try:
            while True:
                self._hand_out()
                try:
                    key = self._ended.get(timeout=_TICK_S)
                except Empty:
                    continue
                if key is None:
                    return
                self._take(key)
        except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 - the build raises it
            told = error if isinstance(error, FieldgridError) else self._lost(error)
            with self._lock:
                self._error = told
                for drive in self._drives:
                    self.events.put(Failed(drive, told))

    def _hand_out(self) -> None:
        """Give the scheduler as many shares as the workers can have."""
        self._look_at_workers()
        with self._lock:
            if self._alone is not None or self._closed:
                return
            if self._suspects:
                if not self._running:
                    self._alone = self._suspects.popleft()
                    self._submit(self._alone)
                return
            while self._tasks and len(self._running) < max(1, _AHEAD * self._threads):
                self._submit(self._tasks.popleft())

    def _look_at_workers(self) -> None:
        """Count their threads, now and then. ClusterError when there has been none for long."""
        now_s = time.monotonic()
        if now_s - self._asked_s < _TICK_S:
            return
        self._threads, self._asked_s = sum(self._client.nthreads().values()), now_s
        if self._threads or not (self._running or self._tasks or self._suspects):
            self._worked_s = now_s
        elif now_s - self._worked_s > NO_WORKERS_S:
            raise ClusterError(
                f"The Dask scheduler {self._address} has had no worker for {NO_WORKERS_S:g} s; "
                f"start some with: dask worker {self._address}"
            )

    def _submit(self, task: _Task) -> None:
        drive = self._drives[task.drive]
        future = self._client.submit(
            _travelling(),
            drive.work,
            tuple(task.share),
            tuple(drive.place),
            versions(),
            key=_key(task.share.name),
            pure=False,
            retries=RETRIES,
        )
        self._running[future.key] = (future, task)
        future.add_done_callback(lambda done: self._ended.put(done.key))

    def _take(self, key: str) -> None:
        """What became of a share."""
        from distributed import KilledWorker

        with self._lock:
            if key not in self._running:
                return  # it was dropped
            future, task = self._running.pop(key)
            drive = self._drives[task.drive]
            was_alone, self._alone = task == self._alone, None
        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            if was_alone:
                self.events.put(Failed(task.drive, _killing(task, drive)))
            else:
                self._suspects.append(task)
        elif error is not None:
            raise ClusterError(
                f"The Dask cluster {self._address} cannot run the tasks of the build "
                f"({type(error).__name__}: {_first_line(error)}); give scheduler and workers the "
                "Python and the packages that this program has."
            )
        else:
            self._keep(task, drive, future.result())

    def _keep(self, task: _Task, drive: _Drive, result: Any) -> None:
        if isinstance(result, Made):
            try:
                keep_part(drive.folder, task.share, result.part)
            except FieldgridError as error:
                result = error
            else:
                frames = task.share.last - task.share.first
                at_s = time.perf_counter() - result.took_s
                self.events.put(Moved(task.drive, result.moved_m, at_s, frames))
                self.events.put(Shared(task.drive, task.share))
                return
        if isinstance(result, FieldgridError):
            self.events.put(Failed(task.drive, result))
        elif isinstance(result, str):
            self.events.put(Failed(task.drive, RuntimeError(result)))
        else:
            host, what = result
            raise ClusterError(
                f"The worker on {host} {what}; install there what this program has, fieldgrid "
                f"{versions()['fieldgrid']} with its requirements."
            )

    def _lost(self, error: BaseException) -> ClusterError:
        return ClusterError(
            f"The Dask scheduler {self._address} is gone, or has given up the tasks of the build "
            f"({type(error).__name__}); start it again."
        )

    @property
    def _address(self) -> str:
        return str(self._client.scheduler.address)


def _key(what: str) -> str:
    return f"fieldgrid-{what}-{uuid4().hex}"


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).strip().partition("\n")[0].rstrip(".")


def _killing(task: _Task, drive: _Drive) -> RecordingError:
    return RecordingError(
        f"Frames {task.share.first} to {task.share.last - 1} of {drive.name} have ended every Dask "
        "worker that staged them; leave the recording out, or give the workers more memory."
    )


def _travelling() -> Callable[..., Any]:
    """The function of a task. It is not one of the module, so that it is sent by its code: the
    scheduler, which reads tasks, needs no fieldgrid, and a worker without can say so."""

    def stage(
        work: bytes,
        share: tuple[int, int],
        place: tuple[str, int | None, str],
        wanted: dict[str, str],
    ) -> Any:
        import platform
        import traceback

        try:
            from fieldgrid.build import remote
            from fieldgrid.errors import FieldgridError

            found = remote.versions()
        except (ImportError, AttributeError) as error:
            return platform.node(), f"has no fieldgrid that can do this ({error})"
        for name, version in wanted.items():
            if found.get(name) != version:
                return platform.node(), f"has {name} {found.get(name)}, not {version}"
        try:
            return remote.stage_share(work, share, place)
        except FieldgridError as error:
            return error
        except (OSError, MemoryError):
            raise  # Dask tries again
        except Exception:  # noqa: BLE001 - the build raises it
            return traceback.format_exc()

    return stage
