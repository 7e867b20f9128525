"""Samples of a gyro that is stuck or spoilt are left out, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.geometry import Gyro, Inertial, Motion
from fieldgrid.poses.faults.gyro.dead_gyro import without_faulty_samples

N = 6000
TIME_NS = np.arange(N) * 10_000_000


def motion(rate_rad_s: Float64, *, whole: bool = False) -> Motion:
    sensed = None
    if whole:
        rates = np.stack([0.0 * rate_rad_s, 0.0 * rate_rad_s, -rate_rad_s], axis=1)
        sensed = Inertial(TIME_NS, rates.astype(np.float32), np.ones((N, 3), np.float32))
    return Motion(gyro=Gyro(TIME_NS, rate_rad_s), inertial=sensed)


def noisy() -> Float64:
    return np.random.default_rng(1).normal(0.0, 0.02, N)


@pytest.mark.parametrize("whole", [False, True])
def test_spoilt_words_and_a_stuck_sensor_are_left_out(whole: bool) -> None:
    rate = noisy()
    rate[[7, 1007, 2007]] = 50.0, -900.0, np.float64(np.finfo(np.float32).max)
    rate[3000:4000] = rate[3000]
    found, note = without_faulty_samples(motion(rate, whole=whole))
    assert note is not None
    assert "Of 6000 samples of the gyro 3 turn faster than 360°/s and 1000 repeat" in note
    assert found.gyro is not None
    kept = np.setdiff1d(np.arange(N), [7, 1007, 2007, *range(3000, 4000)])
    np.testing.assert_array_equal(found.gyro.time_ns, TIME_NS[kept])
    np.testing.assert_array_equal(found.gyro.rate_rad_s, rate[kept])
    assert (found.inertial is None) is not whole
    if found.inertial is not None:
        np.testing.assert_array_equal(found.inertial.time_ns, TIME_NS[kept])
        assert len(found.inertial.force_mps2) == len(found.inertial.rate_rad_s) == len(kept)


def in_degrees() -> Float64:
    turning = np.sin(np.arange(N) / 300.0)
    return np.degrees(noisy() + 0.5 * turning)


def coarse() -> Float64:
    return np.asarray(np.round(noisy() / 2.0, 2))


def at_rest_and_turning() -> Float64:
    """A gyro that hardly says anything else at rest, as coarse ones do."""
    rate = np.zeros(N)
    rate[4000:] = np.round(0.3 + noisy()[4000:], 2)
    return rate


def without_noise() -> Float64:
    """Rows and turns of a simulator."""
    return np.where(np.arange(N) % 1500 < 1000, 0.0, np.sin(np.arange(N) / 70.0))


@pytest.mark.parametrize(
    "rate", [noisy(), in_degrees(), coarse(), at_rest_and_turning(), without_noise()]
)
def test_what_a_gyro_always_says_is_left_as_it_is(rate: Float64) -> None:
    given = motion(rate)
    assert without_faulty_samples(given) == (given, None)
