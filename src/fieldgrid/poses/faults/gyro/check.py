"""A gyro that contradicts the drive, and a drive without it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, Int64, PoseSettings, warning
from fieldgrid.geometry import Inertial, Motion, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import DriveEstimate, smooth_drive
from fieldgrid.poses.faults.gyro.sense import gyro_sense
from fieldgrid.poses.gears.stations import TELL_GEARS
from fieldgrid.poses.smoother.declared import DRIFT, Constant

MOST_SCALE = 0.25
"""No gyro's scale is off by a larger share; what is has wrong axes or units."""

LEAST_UP_MPS2 = 5.0
"""An accelerometer that is the right way up feels twice as much of gravity."""

NOTED_SCALE, NOTED_SIGMAS = 0.05, 4.0
"""A scale that is off by more than both is reported. It is taken out like any other."""

PLAUSIBLE_SCALE = 0.3
"""A gyro whose scale is off by at most this share has the right axes and units."""

STEADY_M = 0.1
"""Fixes that state less do not wander: the gyro is wrong."""

DOUBT, DOUBTFUL_SHARE = 0.02, 0.1
"""Where the doubt of gears is larger than the first in more than the second as a share of the
drive, gears may be wrong, which contradicts a gyro as well."""

NEAR_S = 2.0
"""Two headings that cross agree for a moment; how far they are apart is the most around it."""

CHECK = (
    "Check imu_axes (it may be upside down), its unit (rad/s), its stamps and how far the antenna "
    "sits ahead of the axle."
)

GEARS_UNSURE = f"Or the gears are wrong, which are in doubt: {TELL_GEARS}."


class GyroVerdict(NamedTuple):
    """A drive and its motion with a gyro that fits, or without one; what is wrong with it, None
    where nothing is. `unsure_deg` [n] is how far the headings with it and without it are apart at
    the nodes where nobody knows which of them is right, else 0."""

    drive: DriveEstimate
    motion: Motion
    unsure_deg: Float64
    finding: Finding | None = None


def without_wrong_gyro(fixes: AcceptedFixes, motion: Motion) -> tuple[Motion, Finding | None]:
    """The motion without a gyro that turns otherwise than the path, or of which the drive does not
    show which way it turns, as its accelerometer does not either; and what was wrong with it."""
    gyro = motion.gyro
    if gyro is None or len(gyro.time_ns) < 2:
        return motion, None
    before_s, after_s = (fixes.time_ns[[0, -1]] - gyro.time_ns[[-1, 0]]) / 1e9
    if max(before_s, -after_s) > 0.0:
        apart_s, side = (
            (before_s, "ends {} before") if before_s > 0.0 else (-after_s, "begins {} after")
        )
        return motion._replace(gyro=None, inertial=None), warning(
            "gyro-unused",
            f"The gyro {side.format(f'{apart_s:.1f} s')} the fixes, so it was not used.",
            "If their clocks differ, give --gnss-offset, or time_zone where the log has local "
            "time.",
            Figure(apart_s, "s"),
        )
    sense = gyro_sense(fixes, motion.steps, gyro)
    if sense.is_wrong:
        why = (  # a camera shows whose turns are wrong
            "The path turns the other way than the gyro, so the gyro was not used."
            if motion.steps is not None
            else "The path turns the other way than the gyro, or is mirrored by longitudes that "
            "lost their sign, so the gyro was not used."
        )
    elif sense.is_unknown and not _feels_up(motion.inertial):
        why = (
            "The fixes do not show that the vehicle turns as its gyro does, be they too few or too "
            "noisy in turns, or the gyro another, so it was not used."
        )
    else:
        return motion, None
    return motion._replace(gyro=None, inertial=None), warning("gyro-unused", why, CHECK)


def _feels_up(sensed: Inertial | None) -> bool:
    """Whether the accelerometer of an IMU shows which way up it is, and with it its gyro."""
    if sensed is None or not sensed.feels_force():
        return False
    return float(np.nanmedian(sensed.force_mps2[:, 2])) > LEAST_UP_MPS2


def with_trusted_gyro(
    drive: DriveEstimate,
    fixes: AcceptedFixes,
    all_ns: Int64,
    motion: Motion,
    axle: Axle,
    hints: PoseSettings,
) -> GyroVerdict:
    """The drive with a gyro that fits, or without one."""
    found, scale = drive.smoothed.declared, drive.smoothed.gyro_scale
    fits = GyroVerdict(drive, motion, np.zeros(len(drive.time_ns)), _scale_finding(scale))
    wrong = scale is not None and abs(scale.value) > MOST_SCALE
    # Fixes that drift contradict a right gyro, too.
    if scale is None or not (wrong or (found.contradicts and not found.explains(DRIFT))):
        return fits
    if not wrong and (motion.steps is None or not len(motion.steps.start_ns)):
        return fits  # nothing else saw the turns, so the drive without it would tell nothing
    without = motion._replace(gyro=None, inertial=None)
    rest = smooth_drive(fixes, all_ns, without, axle, hints=hints)
    # What the camera confirms without the gyro was spoilt by it.
    if not wrong and not (rest.measured.sees_turns() and not rest.smoothed.declared.contradicts):
        return fits
    # One of nearly the right scale may be right where the fixes wander, and any where gears are in
    # doubt.
    wanders = float(np.median(fixes.sigma_m)) > STEADY_M
    moves, either = drive.gear != 0, wanders and abs(scale.value) < PLAUSIBLE_SCALE
    remedy = CHECK
    if moves.any() and float(np.mean(drive.doubt[moves] > DOUBT)) > DOUBTFUL_SHARE:
        either = True
        remedy = f"{CHECK} {GEARS_UNSURE}"
    return GyroVerdict(
        *(rest, without, apart_deg(rest, drive) * float(either)),
        warning("gyro-unused", "The gyro contradicts the drive and was not used.", remedy),
    )


def _scale_finding(scale: Constant | None) -> Finding | None:
    """That a gyro turns too much or too little."""
    if scale is None or abs(scale.value) < max(NOTED_SCALE, NOTED_SIGMAS * scale.sigma):
        return None
    too_large = -100.0 * scale.value
    return warning(
        "gyro-scale",
        f"The turns of the gyro are {abs(too_large):.1f} % ± {100.0 * scale.sigma:.1f} % too "
        f"{'large' if too_large > 0.0 else 'small'} beside the drive; that was taken out.",
        "Calibrate its scale.",
        Figure(too_large, "%"),
    )


def apart_deg(one: DriveEstimate, other: DriveEstimate) -> Float64:
    """How far two estimates of a drive are apart in heading at the nodes of the first."""
    heading_rad = np.unwrap(np.radians(other.heading_deg))
    beside_deg = np.degrees(np.interp(one.time_ns, other.time_ns, heading_rad))
    apart_deg = np.abs(wrap_deg(one.heading_deg - beside_deg))
    near_ns = np.linspace(-NEAR_S, NEAR_S, 17) * 1e9
    around = [np.interp(one.time_ns + by, one.time_ns, apart_deg) for by in near_ns]
    return np.asarray(np.max(around, axis=0))
