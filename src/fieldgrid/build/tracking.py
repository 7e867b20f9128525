"""The poses of whatever holds a drive: a recording, a folder without images, a log alone."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fieldgrid.build.poses import estimate_drive
from fieldgrid.errors import ConfigError, RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.pose import Estimate, estimate_poses
from fieldgrid.recording import Columns, is_recording, open_log, open_recording
from fieldgrid.recording.bare import LOOKS_FOR, open_bare, recognises
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
    datum: Datum | None = None,
    carrier: Carrier | None = None,
) -> TrackedDrive:
    """Fixes and motion of a path, conditioned and estimated; no image is read.

    Of a log alone, and of a folder without calibration, the poses are the antenna's, and what
    is known of the vehicle is the `carrier`; where calibration tells it, that is refused. `gnss`
    picks a log of a folder. Raises RecordingError for a path that holds no drive, GnssError
    when no fix of it can be used.
    """
    path, settings = Path(path), settings or BuildSettings()
    if not path.exists():
        raise RecordingError(
            f"{path} does not exist; give the folder of a recording, or a GNSS log."
        )
    if is_recording(path):
        _refuse_carrier(path, carrier)
        with open_recording(path, gnss, columns) as recording:
            estimate = estimate_drive(recording, settings, datum)
            return TrackedDrive(recording.name, recording.gnss_source, estimate, recording.notes)
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
