"""Sweeps of a lidar that moves and turns: times of any unit, and points carried to one instant."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import Datum, Mount, Status, Trajectory
from fieldgrid.perception import OriginTrack, Sweep, seconds_after

_Floats = npt.NDArray[np.float64]

STAMP_NS = 1_780_000_000_123_456_789
SPEED_MPS, RATE_RAD_S, LASTS_S = 2.0, 0.5, 0.1
WALL_NORTH_M = 12.0
MOUNT = Mount(1.9, 8.0, -3.0, 20.0)


class Poses(NamedTuple):
    """Where the lidar is, on an arc to the right, and its heading, radians."""

    east_m: _Floats
    north_m: _Floats
    heading_rad: _Floats


def poses(after_s: npt.ArrayLike) -> Poses:
    after = np.asarray(after_s, dtype=np.float64)
    heading = 0.3 + RATE_RAD_S * after
    radius_m = SPEED_MPS / RATE_RAD_S
    return Poses(
        radius_m * (math.cos(0.3) - np.cos(heading)),
        radius_m * (np.sin(heading) - math.sin(0.3)),
        heading,
    )


def trajectory() -> Trajectory:
    """The arc, at 50 Hz, with one fix that was rejected and lies far off."""
    after_s = np.arange(-20, 21) / 50.0
    at, n = poses(after_s), len(after_s)
    east, status = at.east_m.copy(), [Status.OK] * n
    east[21], status[21] = 99.0, Status.REJECTED
    return Trajectory(
        datum=Datum(41.6, -4.7, 700.0),
        time_ns=STAMP_NS + np.rint(after_s * 1e9).astype(np.int64),
        east_m=east,
        north_m=at.north_m,
        up_m=np.zeros(n),
        heading_deg=np.degrees(at.heading_rad),
        position_sigma_m=np.full(n, 0.02),
        heading_sigma_deg=np.full(n, 0.2),
        speed_mps=np.full(n, SPEED_MPS),
        gear=np.ones(n, dtype=np.int64),
        quality=np.full(n, 4, dtype=np.int64),
        status=tuple(status),
        reason=("",) * n,
        heading_source="smooth",
    )


def seen_wall() -> Sweep:
    """What the lidar sees of a wall along the east in one turn, point by point."""
    after_s = np.linspace(-0.2 * LASTS_S, 0.8 * LASTS_S, 4000)
    at = poses(after_s)
    east = np.linspace(-15.0, 15.0, len(after_s))
    up = 0.5 + 0.3 * np.sin(np.arange(len(after_s)))
    d_east, d_north = east - at.east_m, WALL_NORTH_M - at.north_m
    sin, cos = np.sin(at.heading_rad), np.cos(at.heading_rad)
    vehicle = np.stack([d_east * cos - d_north * sin, d_east * sin + d_north * cos, up], axis=1)
    points = (vehicle @ MOUNT.rotation()).astype(np.float32)
    return Sweep(points, after_s.astype(np.float32))


def wall_off_m(points: npt.NDArray[np.float32]) -> _Floats:
    """How far points are off the wall, metres, if all were seen from where the lidar was at the
    stamp."""
    x, y, _ = MOUNT.rotation() @ points.astype(np.float64).T
    heading = float(poses(0.0).heading_rad)
    return np.asarray(y * math.cos(heading) - x * math.sin(heading) - WALL_NORTH_M)


def test_a_wall_stays_a_wall() -> None:
    sweep = seen_wall()
    raw = np.abs(wall_off_m(sweep.points_m))
    carried = OriginTrack.of(trajectory()).carried(sweep, STAMP_NS, MOUNT.rotation())
    mended = np.abs(wall_off_m(carried))
    assert raw.max() > 0.4  # 44 cm at the end of the sweep
    assert np.percentile(raw, 95) > 20 * np.percentile(mended, 95)
    assert mended.max() < 0.005
    assert carried.dtype == np.float32
    # The heights are those that were seen.
    up = MOUNT.rotation()[2]
    np.testing.assert_allclose(carried @ up, sweep.points_m @ up, atol=1e-5)


def test_it_is_carried_the_right_way_round() -> None:
    """Carried the wrong way, the wall is twice as crooked."""
    sweep = seen_wall()
    assert sweep.after_s is not None
    back = OriginTrack.of(trajectory()).carried(sweep._replace(after_s=-sweep.after_s), STAMP_NS,
                                        MOUNT.rotation())  # fmt: skip
    assert np.abs(wall_off_m(back)).max() > 0.8


def test_points_without_times_stay_as_they_are() -> None:
    points = seen_wall().points_m
    assert OriginTrack.of(trajectory()).carried(Sweep(points), STAMP_NS, MOUNT.rotation()) is points


SINCE_S = np.linspace(0.0, 0.0999, 1000)


@pytest.mark.parametrize(
    ("times", "first_s"),
    [
        (SINCE_S.astype(np.float32), 0.0),
        ((SINCE_S - 0.0999).astype(np.float32), -0.0999),  # the stamp is the end of the turn
        (np.rint(SINCE_S * 1e9).astype(np.uint32), 0.0),
        (np.rint(SINCE_S * 1e6).astype(np.int32), 0.0),
        (SINCE_S * 1e3, 0.0),
        (STAMP_NS / 1e9 + SINCE_S, 0.0),
        (STAMP_NS + SINCE_S * 1e9, 0.0),
        (STAMP_NS + np.rint(SINCE_S * 1e9).astype(np.int64), 0.0),
        (STAMP_NS / 1e9 - 0.05 + SINCE_S, -0.05),
        (SINCE_S[::-1].astype(">f8"), 0.0999),
    ],
)
def test_the_span_of_the_times_tells_their_unit(
    times: npt.NDArray[np.generic], first_s: float
) -> None:
    found = seconds_after(times, STAMP_NS)
    assert found is not None
    backwards = -1.0 if first_s > 0.0 else 1.0
    np.testing.assert_allclose(found, first_s + backwards * SINCE_S, atol=2e-6)


@pytest.mark.parametrize(
    "times",
    [
        np.zeros(1000, dtype=np.float32),  # a driver that does not fill them
        SINCE_S[:50],  # too few
        STAMP_NS / 1e9 + 18.0 + SINCE_S,  # GPS time
        12_345.0 + SINCE_S,  # since the machine was started
        np.where(SINCE_S > 0.05, np.nan, SINCE_S),
        np.linspace(0.0, 1e18, 1000),
    ],
)
def test_what_are_no_times_of_a_sweep_is_left(times: npt.NDArray[np.generic]) -> None:
    assert seconds_after(times, STAMP_NS) is None
