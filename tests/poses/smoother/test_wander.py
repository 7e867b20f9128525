"""Slow errors that wander by more than is stated of them."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Float64, PoseSettings
from fieldgrid.geometry import Carrier, FixColumns, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.model import BIAS_E
from fieldgrid.poses.smoother.wander import unstated_wander
from tests.simulated import DATUM, SLALOM, START, fixes_of, gyro_of, simulate

LASTS_S = 300.0


def measured_at(time_s: Float64, bias_m: Float64) -> Measurements:
    """Nodes of which nothing matters but the stated slow error."""
    n = len(time_s)
    none, no = np.full(n, np.nan), np.zeros(n, np.bool_)
    return Measurements(
        time_s=time_s,
        fix_m=np.full((n, 2), np.nan),
        fix_sigma_m=np.full((n, 2), np.nan),
        bias_m=bias_m,
        bias_s=np.full(n, LASTS_S),
        heading_rad=none,
        heading_sigma_rad=none,
        speed_mps=none,
        speed_sigma_mps=none,
        turned_rad=none[1:],
        seen=~no[1:],
        standing=no,
        step_nodes=np.zeros((0, 2), np.int64),
        step=np.zeros((0, 3)),
        step_sigma=np.zeros((0, 2)),
    )


def states_of(slow_m: Float64) -> Float64:
    state = np.zeros((len(slow_m), 8))
    state[:, BIAS_E:] = slow_m
    return state


def wandering(time_s: Float64, sigma_m: float) -> Float64:
    """A slow error [n, 2] of a sigma, as the model has it."""
    random, step_s = np.random.default_rng(5), np.diff(time_s)
    fading = np.exp(-step_s / LASTS_S)
    slow = np.empty((len(time_s), 2))
    slow[0] = sigma_m * random.normal(size=2)
    for k, one in enumerate(fading):
        fresh = random.normal(size=2)
        slow[k + 1] = one * slow[k] + sigma_m * np.sqrt(1.0 - one**2) * fresh
    return slow


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_a_wander_is_seen_by_its_ratio_to_what_is_stated(period_s: float) -> None:
    time_s = np.arange(0.0, 3000.0, period_s)
    stated = measured_at(time_s, np.full(len(time_s), 0.4))
    slow_m = wandering(time_s, 0.4)
    assert unstated_wander(states_of(slow_m), stated) == pytest.approx(1.0, abs=0.2)
    assert unstated_wander(states_of(3.0 * slow_m), stated) == pytest.approx(9.0, rel=0.2)


def test_less_than_what_is_stated_and_a_constant_error_count_as_stated() -> None:
    time_s = np.arange(0.0, 100.0, 0.2)
    stated = measured_at(time_s, np.full(len(time_s), 0.4))
    assert unstated_wander(states_of(np.full((len(time_s), 2), 5.0)), stated) == 1.0
    assert unstated_wander(states_of(wandering(time_s, 0.1)), stated) == 1.0


def test_a_stated_error_that_grows_may_change_by_as_much() -> None:
    time_s = np.arange(0.0, 30.0, 0.2)
    grows_m = 0.2 + 0.05 * time_s
    slow_m = np.stack([grows_m, -grows_m], axis=1)
    constant = np.full_like(grows_m, 0.2)
    assert unstated_wander(states_of(slow_m), measured_at(time_s, grows_m)) == 1.0
    assert unstated_wander(states_of(slow_m), measured_at(time_s, constant)) > 10.0


@pytest.mark.parametrize("times_s", [[0.0], [0.0, 1.0], [0.0, 30.0, 60.0, 90.0]])
def test_where_no_fixes_are_near_enough_nothing_is_known(times_s: list[float]) -> None:
    time_s = np.array(times_s)
    slow_m = np.outer(time_s, [1.0, 1.0])
    found = unstated_wander(states_of(slow_m), measured_at(time_s, np.full(len(time_s), 0.1)))
    assert found == 1.0


def weaving(fixes: FixColumns, size_m: float) -> FixColumns:
    """Fixes of a receiver that goes to and fro by so much within some seconds."""
    at_s = (fixes.time_ns - START) / 1e9
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    east = east + size_m * np.sin(2.0 * np.pi * at_s / 11.0)
    north = north + size_m * np.sin(2.0 * np.pi * at_s / 17.0 + 1.0)
    lat, lon, _ = DATUM.to_geodetic(east, north, up)
    return fixes.replace(lat_deg=lat, lon_deg=lon)


@pytest.mark.parametrize("size_m", [0.0, 0.5])
def test_headings_know_of_fixes_that_drift_beside_the_turns_of_a_gyro(size_m: float) -> None:
    drive = simulate(SLALOM, 40.0)
    fixes = weaving(fixes_of(drive, 0.2, 0.005, seed=2), size_m)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    settings = PoseSettings(quality=2, accuracy_m=0.5)
    found = estimate_poses(fixes, Carrier(0.0), DATUM, settings, motion).trajectory
    truth_deg = np.degrees(drive.at((found.time_ns - START) / 1e9).heading_rad)
    off_deg = np.abs(wrap_deg(found.heading_deg - truth_deg))[found.accepted]
    sigma_deg = found.heading_sigma_deg[found.accepted]
    assert found.accepted.mean() > 0.5
    assert np.mean(off_deg < 3.0 * sigma_deg) > 0.98
    if size_m == 0.0:
        assert np.median(sigma_deg) < 1.0
