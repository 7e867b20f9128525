"""Frames that are a list of files, known when a recording opens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from fieldgrid.core import Int64, RecordingError, quoted
from fieldgrid.recordings.files import check_regular
from fieldgrid.recordings.frames.frames import Frame, PairRectifier, StereoFrame
from fieldgrid.recordings.frames.images import AS_STORED, SUFFIXES, ImageFile, ImageFormat


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
class StoredFrames:
    """Frames that are files (a `FrameSource`): a row of text
    each; images and clouds stay on disk, and nothing is held open."""

    folder: Path
    shots: tuple[Shot, ...]
    kind: FrameKind

    @property
    def times_ns(self) -> Int64:
        """Times of the frames, increasing."""
        return np.array([shot.time_ns for shot in self.shots], dtype=np.int64)

    @property
    def roles(self) -> tuple[str, ...]:
        """What the files of a frame are."""
        return self.kind.roles

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Some of the frames, unread."""
        return (self.kind.frame(self.folder, shot) for shot in self.shots[start:stop])


_MOST_MISSING = 1000
"""Most missing files that are counted: beyond this number, all may be missing."""


def checked_shots(
    shots: list[Shot], folder: Path, what: str = "stereo pair", *, incomplete: bool = False
) -> tuple[Shot, ...]:
    """The shots in order of time, once it is sure that they can be told apart and, unless they may
    be `incomplete`, exist; `what` is what an error calls one of them."""
    if not shots:
        raise RecordingError(f"{folder} has no {what}; a recording needs at least one.")
    ordered = sorted(shots)
    for earlier, later in pairwise(ordered):
        if earlier.time_ns == later.time_ns:
            raise RecordingError(
                f"Frames {earlier.frame_id} and {later.frame_id} of {folder} have the same time "
                f"{later.time_ns} ns; correct the time stamps."
            )
    ((frame_id, count),) = Counter(shot.frame_id for shot in ordered).most_common(1)
    if count > 1:
        raise RecordingError(
            f"The frame_id {quoted(frame_id)} occurs twice in {folder}; give each frame its own."
        )
    if not incomplete:
        names = [name for shot in ordered for name in shot.files]
        missing, first = 0, None
        for name in names:
            try:
                check_regular(folder / name)
            except RecordingError as problem:
                missing, first = missing + 1, first or problem
                if missing == _MOST_MISSING:
                    break
        if first is not None:
            files = "clouds" if what == "cloud" else "images"
            or_more = " or more" if missing == _MOST_MISSING else ""
            raise RecordingError(
                f"{missing}{or_more} of {len(names)} {files} are missing from {folder}; copy them, "
                f"or let `build --skip-bad` leave their frames out. First: {first}"
            ) from first
    return tuple(ordered)


def image_folders(path: Path, sides: Iterable[tuple[str, str]]) -> tuple[str, str] | None:
    """The first of some pairs of folders that are both there."""
    return next((pair for pair in sides if all((path / name).is_dir() for name in pair)), None)


def paired_shots(
    path: Path, folders: tuple[str, str], times_ns: Sequence[int], *, incomplete: bool = False
) -> tuple[Shot, ...]:
    """A frame for each time, of images that have the same names in both folders."""
    left, right = (
        {file.name for file in (path / name).iterdir() if file.suffix.lower() in SUFFIXES}
        for name in folders
    )
    alone = sorted(left ^ right)
    if alone and not incomplete:
        raise RecordingError(
            f"{path}: {folders[0]} and {folders[1]} do not hold the same files, {alone[0]} is only "
            "in one; unpack the drive again."
        )
    names = sorted(left | right)
    if len(names) != len(times_ns):
        raise RecordingError(
            f"{path} has {len(times_ns)} times for {len(names)} images; unpack the drive again."
        )
    shots = [
        Shot(time_ns, Path(name).stem, (f"{folders[0]}/{name}", f"{folders[1]}/{name}"))
        for time_ns, name in zip(times_ns, names, strict=True)
    ]
    return checked_shots(shots, path, incomplete=incomplete)
