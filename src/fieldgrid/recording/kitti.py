"""KITTI raw: a synchronised drive with its grey or colour pair, oxts and calibration."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

from fieldgrid.angles import heading_from_yaw_rad
from fieldgrid.errors import RecordingError
from fieldgrid.gnss import Fix
from fieldgrid.recording.files import read_text
from fieldgrid.recording.kitti_calibration import (
    CAMERA_HEIGHT_M,
    floats,
    read_kitti_calibration,
)
from fieldgrid.recording.stored import Pair, StoredRecording, checked_pairs

LOOKS_FOR = "one KITTI drive *_sync with image_00 .. image_03 and oxts"

_HEADING_SIGMA_DEG = 0.1  # of the RT3003 by its data sheet
_MAX_OXTS_BYTES = 1 << 16

# OXTS position modes as GGA qualities. -1 is a row that KITTI interpolated for a packet that
# was lost: its position and time stamp do not belong together, so it is "estimated".
_QUALITY_OF_POSMODE = {-1: 6, 2: 1, 3: 1, 4: 2, 5: 5, 6: 4, 7: 9, 8: 2, 9: 2}
_OXTS_FIELDS = 30
_YAW, _FORWARD_MPS, _LEFT_MPS, _POSITION_SIGMA_M, _SATELLITES, _POSMODE = 5, 8, 9, 23, 26, 27


def recognises(path: Path) -> bool:
    """Whether a path is a KITTI drive, or holds some."""
    return bool(_drives(path))


def open_kitti(path: Path, gnss: str | Path | None = None) -> StoredRecording:
    """The drive at or below a path. Its fixes are always those of oxts."""
    drives = _drives(path)
    if len(drives) != 1:
        names = ", ".join(drive.name for drive in drives)
        raise RecordingError(f"{path} holds {len(drives)} KITTI drives: {names}; give one of them.")
    if gnss is not None and str(gnss) != "oxts":
        raise RecordingError(
            f"A KITTI drive has its fixes in oxts, so {str(gnss)!r} cannot be used; "
            "leave --gnss out."
        )
    drive = drives[0]
    left, right = _cameras(drive)
    return StoredRecording(
        name=drive.resolve().name,
        rig=read_kitti_calibration(drive, left, right).rig(),
        folder=drive,
        pairs=checked_pairs(_pairs(drive, left, right), drive),
        fix_log=tuple(_fixes(drive)),
        gnss_source="oxts",
        notes=(
            f"The camera height of {CAMERA_HEIGHT_M} m is KITTI's published value; "
            "no file of the drive gives it.",
            "The heights of oxts are above mean sea level, not above the ellipsoid.",
        ),
    )


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


def _pairs(drive: Path, left: str, right: str) -> list[Pair]:
    names_left, names_right = _listing(drive / f"image_{left}"), _listing(drive / f"image_{right}")
    different = sorted(set(names_left) ^ set(names_right))
    if different:
        raise RecordingError(
            f"{drive}: image_{left} and image_{right} do not hold the same files, "
            f"{different[0]} is only in one; unpack the drive again."
        )
    times_ns = _read_stamps(drive / f"image_{left}", len(names_left), "images")
    return [
        Pair(time_ns, Path(name).stem, f"image_{left}/data/{name}", f"image_{right}/data/{name}")
        for time_ns, name in zip(times_ns, names_left, strict=True)
    ]


def _fixes(drive: Path) -> list[Fix]:
    names = _listing(drive / "oxts")
    times_ns = _read_stamps(drive / "oxts", len(names), "rows of oxts")
    return [
        _fix(drive / "oxts" / "data" / name, time_ns)
        for time_ns, name in zip(times_ns, names, strict=True)
    ]


def _fix(path: Path, time_ns: int) -> Fix:
    values = floats(read_text(path, _MAX_OXTS_BYTES), path)
    if len(values) != _OXTS_FIELDS or not all(math.isfinite(v) for v in values):
        raise RecordingError(
            f"{path} has {len(values)} numbers, not {_OXTS_FIELDS} finite ones; copy it again."
        )
    satellites = int(values[_SATELLITES])
    return Fix(
        time_ns=time_ns,
        lat_deg=values[0],
        lon_deg=values[1],
        height_m=values[2],
        quality=_QUALITY_OF_POSMODE.get(int(values[_POSMODE]), 0),
        satellites=satellites if satellites >= 0 else None,
        sigma_m=values[_POSITION_SIGMA_M],
        speed_mps=math.hypot(values[_FORWARD_MPS], values[_LEFT_MPS]),
        heading_deg=float(heading_from_yaw_rad(values[_YAW])),
        heading_sigma_deg=_HEADING_SIGMA_DEG,
    )


def _listing(folder: Path) -> list[str]:
    suffixes = (".png", ".jpg", ".txt")
    return sorted(p.name for p in (folder / "data").iterdir() if p.suffix.lower() in suffixes)


def _read_stamps(folder: Path, count: int, what: str) -> list[int]:
    """Times of `timestamps.txt`, UTC nanoseconds, one for each of the `count` files."""
    path = folder / "timestamps.txt"
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    if len(lines) != count:
        raise RecordingError(
            f"{path} has {len(lines)} times for {count} {what}; unpack the drive again."
        )
    return [_stamp_ns(line.strip(), path) for line in lines]


def _stamp_ns(text: str, path: Path) -> int:
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
        return int(moment.timestamp()) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    except ValueError:
        raise RecordingError(
            f"{path}: {text[:40]!r} is no time like 2011-09-30 12:08:26.399641520; copy it again."
        ) from None
