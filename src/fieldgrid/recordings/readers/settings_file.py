"""`recording.toml`: what a recording says of itself where it differs from the usual."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field

from fieldgrid.core import MAX_TIME_NS, MIN_TIME_NS, ConfigError, DatumError, RecordingError
from fieldgrid.geometry import Datum
from fieldgrid.recordings.files import is_inside
from fieldgrid.recordings.frames.pixels import BAYER_PATTERNS, BITS
from fieldgrid.recordings.options import MAX_GIVEN_OFFSET_S
from fieldgrid.recordings.poses.pose_source import PoseSource
from fieldgrid.recordings.readers.entries import (
    EntryTable,
    Exact,
    Number,
    Positive,
    entry,
    fitted,
    read_document,
)
from fieldgrid.recordings.tables.columns import Columns, columns_from_mapping
from fieldgrid.recordings.tables.motion_files import check_axes

SETTINGS = "recording.toml"

SENSORS = ("stereo", "depth", "disparity", "cloud")
"""What a recording's frames can be."""


def _inside(name: str) -> str:
    if not is_inside(name):
        raise ValueError("leads out of the recording")
    return name


def _axes(value: object) -> str:
    return check_axes(str(value))


_Path = Annotated[str, AfterValidator(_inside)]
_TEXT = "give a text in quotes"
_INSIDE = "give a path inside its folder, in quotes"
_ABOVE = "give a number above 0"


def _ns(seconds: Decimal) -> int:
    return round(seconds * 1_000_000_000)


class _Datum(EntryTable):
    lat_deg: Number = entry("give the latitude in degrees")
    lon_deg: Number = entry("give the longitude in degrees")
    height_m: Number = entry("give the height above the ellipsoid in metres")


class _Origin(EntryTable):
    """The datum as other programs write it, among other things."""

    model_config = ConfigDict(extra="ignore")

    lat_deg: Number = entry("give the latitude in degrees")
    lon_deg: Number = entry("give the longitude in degrees")
    ellipsoid_height_m: Number = entry("give the height above the ellipsoid in metres")


class _Gnss(EntryTable):
    columns: dict[str, Any] | None = entry("give a table [gnss.columns]", None)


class _Images(EntryTable):
    rectified: bool | None = entry("give true or false", None)
    bayer: str | None = entry(
        f"give one of {', '.join(BAYER_PATTERNS)}, the colours of the first two pixels of the "
        "first two rows",
        None,
        pattern=f"^(?:{'|'.join(BAYER_PATTERNS)})$",
    )
    bits: int | None = entry(
        f"give how many of 16 bits the camera fills, {BITS[0]} to {BITS[-1]}",
        None,
        ge=BITS[0],
        le=BITS[-1],
    )


class Start(EntryTable):
    """When a drive began whose times count from 0, and where it headed, None when not said."""

    utc_s: Exact = entry(
        "give the UTC of the first frame as seconds since 1970, a time after 1980",
        ge=MIN_TIME_NS / 10**9,
        le=MAX_TIME_NS / 10**9,
    )
    heading_deg: Number | None = entry("give the heading of the first frame in degrees", None)

    @property
    def time_ns(self) -> int:
        """UTC in nanoseconds."""
        return _ns(self.utc_s)


class _Depth(EntryTable):
    scale_m: Positive | None = entry(_ABOVE, None)
    baseline_m: Positive | None = entry(_ABOVE, None)


class _Disparity(EntryTable):
    scale_px: Positive | None = entry(_ABOVE, None)
    baseline_m: Positive | None = entry(_ABOVE, None)


class _Cloud(EntryTable):
    axes: Annotated[str | None, BeforeValidator(_axes)] = entry(
        "give where x, y and z of the clouds point, a right-handed set of f or b, l or r, u or d, "
        "like flu or rdf",
        None,
    )
    scale_m: Positive = entry(_ABOVE, 1.0)
    points_per_sr: Positive | None = entry(_ABOVE, None)
    corrected: bool | None = entry("give true or false", None)


class _Poses(EntryTable):
    file: _Path | None = entry(_INSIDE, None)
    topic: str | None = entry(_TEXT, None)
    axes: str | None = entry("give where x, y and z of the body point, like flu or rdf", None)
    point_flu_m: Annotated[list[Number] | None, Field(min_length=3, max_length=3)] = entry(
        "give where the body's origin is: [forward, left, up] of the sensor in metres", None
    )
    times: _Path | None = entry(_INSIDE, None)
    time_offset_s: Exact | None = entry(
        "give the seconds to add to the times of the poses",
        None,
        ge=-MAX_TIME_NS / 10**9,
        le=MAX_TIME_NS / 10**9,
    )

    def source(self, folder: Path) -> PoseSource:
        point, offset_s = self.point_flu_m, self.time_offset_s
        return PoseSource(
            None if self.file is None else folder / self.file,
            self.topic,
            self.axes,
            None if point is None else (point[0], point[1], point[2]),
            None if self.times is None else folder / self.times,
            None if offset_s is None else _ns(offset_s),
        )


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """What `recording.toml` says; the defaults are what holds without it.

    `frames` and `calibration` are paths inside the recording. `rectified` is whether the images
    are rectified, None when that is not said; `bayer` the colours of the first two rows of images
    that are a Bayer mosaic, like "rggb"; `bits` how many of 16 bits the camera fills.
    `sensor` is which frames to take where there are several kinds. Of depths and disparities,
    `scale` is what one unit of their files is, metres or px, and `baseline_m` that of the pair
    they come from. Of clouds, `axes` are where x, y and z point, `cloud_scale_m` what one unit of
    their files is, `points_per_sr` how dense they are, and `corrected` whether their points were
    carried to one instant. `poses` says where poses of another program are.
    """

    name: str = ""
    image_time_offset_ns: int = 0
    gnss_offset_ns: int = 0
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
    cloud_scale_m: float = 1.0
    points_per_sr: float | None = None
    corrected: bool | None = None
    poses: PoseSource | None = None


class _File(EntryTable):
    name: str = entry(_TEXT, "")
    image_time_offset_s: Exact = entry(
        "give the seconds that an image time must be moved by to be GNSS time, at most 40 years",
        Decimal(0),
        ge=-MAX_GIVEN_OFFSET_S,
        le=MAX_GIVEN_OFFSET_S,
    )
    gnss_time_offset_s: Exact = entry(
        "give the seconds that a time of the GNSS log must be moved by to be that of images, gyro "
        "and wheels, at most 40 years",
        Decimal(0),
        ge=-MAX_GIVEN_OFFSET_S,
        le=MAX_GIVEN_OFFSET_S,
    )
    frames: _Path | None = entry(_INSIDE, None)
    calibration: _Path | None = entry(_INSIDE, None)
    datum: _Datum | None = entry("give a table [datum]", None)
    gnss: _Gnss = entry("give a table [gnss.columns]", _Gnss())
    images: _Images = entry("give a table [images]", _Images())
    start: Start | None = entry("give a table [start]", None)
    sensor: Literal["stereo", "depth", "disparity", "cloud"] | None = entry(
        f"give one of {', '.join(SENSORS)}", None
    )
    depth: _Depth | None = entry("give a table [depth]", None)
    disparity: _Disparity | None = entry("give a table [disparity]", None)
    cloud: _Cloud = entry("give a table [cloud]", _Cloud())
    poses: _Poses | None = entry("give a table [poses]", None)


def read_settings(path: Path) -> RecordingSettings:
    """The settings in a file, the defaults where there is none.

    Raises RecordingError for one that cannot be understood, unknown keys included.
    """
    if not path.exists():
        return RecordingSettings()
    document = read_document(path, "TOML", number=Decimal)  # exact, for the nanoseconds
    said = fitted(_File, document, str(path))
    try:
        columns = None if said.gnss.columns is None else columns_from_mapping(said.gnss.columns)
        datum = None if said.datum is None else Datum(**said.datum.model_dump())
    except (ConfigError, DatumError) as problem:
        raise RecordingError(f"{path}: {problem}") from problem
    if said.depth and said.disparity:
        raise RecordingError(
            f"{path} has both [depth] and [disparity]; leave the one that is not used out."
        )
    depth, disparity = said.depth or _Depth(), said.disparity or _Disparity()
    return RecordingSettings(
        name=said.name,
        image_time_offset_ns=_ns(said.image_time_offset_s),
        gnss_offset_ns=_ns(said.gnss_time_offset_s),
        datum=datum,
        columns=columns,
        frames=said.frames,
        calibration=said.calibration,
        **said.images.model_dump(),
        start=said.start,
        sensor=said.sensor,
        scale=depth.scale_m or disparity.scale_px,
        baseline_m=depth.baseline_m or disparity.baseline_m,
        axes=said.cloud.axes,
        cloud_scale_m=said.cloud.scale_m,
        points_per_sr=said.cloud.points_per_sr,
        corrected=said.cloud.corrected,
        poses=None if said.poses is None else said.poses.source(path.parent),
    )


def read_session_datum(path: Path) -> Datum | None:
    """The origin that `session.json` declares. Other programs write files of that name too."""
    document = read_document(path, "JSON", number=Decimal) if path.exists() else None
    origin = document.get("ltp_origin") if isinstance(document, dict) else None
    if not isinstance(origin, dict):
        return None
    said = fitted(_Origin, origin, f"{path}: ltp_origin")
    try:
        return Datum(said.lat_deg, said.lon_deg, said.ellipsoid_height_m)
    except DatumError as problem:
        raise RecordingError(f"{path}: {problem}") from problem
