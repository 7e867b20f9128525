"""Shares of drives, staged side by side by other processes; their parts are kept here.

The processes are of this machine, or the workers of a Dask cluster. Both are executors of
`concurrent.futures` and run the same function.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import BrokenExecutor, Executor, Future
from importlib import import_module
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

from fieldgrid.core import Closing, ConfigError, RecordingError, await_workers, is_death, result_of
from fieldgrid.pipeline.staging.parts import Share
from fieldgrid.pipeline.staging.remote import RecordingPlace, StagedShare, stage_share

if TYPE_CHECKING:
    from distributed import Client

_ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL", "NUMBA", "VECLIB")
}
_TICK_S = 0.5


class ShareTask(NamedTuple):
    """A share of the drive of a number and a name."""

    drive: int
    name: str
    share: Share


ShareResult = tuple[ShareTask, StagedShare | Exception]
"""What became of a share: it is staged, or there is an error."""


class Processes:
    """`count` processes of this machine, which start at once.

    They are Pythons of their own, so that nothing of this program is copied by fork() and its main
    module is not run again.
    """

    def __init__(self, count: int) -> None:
        self.count = count

    def start(self) -> Executor:
        """Processes that import what they need before they have a share."""
        from loky import ProcessPoolExecutor  # late: few frames are staged in threads
        from loky.backend import get_context

        try:
            found: Executor = ProcessPoolExecutor(
                self.count,
                context=get_context("loky"),
                initializer=_begin,
                initargs=(os.getpid(),),
                env=_ONE_THREAD,
            )
            for _ in range(self.count):
                found.submit(import_module, stage_share.__module__)
        except OSError as error:
            raise ConfigError(
                f"The processes of the build cannot be started ({error}); give --jobs 1."
            ) from error
        return found

    def sent(self, work: bytes) -> bytes:
        """What a task takes for the work on a drive."""
        return work

    def take(self, future: Future[StagedShare]) -> StagedShare:
        """What became of a share."""
        return future.result()

    def end(self, executor: Executor) -> None:
        """End all processes, whatever they are at."""
        ending: Any = executor  # loky's executor has an argument more
        ending.shutdown(wait=True, kill_workers=True)


def _begin(build: int) -> None:
    """The life of a process begins: it ends with the build, which also says when to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # what a library prints is no result of the command

    def watch() -> None:
        while os.getppid() == build:
            time.sleep(_TICK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Workers:
    """The workers of a Dask cluster."""

    def __init__(self, client: Client) -> None:
        self._client, self.count = client, sum(client.nthreads().values())
        await_workers(client)

    def start(self) -> Executor:
        """The client as an executor."""
        found: Executor = self._client.get_executor(pure=False)
        return found

    def sent(self, work: bytes) -> Any:
        """A task that gives the work: sent to each worker once, and again when one dies."""
        return self._client.submit(bytes, work, pure=False)

    def take(self, future: Future[StagedShare]) -> StagedShare:
        """What became of a share; ClusterError where the cluster could not do it."""
        return result_of(future, self._client)

    def end(self, executor: Executor) -> None:
        """Take back all that is not done; what a worker is at it does to the end of the share."""
        if self._client.status == "running":
            executor.shutdown(wait=False)


class Staging(Closing):
    """Shares under way. Close it to end them.

    A share that a process died of may have done nothing: it is staged again when there is no other,
    by itself. Only a share whose process dies then, too, is given up.
    """

    def __init__(self, by: Processes | Workers) -> None:
        self._by = by
        self._executor = by.start()
        self._works: dict[int, tuple[Any, RecordingPlace | None]] = {}
        self._running: dict[Future[StagedShare], ShareTask] = {}
        self._suspects: deque[ShareTask] = deque()
        self._alone: ShareTask | None = None
        self._ended: SimpleQueue[Future[StagedShare]] = SimpleQueue()

    def add(
        self,
        drive: int,
        name: str,
        work: bytes,
        place: RecordingPlace | None,
        shares: Iterable[Share],
    ) -> None:
        """Stage these shares of a drive after those that were added before."""
        self._works[drive] = self._by.sent(work), place
        for share in shares:
            self._submit(ShareTask(drive, name, share))

    def drop(self, drive: int) -> None:
        """Stage no more shares of a drive."""
        for future, task in list(self._running.items()):
            if task.drive == drive:
                del self._running[future]
                future.cancel()
        self._suspects = deque(task for task in self._suspects if task.drive != drive)

    def next(self) -> ShareResult | None:
        """What has ended next; None where that is nothing for half a second."""
        if self._suspects and not self._running:
            self._alone = self._suspects.popleft()
            self._submit(self._alone)
        try:
            future = self._ended.get(timeout=_TICK_S)  # so that Ctrl-C is heard
        except Empty:
            return None
        under_way = list(self._running.values())
        task = self._running.pop(future, None)
        if task is None:
            return None  # it was dropped
        error = None if future.cancelled() else future.exception()
        if is_death(error):
            return self._died(task, under_way, isinstance(error, BrokenExecutor))
        try:
            return task, self._by.take(future)
        except Exception as told:  # noqa: BLE001 - the build raises it
            return task, told

    def _died(
        self, task: ShareTask, under_way: list[ShareTask], is_broken: bool
    ) -> ShareResult | None:
        """What is known of a task whose process has died. An executor that `is_broken` has ended
        all tasks; those that were handed out first were at work."""
        suspects = [task]
        if is_broken:
            suspects = under_way[: self._by.count]
            self._running.clear()
            self._by.end(self._executor)
            self._executor = self._by.start()
            for other in under_way[self._by.count :]:
                self._submit(other)
        if suspects == [self._alone]:
            return task, RecordingError(
                f"Frames {task.share.first} to {task.share.last - 1} of {task.name} have ended "
                "every process that staged them; leave the recording out, or give the processes "
                "more memory, as by fewer --jobs (with --jobs 1 there is only this process)."
            )
        self._suspects += suspects
        return None

    def close(self) -> None:
        """End all staging."""
        self._by.end(self._executor)

    def _submit(self, task: ShareTask) -> None:
        work, place = self._works[task.drive]
        try:
            future = self._executor.submit(stage_share, work, task.share, place)
        except BrokenExecutor as error:  # its processes have died, or cannot start
            future = Future()
            future.set_exception(error)
        self._running[future] = task
        future.add_done_callback(self._ended.put)
