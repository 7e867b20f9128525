"""The plain folder: images, frames.csv, calibration/, gnss/ and an optional recording.toml."""

from __future__ import annotations

import json
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.errors import ConfigError, DatumError, RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.recording.calibration import read_calibration
from fieldgrid.recording.columns import Columns, columns_from_mapping
from fieldgrid.recording.files import read_text
from fieldgrid.recording.fix_log import FixLog
from fieldgrid.recording.frame_table import TABLE, read_frames
from fieldgrid.recording.logs import find_log, passed_over, read_fix_log
from fieldgrid.recording.motion_files import read_motion
from fieldgrid.recording.mounting import MOUNTING
from fieldgrid.recording.options import MAX_OFFSET_S, Options
from fieldgrid.recording.stored import StoredRecording

LOOKS_FOR = f"{TABLE}, or left/ and right/"

_SETTINGS = "recording.toml"
_SESSION = "session.json"
_MAX_BYTES = 1 << 20


def recognises(path: Path) -> bool:
    """Whether a folder is a plain recording."""
    return (path / TABLE).is_file() or all((path / side).is_dir() for side in ("left", "right"))


def open_folder(path: Path, options: Options) -> StoredRecording:
    """The recording in a plain folder. What the options say outranks the settings file."""
    options.refuse_topics(path)
    settings = _read_settings(path / _SETTINGS)
    calibration = read_calibration(path / "calibration")
    mounting = options.find_mounting(path / "calibration" / MOUNTING, path)
    offset_ns = options.offset_or(settings.image_time_offset_ns)
    pairs, frame_notes = read_frames(path)
    log_path = find_log(path, options.gnss)
    log = (
        FixLog((), (passed_over(path),))
        if log_path is None
        else read_fix_log(log_path, options.columns or settings.columns)
    )
    moved = read_motion(path, mounting.imu_axes)
    return StoredRecording(
        name=settings.name or path.resolve().name,
        rig=mounting.rig(calibration.camera, offset_ns),
        folder=path,
        pairs=pairs,
        fix_log=log.fixes,
        gnss_source="" if log_path is None else _name_of(log_path, path),
        datum_hint=settings.datum or _session_datum(path / _SESSION),
        notes=calibration.notes + frame_notes + log.notes + moved.notes,
        own_motion=moved.motion._replace(gyro=moved.motion.gyro or log.motion.gyro),
    )


def _name_of(log_path: Path, folder: Path) -> str:
    inside = log_path.is_relative_to(folder)
    return log_path.relative_to(folder).as_posix() if inside else log_path.name


class _Settings(NamedTuple):
    name: str = ""
    image_time_offset_ns: int = 0
    datum: Datum | None = None
    columns: Columns | None = None


def _read_settings(path: Path) -> _Settings:
    if not path.exists():
        return _Settings()
    text = read_text(path, _MAX_BYTES)
    try:
        document = tomllib.loads(text, parse_float=Decimal)  # exact, for the nanoseconds
    except (ValueError, ArithmeticError, RecursionError) as problem:
        raise RecordingError(f"{path} is not TOML: {problem}; correct it.") from problem
    _refuse_unknown(document, ("name", "image_time_offset_s", "datum", "gnss"), path)
    name = document.get("name", "")
    if not isinstance(name, str):
        raise RecordingError(f"{path}: name is {name!r}; give a text in quotes.")
    offset_s = _number(document.get("image_time_offset_s", 0), "image_time_offset_s", path)
    if abs(offset_s) > MAX_OFFSET_S:
        raise RecordingError(
            f"{path}: image_time_offset_s = {offset_s} is beyond an hour; give the seconds that "
            "an image time must be moved by to be GNSS time."
        )
    datum = document.get("datum")
    return _Settings(
        name,
        round(offset_s * 1_000_000_000),
        None if datum is None else _datum(datum, path),
        _columns(document.get("gnss", {}), path),
    )


def _columns(table: object, path: Path) -> Columns | None:
    """What `[gnss.columns]` says of the columns of the log."""
    columns = table.get("columns") if isinstance(table, dict) else table
    if isinstance(table, dict):
        _refuse_unknown(table, ("columns",), path)
    if columns is None:
        return None
    if not isinstance(columns, dict):
        raise RecordingError(f"{path}: the columns are {columns!r}; give a table [gnss.columns].")
    try:
        return columns_from_mapping(columns)
    except ConfigError as problem:
        raise RecordingError(f"{path}: {problem}") from problem


def _datum(table: object, path: Path) -> Datum:
    keys = ("lat_deg", "lon_deg", "height_m")
    if not isinstance(table, dict) or not all(key in table for key in keys):
        raise RecordingError(f"{path}: [datum] needs {', '.join(keys)}; add what is missing.")
    _refuse_unknown(table, keys, path)
    return _checked_datum([table[key] for key in keys], path)


def _session_datum(path: Path) -> Datum | None:
    """The origin that `session.json` declares. Other programs write files of that name too."""
    if not path.exists():
        return None
    text = read_text(path, _MAX_BYTES)
    try:
        document = json.loads(text, parse_float=Decimal)
    except (ValueError, ArithmeticError, RecursionError) as problem:
        raise RecordingError(f"{path} is not JSON: {problem}; correct or remove it.") from problem
    origin = document.get("ltp_origin") if isinstance(document, dict) else None
    if not isinstance(origin, dict):
        return None
    keys = ("lat_deg", "lon_deg", "ellipsoid_height_m")
    if not all(key in origin for key in keys):
        raise RecordingError(f"{path}: ltp_origin needs {', '.join(keys)}; add what is missing.")
    return _checked_datum([origin[key] for key in keys], path)


def _checked_datum(values: list[object], path: Path) -> Datum:
    lat_deg, lon_deg, height_m = (float(_number(v, "the datum", path)) for v in values)
    try:
        return Datum(lat_deg, lon_deg, height_m)
    except DatumError as problem:
        raise RecordingError(f"{path}: {problem}") from problem


def _number(value: object, key: str, path: Path) -> Decimal:
    is_number = isinstance(value, (int, Decimal)) and not isinstance(value, bool)
    number = Decimal(value) if is_number else Decimal("nan")  # type: ignore[arg-type]
    if not number.is_finite() or abs(number) >= 10**9:
        raise RecordingError(f"{path}: {key} holds {value!r}; give a number.")
    return number


def _refuse_unknown(table: dict[str, Any], known: tuple[str, ...], path: Path) -> None:
    unknown = sorted(table.keys() - set(known))
    if unknown:
        raise RecordingError(
            f"{path}: {unknown[0]!r} is not a setting; known are {', '.join(known)}."
        )
