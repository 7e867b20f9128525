"""A drive without images: the folder of a recording that has `gnss/`, and perhaps `imu/`."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fieldgrid.fixes import FixColumns
from fieldgrid.motion import Motion
from fieldgrid.recording.calibration import read_calibration
from fieldgrid.recording.columns import Columns
from fieldgrid.recording.logs import find_log, passed_over, read_fix_log
from fieldgrid.recording.motion_files import AXES, read_motion
from fieldgrid.recording.mounting import MOUNTING, Mounting, read_mounting
from fieldgrid.recording.protocol import Stream
from fieldgrid.rig import Rig

LOOKS_FOR = "gnss/"


class BareDrive(NamedTuple):
    """What a drive without images holds; `rig` is None where nothing says what carried it.

    `streams` are everything that was recorded, used or not, where that is more than the fixes and
    the motion.
    """

    fixes: FixColumns
    motion: Motion
    rig: Rig | None
    gnss_source: str
    notes: tuple[str, ...]
    streams: tuple[Stream, ...] = ()


def recognises(path: Path) -> bool:
    """Whether a folder holds at least the GNSS logs of a drive."""
    return (path / "gnss").is_dir()


def open_bare(
    path: Path, gnss: str | Path | None = None, columns: Columns | None = None
) -> BareDrive:
    """The fixes and the motion in a folder; `gnss` picks one of several logs."""
    log_path = find_log(path, gnss)
    mounting = _mounting(path / "calibration")
    moved = read_motion(path, AXES if mounting is None else mounting.imu_axes)
    rig = None if mounting is None else mounting.rig(read_calibration(path / "calibration").camera)
    if log_path is None:
        return BareDrive(
            FixColumns.of([]), moved.motion, rig, "", (passed_over(path), *moved.notes)
        )
    log = read_fix_log(log_path, columns)
    motion = moved.motion._replace(
        gyro=moved.motion.gyro or log.motion.gyro, wheels=moved.motion.wheels or log.motion.wheels
    )
    return BareDrive(log.fixes, motion, rig, log_path.name, log.notes + moved.notes)


def _mounting(folder: Path) -> Mounting | None:
    if not folder.is_dir():
        return None
    return read_mounting(folder / MOUNTING)
