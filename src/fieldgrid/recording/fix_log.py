"""GNSS logs on disk: which one to take, and its fixes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from fieldgrid.errors import GnssError, RecordingError
from fieldgrid.gnss import Fix, NmeaLog, parse_nmea
from fieldgrid.recording.files import check_regular, parse_time_ns, read_table

SUFFIXES = frozenset({".nmea", ".csv", ".ubx"})
"""File name endings of GNSS logs, in lower case."""


class FixLog(NamedTuple):
    """The fixes of a log, and remarks on it."""

    fixes: tuple[Fix, ...]
    notes: tuple[str, ...] = ()


def find_log(folder: Path, wanted: str | Path | None) -> Path | None:
    """The log in `gnss/` of a recording, the one that is `wanted`, or None when it has none.

    `wanted` is a file name in `gnss/`, a path inside the recording, or a path anywhere.
    """
    present = []
    if (folder / "gnss").is_dir():
        present = [p for p in sorted((folder / "gnss").iterdir()) if p.suffix.lower() in SUFFIXES]
    names = ", ".join(path.name for path in present) or "none"
    if wanted is not None:
        for path in (folder / "gnss" / wanted, folder / wanted, Path(wanted)):
            if path.is_file():
                return path
        raise RecordingError(
            f"The GNSS log {str(wanted)!r} is neither in {folder / 'gnss'} nor a file of its own; "
            f"the recording has: {names}."
        )
    if len(present) > 1:
        raise RecordingError(f"{folder} has several GNSS logs: {names}; give --gnss NAME.")
    return present[0] if present else None


def read_fix_log(path: Path) -> FixLog:
    """The fixes of an NMEA or CSV log, told apart by the file name."""
    if path.suffix.lower() == ".ubx":
        raise RecordingError(
            f"{path} is a UBX log, which is not supported yet; convert it to NMEA, or let the "
            "receiver write NMEA."
        )
    return _read_csv(path) if path.suffix.lower() == ".csv" else _read_nmea(path)


def _read_nmea(path: Path) -> FixLog:
    check_regular(path)
    try:
        with path.open("rb") as file:
            log = parse_nmea(file)
    except OSError as problem:
        raise RecordingError(
            f"{path} cannot be read: {problem.strerror}; check the disk."
        ) from problem
    except GnssError as problem:
        raise GnssError(f"{path}: {problem}") from problem
    return FixLog(tuple(log.fixes), tuple(_remarks(log, path.name)))


def _remarks(log: NmeaLog, name: str) -> list[str]:
    counted = (
        (log.bad_checksum + log.broken, "damaged sentences skipped"),
        (log.no_position, "GGA sentences without a position"),
        (log.repeated, "repeated positions of one epoch skipped"),
        (log.no_geoid, "fixes without geoid separation: their height is above mean sea level"),
    )
    return [f"{name}: {count} {what}." for count, what in counted if count]


def _read_csv(path: Path) -> FixLog:
    fixes, has_quality = [], True
    for line, row in read_table(path, ("lat_deg", "lon_deg", "height_m")):
        has_quality = "quality" in row
        try:
            fixes.append(_fix(row))
        except ValueError as problem:
            raise RecordingError(f"{path}, line {line}: {problem}; correct it.") from problem
    notes = () if has_quality else (f"{path.name}: no column quality; taken as 1 (GPS).",)
    return FixLog(tuple(fixes), notes)


def _fix(row: dict[str, str]) -> Fix:
    def optional(column: str) -> float | None:
        text = row.get(column, "")
        return _number(column, text) if text else None

    quality, satellites = optional("quality"), optional("satellites")
    lat_deg, lon_deg, height_m = (
        _number(column, row[column]) for column in ("lat_deg", "lon_deg", "height_m")
    )
    return Fix(
        time_ns=parse_time_ns(row),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        height_m=height_m,
        quality=1 if quality is None else int(quality),
        satellites=None if satellites is None else int(satellites),
        hdop=optional("hdop"),
        age_s=optional("age_s"),
        sigma_m=optional("sigma_m"),
        speed_mps=optional("speed_mps"),
        heading_deg=optional("heading_deg"),
        heading_sigma_deg=optional("heading_sigma_deg"),
    )


def _number(column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{column} {text!r} is not a number")
    return value
