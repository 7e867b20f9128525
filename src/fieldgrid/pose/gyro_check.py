"""A gyro that contradicts the drive: with its scale corrected, or without it."""

from __future__ import annotations

from fieldgrid.array_types import Int64
from fieldgrid.motion import Motion
from fieldgrid.pose.accepted import AcceptedFixes
from fieldgrid.pose.axle import Axle
from fieldgrid.pose.drive import Drive, smooth_drive
from fieldgrid.pose.gears import GearHints

MOST_SCALE = 0.25
"""No gyro's scale is off by a larger share; what is has wrong axes or units."""


def with_trusted_gyro(
    drive: Drive,
    fixes: AcceptedFixes,
    all_ns: Int64,
    motion: Motion,
    axle: Axle,
    hints: GearHints,
) -> tuple[Drive, Motion, str | None]:
    """The drive and its motion with a gyro that fits, or without one; and what was wrong with it,
    None where nothing was."""
    found = drive.smoothed.declared
    if not drive.at.has_gyro() or not found.contradicts:
        return drive, motion, None
    scale = found.gyro_scale
    if found.blames_gyro and abs(scale.value) < MOST_SCALE:
        scaled = _scaled(motion, 1.0 + scale.value)
        again = smooth_drive(fixes, all_ns, scaled, axle, hints=hints)
        if not again.smoothed.declared.contradicts:
            size = "small" if scale.value > 0.0 else "large"
            return (
                again,
                scaled,
                f"The turns of the gyro are {100.0 * abs(scale.value):.1f} % ± "
                f"{100.0 * scale.sigma:.1f} % too {size} beside the drive; that was taken out. "
                "Calibrate its scale.",
            )
    without = motion._replace(gyro=None, inertial=None)
    rest = smooth_drive(fixes, all_ns, without, axle, hints=hints)
    # What the camera confirms without the gyro was spoilt by it.
    if not found.blames_gyro and not (rest.turns_seen and not rest.smoothed.declared.contradicts):
        return drive, motion, None
    return (
        rest,
        without,
        f"The gyro contradicts the drive by {found.misfit:.0f} sigmas and was not used: check "
        "imu_axes (it may be upside down), its unit (rad/s) and its stamps.",
    )


def _scaled(motion: Motion, size: float) -> Motion:
    """The same with the rates of the IMU times `size`."""
    gyro, sensed = motion.gyro, motion.inertial
    if gyro is not None:
        gyro = gyro._replace(rate_rad_s=size * gyro.rate_rad_s)
    if sensed is not None:
        rates = (size * sensed.rate_rad_s).astype(sensed.rate_rad_s.dtype)
        sensed = sensed._replace(rate_rad_s=rates)
    return motion._replace(gyro=gyro, inertial=sensed)
