"""The staged frames of the drives of a build, beside the map, for a build that is to go on after it
was ended.

The journal of a drive (`kept_frames`) is called by the key of its start, so frames are found again
only by a build that would make the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import ConfigError, FieldgridError, MapError, RecordingError, holding
from fieldgrid.pipeline.report import Progress
from fieldgrid.pipeline.staging.drive_start import DriveStart
from fieldgrid.pipeline.staging.journal import read_journal
from fieldgrid.pipeline.staging.kept_frames import (
    BAD,
    BEGIN,
    FRAME,
    KeptDrive,
    Store,
    drop_journal,
    work_folder,
)
from fieldgrid.pipeline.staging.shares import DriveWork, FrameOutcome, moved_m, stage_frames

SHARE_FRAMES = 16
"""Frames that a process stages at a time. The frame before them is looked at twice, and what an end
of the build costs is a share for each process."""

_YOUNG_S = 60.0


WAYS = "Repeat the command that made it, or remove that file."
"""What to do with the staged frames of another drive."""


class Share(NamedTuple):
    """Frames number `first` to before `last` of those that are taken of a drive."""

    first: int
    last: int


def left_behind(out: Path) -> dict[Path, DriveStart | None]:
    """The drives of which a build of `out` that has ended left staged frames, by their journals,
    None where it cannot be read what they are; not those of a build that still runs. The journals
    of builds that were killed before their first frame go."""
    found = dict[Path, DriveStart | None]()
    for path in sorted(work_folder(out).glob("*.build")):
        try:
            # A build that begins at this moment does not hold its journal yet.
            is_old = time.time() - path.stat().st_mtime > _YOUNG_S
            with holding(path) as is_free:
                records = read_journal(path) if is_free else iter(())
                kinds = {record.kind: record for record in records}
                if FRAME in kinds or BAD in kinds:
                    found[path] = DriveStart.from_json(kinds[BEGIN].value)
                elif is_free and is_old:
                    drop_journal(path)
        except (OSError, FieldgridError, LookupError, ValueError, TypeError):
            found[path] = None
    return found


def settle_left_behind(out: Path, resume: bool | None) -> None:
    """Refuse to build where an earlier build has left staged frames, unless told what to do."""
    left = left_behind(out)
    if left and resume is None:
        names = ", ".join([start.name if start else "a drive" for start in left.values()][:3])
        raise ConfigError(
            f"{work_folder(out)} holds staged frames of a build that was ended "
            f"({names}{', ...' if len(left) > 3 else ''}); give "
            "--resume with the command that it was to go on, or --no-resume to remove them."
        )
    for path in left if resume is False else ():
        drop_journal(path)


class DriveParts(Store[KeptDrive]):
    """The staged frames of a drive: those that are there already, and those to be made."""

    def __init__(
        self,
        out: Path,
        start: DriveStart,
        work: DriveWork,
        skip_bad: int | float,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        """Those that are made by some `work`; at most `skip_bad` may be bad, a number or, below 1,
        a share of the frames. `progress` is called after each."""
        self.start, self._work, self._written_s = start, work, 0.0
        self._skip_bad, self._progress = skip_bad, progress
        super().__init__(out, f"{start.key}.build", KeptDrive)
        self.begin(start, WAYS)
        self._bad, frames = self.drive.bad, self.drive.frames
        self._moved_m = sum(moved_m(frame.found) for frame in frames)
        self.done = {frame.number for frame in frames} | self._bad.keys()
        """The numbers of the frames that are staged or known to be bad. A frame that is damaged is
        made again."""
        # Without a frame, it is gone when it is let go.
        self._open.callback(lambda: None if self.done else drop_journal(self.path))

    def add(self, number: int, looked: FrameOutcome) -> None:
        """Keep what became of a frame. RecordingError where too many are bad, MapWriteError on a
        full disk."""
        start = time.thread_time()
        if looked.bad is not None:
            self.keep_bad(number, looked.bad)
            self._bad[number] = looked.bad
        else:
            assert looked.staged is not None
            self.keep(number, looked.staged, looked.found, looked.times)
        self.done.add(number)
        self._moved_m += moved_m(looked.found)
        self._written_s += time.thread_time() - start
        self._check_bad()
        self.tell()

    def tell(self) -> None:
        """Tell how far the drive is."""
        if self._progress is not None:
            way_m = self._moved_m if self._work.odometry else None
            self._progress(Progress(self.start.name, len(self.done), self._work.total, way_m))

    def stage(self, jobs: int) -> None:
        """Stage what is missing in threads of this process, `jobs` frames at a time."""
        for first, last in list(self.missing(self._work.total)):
            with closing(stage_frames(self._work, first, last, jobs)) as looks:
                for number, looked in enumerate(looks, first):
                    self.add(number, looked)

    def _check_bad(self) -> None:
        """Raise RecordingError when more frames are bad than may be."""
        most, count = self._skip_bad, self._work.total
        most = int(most * count) if isinstance(most, float) else most
        if len(self._bad) > most:
            raise RecordingError(
                f"{len(self._bad)} of {count} frames of {self.start.name} cannot be read, "
                f"and --skip-bad allows {most}; allow more, or copy the recording again. "
                f"First: {self._bad[min(self._bad)].reason}"
            )

    def missing(self, most: int = 0) -> Iterator[Share]:
        """The frames that are not staged yet, at most so many together, those of a share if 0."""
        first, most, count = 0, most or SHARE_FRAMES, self._work.total
        while first < count:
            last = first
            while last < min(first + most, count) and last not in self.done:
                last += 1
            if last > first:
                yield Share(first, last)
            first = max(last, first + 1)

    def staged(self) -> KeptDrive:
        """The whole drive, once no frame is missing. RecordingError where too many are bad."""
        self._check_bad()
        found = self.read()
        found.times.map_s += self._written_s
        if len(found.frames) + len(found.bad) < self._work.total:
            raise MapError(f"The staged frames in {self.path} cannot be read back; check the disk.")
        return found

    def remove(self) -> None:
        """Remove the frames of a drive that is given up."""
        self.done.clear()
        super().remove()
