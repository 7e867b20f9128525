"""Recordings: what was on the vehicle's disk after a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.errors import CalibrationError, RecordingError
from fieldgrid.recording import bag, euroc, folder, kitti, kitti_odometry
from fieldgrid.recording.columns import Columns, columns_from_text
from fieldgrid.recording.fix_log import FixLog
from fieldgrid.recording.images import ImageFile
from fieldgrid.recording.logs import read_fix_log
from fieldgrid.recording.mounting import Mounting
from fieldgrid.recording.options import ROLES, Options
from fieldgrid.recording.places import mounting_place
from fieldgrid.recording.protocol import (
    CloudFrame,
    CloudSource,
    DepthFrame,
    DepthSource,
    Frame,
    Image,
    ImageSource,
    Recording,
    Source,
    StereoFrame,
    Stream,
)
from fieldgrid.rig import LeverArm, Mount

__all__ = [
    "ROLES",
    "CloudFrame",
    "CloudSource",
    "Columns",
    "DepthFrame",
    "DepthSource",
    "FixLog",
    "Frame",
    "Image",
    "ImageFile",
    "ImageSource",
    "Mounting",
    "Options",
    "Recording",
    "Source",
    "StereoFrame",
    "Stream",
    "columns_from_text",
    "is_bag",
    "is_recording",
    "kind_of",
    "open_log",
    "open_recording",
    "open_unmounted",
]


_NO_MOUNTING = Mounting(Mount(1.0, 0.0), LeverArm(0.0, 0.0, 0.0), source="no mounting")


class _Backend(NamedTuple):
    looks_for: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Options], Recording]


_BAG = _Backend(bag.LOOKS_FOR, bag.recognises, bag.open_recorded)
_BACKENDS = {
    "KITTI raw": _Backend(kitti.LOOKS_FOR, kitti.recognises, kitti.open_kitti),
    "KITTI odometry": _Backend(
        kitti_odometry.LOOKS_FOR, kitti_odometry.recognises, kitti_odometry.open_sequence
    ),
    "EuRoC": _Backend(euroc.LOOKS_FOR, euroc.recognises, euroc.open_euroc),
    "plain folder": _Backend(folder.LOOKS_FOR, folder.recognises, folder.open_folder),
    "ROS bag": _BAG,
}


def is_recording(path: str | Path) -> bool:
    """Whether a path is a recording, a bag included, rather than a log or something else."""
    return _backend(Path(path)) is not None


def is_bag(path: str | Path) -> bool:
    """Whether a path is a recording in a ROS bag, and none of another kind."""
    return _backend(Path(path)) is _BAG


def kind_of(path: str | Path) -> str:
    """What kind of recording a path is, in words; empty when it is none that is known."""
    backend = _backend(Path(path))
    return next((kind for kind, one in _BACKENDS.items() if one is backend), "")


def _backend(path: Path) -> _Backend | None:
    return next((one for one in _BACKENDS.values() if one.recognises(path)), None)


def open_log(path: str | Path, columns: Columns | None = None) -> FixLog:
    """A GNSS log alone: its fixes, the motion that it also holds, and remarks.

    NMEA, UBX, a table whose names are guessed where `columns` says nothing, or an ISO 11783-10
    time log. What is wrong is a :class:`RecordingError` or a :class:`GnssError` that says so.
    """
    path = Path(path)
    try:
        return read_fix_log(path, columns)
    except OSError as problem:
        raise _unreadable(problem, path) from problem


def open_recording(
    path: str | Path,
    gnss: str | Path | None = None,
    columns: Columns | None = None,
    *,
    topics: Mapping[str, str] | None = None,
    mounting: str | Path | Mounting | None = None,
    image_time_offset_ns: int | None = None,
) -> Recording:
    """The recording at a path, of whichever kind it is; use it as a context manager.

    The rest is what :class:`Options` says. What is wrong with a recording is a
    :class:`RecordingError` or a :class:`GnssError` that says so.
    """
    path = Path(path)
    own = mounting if isinstance(mounting, Mounting | None) else Path(mounting)
    options = Options(gnss, columns, topics or {}, own, image_time_offset_ns)
    try:
        if not path.exists():
            raise RecordingError(f"{path} does not exist; give the folder of a recording or a bag.")
        backend = _backend(path)
        if backend is not None:
            return backend.open(path, options)
        if path.is_file():
            raise RecordingError(f"{path} is a file, and no bag; give the folder of a recording.")
    except OSError as problem:
        raise _unreadable(problem, path) from problem
    kinds = "; ".join(f"{backend.looks_for} ({kind})" for kind, backend in _BACKENDS.items())
    raise RecordingError(
        f"{path} is no recording; looked for {kinds}; give the folder of one of these, or a bag."
    )


def open_unmounted(path: Path, **opening: Any) -> tuple[Recording, bool]:
    """A recording that need not say how its sensor is mounted, and whether it does.

    Where it does not, its rig has a mount that stands for none. `opening` as of
    :func:`open_recording`.
    """
    try:
        return open_recording(path, **opening), True
    except CalibrationError:
        if opening.get("mounting") is not None or mounting_place(path).exists():
            raise
        # Any mounting will do; if there is another fault, this raises it.
        return open_recording(path, **{**opening, "mounting": _NO_MOUNTING}), False


def _unreadable(problem: OSError, path: Path) -> RecordingError:
    return RecordingError(
        f"{problem.filename or path} cannot be read: {problem.strerror}; check its permissions."
    )
