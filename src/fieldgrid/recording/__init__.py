"""Recordings: what was on the vehicle's disk after a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from fieldgrid.errors import RecordingError
from fieldgrid.recording import folder, kitti
from fieldgrid.recording.columns import Columns, columns_from_text
from fieldgrid.recording.fix_log import FixLog
from fieldgrid.recording.images import ImageFile
from fieldgrid.recording.logs import read_fix_log
from fieldgrid.recording.mounting import Mounting
from fieldgrid.recording.options import ROLES, Options
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
    "is_recording",
    "open_log",
    "open_recording",
]


class _Backend(NamedTuple):
    looks_for: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Options], Recording]


_BACKENDS = {
    "KITTI raw": _Backend(kitti.LOOKS_FOR, kitti.recognises, kitti.open_kitti),
    "plain folder": _Backend(folder.LOOKS_FOR, folder.recognises, folder.open_folder),
}


def is_recording(path: str | Path) -> bool:
    """Whether a path is the folder of a recording, rather than a log or something else."""
    path = Path(path)
    return path.is_dir() and any(backend.recognises(path) for backend in _BACKENDS.values())


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
        if not path.is_dir():
            what = "is a file" if path.exists() else "does not exist"
            raise RecordingError(f"{path} {what}; give the folder of a recording.")
        for backend in _BACKENDS.values():
            if backend.recognises(path):
                return backend.open(path, options)
    except OSError as problem:
        raise _unreadable(problem, path) from problem
    kinds = "; ".join(f"{backend.looks_for} ({kind})" for kind, backend in _BACKENDS.items())
    raise RecordingError(f"{path} is no recording; looked for {kinds}.")


def _unreadable(problem: OSError, path: Path) -> RecordingError:
    return RecordingError(
        f"{problem.filename or path} cannot be read: {problem.strerror}; check its permissions."
    )
