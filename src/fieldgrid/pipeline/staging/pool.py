"""Processes that stage shares of drives side by side.

Each is a Python of its own that runs `worker`: nothing of this program is copied by fork(),
and its main module is not run again. A thread here gives it shares and takes its answers; when it
dies, the share is given to another.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

from fieldgrid.core import Closing, ConfigError, FieldgridError, RecordingError
from fieldgrid.pipeline.staging.executor import (
    DriveFailure,
    DriveOrder,
    Event,
    ShareResult,
    StagingProgress,
)
from fieldgrid.pipeline.staging.parts import Share
from fieldgrid.pipeline.staging.worker import Answer, ShareOrder, not_importable

DEATHS = 3
"""Number of processes that have died of a share when it is given up, and its drive with it."""

_BOOT = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from fieldgrid.pipeline.staging.worker import main; main()"
)
_ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL", "NUMBA", "VECLIB")
}


_DriveShare = tuple[int, Share]
"""The number of a drive, and a share of it."""


class Pool(Closing):
    """`count` processes (a `Executor`). They start at once; one
    that dies is followed by another when there is a share for it."""

    def __init__(self, count: int, out: Path) -> None:
        self.events: SimpleQueue[Event] = SimpleQueue()
        self._out = out
        self._drives: dict[int, tuple[DriveOrder, bytes]] = {}
        self._tasks: deque[_DriveShare] = deque()
        self._deaths: Counter[_DriveShare] = Counter()
        self._changed = threading.Condition()
        self._closed = False
        self._running: set[subprocess.Popen[bytes]] = set()
        self._threads = [
            threading.Thread(target=self._serve, name="fieldgrid-worker", daemon=True)
            for _ in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def add(self, order: DriveOrder) -> None:
        """Stage these shares of a drive, after those that were added before."""
        try:
            packed = pickle.dumps(order.work)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            raise not_importable(error) from error
        with self._changed:
            self._drives[order.drive] = order, packed
            self._tasks += [(order.drive, share) for share in order.shares]
            self._changed.notify_all()

    def drop(self, drive: int) -> None:
        """Stage no more shares of a drive."""
        with self._changed:
            self._tasks = deque(task for task in self._tasks if task[0] != drive)

    def close(self) -> None:
        """End all processes, whatever they are at."""
        with self._changed:
            self._closed = True
            for process in self._running:
                process.kill()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _next(self) -> _DriveShare | None:
        with self._changed:
            self._changed.wait_for(lambda: self._tasks or self._closed)
            return None if self._closed else self._tasks.popleft()

    def _serve(self) -> None:
        """The life of a thread: a process, or one after the other, and its shares."""
        process: subprocess.Popen[bytes] | None = None
        known = -1
        with suppress(Exception):  # the first share tries again, and tells why not
            process = self._start()
        while (task := self._next()) is not None:
            try:
                if process is None:
                    process, known = self._start(), -1
                self._do(process, task, known)
                known = task[0]
            except (OSError, EOFError, pickle.UnpicklingError) as error:
                status = None if process is None else self._end(process)
                process = None
                self._died(task, status, error)
            except Exception as error:  # noqa: BLE001 - the build raises it, and does not wait on
                if process is not None:
                    self._end(process)
                process = None
                self.events.put(DriveFailure(task[0], error))
        if process is not None:
            self._end(process)

    def _start(self) -> subprocess.Popen[bytes]:
        with self._changed:
            if self._closed:
                raise EOFError
            process = subprocess.Popen(
                [sys.executable, "-c", _BOOT],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, **_ONE_THREAD},
                # Ctrl-C is for the build, which ends its processes.
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )
            self._running.add(process)
        assert process.stdin is not None
        try:
            pickle.dump(sys.path, process.stdin)
            process.stdin.flush()  # so that it imports before its first order
        except OSError:
            self._end(process)
            raise
        return process

    def _end(self, process: subprocess.Popen[bytes]) -> int:
        """End a process, unless it has ended; returns its exit status."""
        with self._changed:
            self._running.discard(process)
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError):  # it is gone, and did not read what it was sent
            process.stdin.close()
        process.stdout.close()
        return process.wait()

    def _do(self, process: subprocess.Popen[bytes], task: _DriveShare, known: int) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        drive, share = task
        order, work = self._drives[drive]
        sent = b"" if known == drive else work
        pickle.dump(ShareOrder(drive, sent, share, order.folder, self._out), process.stdin)
        process.stdin.flush()
        frames, moved_m = 0, 0.0
        try:
            while True:
                answer: Answer = pickle.load(process.stdout)
                if not isinstance(answer, float):
                    self.events.put(
                        ShareResult(drive, share) if answer is None else DriveFailure(drive, answer)
                    )
                    return
                frames, moved_m = frames + 1, moved_m + answer
                self.events.put(StagingProgress(drive, answer, time.perf_counter()))
        except (OSError, EOFError, pickle.UnpicklingError):
            if frames:
                self.events.put(StagingProgress(drive, -moved_m, time.perf_counter(), -frames))
            raise

    def _died(self, task: _DriveShare, status: int | None, error: Exception) -> None:
        """Give a share to another process, unless too many have died of it."""
        with self._changed:
            if self._closed:
                return
            self._deaths[task] += 1
            if self._deaths[task] < DEATHS and status is not None:
                self._tasks.appendleft(task)
                self._changed.notify_all()
                return
        drive, share = task
        problem: FieldgridError
        if status is None:
            problem = ConfigError(
                f"The processes of the build cannot be started ({error}); give --jobs 1."
            )
        else:
            how = f"signal {-status}" if status < 0 else f"exit status {status}"
            problem = RecordingError(
                f"Frames {share.first} to {share.last - 1} of {self._drives[drive][0].name} have "
                f"ended {DEATHS} processes of the build ({how}); leave the recording out, or give "
                "fewer --jobs if the memory was full."
            )
        self.events.put(DriveFailure(drive, problem))
