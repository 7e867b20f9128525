"""Frames that kill the process of a build that stages them."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from fieldgrid.core import Int64
from fieldgrid.recordings import Drive, DriveOptions, Frame, FrameSource, open_drive


@dataclass(frozen=True)
class Killing:
    """The frames of a drive; before number `at` the process that takes them dies, `times` times in
    all, which `marks` counts. The process that made it survives."""

    source: FrameSource
    at: int
    times: int
    marks: Path
    survivor: int

    @property
    def times_ns(self) -> Int64:
        return self.source.times_ns

    @property
    def roles(self) -> tuple[str, ...]:
        return self.source.roles

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        for number, frame in enumerate(self.source.frames(start, stop), start):
            died = self.marks.stat().st_size if self.marks.exists() else 0
            if number == self.at and died < self.times and os.getpid() != self.survivor:
                with self.marks.open("a") as marks:
                    marks.write("x")
                os.kill(os.getpid(), signal.SIGKILL)
            yield frame


def opening(  # type: ignore[no-untyped-def]
    name: str, at: int, times: int, marks: Path
):
    """`open_drive`, but the drive of this name kills."""

    def opened(path: str | Path, options: DriveOptions | None) -> Drive:
        found = open_drive(path, options).recording()
        if found.name != name:
            return found
        return replace(found, source=Killing(found.source, at, times, marks, os.getpid()))

    return opened
