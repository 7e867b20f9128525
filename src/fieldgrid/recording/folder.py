"""The plain folder: images, frames.csv, calibration/, gnss/ and an optional recording.toml."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path

from fieldgrid.errors import RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.recording.files import read_text
from fieldgrid.recording.fix_log import FixLog
from fieldgrid.recording.frame_table import TABLE
from fieldgrid.recording.logs import find_log, log_name, passed_over, read_fix_log
from fieldgrid.recording.motion_files import read_motion
from fieldgrid.recording.mounting import MOUNTING
from fieldgrid.recording.options import Options
from fieldgrid.recording.sensors import CALIBRATION, has_frames, read_seen
from fieldgrid.recording.settings_file import MAX_BYTES, SETTINGS, checked_datum, read_settings
from fieldgrid.recording.stored import StoredRecording

LOOKS_FOR = f"{TABLE}, or left/ and right/, depth/, disparity/ or clouds/"

_SESSION = "session.json"


def recognises(path: Path) -> bool:
    """Whether a folder is a plain recording."""
    if (path / TABLE).is_file() or has_frames(path):
        return True
    return (path / SETTINGS).is_file() and read_settings(path / SETTINGS).frames is not None


def open_folder(path: Path, options: Options) -> StoredRecording:
    """The recording in a plain folder. What the options say outranks the settings file."""
    options.refuse_topics(path)
    settings = read_settings(path / SETTINGS)
    mounting = options.find_mounting(path / CALIBRATION / MOUNTING, path)
    seen = read_seen(path, settings, mounting, options.offset_or(settings.image_time_offset_ns))
    log_path = find_log(path, options.gnss)
    log = (
        FixLog(FixColumns.of([]), (passed_over(path),))
        if log_path is None
        else read_fix_log(log_path, options.columns or settings.columns)
    )
    moved = read_motion(path, mounting.imu_axes)
    return StoredRecording(
        name=settings.name or path.resolve().name,
        rig=seen.rig,
        folder=path,
        shots=seen.shots,
        kind=seen.kind,
        fix_log=log.fixes,
        gnss_source="" if log_path is None else log_name(log_path, path),
        gnss_path=log_path,
        datum_hint=settings.datum or _session_datum(path / _SESSION),
        notes=seen.notes + log.notes + moved.notes,
        own_motion=moved.motion._replace(
            gyro=moved.motion.gyro or log.motion.gyro,
            wheels=moved.motion.wheels or log.motion.wheels,
        ),
    )


def _session_datum(path: Path) -> Datum | None:
    """The origin that `session.json` declares. Other programs write files of that name too."""
    if not path.exists():
        return None
    text = read_text(path, MAX_BYTES)
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
    return checked_datum([origin[key] for key in keys], path)
