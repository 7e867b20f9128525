"""The poses of whatever holds a drive: a recording, a folder without images, a log alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from fieldgrid.build.poses import estimate_drive
from fieldgrid.errors import ConfigError, RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.pose import Estimate, estimate_poses
from fieldgrid.recording import (
    Columns,
    Options,
    bag,
    is_bag,
    is_recording,
    open_log,
    open_recording,
)
from fieldgrid.recording.bare import LOOKS_FOR, BareDrive, open_bare, recognises
from fieldgrid.recording.isoxml import is_time_log
from fieldgrid.rig import Carrier
from fieldgrid.settings import BuildSettings


class TrackedDrive(NamedTuple):
    """An estimate with the name of its drive, its log, and the remarks of those who read it."""

    name: str
    gnss_source: str
    estimate: Estimate
    notes: tuple[str, ...]


def track_drive(
    path: str | Path,
    settings: BuildSettings | None = None,
    *,
    gnss: str | Path | None = None,
    columns: Columns | None = None,
    topics: Mapping[str, str] | None = None,
    mounting: Path | None = None,
    image_time_offset_ns: int | None = None,
    datum: Datum | None = None,
    carrier: Carrier | None = None,
) -> TrackedDrive:
    """Fixes and motion of a path, conditioned and estimated; no image is read.

    Of a log alone, and of a folder without calibration, the poses are the antenna's, and what
    is known of the vehicle is the `carrier`; where calibration tells it, that is refused. `gnss`
    picks a log of a folder; `topics`, `mounting` and `image_time_offset_ns` are what
    `open_recording` takes, and refused where there is no recording. Raises RecordingError for a
    path that holds no drive, GnssError when no fix of it can be used.
    """
    path, settings = Path(path), settings or BuildSettings()
    options = Options(gnss, columns, topics or {}, mounting, image_time_offset_ns)
    if not path.exists():
        raise RecordingError(
            f"{path} does not exist; give the folder of a recording, or a GNSS log."
        )
    if is_bag(path):
        return _tracked_bag(path, settings, options, datum, carrier)
    if is_recording(path):
        _refuse_carrier(path, carrier)
        with open_recording(
            path,
            gnss,
            columns,
            topics=topics,
            mounting=mounting,
            image_time_offset_ns=image_time_offset_ns,
        ) as recording:
            estimate = estimate_drive(recording, settings, datum)
            return TrackedDrive(recording.name, recording.gnss_source, estimate, recording.notes)
    refuse_options(path, options)
    if recognises(path):
        bare = open_bare(path, gnss, columns)
        if bare.rig is not None:
            _refuse_carrier(path, carrier)
        vehicle = bare.rig or carrier
        estimate = estimate_poses(bare.fixes, vehicle, datum, settings.pose, bare.motion)
        return TrackedDrive(path.resolve().name, bare.gnss_source, estimate, bare.notes)
    if path.is_dir() and not is_time_log(path):
        raise RecordingError(
            f"{path} holds no drive: it is no recording, and has neither {LOOKS_FOR} nor an "
            "ISO 11783-10 time log; give the folder of one, or a GNSS log."
        )
    return _tracked_log(path, settings, gnss, columns, datum, carrier)


def _tracked_bag(
    path: Path,
    settings: BuildSettings,
    options: Options,
    datum: Datum | None,
    carrier: Carrier | None,
) -> TrackedDrive:
    drive = bag.open_drive(path, options)
    if isinstance(drive, BareDrive):
        estimate = estimate_poses(drive.fixes, carrier, datum, settings.pose, drive.motion)
        return TrackedDrive(path.resolve().stem, drive.gnss_source, estimate, drive.notes)
    with drive:
        _refuse_carrier(path, carrier)
        estimate = estimate_drive(drive, settings, datum)
        notes = (*drive.losses, *drive.notes)
        return TrackedDrive(drive.name, drive.gnss_source, estimate, notes)


def refuse_options(path: Path, options: Options) -> None:
    """Raise ConfigError for what is said of images or topics where there are none."""
    options.refuse_topics(path)
    if options.mounting is not None or options.image_time_offset_ns is not None:
        given = "--mounting" if options.mounting is not None else "--time-offset"
        raise ConfigError(f"{path} is no recording with images; leave {given} out.")


def _refuse_carrier(path: Path, carrier: Carrier | None) -> None:
    if carrier is not None:
        raise ConfigError(
            f"{path} has a mounting.json, which tells where the antenna sits and what a recorded "
            "heading means; write it there, and leave --antenna-ahead and --heading-offset out."
        )


def _tracked_log(
    path: Path,
    settings: BuildSettings,
    gnss: str | Path | None,
    columns: Columns | None,
    datum: Datum | None,
    carrier: Carrier | None,
) -> TrackedDrive:
    if gnss is not None:
        raise ConfigError(
            f"{path} is a log already, so {str(gnss)!r} cannot be picked in it; leave --gnss out."
        )
    log = open_log(path, columns)
    estimate = estimate_poses(log.fixes, carrier, datum, settings.pose, log.motion)
    return TrackedDrive(path.stem, path.name, estimate, log.notes)
