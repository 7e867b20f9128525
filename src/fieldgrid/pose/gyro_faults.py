"""Samples of a gyro that no vehicle makes: a sensor that is stuck, a word that was spoilt."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.motion import Gyro, Inertial, Motion

MOST_RATE_RAD_S = 2.0 * np.pi
"""No vehicle that maps turns around faster than once in a second."""

FEW = 0.01
"""Of a gyro of which more samples are so, it is how it is logged: its unit, or its resolution."""

STUCK_S, MOST_STUCK = 1.0, 0.4
"""For so long a working gyro does not say the same to the last digit, if it hardly ever does; and
it is not stuck for a larger share of a drive."""

FEWEST_SAMPLES = 2
"""Of fewer samples a gyro tells no turn."""


def without_faulty_samples(motion: Motion) -> tuple[Motion, str | None]:
    """The motion without samples of its gyro that are spoilt or stuck, and a sentence on them, None
    where there are none. Those of a whole IMU are left out of it, too."""
    gyro = motion.gyro
    if gyro is None or len(gyro.time_ns) < 2:
        return motion, None
    wild = np.abs(gyro.rate_rad_s) > MOST_RATE_RAD_S
    wild &= bool(wild.mean() < FEW)
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
    note = f"Of {len(faulty)} samples of the gyro {' and '.join(said)}; they were left out."
    return without_samples(motion, faulty), note


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
