"""`recording.toml`: what a recording says of itself where it differs from the usual."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

from fieldgrid.errors import ConfigError, DatumError, RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.recording.columns import Columns, columns_from_mapping
from fieldgrid.recording.files import MAX_TIME_NS, MIN_TIME_NS, is_inside, read_text
from fieldgrid.recording.motion_files import check_axes
from fieldgrid.recording.options import MAX_OFFSET_S
from fieldgrid.recording.pixels import BAYER_PATTERNS, BITS

SETTINGS = "recording.toml"

MAX_BYTES = 1 << 20

_KNOWN = (
    *("name", "image_time_offset_s", "frames", "calibration"),
    *("datum", "gnss", "images", "start"),
    *("sensor", "depth", "disparity", "cloud"),
)


SENSORS = ("stereo", "depth", "disparity", "cloud")
"""What a recording's frames can be."""


@dataclass(frozen=True, slots=True)
class Start:
    """When a drive began whose times count from 0, and where it headed, None when not said."""

    time_ns: int
    heading_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Settings:
    """What `recording.toml` says; the defaults are what holds without it.

    `frames` and `calibration` are paths inside the recording. `rectified` is whether the images
    are rectified, None when that is not said; `bayer` the colours of the first two rows of images
    that are a Bayer mosaic, like "rggb"; `bits` how many of 16 bits the camera fills.
    `sensor` is which frames to take where there are several kinds. Of depths and disparities,
    `scale` is what one unit of their files is, metres or px, and `baseline_m` that of the pair
    they come from. Of clouds, `axes` are where x, y and z point, and `points_per_sr` how dense
    they are.
    """

    name: str = ""
    image_time_offset_ns: int = 0
    datum: Datum | None = None
    columns: Columns | None = None
    frames: str | None = None
    calibration: str | None = None
    rectified: bool | None = None
    bayer: str | None = None
    bits: int | None = None
    start: Start | None = None
    sensor: str | None = None
    scale: float | None = None
    baseline_m: float | None = None
    axes: str | None = None
    points_per_sr: float | None = None


def read_settings(path: Path) -> Settings:
    """The settings in a file, the defaults where there is none.

    Raises RecordingError for one that cannot be understood, unknown keys included.
    """
    if not path.exists():
        return Settings()
    text = read_text(path, MAX_BYTES)
    try:
        document = tomllib.loads(text, parse_float=Decimal)  # exact, for the nanoseconds
    except (ValueError, ArithmeticError, RecursionError) as problem:
        raise RecordingError(f"{path} is not TOML: {problem}; correct it.") from problem
    _refuse_unknown(document, _KNOWN, path)
    datum = document.get("datum")
    images = _table(document, "images", ("rectified", "bayer", "bits"), path)
    cloud = _table(document, "cloud", ("axes", "points_per_sr"), path)
    return Settings(
        name=_text(document, "name", path) or "",
        image_time_offset_ns=_offset_ns(document, path),
        datum=None if datum is None else _datum(datum, path),
        columns=_columns(document.get("gnss", {}), path),
        frames=_inside(document, "frames", path),
        calibration=_inside(document, "calibration", path),
        rectified=_rectified(images, path),
        bayer=_bayer(images, path),
        bits=_bits(images, path),
        start=_start(document, path),
        sensor=_sensor(document, path),
        **_ranges(document, path),
        axes=_axes(cloud, path),
        points_per_sr=_positive(cloud, "points_per_sr", path),
    )


def checked_datum(values: list[object], path: Path) -> Datum:
    """The datum of latitude, longitude, height in a file of which `path` is the name."""
    lat_deg, lon_deg, height_m = (float(_number(v, "the datum", path)) for v in values)
    try:
        return Datum(lat_deg, lon_deg, height_m)
    except DatumError as problem:
        raise RecordingError(f"{path}: {problem}") from problem


def _offset_ns(document: Mapping[str, Any], path: Path) -> int:
    offset_s = _number(document.get("image_time_offset_s", 0), "image_time_offset_s", path)
    if abs(offset_s) > MAX_OFFSET_S:
        raise RecordingError(
            f"{path}: image_time_offset_s = {offset_s} is beyond a day; give the seconds that "
            "an image time must be moved by to be GNSS time."
        )
    return round(offset_s * 1_000_000_000)


def _datum(table: object, path: Path) -> Datum:
    keys = ("lat_deg", "lon_deg", "height_m")
    if not isinstance(table, dict) or not all(key in table for key in keys):
        raise RecordingError(f"{path}: [datum] needs {', '.join(keys)}; add what is missing.")
    _refuse_unknown(table, keys, path)
    return checked_datum([table[key] for key in keys], path)


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


def _inside(document: Mapping[str, Any], key: str, path: Path) -> str | None:
    name = _text(document, key, path)
    if name is not None and not is_inside(name):
        raise RecordingError(
            f"{path}: {key} = {name!r} leads out of the recording; give a path inside its folder."
        )
    return name


def _rectified(images: Mapping[str, Any], path: Path) -> bool | None:
    value = images.get("rectified")
    if value is not None and not isinstance(value, bool):
        raise RecordingError(f"{path}: rectified is {value!r}; give true or false.")
    return value


def _bayer(images: Mapping[str, Any], path: Path) -> str | None:
    value = images.get("bayer")
    if value is not None and value not in BAYER_PATTERNS:
        raise RecordingError(
            f"{path}: bayer is {value!r}; give one of {', '.join(BAYER_PATTERNS)}, the colours of "
            "the first two pixels of the first two rows."
        )
    return value


def _bits(images: Mapping[str, Any], path: Path) -> int | None:
    value = images.get("bits")
    if value is not None and (isinstance(value, bool) or value not in BITS):
        raise RecordingError(
            f"{path}: bits is {value!r}; give how many of 16 bits the camera fills, "
            f"{BITS[0]} to {BITS[-1]}."
        )
    return value


def _sensor(document: Mapping[str, Any], path: Path) -> str | None:
    value = document.get("sensor")
    if value is not None and value not in SENSORS:
        raise RecordingError(f"{path}: sensor is {value!r}; give one of {', '.join(SENSORS)}.")
    return value


def _ranges(document: Mapping[str, Any], path: Path) -> dict[str, float | None]:
    """What `[depth]` or `[disparity]` says; a recording is of one of them."""
    depth = _table(document, "depth", ("scale_m", "baseline_m"), path)
    disparity = _table(document, "disparity", ("scale_px", "baseline_m"), path)
    if depth and disparity:
        raise RecordingError(
            f"{path} has both [depth] and [disparity]; leave the one that is not used out."
        )
    return {
        "scale": _positive(depth, "scale_m", path) or _positive(disparity, "scale_px", path),
        "baseline_m": _positive(depth or disparity, "baseline_m", path),
    }


def _axes(cloud: Mapping[str, Any], path: Path) -> str | None:
    if "axes" not in cloud:
        return None
    try:
        return check_axes(str(cloud["axes"]))
    except ValueError:
        raise RecordingError(
            f"{path}: axes are {cloud['axes']!r}; give where x, y and z of the clouds point, a "
            "right-handed set of f or b, l or r, u or d, like flu or rdf."
        ) from None


def _positive(table: Mapping[str, Any], key: str, path: Path) -> float | None:
    if key not in table:
        return None
    value = float(_number(table[key], key, path))
    if value <= 0.0:
        raise RecordingError(f"{path}: {key} is {value}; give a number above 0.")
    return value


def _start(document: Mapping[str, Any], path: Path) -> Start | None:
    table = _table(document, "start", ("utc_s", "heading_deg"), path)
    if not table:
        return None
    time_ns = round(_number(table.get("utc_s"), "utc_s", path, 10**11) * 1_000_000_000)
    if not MIN_TIME_NS <= time_ns <= MAX_TIME_NS:
        raise RecordingError(
            f"{path}: utc_s = {table['utc_s']} is no time after 1980 in seconds since 1970; "
            "give the UTC of the first frame."
        )
    heading = table.get("heading_deg")
    return Start(time_ns, None if heading is None else float(_number(heading, "heading_deg", path)))


def _table(
    document: Mapping[str, Any], key: str, known: tuple[str, ...], path: Path
) -> Mapping[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise RecordingError(f"{path}: {key} is {table!r}; give a table [{key}].")
    _refuse_unknown(table, known, path)
    return table


def _text(document: Mapping[str, Any], key: str, path: Path) -> str | None:
    value = document.get(key)
    if value is not None and not isinstance(value, str):
        raise RecordingError(f"{path}: {key} is {value!r}; give a text in quotes.")
    return value


def _number(value: object, key: str, path: Path, limit: int = 10**9) -> Decimal:
    is_number = isinstance(value, (int, Decimal)) and not isinstance(value, bool)
    number = Decimal(value) if is_number else Decimal("nan")  # type: ignore[arg-type]
    if not number.is_finite() or abs(number) >= limit:
        raise RecordingError(f"{path}: {key} holds {value!r}; give a number.")
    return number


def _refuse_unknown(table: Mapping[str, Any], known: tuple[str, ...], path: Path) -> None:
    unknown = sorted(table.keys() - set(known))
    if unknown:
        raise RecordingError(
            f"{path}: {unknown[0]!r} is not a setting; known are {', '.join(known)}."
        )
