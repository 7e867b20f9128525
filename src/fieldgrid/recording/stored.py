"""A recording that is a list of image files and a list of fixes, both known when it opens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import Fix
from fieldgrid.motion import Motion
from fieldgrid.recording.files import check_regular
from fieldgrid.recording.images import ImageFile
from fieldgrid.recording.protocol import Frame, PairRectifier, StereoFrame, Stream
from fieldgrid.rig import Rig


class Pair(NamedTuple):
    """A frame on disk; the paths are relative to the folder of the recording."""

    time_ns: int
    frame_id: str
    left: str
    right: str


@dataclass(frozen=True, slots=True)
class StoredRecording:
    """A :class:`~fieldgrid.recording.protocol.Recording` of image files.

    It holds a row of text a frame; the images stay on disk. Nothing is held open.
    """

    name: str
    rig: Rig
    folder: Path
    pairs: tuple[Pair, ...]
    fix_log: tuple[Fix, ...]
    gnss_source: str = ""
    datum_hint: Datum | None = None
    notes: tuple[str, ...] = ()
    own_motion: Motion = field(default_factory=Motion)
    losses: tuple[str, ...] = ()
    rectifier: PairRectifier | None = None

    @property
    def frame_count(self) -> int:
        """How many frames there are."""
        return len(self.pairs)

    def frame_times_ns(self) -> npt.NDArray[np.int64]:
        """Times of the frames, shape (frame_count,), increasing."""
        return np.array([pair.time_ns for pair in self.pairs], dtype=np.int64)

    def frames(self) -> Iterator[Frame]:
        """The frames in order of time, images unread."""
        size_px = (self.rig.camera.width_px, self.rig.camera.height_px)
        for pair in self.pairs:
            left, right = (ImageFile(self.folder / name) for name in (pair.left, pair.right))
            yield StereoFrame(pair.frame_id, pair.time_ns, left, right, size_px, self.rectifier)

    def fixes(self) -> Sequence[Fix]:
        """The fixes in the order of the log."""
        return self.fix_log

    def motion(self) -> Motion:
        """What the drive knows of its own motion."""
        return self.own_motion

    def streams(self) -> Sequence[Stream]:
        """Images, fixes and motion, each with its times."""
        frames_ns = self.frame_times_ns()
        fixes_ns = np.array([fix.time_ns for fix in self.fix_log], dtype=np.int64)
        found = [
            Stream(side, "image", side, len(frames_ns), frames_ns) for side in ("left", "right")
        ]
        if self.gnss_source:
            found.append(Stream(self.gnss_source, "fixes", "fix", len(fixes_ns), fixes_ns))
        gyro, wheels, _ = self.own_motion
        if gyro is not None:
            found.append(Stream("gyro", "gyro", "gyro", len(gyro.time_ns), gyro.time_ns))
        if wheels is not None:
            found.append(Stream("wheels", "speed", "wheels", len(wheels.time_ns), wheels.time_ns))
        return found

    def close(self) -> None:
        """Nothing to release."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def checked_pairs(pairs: list[Pair], folder: Path) -> tuple[Pair, ...]:
    """The pairs in order of time, once it is sure that they can be told apart and exist."""
    if not pairs:
        raise RecordingError(f"{folder} has no stereo pair; a recording needs at least one.")
    ordered = sorted(pairs)
    for earlier, later in pairwise(ordered):
        if earlier.time_ns == later.time_ns:
            raise RecordingError(
                f"Frames {earlier.frame_id} and {later.frame_id} of {folder} have the same time "
                f"{later.time_ns} ns; correct the time stamps."
            )
    seen: set[str] = set()
    for pair in ordered:
        if pair.frame_id in seen:
            raise RecordingError(
                f"The frame_id {pair.frame_id!r} occurs twice in {folder}; give each frame its own."
            )
        seen.add(pair.frame_id)
    _check_files(ordered, folder)
    return tuple(ordered)


def _check_files(pairs: list[Pair], folder: Path) -> None:
    missing = 0
    first: RecordingError | None = None
    for pair in pairs:
        for name in (pair.left, pair.right):
            try:
                check_regular(folder / name)
            except RecordingError as problem:
                missing += 1
                first = first or problem
    if first is not None:
        raise RecordingError(
            f"{missing} of {2 * len(pairs)} images are missing from {folder}. First: {first}"
        ) from first
