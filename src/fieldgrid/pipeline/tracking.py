"""The poses of whatever holds a drive: a recording, a folder without images, a log alone."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import BuildSettings, ConfigError, Finding, warning
from fieldgrid.geometry import Carrier, Datum
from fieldgrid.pipeline.poses import estimate_drive, told_of
from fieldgrid.poses import Estimate
from fieldgrid.recordings import DriveOptions, open_drive


class TrackedDrive(NamedTuple):
    """An estimate with the name of its drive, its log, and all findings."""

    name: str
    gnss_source: str
    estimate: Estimate
    findings: tuple[Finding, ...]


def track_drive(
    path: str | Path,
    settings: BuildSettings | None = None,
    options: DriveOptions | None = None,
    *,
    datum: Datum | None = None,
    carrier: Carrier | None = None,
) -> TrackedDrive:
    """Fixes and motion of a path, conditioned and estimated; no image is read.

    Of a log alone, and of a drive of whose vehicle nothing is known, the poses are the antenna's,
    and what is known of the vehicle is the `carrier`; where calibration tells it, that is refused.
    `options` are those of `open_drive`. Raises RecordingError for a path that holds no drive,
    GnssError when no fix of it can be used.
    """
    with open_drive(path, options) as drive:
        if drive.rig is not None and carrier is not None:
            raise ConfigError(
                f"{path} has a mounting, which tells where the antenna sits and what a recorded "
                "heading means; write it there, and leave --antenna-ahead and --heading-offset out."
            )
        findings = told_of(drive)
        if drive.rig is None and drive.refusal is not None:
            why = f"The poses are those of the antenna: {drive.refusal}"
            findings.insert(0, warning("antenna-poses", why))
        estimate = estimate_drive(drive, settings, datum, carrier=carrier)
        findings += estimate.report.findings
        return TrackedDrive(drive.name, drive.gnss_source, estimate, tuple(findings))
