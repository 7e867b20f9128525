"""A recording that is a list of files and a list of fixes, both known when it opens."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np

from fieldgrid.array_types import Int64
from fieldgrid.errors import RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.motion import Motion
from fieldgrid.recording.files import check_regular
from fieldgrid.recording.images import AS_STORED, ImageFile, ImageFormat
from fieldgrid.recording.protocol import Frame, PairRectifier, StereoFrame, Stream
from fieldgrid.rig import Rig


class Shot(NamedTuple):
    """A frame on disk; the paths of its files are relative to the folder of the recording."""

    time_ns: int
    frame_id: str
    files: tuple[str, ...]


class FrameKind(Protocol):
    """What the files of a shot are, and the frame that they make."""

    @property
    def roles(self) -> tuple[str, ...]:
        """What each file of a shot is, of `options.ROLES`."""

    def frame(self, folder: Path, shot: Shot) -> Frame:
        """The frame, its files unread."""


@dataclass(frozen=True, slots=True)
class PairKind:
    """A left and a right image, for a calibration of `size_px`."""

    size_px: tuple[int, int]
    rectifier: PairRectifier | None = None
    image_format: ImageFormat = AS_STORED

    @property
    def roles(self) -> tuple[str, ...]:
        """The two sides."""
        return "left", "right"

    def frame(self, folder: Path, shot: Shot) -> Frame:
        """The pair, its images unread."""
        left, right = (ImageFile(folder / name, format=self.image_format) for name in shot.files)
        return StereoFrame(shot.frame_id, shot.time_ns, left, right, self.size_px, self.rectifier)


@dataclass(frozen=True, slots=True)
class StoredRecording:
    """A :class:`~fieldgrid.recording.protocol.Recording` of files.

    It holds a row of text a frame; images and clouds stay on disk. Nothing is held open.
    """

    name: str
    rig: Rig
    folder: Path
    shots: tuple[Shot, ...]
    kind: FrameKind
    fix_log: FixColumns
    gnss_source: str = ""
    datum_hint: Datum | None = None
    notes: tuple[str, ...] = ()
    own_motion: Motion = field(default_factory=Motion)
    losses: tuple[str, ...] = ()
    gnss_path: Path | None = None

    @property
    def frame_count(self) -> int:
        """How many frames there are."""
        return len(self.shots)

    def frame_times_ns(self) -> Int64:
        """Times of the frames, shape (frame_count,), increasing."""
        return np.array([shot.time_ns for shot in self.shots], dtype=np.int64)

    def frames(self) -> Iterator[Frame]:
        """The frames in order of time, unread."""
        return (self.kind.frame(self.folder, shot) for shot in self.shots)

    def fixes(self) -> FixColumns:
        """The fixes in the order of the log."""
        return self.fix_log

    def gnss_sha256(self) -> str:
        """The hash of the log of fixes where that is a file."""
        if self.gnss_path is None or not self.gnss_path.is_file():
            return ""
        with self.gnss_path.open("rb") as log:
            return hashlib.file_digest(log, "sha256").hexdigest()

    def motion(self) -> Motion:
        """What the drive knows of its own motion."""
        return self.own_motion

    def streams(self) -> Sequence[Stream]:
        """Images, fixes and motion, each with its times."""
        frames_ns = self.frame_times_ns()
        fixes_ns = self.fix_log.time_ns
        found = [
            Stream(role, "cloud" if role == "cloud" else "image", role, len(frames_ns), frames_ns)
            for role in self.kind.roles
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


def checked_shots(shots: list[Shot], folder: Path, what: str = "stereo pair") -> tuple[Shot, ...]:
    """The shots in order of time, once it is sure that they can be told apart and exist; `what`
    is what an error calls one of them."""
    if not shots:
        raise RecordingError(f"{folder} has no {what}; a recording needs at least one.")
    ordered = sorted(shots)
    for earlier, later in pairwise(ordered):
        if earlier.time_ns == later.time_ns:
            raise RecordingError(
                f"Frames {earlier.frame_id} and {later.frame_id} of {folder} have the same time "
                f"{later.time_ns} ns; correct the time stamps."
            )
    seen: set[str] = set()
    for shot in ordered:
        if shot.frame_id in seen:
            raise RecordingError(
                f"The frame_id {shot.frame_id!r} occurs twice in {folder}; give each frame its own."
            )
        seen.add(shot.frame_id)
    _check_files(ordered, folder, what)
    return tuple(ordered)


def _check_files(shots: list[Shot], folder: Path, what: str) -> None:
    missing = 0
    first: RecordingError | None = None
    for shot in shots:
        for name in shot.files:
            try:
                check_regular(folder / name)
            except RecordingError as problem:
                missing += 1
                first = first or problem
    if first is not None:
        files = "clouds" if what == "cloud" else "images"
        raise RecordingError(
            f"{missing} of {sum(len(shot.files) for shot in shots)} {files} are missing from "
            f"{folder}. First: {first}"
        ) from first
