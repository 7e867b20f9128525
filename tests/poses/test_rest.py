"""When a vehicle stood still."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import Motion, Status
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.drive import at_rest
from tests.simulated import DATUM, STOP, Command, Drive, fixes_of, simulate, steps_of

_Float64 = npt.NDArray[np.float64]


def resting(
    drive: Drive, noise_m: float, speed_mps: _Float64 | None = None
) -> npt.NDArray[np.bool_]:
    n = len(drive.time_s)
    random = np.random.default_rng(1)
    east, north = (axis + random.normal(0.0, noise_m, n) for axis in drive[1:3])
    told = np.full(n, np.nan) if speed_mps is None else speed_mps
    return at_rest(drive.time_s, east, north, np.full(n, noise_m), told)


@pytest.mark.parametrize("period_s", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("noise_m", [0.005, 0.05])
@pytest.mark.parametrize("told", [True, False])
def test_a_stop_is_seen_and_nothing_else(period_s: float, noise_m: float, told: bool) -> None:
    drive = simulate(STOP, 20.0, speed_mps=1.5).every(period_s)
    found = resting(drive, noise_m, drive.speed_mps if told else None)
    still = drive.speed_mps < 0.001
    inside = still & (drive.time_s > 18.5) & (drive.time_s < 25.0)
    assert inside.any()
    # Three fixes a window, 5 cm of noise: now and then one seems to have moved.
    assert np.mean(found[inside]) > 0.8
    assert found[inside].all() or (period_s, noise_m, told) == (1.0, 0.05, False)
    assert not found[drive.speed_mps > 0.4].any()


def test_a_crawl_is_no_stop() -> None:
    drive = simulate([Command(60.0, 0.2)], 20.0).every(0.2)
    assert not resting(drive, 0.005)[10:].any()
    assert not resting(drive, 0.005, drive.speed_mps)[10:].any()


def test_a_receiver_that_always_says_zero_is_not_believed() -> None:
    drive = simulate(STOP, 20.0, speed_mps=1.5).every(0.2)
    found = resting(drive, 0.01, np.zeros(len(drive.time_s)))
    assert not found[drive.speed_mps > 0.4].any()
    assert found[(drive.time_s > 18.5) & (drive.time_s < 25.0)].all()


def test_speeds_in_another_unit_are_not_believed() -> None:
    drive = simulate([Command(20.0, 1.5), Command(10.0, 0.15), Command(20.0, 1.5)]).every(0.2)
    kmh = resting(drive, 0.005, drive.speed_mps * 3.6)
    assert not kmh.any()  # 0.15 m/s is 0.54 km/h
    knots = resting(drive, 0.005, drive.speed_mps / 3.6)
    assert not knots[drive.time_s > 3.0].any()


def test_where_the_receiver_says_it_stands_its_positions_may_wander() -> None:
    n = 200
    time_s = np.arange(n) * 0.2
    east = np.where(time_s < 20.0, 1.5 * time_s, 30.0)
    speed = np.where(time_s < 20.0, 1.5, 0.0)
    wander = np.where(time_s < 20.0, 0.0, 0.15 * (time_s - 20.0))
    noise_m = np.full(n, 0.01)
    told = at_rest(time_s, east, wander, noise_m, speed)
    untold = at_rest(time_s, east, wander, noise_m, np.full(n, np.nan))
    late = time_s > 23.0
    assert told[late].all()
    assert not untold[late].any()


def test_where_and_when_does_not_matter() -> None:
    drive = simulate(STOP, 20.0).every(0.2)
    moved = drive._replace(
        time_s=drive.time_s + 5000.0, east_m=drive.north_m - 400.0, north_m=drive.east_m + 70.0
    )
    noise_m, told = np.full(len(drive.time_s), 0.01), np.full(len(drive.time_s), np.nan)
    found = (at_rest(d.time_s, d.east_m, d.north_m, noise_m, told) for d in (drive, moved))
    assert np.array_equal(*found)


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_fixes_say_nothing(n: int) -> None:
    zero, nan = np.zeros(n), np.full(n, np.nan)
    assert not at_rest(np.arange(n) * 0.2, zero, zero, zero + 0.01, nan).any()


def test_a_vehicle_rests_during_a_step_of_the_camera_that_reaches_beyond_the_stop() -> None:
    drive = simulate(STOP, 20.0, speed_mps=1.5)
    motion = Motion(steps=steps_of(drive, 10.0, noise=1.0))
    track = estimate_poses(
        fixes_of(drive, 0.2, 0.02, seed=1), None, DATUM, motion=motion
    ).trajectory
    second = (track.time_ns - track.time_ns[0]) / 1e9
    inside = (second > 19.0) & (second < 24.0)
    assert (track.gear[inside] == 0).all()
    assert {track.status[k] for k in np.flatnonzero(inside)} == {Status.HELD}
