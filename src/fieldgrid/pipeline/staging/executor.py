"""Who stages shares of drives for a build, and what they tell it.

`pool` does it in processes of this machine, `cluster` in those of a Dask cluster.
"""

from __future__ import annotations

from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple, Protocol

from fieldgrid.pipeline.staging.parts import Share
from fieldgrid.pipeline.staging.shares import DriveWork


class StagingProgress(NamedTuple):
    """Frames of a drive are staged; at `at_s`, on `time.perf_counter`, it was in work. Both numbers
    are negative where a process died: frames that were done are to be done again."""

    drive: int
    moved_m: float
    at_s: float
    frames: int = 1


class ShareResult(NamedTuple):
    """A share of a drive is staged, and its part written."""

    drive: int
    share: Share


class DriveFailure(NamedTuple):
    """A drive cannot be staged."""

    drive: int
    error: BaseException


Event = StagingProgress | ShareResult | DriveFailure


class DriveOrder(NamedTuple):
    """A drive of which these shares are to be staged, their parts to be written to a folder.

    `recording` is where the recording lies, as it was given.
    """

    drive: int
    name: str
    recording: Path
    work: DriveWork
    folder: Path
    shares: list[Share]


class Executor(Protocol):
    """Stages what it is given, in that order, and tells of it by `events`."""

    events: SimpleQueue[Event]

    def add(self, order: DriveOrder) -> None:
        """Stage these shares of a drive, after those that were added before."""

    def drop(self, drive: int) -> None:
        """Stage no more shares of a drive."""

    def close(self) -> None:
        """End all staging; another time does nothing."""
