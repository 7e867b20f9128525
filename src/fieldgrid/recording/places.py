"""Where the mounting of a recording is kept, whatever kind of recording it is."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.recording import euroc, folder, kitti
from fieldgrid.recording.mounting import MOUNTING


def mounting_place(recording: Path) -> Path:
    """The `mounting.json` that a recording is opened with, or where its own would be.

    Of a bag that is one file, a file beside it, which has its name unless another is there; in a
    plain folder beside the calibration; else in the folder.
    """
    if recording.is_file():
        shared = recording.with_name(MOUNTING)
        own = recording.with_name(f"{recording.stem}.{MOUNTING}")
        return shared if shared.exists() and not own.exists() else own
    if kitti.recognises(recording):
        return kitti.mounting_path(recording)
    if folder.recognises(recording):
        return recording / "calibration" / MOUNTING
    if euroc.recognises(recording):
        return euroc.mounting_path(recording)
    return recording / MOUNTING
