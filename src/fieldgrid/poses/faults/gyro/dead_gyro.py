"""A gyro that says the same for long while the path turns: a sensor that died, or a driver that
hands out zeros.

What repeats is no fault by itself: a gyro without noise, of a simulator, says the same along each
straight row, and so does a coarse one. What the path does meanwhile tells them apart.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Bool, Figure, Finding, Float64, Int64, warning
from fieldgrid.geometry import Gyro, Inertial, Motion
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.gyro.check import CHECK
from fieldgrid.poses.faults.gyro.sense import course_lines

# Samples of a gyro that no vehicle makes: a sensor that is stuck, a word that was spoilt.


MOST_RATE_RAD_S = 2.0 * np.pi
"""No vehicle that maps turns around faster than once in a second."""

FEW = 0.01
"""Of a gyro of which more samples are so, it is how it is logged: its unit, or its resolution."""

STUCK_S, MOST_STUCK = 1.0, 0.4
"""For so long a working gyro does not say the same to the last digit, if it hardly ever does; and
it is not stuck for a larger share of a drive."""

FEWEST_SAMPLES = 2
"""Of fewer samples a gyro tells no turn."""


def without_faulty_samples(motion: Motion) -> tuple[Motion, Finding | None]:
    """The motion without samples of its gyro that are spoilt or stuck, and a finding on them, None
    where there are none. Those of a whole IMU are left out of it, too."""
    gyro = motion.gyro
    if gyro is None or len(gyro.time_ns) < 2:
        return motion, None
    wild = np.abs(gyro.rate_rad_s) > MOST_RATE_RAD_S
    if wild.mean() > FEW:
        return motion._replace(gyro=None, inertial=None), warning(
            "gyro-unused",
            f"The gyro turns faster than {np.degrees(MOST_RATE_RAD_S):.0f}°/s in "
            f"{100.0 * wild.mean():.0f} % of its samples, which no vehicle does, so it was not "
            "used.",
            CHECK,
        )
    # Runs of equal values that last, of a gyro that is not used to say the same twice.
    first, last = runs_of_equal_rates(gyro.rate_rad_s)
    long = (gyro.time_ns[last] - gyro.time_ns[first]) / 1e9 > STUCK_S
    brief = ~long
    again = float((last - first)[brief].sum()) / max(float((last - first + 1)[brief].sum()), 1.0)
    stuck = np.repeat(long, last - first + 1)
    # A gyro without noise, of a simulator, says the same along each straight row.
    stuck &= bool(again < FEW and stuck.mean() < MOST_STUCK)
    faulty = wild | stuck
    if not faulty.any():
        return motion, None
    said = [
        f"{int(wrong.sum())} {what}"
        for wrong, what in (
            (wild, f"turn faster than {np.degrees(MOST_RATE_RAD_S):.0f}°/s"),
            (stuck & ~wild, f"repeat the same value for more than {STUCK_S:g} s"),
        )
        if wrong.any()
    ]
    told = f"Of {len(faulty)} samples of the gyro {' and '.join(said)}; they were left out."
    return without_samples(motion, faulty), warning("gyro-samples", told)


def without_samples(motion: Motion, faulty: Bool) -> Motion:
    """The motion without some samples of its gyro, and without the same ones of its IMU; without a
    gyro where too few are left."""
    gyro, sensed = motion.gyro, motion.inertial
    if gyro is None or np.count_nonzero(~faulty) < FEWEST_SAMPLES:
        return motion._replace(gyro=None, inertial=None)
    if sensed is not None:
        kept = ~np.isin(sensed.time_ns, gyro.time_ns[faulty])
        sensed = Inertial(sensed.time_ns[kept], sensed.rate_rad_s[kept], sensed.force_mps2[kept])
    gyro = Gyro(gyro.time_ns[~faulty], gyro.rate_rad_s[~faulty])
    return motion._replace(gyro=gyro, inertial=sensed)


def runs_of_equal_rates(rate_rad_s: Float64) -> tuple[Int64, Int64]:
    """The first and the last sample [r] of each run of samples that say the same."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(rate_rad_s) != 0.0, [True]]))
    return edges[:-1], edges[1:] - 1


LONG_S = 5.0
"""A shorter run spoils no heading."""

FEWEST_LINES, IN_A_ROW, OFF_RAD = 6, 3, np.radians(30.0)
"""Least number of lines of the path, which are good to 14° each; the number of them in a row that
are off, since between two rows of a field there are no more; and by how much they are off."""


def without_dead_gyro(fixes: AcceptedFixes, motion: Motion) -> tuple[Motion, Finding | None]:
    """The motion without the samples of its gyro during which it said the same and the path turned
    otherwise, and a finding on them, None where there are none."""
    gyro = motion.gyro
    if gyro is None or len(gyro.time_ns) < 2:
        return motion, None
    time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
    runs = np.stack(runs_of_equal_rates(gyro.rate_rad_s), axis=1)
    runs = runs[time_s[runs[:, 1]] - time_s[runs[:, 0]] > LONG_S]
    if len(runs) == 0:
        return motion, None
    dead, dead_s = np.zeros(len(gyro.time_ns), dtype=np.bool_), 0.0
    line_rad, line_s = course_lines(fixes, gyro)
    for first, last in runs.tolist():
        inside = (line_s >= time_s[first]) & (line_s <= time_s[last])
        if _turns(line_rad[inside], line_s[inside], gyro.rate_rad_s[first]):
            dead[first : last + 1] = True
            dead_s += float(time_s[last] - time_s[first])
    if not dead.any():
        return motion, None
    return without_samples(motion, dead), _told(gyro, dead, dead_s)


def _turns(line_rad: Float64, line_s: Float64, rate_rad_s: float) -> bool:
    """Whether lines turn otherwise than a vehicle that turns at one rate."""
    if len(line_rad) < FEWEST_LINES:
        return False
    # Of a line there are two directions, which twice its angle does not tell apart.
    twice = 2.0 * (line_rad - rate_rad_s * (line_s - line_s[0]))
    usual = np.median(np.stack([np.sin(twice), np.cos(twice)]), axis=1)
    off = np.abs(np.angle(np.exp(1j * (twice - np.arctan2(*usual))))) / 2.0 > OFF_RAD
    return bool((np.convolve(off, np.ones(IN_A_ROW), "valid") == IN_A_ROW).any())


def _told(gyro: Gyro, dead: Bool, dead_s: float) -> Finding:
    """What was left out, and what to look at."""
    if dead.all():
        rate_dps = float(np.degrees(gyro.rate_rad_s[0]))
        return warning(
            "gyro-unused",
            f"The gyro says {rate_dps:z.3g}°/s throughout while the path turns, so it was not "
            "used.",
            "Check the driver of the IMU and the column or topic of its rates.",
        )
    first_s = (gyro.time_ns[np.flatnonzero(dead)[0]] - gyro.time_ns[0]) / 1e9
    return warning(
        "gyro-samples",
        f"The gyro says the same for {dead_s:.0f} s (first {first_s:.0f} s after its start) while "
        "the path turns otherwise; these samples were left out.",
        "Check the driver of the IMU.",
        Figure(dead_s, "s"),
    )
