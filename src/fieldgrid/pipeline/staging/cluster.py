"""Shares of drives, staged by the workers of a Dask cluster; their parts are kept here."""

from __future__ import annotations

import threading
import time
from queue import SimpleQueue
from typing import TYPE_CHECKING

from fieldgrid.core import (
    Closing,
    Cluster,
    FieldgridError,
    RecordingError,
    Task,
    TaskResult,
    WorkersDied,
)
from fieldgrid.pipeline.staging.executor import (
    DriveFailure,
    DriveOrder,
    Event,
    ShareResult,
    StagingProgress,
)
from fieldgrid.pipeline.staging.parts import Share, keep_part
from fieldgrid.pipeline.staging.remote import StagedShare, packed, place_of

if TYPE_CHECKING:
    from distributed import Client


class Stagers(Closing):
    """The workers of a Dask cluster (a `Executor`). The drive of
    a share that ends them is left out."""

    def __init__(self, client: Client) -> None:
        self.events: SimpleQueue[Event] = SimpleQueue()
        self._lock = threading.Lock()
        self._drives: dict[int, DriveOrder] = {}
        self._cluster = Cluster(
            client, "fieldgrid.pipeline.staging.remote:stage_share", self._take, self._fail
        )

    def add(self, order: DriveOrder) -> None:
        """Stage these shares of a drive, after those that were added before."""
        place = tuple(place_of(order.recording))
        with self._lock:
            self._drives[order.drive] = order
        self._cluster.begin(order.drive, packed(order.work))
        self._cluster.add(
            [Task(order.drive, share.name, (tuple(share), place)) for share in order.shares]
        )

    def drop(self, drive: int) -> None:
        """Stage no more shares of a drive."""
        self._cluster.drop(drive)

    def close(self) -> None:
        """Take back all that is not done; what a worker is at it does to the end of the share."""
        self._cluster.close()

    def _take(self, ended: TaskResult) -> None:
        """What became of a share."""
        number, share = ended.task.group, Share(*ended.task.arguments[0])
        with self._lock:
            drive = self._drives[number]
        if isinstance(ended.error, WorkersDied):
            problem = RecordingError(
                f"Frames {share.first} to {share.last - 1} of {drive.name} have ended every Dask "
                "worker that staged them; leave the recording out, or give the workers more memory."
            )
            self._fail(number, problem)
        elif ended.error is not None:
            self._fail(number, ended.error)
        else:
            made: StagedShare = ended.value
            try:
                keep_part(drive.folder, share, made.part)
            except FieldgridError as error:
                self._fail(number, error)
                return
            at_s = time.perf_counter() - made.took_s
            self.events.put(StagingProgress(number, made.moved_m, at_s, share.last - share.first))
            self.events.put(ShareResult(number, share))

    def _fail(self, number: int, error: BaseException) -> None:
        self.events.put(DriveFailure(number, error))
