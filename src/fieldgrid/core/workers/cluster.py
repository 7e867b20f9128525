"""Tasks on the workers of a Dask cluster.

A thread here hands them out, few more than the workers have threads, and takes what comes back. A
worker needs this package and the files; the scheduler needs Dask alone.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

from fieldgrid.core.closing import Closing
from fieldgrid.core.errors import ClusterError, FieldgridError
from fieldgrid.core.workers.connecting import first_line

if TYPE_CHECKING:
    from distributed import Client, Future


import ctypes
import platform
from functools import lru_cache
from importlib.metadata import version

import cv2
import numpy as np

from fieldgrid.version import software_version

# What the bits of a result depend on beside its inputs.


def versions() -> dict[str, str]:
    """The versions of this package and of those that it computes with, by name."""
    return {
        "fieldgrid": software_version(),
        "NumPy": np.__version__,
        "OpenCV": cv2.__version__,
        "Numba": version("numba"),
        "SciPy": version("scipy"),
    }


# How a worker of Dask asks the system for memory.


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES, _LARGE_BYTES = 64 << 20, 32 << 20


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """Let this process use again what it has freed, up to 64 MB, as glibc does by itself.

    Dask's nanny starts workers so that each array of 128 kB or more goes back to the system, and
    is asked for again, page by page: verifying a map took more than twice the processor time.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    mallopt = ctypes.CDLL(None).mallopt
    mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


RETRIES = 2
"""How often Dask does a task again that failed for the worker's disk or memory. One whose worker
dies is done again as often as the scheduler's `allowed-failures` says, 3 times by default."""

NO_WORKERS_S = 60.0
"""How long a scheduler may be without a worker."""

_AHEAD = 2
"""Tasks that are handed out for each thread of a worker: one to work at, one to go on with."""

_TICK_S = 1.0


class Task(NamedTuple):
    """A call of the cluster's function with the data of a group and further arguments. `name` is
    what it is called in Dask's dashboard."""

    group: int
    name: str
    arguments: tuple[Any, ...]


class WorkersDied(Exception):  # noqa: N818 - it tells what became of a task, and is not raised
    """Every worker that did a task has died, also with nothing beside it."""


class TaskResult(NamedTuple):
    """What became of a task: what the function returned, or the error that it ended with, which
    is a FieldgridError that the function raised, WorkersDied, or a RuntimeError with the traceback
    of what nobody foresaw."""

    task: Task
    value: Any = None
    error: Exception | None = None


class Cluster(Closing):
    """The workers of a Dask cluster, for one function: `function` is "module:name" of this package.

    `tell`, which the thread calls, hears of every task that has ended, and `lose`, for every group,
    of what ends all: ClusterError, or whatever `tell` raised.

    Dask suspects every task that a worker had when it died. One that it gives up is done once
    more with nothing beside it: only when workers die then, too, it has ended with WorkersDied.
    """

    def __init__(
        self,
        client: Client,
        function: str,
        tell: Callable[[TaskResult], None],
        lose: Callable[[int, BaseException], None],
    ) -> None:
        self._client, self._function = client, function
        self._tell, self._lose = tell, lose
        self._lock = threading.Lock()
        self._groups: dict[int, Future] = {}
        self._tasks: deque[Task] = deque()
        self._suspects: deque[Task] = deque()
        self._alone: Task | None = None
        self._running: dict[str, tuple[Future, Task]] = {}
        self._ended: SimpleQueue[str | None] = SimpleQueue()
        self._error: BaseException | None = None
        self._closed = False
        self._threads, self._asked_s, self._worked_s = 0, -_TICK_S, time.monotonic()
        self._thread = threading.Thread(target=self._serve, name="fieldgrid-cluster", daemon=True)
        self._thread.start()

    @property
    def ahead(self) -> int:
        """How many tasks are handed out at a time."""
        return max(1, _AHEAD * self._threads)

    def begin(self, group: int, data: bytes) -> None:
        """A group of tasks, and the data that is sent once to each worker that does one of them."""
        # A task of its own: when the worker that has it dies, Dask makes it again.
        future = self._client.submit(bytes, data, key=f"fieldgrid-data-{uuid4().hex}", pure=False)
        with self._lock:
            self._groups[group] = future
            if self._error is not None:
                self._lose(group, self._error)

    def add(self, tasks: Sequence[Task]) -> None:
        """Do these tasks, of groups that have begun, after those that were added before."""
        with self._lock:
            self._tasks += tasks
        self._ended.put("")

    def drop(self, group: int) -> None:
        """Do no more tasks of a group, and tell of none."""
        with self._lock:
            self._tasks = deque(task for task in self._tasks if task.group != group)
            self._suspects = deque(task for task in self._suspects if task.group != group)
            dropped = [key for key, (_, task) in self._running.items() if task.group == group]
            self._cancel([self._running.pop(key)[0] for key in dropped])
            if group in self._groups:
                self._cancel([self._groups.pop(group)])
            if self._alone is not None and self._alone.group == group:
                self._alone = None

    def close(self) -> None:
        """Take back all that is not done; what a worker is at it does to the end of the task."""
        with self._lock:
            self._closed = True
            self._cancel([future for future, _ in self._running.values()])
            self._cancel(list(self._groups.values()))
            self._running.clear()
            self._groups.clear()
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
        except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 - the caller raises it
            told: BaseException = error
            if not isinstance(error, FieldgridError):
                told = ClusterError(
                    f"The Dask scheduler {self._address} is gone, or has given up the tasks of "
                    f"this program ({type(error).__name__}); start it again."
                )
            with self._lock:
                self._error = told
                for group in self._groups:
                    self._lose(group, told)

    def _hand_out(self) -> None:
        """Give the scheduler as many tasks as the workers can have."""
        self._look_at_workers()
        with self._lock:
            if self._alone is not None or self._closed:
                return
            if self._suspects:
                if not self._running:
                    self._alone = self._suspects.popleft()
                    self._submit(self._alone)
                return
            while self._tasks and len(self._running) < self.ahead:
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

    def _submit(self, task: Task) -> None:
        future = self._client.submit(
            _travelling(),
            self._groups[task.group],
            self._function,
            task.arguments,
            versions(),
            key=f"fieldgrid-{task.name}-{uuid4().hex}",
            pure=False,
            retries=RETRIES,
        )
        self._running[future.key] = (future, task)
        future.add_done_callback(lambda done: self._ended.put(done.key))

    def _take(self, key: str) -> None:
        """What became of a task."""
        from distributed import KilledWorker

        with self._lock:
            if key not in self._running:
                return  # it was dropped, or this only says that there is more to do
            future, task = self._running.pop(key)
            was_alone, self._alone = task == self._alone, None
        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker):
            if was_alone:
                self._tell(TaskResult(task, error=WorkersDied()))
            else:
                self._suspects.append(task)
        elif error is not None:
            raise ClusterError(
                f"The Dask cluster {self._address} cannot run the tasks of this program "
                f"({type(error).__name__}: {first_line(error)}); give scheduler and workers the "
                "Python and the packages that this program has."
            )
        else:
            self._tell(_ended(task, *future.result()))

    @property
    def _address(self) -> str:
        return str(self._client.scheduler.address)


def _ended(task: Task, how: str, told: Any) -> TaskResult:
    if how == "unable":
        host, what = told
        raise ClusterError(
            f"The worker on {host} {what}; install there what this program has, fieldgrid "
            f"{versions()['fieldgrid']} with its requirements."
        )
    if how == "done":
        return TaskResult(task, told)
    return TaskResult(task, error=RuntimeError(told) if how == "defect" else told)


def _travelling() -> Callable[..., Any]:
    """The function of a task. It is not one of the module, so that it is sent by its code: the
    scheduler, which reads tasks, needs no fieldgrid, and a worker without can say so."""

    def do(data: bytes, function: str, arguments: tuple[Any, ...], wanted: dict[str, str]) -> Any:
        import importlib
        import platform
        import traceback

        module, _, name = function.partition(":")
        try:
            from fieldgrid.core.errors import FieldgridError

            call = getattr(importlib.import_module(module), name)
            found = versions()
        except (ImportError, AttributeError) as error:
            what = f"has no fieldgrid that can do this ({error})"
            return "unable", (platform.node(), what)
        for library, needed in wanted.items():
            if found.get(library) != needed:
                what = f"has {library} {found.get(library)}, not {needed}"
                return "unable", (platform.node(), what)
        keep_freed_memory()
        try:
            return "done", call(data, *arguments)
        except FieldgridError as error:
            return "refused", error
        except (OSError, MemoryError):
            raise  # Dask tries again
        except Exception:  # noqa: BLE001 - the caller raises it
            return "defect", traceback.format_exc()

    return do
