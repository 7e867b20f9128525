"""KITTI raw: a synchronised drive with its grey or colour pair, oxts and calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError, quoted
from fieldgrid.recordings.calibration.kitti import HEIGHT_NOTE, read_kitti_rig
from fieldgrid.recordings.calibration.mounting import MOUNTING
from fieldgrid.recordings.drive import Drive, Recording, as_recording, with_frames
from fieldgrid.recordings.files import read_lines, read_text
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.readers.oxts import FIELDS, oxts_fixes, oxts_motion
from fieldgrid.recordings.stored import PairKind, StoredFrames, image_folders, paired_shots
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.times import TimeScale, UnreadableTimeError, to_utc_ns

_SIDES = (("image_00/data", "image_01/data"), ("image_02/data", "image_03/data"))
_MAX_OXTS_BYTES = 1 << 16


def open_kitti(path: Path, options: DriveOptions) -> Drive:
    """The drive at or below a path. Its fixes are always those of oxts."""
    drives = _drives(path)
    if len(drives) != 1:
        names = ", ".join(drive.name for drive in drives)
        raise RecordingError(f"{path} holds {len(drives)} KITTI drives: {names}; give one of them.")
    options.refuse_topics(path)
    options.refuse(f"{path} has its fixes in oxts, with their dates", "epoch_ns")
    if str(options.gnss) != "oxts":
        options.refuse(f"A KITTI drive has its fixes in oxts, and not in {options.gnss}", "gnss")
    options.refuse("The fixes of a KITTI drive are no table", "columns")
    folder = drives[0]
    files = sorted((folder / "oxts" / "data").glob("*.txt"))
    times_ns = _read_stamps(folder / "oxts")
    if len(times_ns) != len(files):
        raise RecordingError(
            f"{folder / 'oxts'} has {len(times_ns)} times in timestamps.txt for {len(files)} rows; "
            "unpack the drive again."
        )
    rows = np.array([_row(file) for file in files]).reshape(len(files), len(FIELDS))
    fixes, motion = oxts_fixes(times_ns, rows), oxts_motion(times_ns, rows)
    drive = Drive(
        path=path,
        name=folder.resolve().name,
        log=options.in_time(FixLog(fixes, motion=motion)),
        gnss_source="oxts",
        notes=("The heights of oxts are above mean sea level, not above the ellipsoid.",),
    )
    return with_frames(drive, lambda drive: _recording(drive, folder, options))


def _recording(drive: Drive, folder: Path, options: DriveOptions) -> Recording:
    folders = image_folders(folder, _SIDES)
    if folders is None:
        raise RecordingError(
            f"{folder} has neither image_00 and image_01 nor image_02 and image_03 with data; "
            "unpack the images of the drive."
        )
    rig = read_kitti_rig(folder, folders[0][6:8], folders[1][6:8])
    rig = replace(rig, image_time_offset_ns=options.offset_or(0))
    notes: tuple[str, ...] = (HEIGHT_NOTE,)
    if options.mounting is not None or (folder / MOUNTING).exists():
        mounting = options.find_mounting(folder / MOUNTING, folder)
        rig, notes = mounting.rig(rig.sensor, rig.image_time_offset_ns), ()
    times_ns = _read_stamps(folder / folders[0][:8]).tolist()
    shots = paired_shots(folder, folders, times_ns, incomplete=options.incomplete)
    kind = PairKind((rig.camera.width_px, rig.camera.height_px))
    return as_recording(drive, rig, StoredFrames(folder, shots, kind), notes)


def _drives(path: Path) -> list[Path]:
    """Drives at a path, right below it, or in a folder of a date below it."""
    candidates = [path, *sorted(path.glob("*_sync")), *sorted(path.glob("*/*_sync"))]
    return [p for p in candidates if (p / "oxts").is_dir() and any(p.glob("image_0[0-3]"))]


def _row(path: Path) -> Float64:
    words = read_text(path, _MAX_OXTS_BYTES).split()
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if values.size != len(FIELDS) or not np.isfinite(values).all():
        raise RecordingError(f"{path} is no row of {len(FIELDS)} finite numbers; copy it again.")
    return values


def _read_stamps(folder: Path) -> Int64:
    """The times of `timestamps.txt`, UTC nanoseconds."""
    path = folder / "timestamps.txt"
    lines = [line.strip() for _, line in read_lines(path) if line.strip()]
    try:
        return to_utc_ns(lines, TimeScale(), decimal_comma=False)
    except UnreadableTimeError as problem:
        raise RecordingError(
            f"{path}: {quoted(lines[problem.place])} is no time like 2011-09-30 "
            "12:08:26.399641520; copy it again."
        ) from None


FORMAT = Format(
    "KITTI raw",
    "one KITTI drive *_sync with image_00 .. image_03 and oxts",
    lambda path: bool(_drives(path)),
    open_kitti,
    lambda path: next(iter(_drives(path)), path) / MOUNTING,
)
