"""KITTI raw: a synchronised drive with its grey or colour pair, oxts and calibration."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fieldgrid.core import RecordingError
from fieldgrid.recordings.calibration.mounting import MOUNTING
from fieldgrid.recordings.drive import Drive, Recording, as_recording, with_frames
from fieldgrid.recordings.files import read_lines, read_text
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.readers.kitti_calibration import (
    CAMERA_HEIGHT_M,
    floats,
    read_kitti_rig,
)
from fieldgrid.recordings.readers.oxts import FIELDS, oxts_fixes, oxts_motion
from fieldgrid.recordings.stored import PairKind, Shot, StoredFrames, checked_shots
from fieldgrid.recordings.tables.fix_log import FixLog

_MAX_OXTS_BYTES = 1 << 16


def open_kitti(path: Path, options: DriveOptions) -> Drive:
    """The drive at or below a path. Its fixes are always those of oxts."""
    drives = _drives(path)
    if len(drives) != 1:
        names = ", ".join(drive.name for drive in drives)
        raise RecordingError(f"{path} holds {len(drives)} KITTI drives: {names}; give one of them.")
    options.refuse_of_bags(path)
    if str(options.gnss) != "oxts":
        options.refuse(f"A KITTI drive has its fixes in oxts, and not in {options.gnss}", "gnss")
    options.refuse("The fixes of a KITTI drive are no table", "columns")
    folder = drives[0]
    files = _listing(folder / "oxts")
    stamps_ns = _read_stamps(folder / "oxts", len(files), "rows of oxts")
    numbers = [_row(folder / "oxts" / "data" / name) for name in files]
    times_ns = np.array(stamps_ns, dtype=np.int64)
    rows = np.array(numbers).reshape(len(files), len(FIELDS))
    drive = Drive(
        path=path,
        name=folder.resolve().name,
        log=options.in_time(FixLog(oxts_fixes(times_ns, rows), motion=oxts_motion(times_ns, rows))),
        gnss_source="oxts",
        notes=("The heights of oxts are above mean sea level, not above the ellipsoid.",),
    )
    return with_frames(drive, lambda drive: _recording(drive, folder, options))


def _recording(drive: Drive, folder: Path, options: DriveOptions) -> Recording:
    left, right = _cameras(folder)
    rig, offset_ns = read_kitti_rig(folder, left, right), options.offset_or(0)
    if options.mounting is None and not (folder / MOUNTING).exists():
        rig = replace(rig, image_time_offset_ns=offset_ns)
    else:
        rig = options.find_mounting(folder / MOUNTING, folder).rig(rig.sensor, offset_ns)
    names_left, names_right = (_listing(folder / f"image_{side}") for side in (left, right))
    different = sorted(set(names_left) ^ set(names_right))
    if different and not options.incomplete:
        raise RecordingError(
            f"{folder}: image_{left} and image_{right} do not hold the same files, "
            f"{different[0]} is only in one; unpack the drive again."
        )
    names = sorted({*names_left, *names_right})
    times_ns = _read_stamps(folder / f"image_{left}", len(names), "images")
    listed = [
        Shot(time_ns, Path(name).stem, (f"image_{left}/data/{name}", f"image_{right}/data/{name}"))
        for time_ns, name in zip(times_ns, names, strict=True)
    ]
    shots = checked_shots(listed, folder, incomplete=options.incomplete)
    kind = PairKind((rig.camera.width_px, rig.camera.height_px))
    note = (
        f"The camera height of {CAMERA_HEIGHT_M} m is KITTI's published value; "
        "no file of the drive gives it."
    )
    notes = (note,) if rig.mount.height_m == CAMERA_HEIGHT_M else ()
    return as_recording(drive, rig, StoredFrames(folder, shots, kind), notes)


def _drives(path: Path) -> list[Path]:
    """Drives at a path, right below it, or in a folder of a date below it."""
    candidates = [path, *sorted(path.glob("*_sync")), *sorted(path.glob("*/*_sync"))]
    return [p for p in candidates if (p / "oxts").is_dir() and any(p.glob("image_0[0-3]"))]


def _cameras(drive: Path) -> tuple[str, str]:
    """Two-digit numbers of the left and right camera: the grey pair, else the colour pair."""
    for left, right in (("00", "01"), ("02", "03")):
        if all((drive / f"image_{number}" / "data").is_dir() for number in (left, right)):
            return left, right
    raise RecordingError(
        f"{drive} has neither image_00 and image_01 nor image_02 and image_03 with data; "
        "unpack the images of the drive."
    )


def _row(path: Path) -> list[float]:
    values = floats(read_text(path, _MAX_OXTS_BYTES), path)
    if len(values) != len(FIELDS) or not all(math.isfinite(v) for v in values):
        raise RecordingError(
            f"{path} has {len(values)} numbers, not {len(FIELDS)} finite ones; copy it again."
        )
    return values


def _listing(folder: Path) -> list[str]:
    suffixes = (".png", ".jpg", ".txt")
    return sorted(p.name for p in (folder / "data").iterdir() if p.suffix.lower() in suffixes)


def _read_stamps(folder: Path, count: int, what: str) -> list[int]:
    """Times of `timestamps.txt`, UTC nanoseconds, one for each of the `count` files."""
    path = folder / "timestamps.txt"
    times_ns = []
    found = 0
    for _, line in read_lines(path):
        if line.strip():
            found += 1
            if found <= count:
                times_ns.append(_stamp_ns(line.strip(), path))
    if found != count:
        raise RecordingError(
            f"{path} has {found} times for {count} {what}; unpack the drive again."
        )
    return times_ns


def _stamp_ns(text: str, path: Path) -> int:
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
        return int(moment.timestamp()) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    except ValueError:
        raise RecordingError(
            f"{path}: {text[:40]!r} is no time like 2011-09-30 12:08:26.399641520; copy it again."
        ) from None


FORMAT = Format(
    "KITTI raw",
    "one KITTI drive *_sync with image_00 .. image_03 and oxts",
    lambda path: bool(_drives(path)),
    open_kitti,
    lambda path: next(iter(_drives(path)), path) / MOUNTING,
)
