"""Recordings: what was on the vehicle's disk after a drive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from fieldgrid.errors import RecordingError
from fieldgrid.recording import folder, kitti
from fieldgrid.recording.images import ImageFile
from fieldgrid.recording.protocol import Frame, Image, ImageSource, Recording

__all__ = ["Frame", "Image", "ImageFile", "ImageSource", "Recording", "open_recording"]


class _Backend(NamedTuple):
    looks_for: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, str | Path | None], Recording]


_BACKENDS = {
    "KITTI raw": _Backend(kitti.LOOKS_FOR, kitti.recognises, kitti.open_kitti),
    "plain folder": _Backend(folder.LOOKS_FOR, folder.recognises, folder.open_folder),
}


def open_recording(path: str | Path, gnss: str | Path | None = None) -> Recording:
    """The recording at a path, of whichever kind it is; use it as a context manager.

    `gnss` picks one of several GNSS logs by file name, or gives the path of another. What is
    wrong with a recording is a :class:`RecordingError` or a :class:`GnssError` that says so.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            what = "is a file" if path.exists() else "does not exist"
            raise RecordingError(f"{path} {what}; give the folder of a recording.")
        for backend in _BACKENDS.values():
            if backend.recognises(path):
                return backend.open(path, gnss)
    except OSError as problem:
        raise RecordingError(
            f"{problem.filename or path} cannot be read: {problem.strerror}; check its permissions."
        ) from problem
    kinds = "; ".join(f"{backend.looks_for} ({kind})" for kind, backend in _BACKENDS.items())
    raise RecordingError(f"{path} is no recording; looked for {kinds}.")
