"""What sensors say at the nodes of a drive."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Carrier, Datum, Motion, WheelSpeed
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.fused import conditioned
from fieldgrid.poses.measured import measurements, wheel_speed_at
from fieldgrid.poses.nodes import nodes
from tests.simulated import Command, fixes_of, simulate

DATUM = Datum(39.5, -1.1, 700.0)
SECOND = 1_000_000_000


def test_wheels_say_nothing_beyond_what_they_logged() -> None:
    stamps = np.array([0, 1, 2, 9, 10]) * SECOND
    wheels = WheelSpeed(stamps, np.array([1.0, 2.0, np.nan, 3.0, 4.0]))
    at = np.array([-SECOND, 0, SECOND // 2, 5 * SECOND, 9 * SECOND, 11 * SECOND])
    told = wheel_speed_at(at, wheels)
    assert told[[1, 2, 4]].tolist() == [1.0, 1.5, 3.0]
    assert np.isnan(told[[0, 3, 5]]).all()
    assert np.isnan(wheel_speed_at(at, WheelSpeed(stamps[:1], np.array([1.0])))).all()


def test_wheels_that_stop_logging_vouch_for_no_gear() -> None:
    """Forward, then long back the same way; the log of the wheels ends before that."""
    drive = simulate([Command(15.0, 1.5, 0.02), Command(3.0, 0.0), Command(12.0, -1.5, 0.02)], 30.0)
    fixes = fixes_of(drive, 0.2, 0.01)
    start_ns = int(fixes.time_ns[0])
    stamps = start_ns + (np.arange(0.0, 14.0, 0.1) * 1e9).astype(np.int64)
    wheels = WheelSpeed(stamps, np.full(len(stamps), 1.5))
    found = estimate_poses(fixes, Carrier(0.0), DATUM, motion=Motion(wheels=wheels)).trajectory
    truth = drive.at((found.time_ns - start_ns) / 1e9)
    back = found.accepted & (truth.speed_mps < -0.3)
    assert back.sum() > 20
    assert (found.gear[back] == -1).all()


@pytest.mark.parametrize("period_s", [0.1, 0.99, 1.01, 2.0, 5.0])
def test_late_stamps_spread_fixes_along_the_way_at_any_rate(period_s: float) -> None:
    drive = simulate([Command(60.0, 2.0)], 30.0, speed_mps=2.0)
    fixes = conditioned(fixes_of(drive, period_s), PoseSettings(), DATUM).accepted
    fixes = fixes._replace(noise=fixes.noise._replace(late_s=0.1))
    at = nodes(fixes.time_ns, fixes.time_ns, Motion())
    n = len(at.time_ns)
    found = measurements(fixes, at, np.zeros(n, np.bool_), Motion(), np.ones(n, np.int64), None)
    along_m, across_m = found.fix_sigma_m[at.fix >= 0].T
    assert np.sqrt(along_m**2 - across_m**2) == pytest.approx(0.2, abs=0.02)
