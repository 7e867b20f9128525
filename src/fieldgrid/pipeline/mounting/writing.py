"""An estimate as the `mounting.json` of its recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fieldgrid.core import ConfigError
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.pipeline.mounting.estimate import MountEstimate
from fieldgrid.recordings import (
    Mounting,
    is_url,
    mounting_path,
    read_mounting,
    url_of,
    write_mounting,
)

_HEIGHT_DIGITS, _ANGLE_DIGITS, _AXLE_DIGITS = 3, 2, 2


def write_estimate(
    estimate: MountEstimate,
    recording: str | Path,
    antenna_flu_m: tuple[float, float, float] | None = None,
) -> Path:
    """Write an estimate where the recording at a path looks for its mounting; the file's path.

    What is not estimated stays what the file or the recording states. `antenna_flu_m` is the
    antenna (forward, left, up of the camera, metres), which no drive tells: raises ConfigError
    when nobody does, since a forgotten lever arm misplaces the map.
    """
    url = str(recording) if is_url(recording) else url_of(Path(recording))
    if url is not None:
        raise ConfigError(
            f"{url} is only read, so its mounting was not written; write what was measured into "
            "its mounting.json there, or give --mounting FILE.json."
        )
    place, rig, mount = mounting_path(Path(recording)), estimate.stated, _rounded(estimate)
    if antenna_flu_m is not None:
        forward_m, left_m, up_m = antenna_flu_m
        antenna = LeverArm(-left_m + 0.0, forward_m, mount.height_m + up_m)
    elif rig is not None:
        # It keeps its place beside the camera, whose height is another now.
        antenna = replace(rig.antenna, up_m=rig.antenna.up_m - rig.mount.height_m + mount.height_m)
    else:
        raise ConfigError(
            f"{place} was not written: where the GNSS antenna sits cannot be told from a drive, "
            "and a forgotten lever arm misplaces the whole map; measure it from the camera and "
            "give it with --antenna FORWARD LEFT UP."
        )
    if place.exists():
        mounting = replace(read_mounting(place), mount=mount, antenna=antenna)
    elif rig is not None:
        mounting = Mounting(
            mount,
            antenna,
            rig.rear_axle_forward_m,
            rig.heading_offset_deg,
            rig.heading_convention,
        )
    else:
        mounting = Mounting(mount, antenna)
    if estimate.axle_ahead_m is not None:
        ahead_m = round(estimate.axle_ahead_m.value, _AXLE_DIGITS)
        mounting = replace(mounting, rear_axle_forward_m=-ahead_m)
    write_mounting(place, mounting)
    return place


def _rounded(estimate: MountEstimate) -> Mount:
    """The mount without digits that mean nothing; a yaw that was not told stays as stated."""
    mount = estimate.mount
    yaw_deg = mount.yaw_deg
    if estimate.yaw_deg is None and estimate.stated is not None:
        yaw_deg = estimate.stated.mount.yaw_deg
    return Mount(
        round(mount.height_m, _HEIGHT_DIGITS),
        round(mount.tilt_deg, _ANGLE_DIGITS),
        round(mount.roll_deg, _ANGLE_DIGITS) + 0.0,
        round(yaw_deg, _ANGLE_DIGITS) + 0.0,
    )
