"""What wheels say of changes of gear."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.array_types import Bool, Float64
from fieldgrid.geodesy import Datum
from fieldgrid.motion import Motion, WheelSpeed
from fieldgrid.pose import estimate_poses
from fieldgrid.pose.gears import rolled
from fieldgrid.rig import Carrier
from tests.simulated import K_TURN, Command, fixes_of, simulate, time_ns

SECOND_NS = 1_000_000_000
DATUM = Datum(39.5, -1.1, 700.0)


def at_seconds(speed_mps: Float64, every_s: float = 0.1) -> Bool:
    """Of instants a second apart, from wheels that begin a while before and end a while after."""
    time_s = every_s * np.arange(len(speed_mps)) - 3.0
    wheels = WheelSpeed(np.round(time_s * 1e9).astype(np.int64), speed_mps)
    return rolled(np.arange(11, dtype=np.int64) * SECOND_NS, wheels)


def test_wheels_that_turn_all_the_time_have_rolled() -> None:
    assert at_seconds(np.full(200, 1.0)).all()
    assert at_seconds(np.full(200, -1.0)).all()


@pytest.mark.parametrize("stop", [np.zeros(5), np.full(1, 0.2), np.full(3, np.nan)])
def test_a_stop_or_a_gap_counts_for_a_second_around(stop: Float64) -> None:
    speed_mps = np.full(200, 1.0)
    speed_mps[80 : 80 + len(stop)] = stop  # 5 s on
    told = at_seconds(speed_mps)
    assert not told[[5, 6]].any()
    assert told[[0, 1, 2, 3, 8, 9, 10]].all()


def test_wheels_that_turn_back_from_one_sample_to_the_next_have_stopped() -> None:
    speed_mps = np.concatenate([np.full(80, 1.0), np.full(120, -1.0)])
    assert not at_seconds(speed_mps)[[5, 6]].any()


def test_wheels_of_few_samples_and_those_elsewhere_tell_nothing() -> None:
    assert not at_seconds(np.full(40, 1.0), every_s=0.5).any()
    assert not rolled(np.arange(5, dtype=np.int64) * SECOND_NS + 90 * SECOND_NS, None).any()
    late = WheelSpeed(np.arange(50, dtype=np.int64) * 100_000_000, np.full(50, 1.0))
    assert not rolled(np.arange(5, dtype=np.int64) * SECOND_NS + 90 * SECOND_NS, late).any()


def test_poor_fixes_turn_no_vehicle_back_whose_wheels_turn_on() -> None:
    """Half a metre of noise: without wheels a part of the drive is in reverse."""
    drive = simulate([Command(60.0, 1.0), Command(20.0, 1.0, 0.1), Command(60.0, 1.0)], 35.0)
    fixes = fixes_of(drive, 0.4, 0.5, seed=4)
    speed = drive.every(0.1)
    wheels = WheelSpeed(time_ns(speed.time_s), np.abs(speed.speed_mps))
    found = estimate_poses(fixes, Carrier(0.0), DATUM, motion=Motion(wheels=wheels))
    assert (found.trajectory.gear >= 0).mean() > 0.99


def test_real_changes_of_gear_are_seen_beside_unsigned_wheels() -> None:
    drive = simulate(K_TURN, 35.0)
    speed = drive.every(0.1)
    wheels = WheelSpeed(time_ns(speed.time_s), np.abs(speed.speed_mps))
    found = estimate_poses(
        fixes_of(drive, 0.2, 0.01), Carrier(0.0), DATUM, motion=Motion(wheels=wheels)
    )
    truth = drive.at((found.trajectory.time_ns - found.trajectory.time_ns[0]) / 1e9)
    backward = truth.speed_mps < -0.3
    assert backward.any()
    assert (found.trajectory.gear[backward] == -1).mean() > 0.95
