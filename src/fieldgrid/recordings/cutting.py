"""A drive cut to a part of its time: fixes, motion, poses and frames alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fieldgrid.core import MIN_TIME_NS, Bool, Int64, RecordingError, utc_text
from fieldgrid.recordings.drive import Drive, Recording
from fieldgrid.recordings.frames.frames import Frame, FrameSource
from fieldgrid.recordings.stored import StoredFrames


@dataclass(frozen=True, slots=True)
class PartOfFrames:
    """Frames `first` to before `stop` of a source (a `FrameSource` itself)."""

    whole: FrameSource
    first: int
    stop: int

    @property
    def times_ns(self) -> Int64:
        """Times of the frames, increasing."""
        return self.whole.times_ns[self.first : self.stop]

    @property
    def roles(self) -> tuple[str, ...]:
        """What the parts of a frame are."""
        return self.whole.roles

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Some of the frames, unread."""
        return self.whole.frames(self.first + start, self.first + stop)


def cut(drive: Drive, from_ns: int | None, until_ns: int | None) -> Drive:
    """What was recorded from one time to before another, None for an end of the drive. They are
    UTC, or, before 1980, counted from the first fix (without fixes, the first pose or frame).

    Raises RecordingError where nothing is left.
    """
    poses = drive.motion().poses
    none = np.zeros(0, dtype=np.int64)
    frames_ns = drive.image_times_ns() if isinstance(drive, Recording) else none
    columns = [drive.fixes().time_ns, frames_ns if poses is None else poses.time_ns, frames_ns]
    spans = [(int(times.min()), int(times.max())) for times in columns if len(times)]
    if (from_ns is None and until_ns is None) or not spans:
        return drive
    begins_ns, ends_ns = spans[0]
    first_ns, last_ns = (
        end_ns if said_ns is None else said_ns + (begins_ns if said_ns < MIN_TIME_NS else 0)
        for said_ns, end_ns in ((from_ns, -(2**63)), (until_ns, 2**63 - 1))
    )

    def inside(time_ns: Int64) -> Bool:
        return np.asarray((time_ns >= first_ns) & (time_ns < last_ns))

    if not any(inside(times).any() for times in columns):
        raise RecordingError(
            f"Nothing is left of {drive.name}, which was recorded from {utc_text(begins_ns)} to "
            f"{utc_text(ends_ns)}; give other times with --from and --until."
        )
    fixes = drive.fixes()[inside(drive.fixes().time_ns)]
    motion = drive.motion().between(first_ns, last_ns)
    part = replace(drive, log=drive.log._replace(fixes=fixes, motion=motion))
    if isinstance(part, Recording):
        kept = np.flatnonzero(inside(frames_ns))
        first, stop = (int(kept[0]), int(kept[-1]) + 1) if len(kept) else (0, 0)
        if isinstance(part.source, StoredFrames):
            part = replace(part, source=replace(part.source, shots=part.source.shots[first:stop]))
        else:
            part = replace(part, source=PartOfFrames(part.source, first, stop))
    return part
