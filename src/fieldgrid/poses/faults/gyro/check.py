"""A gyro that contradicts the drive, and a drive without it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Gyro, Inertial, Motion, first_beyond, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import DriveEstimate, smooth_drive
from fieldgrid.poses.faults.gyro.sense import gyro_sense
from fieldgrid.poses.faults.leaps.leaps import usual_period_s
from fieldgrid.poses.gears.stations import TELL_GEARS, GearHints
from fieldgrid.poses.smoother.declared import Constant

MOST_SCALE = 0.25
"""No gyro's scale is off by a larger share; what is has wrong axes or units."""

REACH_M, REACH_NOISES, MOST_S = 1.5, 10.0, 10.0
"""The path's turn is that between chords of this length, or of this multiple of the noise, driven
in at most this time each."""

LEAST_TURN_RAD = np.radians(3.0)
"""Turns that scatter by less tell nothing."""

MOST_PERIODS = 2.5
"""Fixes that are farther apart than this number of usual periods have a hole between them."""

LEAST_UP_MPS2 = 5.0
"""An accelerometer that is the right way up feels twice as much of gravity."""

MOST_TURN_RAD = np.radians(60.0)
"""A path that turns by more within two chords has a cusp."""

WRONG_RATIO, WRONG_SIGMAS, RELATED_SIGMAS = 0.4, 5.0, 2.5
"""A gyro that differs from the path's turns by more than this share and this number of sigmas has
wrong axes or units: an antenna ahead of the axle or a scale make less."""

FEWEST_TURNS, HUBER, ROUNDS = 6, 1.5, 8

NOTED_SCALE, NOTED_SIGMAS = 0.05, 4.0
"""A scale that is off by more than both is reported. It is taken out like any other."""

PLAUSIBLE_RATIO = 0.3
"""A gyro that differs from the path's turns by at most this share has the right axes and units."""

STEADY_M = 0.1
"""Fixes that state less do not wander: the gyro is wrong."""

DOUBT, DOUBTFUL_SHARE = 0.02, 0.1
"""Where the doubt of gears is larger than the first in more than the second as a share of the
drive, gears may be wrong, which contradicts a gyro as well."""

NEAR_S = 2.0
"""Two headings that cross agree for a moment; how far they are apart is the most around it."""

CHECK = (
    "was not used: check imu_axes (it may be upside down), its unit (rad/s), its stamps and how "
    "far the antenna sits ahead of the axle."
)

GEARS_UNSURE = f"Or the gears are wrong, which are in doubt: {TELL_GEARS}."


class GyroVerdict(NamedTuple):
    """A drive and its motion with a gyro that fits, or without one; what is wrong with it, None
    where nothing is. `unsure_deg` [n] is how far the headings with it and without it are apart at
    the nodes where nobody knows which of them is right, else 0."""

    drive: DriveEstimate
    motion: Motion
    unsure_deg: Float64
    note: str | None = None

    def unsure_at(self, time_ns: Int64) -> Float64:
        """By how much headings are unsure at other instants, degrees."""
        return np.asarray(np.interp(time_ns, self.drive.time_ns, self.unsure_deg))


class TurnRatio(NamedTuple):
    """What the path turns for each radian of the gyro, with its 1-sigma error."""

    value: float
    sigma: float

    @property
    def is_wrong(self) -> bool:
        """Whether the ratio is farther from 1 than that of any gyro with the right axes and
        units."""
        # Turns that have nothing to do with each other are of other moments: a clock is wrong.
        related = abs(self.value) > RELATED_SIGMAS * self.sigma
        return related and abs(self.value - 1.0) > max(WRONG_RATIO, WRONG_SIGMAS * self.sigma)


def turn_ratio(fixes: AcceptedFixes, gyro: Gyro) -> TurnRatio | None:
    """The turns of the path beside those of the gyro, whose bias is free; in reverse the two turn
    alike. None where there are too few."""
    if len(fixes.time_ns) < 2:
        return None
    points, time_s = fixes.points_m(), (fixes.time_ns - gyro.time_ns[0]) / 1e9
    reach_m = max(REACH_M, REACH_NOISES * float(np.median(fixes.noise.across_m)))
    before, after = first_beyond(points, reach_m, -1), first_beyond(points, reach_m, 1)
    at = np.flatnonzero((before >= 0) & (after >= 0) & (after < len(points)))
    a, b = points[at] - points[before[at]], points[after[at]] - points[at]
    turned = np.arctan2(a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1], (a * b).sum(axis=1))
    start_s, stop_s = (
        (time_s[before[at]] + time_s[at]) / 2.0,
        (time_s[at] + time_s[after[at]]) / 2.0,
    )
    slowest_s = np.maximum(time_s[at] - time_s[before[at]], time_s[after[at]] - time_s[at])
    gyro_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
    rises = np.diff(gyro_s) * (gyro.rate_rad_s[1:] + gyro.rate_rad_s[:-1]) / 2.0
    angle = np.concatenate([[0.0], np.cumsum(rises)])
    told = np.interp(stop_s, gyro_s, angle) - np.interp(start_s, gyro_s, angle)
    use = (slowest_s < MOST_S) & (np.abs(turned) < MOST_TURN_RAD)
    use &= (start_s >= 0.0) & (stop_s <= gyro_s[-1])
    # What the path did in a hole of the fixes, a cusp say, no chord tells.
    step_s = np.diff(time_s)
    holes = np.concatenate([[0], np.cumsum(step_s > MOST_PERIODS * usual_period_s(step_s))])
    use &= holes[after[at]] == holes[before[at]]
    overlap = float(np.median((after - before)[at])) if len(at) else 1.0
    if use.sum() < FEWEST_TURNS * max(overlap / 2.0, 1.0):
        return None
    columns, off = np.column_stack([told, stop_s - start_s])[use], turned[use]
    weight, line, normal, scale = np.ones(len(off)), np.zeros(2), np.eye(2), 1.0
    for _ in range(ROUNDS):
        normal = columns.T @ (columns * weight[:, None])
        line = np.linalg.lstsq(normal, columns.T @ (weight * off), rcond=None)[0]
        away = np.abs(off - columns @ line)
        scale = max(1.4826 * float(np.median(away)), 1e-4)
        weight = np.minimum(HUBER * scale / np.maximum(away, 1e-12), 1.0)
    if np.std(columns[:, 0]) < LEAST_TURN_RAD:
        return None  # straight on there is only the gyro's noise
    # Neighbours share their chords.
    sigma = scale * np.sqrt(overlap * np.linalg.pinv(normal)[0, 0])
    return TurnRatio(float(line[0]), float(sigma))


def without_wrong_gyro(fixes: AcceptedFixes, motion: Motion) -> tuple[Motion, str | None]:
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
        note = (
            f"The gyro {side.format(f'{apart_s:.1f} s')} the fixes, so it was not used. If their "
            "clocks differ, give --gnss-offset, or time_zone where the log has local time."
        )
        return motion._replace(gyro=None, inertial=None), note
    ratio, sense = turn_ratio(fixes, gyro), gyro_sense(fixes, motion.steps, gyro)
    # One that turns by 140° where it stands and goes on in reverse leaves a path that turns by 40°
    # the other way. The lines of the fixes count a course and its reverse as one; the camera, which
    # vouches for the gyro beside fixes that are mirrored, does not count here.
    if (
        ratio is not None
        and ratio.is_wrong
        and not (ratio.value < 0.0 and gyro_sense(fixes, None, gyro).is_right)
    ):
        note = (
            f"For each degree of the gyro the path turns {ratio.value:.2g}° ± {ratio.sigma:.1g}°: "
            f"the gyro {CHECK}"
        )
    elif sense.is_wrong:
        note = f"The path turns the other way than the gyro: the gyro {CHECK}"
    # Turns that the fixes did show, and which do not tell the sense, are of other moments.
    elif sense.is_unknown and not (ratio is None and _feels_up(motion.inertial)):
        note = (
            "The fixes are too few or too noisy where the vehicle turned to show which way the "
            "gyro turns, so it was not used. Drive a curve with good reception."
        )
    else:
        return motion, None
    return motion._replace(gyro=None, inertial=None), note


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
    hints: GearHints,
) -> GyroVerdict:
    """The drive with a gyro that fits, or without one."""
    found, scale = drive.smoothed.declared, drive.smoothed.gyro_scale
    fits = GyroVerdict(drive, motion, np.zeros(len(drive.time_ns)), _scale_note(scale))
    wrong = scale is not None and abs(scale.value) > MOST_SCALE
    if scale is None or not (wrong or found.contradicts):
        return fits
    if not wrong and (motion.steps is None or not len(motion.steps.start_ns)):
        return fits  # nothing else saw the turns, so the drive without it would tell nothing
    without = motion._replace(gyro=None, inertial=None)
    rest = smooth_drive(fixes, all_ns, without, axle, hints=hints)
    # What the camera confirms without the gyro was spoilt by it.
    if not wrong and not (rest.turns_seen and not rest.smoothed.declared.contradicts):
        return fits
    # One that turns as the path does may be right where the fixes wander, and any where gears are
    # in doubt.
    gyro, moves = motion.gyro, drive.gear != 0
    ratio = None if gyro is None else turn_ratio(fixes, gyro)
    wanders = float(np.median(fixes.sigma_m)) > STEADY_M
    either = wanders and ratio is not None and abs(ratio.value - 1.0) < PLAUSIBLE_RATIO
    note = f"The gyro contradicts the drive and {CHECK}"
    if moves.any() and float(np.mean(drive.doubt[moves] > DOUBT)) > DOUBTFUL_SHARE:
        either = True
        note += f" {GEARS_UNSURE}"
    return GyroVerdict(rest, without, apart_deg(rest, drive) * float(either), note)


def _scale_note(scale: Constant | None) -> str | None:
    """That a gyro turns too much or too little."""
    if scale is None or abs(scale.value) < max(NOTED_SCALE, NOTED_SIGMAS * scale.sigma):
        return None
    size = "small" if scale.value > 0.0 else "large"
    return (
        f"The turns of the gyro are {100.0 * abs(scale.value):.1f} % ± "
        f"{100.0 * scale.sigma:.1f} % too {size} beside the drive; that was taken out. Calibrate "
        "its scale."
    )


def apart_deg(one: DriveEstimate, other: DriveEstimate) -> Float64:
    """How far two estimates of a drive are apart in heading at the nodes of the first."""
    heading_rad = np.unwrap(np.radians(other.heading_deg))
    beside_deg = np.degrees(np.interp(one.time_ns, other.time_ns, heading_rad))
    apart_deg = np.abs(wrap_deg(one.heading_deg - beside_deg))
    near_ns = np.linspace(-NEAR_S, NEAR_S, 17) * 1e9
    around = [np.interp(one.time_ns + by, one.time_ns, apart_deg) for by in near_ns]
    return np.asarray(np.max(around, axis=0))


def scaled(motion: Motion, size: float) -> Motion:
    """The motion with the rates of the IMU times `size`."""
    gyro, sensed = motion.gyro, motion.inertial
    if gyro is not None:
        gyro = gyro._replace(rate_rad_s=size * gyro.rate_rad_s)
    if sensed is not None:
        rates = (size * sensed.rate_rad_s).astype(sensed.rate_rad_s.dtype)
        sensed = sensed._replace(rate_rad_s=rates)
    return motion._replace(gyro=gyro, inertial=sensed)
