"""The way of the vehicle just now, by gyro and wheels, without an estimate of its poses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.geometry import Datum, Status, Trajectory
from fieldgrid.live.pose.dead_reckoning import ROLLED_S, DeadReckoning
from fieldgrid.live.pose.sensor_rows import MOST_NEW, RecentRows, rows_of
from fieldgrid.perception import CameraStep

START_NS = 1_700_000_000_000_000_000
SPEED_MPS, RATE_RAD_S = 2.0, 0.5


def at_ns(seconds: float) -> int:
    return START_NS + round(1e9 * seconds)


def rows(
    going: DeadReckoning, part: str, value: float, until_s: float, from_s: float = 0.0
) -> None:
    for seconds in np.arange(from_s, until_s, 0.05):
        going._rows.add(part, rows_of(part, at_ns(float(seconds)), value))


def estimate(until_s: float, bias_rad_s: float = 0.0) -> Any:
    """An estimate of a drive in a circle to the right."""
    report = SimpleNamespace(gyro_bias_dps=float(np.degrees(bias_rad_s)))
    return SimpleNamespace(trajectory=track(until_s), report=report)


def track(until_s: float, rate_rad_s: float = RATE_RAD_S) -> Trajectory:
    seconds: Float64 = np.arange(0.0, until_s + 1e-9, 0.2)
    heading, n = rate_rad_s * seconds, len(seconds)
    radius_m = SPEED_MPS / RATE_RAD_S
    return Trajectory(
        Datum(41.65, -4.72, 700.0),
        np.array([at_ns(float(s)) for s in seconds], dtype=np.int64),
        radius_m * (1.0 - np.cos(heading)),
        radius_m * np.sin(heading),
        np.zeros(n),
        np.degrees(heading),
        np.full(n, 0.02),
        np.full(n, 0.3),
        np.full(n, SPEED_MPS),
        np.ones(n, np.int64),
        np.full(n, 4),
        (Status.OK,) * n,
        ("",) * n,
        "smooth",
    )


def test_a_step_is_the_arc_of_gyro_and_wheels() -> None:
    going = DeadReckoning(RecentRows(), 0.0)
    rows(going, "gyro", RATE_RAD_S, 3.0)
    rows(going, "wheels", SPEED_MPS, 3.0)
    step = going.step(at_ns(2.0), at_ns(2.8))
    assert isinstance(step, CameraStep)
    turn_rad, radius_m = 0.8 * RATE_RAD_S, SPEED_MPS / RATE_RAD_S
    assert step.turn_deg == pytest.approx(np.degrees(turn_rad), abs=1e-6)
    assert step.forward_m == pytest.approx(radius_m * np.sin(turn_rad), abs=1e-3)
    assert step.right_m == pytest.approx(radius_m * (1.0 - np.cos(turn_rad)), abs=1e-3)
    assert 0.01 < step.sigma_m < 0.1
    # An origin 1 m before the axle slides to the outside.
    ahead = DeadReckoning(RecentRows(), -1.0)
    rows(ahead, "gyro", RATE_RAD_S, 3.0)
    rows(ahead, "wheels", SPEED_MPS, 3.0)
    outer = ahead.step(at_ns(2.0), at_ns(2.8))
    assert outer is not None
    assert outer.right_m - step.right_m == pytest.approx(np.sin(turn_rad), abs=1e-3)
    assert outer.forward_m - step.forward_m == pytest.approx(np.cos(turn_rad) - 1.0, abs=1e-3)


def test_what_nothing_tells_is_not_made_up() -> None:
    going = DeadReckoning(RecentRows(), None)
    assert going.around(at_ns(1.0)) is None
    rows(going, "gyro", RATE_RAD_S, 3.0)
    assert going.step(at_ns(2.0), at_ns(2.8)) is None  # no speed
    going.know(estimate(2.0))
    assert going.step(at_ns(2.0), at_ns(2.8)) is not None
    assert going.around(at_ns(2.9)) is not None
    assert going.around(at_ns(4.0)) is None  # the gyro is silent
    assert going.step(at_ns(2.0), at_ns(2.0)) is None
    assert going.step(at_ns(1.0), at_ns(1.1 + ROLLED_S)) is None
    rows(going, "gyro", RATE_RAD_S, 6.0, from_s=5.0)
    assert going.around(at_ns(5.5)) is None  # the estimate is too old
    assert going.around(at_ns(4.4)) is None  # a hole in the gyro


def test_an_estimate_tells_the_gyros_bias() -> None:
    going = DeadReckoning(RecentRows(), None)
    rows(going, "gyro", RATE_RAD_S + 0.05, 12.0)
    going.know(estimate(11.8, 0.05))
    step = going.step(at_ns(11.0), at_ns(12.0))
    assert step is not None
    assert step.turn_deg == pytest.approx(np.degrees(RATE_RAD_S), abs=0.05)
    assert step.sigma_m > 0.3  # where wheels do not tell it, the speed may change


def test_rows_come_in_any_order_and_old_ones_go() -> None:
    going = DeadReckoning(RecentRows(), None)
    rows(going, "wheels", SPEED_MPS, 60.0)
    rows(going, "gyro", RATE_RAD_S, 60.0, from_s=59.0)
    rows(going, "gyro", RATE_RAD_S, 59.0, from_s=50.0)
    assert going.step(at_ns(55.0), at_ns(55.5)) is not None
    assert len(going._rows.track("wheels", 1).time_ns) <= 15 * 20 + 1
    for _ in range(2 * MOST_NEW):
        going._rows.add("wheels", rows_of("wheels", at_ns(60.0), SPEED_MPS))
    assert len(going._rows._rows["wheels"]) < MOST_NEW
