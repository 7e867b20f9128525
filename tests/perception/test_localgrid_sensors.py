"""Local grids of depth images and clouds: the same as of pairs, as far as they see the same."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy.ndimage import maximum_filter

from fieldgrid.core import CalibrationError, DensitySettings, StereoSettings
from fieldgrid.geometry import (
    OBSTACLE_ABOVE,
    GridSpec,
    LeverArm,
    Lidar,
    LocalGrid,
    Mount,
    Rig,
    StereoCamera,
)
from fieldgrid.perception import FrameGround, LocalGridder, points_per_sr, reliable_range_m
from fieldgrid.perception.localgrid import SPARSE_POINTS, points_needed
from fieldgrid.perception.stereo import Disparity
from tests.scenes import Box, Ground, depth_rig, depths, lidar_rig, paper_rig, render, sweep

SPEC = GridSpec(10.0, 15.0, 0.05)
COARSE = GridSpec(10.0, 15.0, 0.25)
MOUNT = Mount(2.0, 0.0)
THINGS: list[Ground | Box] = [Ground(), Box((-2.0, -1.0), (8.0, 9.0), (0.0, 1.5))]


def by_depth(
    things: list[Ground | Box],
    rig: Rig | None = None,
    mount: Mount | None = None,
    spec: GridSpec = SPEC,
    density: DensitySettings | None = None,
) -> tuple[LocalGrid, FrameGround]:
    rig = rig or depth_rig()
    return LocalGridder(rig, spec, density=density).from_depth(depths(rig, things, mount))


def by_lidar(
    things: list[Ground | Box],
    mount: Mount = MOUNT,
    hung: Mount | None = None,
    spec: GridSpec = SPEC,
    density: DensitySettings | None = None,
    step_deg: float = 0.2,
) -> tuple[LocalGrid, FrameGround]:
    """The grid by a lidar that is said to be at `mount`, and hangs as `hung` says."""
    points = sweep(hung or mount, things, step_deg)
    rig = lidar_rig(points_per_sr(points), mount)
    return LocalGridder(rig, spec, density=density).from_cloud(points)


def obstacles(grid: LocalGrid) -> npt.NDArray[np.bool_]:
    return grid.density > OBSTACLE_ABOVE


def axes(spec: GridSpec) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    x, y = spec.centres_m()
    return np.broadcast_to(x[None, :], spec.shape), np.broadcast_to(y[:, None], spec.shape)


# --- what stands, and what is free


@pytest.mark.parametrize("hung", [None, Mount(2.84, 16.0, -1.0)])
def test_a_box_appears_where_it_stands_to_a_depth_camera(hung: Mount | None) -> None:
    grid, ground = by_depth(THINGS, mount=hung)
    shows_the_box(grid, 0.97)
    assert ground.refined
    assert ground.camera_height_m == pytest.approx((hung or Mount(2.8, 15.0)).height_m, abs=0.03)


@pytest.mark.parametrize("hung", [None, Mount(2.04, 1.0, -1.0)])
def test_a_box_appears_where_it_stands_to_a_lidar(hung: Mount | None) -> None:
    grid, ground = by_lidar(THINGS, hung=hung)
    shows_the_box(grid, 0.1)  # what a lidar sees of the ground is rings
    assert ground.refined
    assert ground.camera_height_m == pytest.approx((hung or MOUNT).height_m, abs=0.03)


def shows_the_box(grid: LocalGrid, seen_share: float) -> None:
    x, y = axes(SPEC)
    front = obstacles(grid) & (y > 7.85) & (y < 8.2)
    across = (x[0] > -1.9) & (x[0] < -1.1)
    assert front.any(axis=0)[across].mean() > 0.9
    away = (x < -2.25) | (x > -0.75) | (y < 7.7) | (y > 9.3)
    assert not grid.density[away].any()
    before = (np.abs(x + 1.5) < 0.5) & (y > 6.5) & (y < 7.5)
    assert grid.observed[before].mean() > seen_share
    hidden = (np.abs(x + 1.5) < 0.3) & (y > 9.5) & (y < 10.5)
    assert not grid.observed[hidden].any()


def test_a_depth_image_gives_the_grid_of_the_pair_it_is_from() -> None:
    """Disparities of the left camera and their depths, a box away from the edges of cells."""
    things: list[Ground | Box] = [Ground(), Box((-2.1, -1.1), (8.12, 9.1), (0.0, 1.5))]
    stereo = replace(paper_rig(), sensor=StereoCamera(640, 480, 780.0, 320.0, 240.0, 1.0))
    gridder = LocalGridder(stereo, COARSE, StereoSettings(min_range_m=5.0))
    region = gridder.region
    values = render(stereo, things, region.num_disparities, row_start=region.row_start)
    pair, _ = gridder.from_disparity(Disparity(values, region.row_start))

    image = np.full((480, 640), np.nan, np.float32)
    image[region.row_start :] = np.where(values > 0, 780.0 * 16.0 / np.maximum(values, 1), np.nan)
    rig = depth_rig(baseline_m=1.0)
    depth, _ = LocalGridder(rig, COARSE).from_depth(image)
    # Half a baseline is two cells, and a whole patch of ground.
    ours, theirs = depth.density[:, 2:].astype(int), pair.density[:, :-2].astype(int)
    assert (obstacles(pair)).sum() > 5
    assert (
        np.abs(ours - theirs).max() <= 6
    )  # the ranges differ, and with them what a point is worth
    assert (depth.observed[:, 2:] == pair.observed[:, :-2]).mean() > 0.99


# --- densities compare


def wall_density(grid: LocalGrid, spec: GridSpec) -> float:
    x, _ = axes(spec)
    return float(grid.density[np.abs(x) < 1.0].astype(float).sum())


@settings(deadline=None, max_examples=8)
@given(st.floats(6.0, 12.0), st.sampled_from([0.0, 2.0]))
def test_a_wall_is_as_dense_to_every_sensor(range_m: float, exponent: float) -> None:
    """A wall of 2 m x 1.1 m across the way, of which all sensors see all of the slice."""
    wall: list[Ground | Box] = [Ground(), Box((-1.0, 1.0), (range_m, range_m + 0.4), (0.0, 1.5))]
    chosen = DensitySettings(
        slice_bottom_m=0.3,
        slice_top_m=1.4,
        saturation_m2_per_m3=30.0,
        max_gain=100.0,
        range_exponent=exponent,
        max_range_sigma_m=5.0,
    )
    spec = GridSpec(10.0, 15.0, 0.25)
    mount = Mount(1.5, 8.0)
    stereo = replace(paper_rig(), mount=mount)
    gridder = LocalGridder(stereo, spec, StereoSettings(min_range_m=4.0), chosen)
    region = gridder.region
    values = render(stereo, wall, region.num_disparities, row_start=region.row_start)
    pair, _ = gridder.from_disparity(Disparity(values, region.row_start))
    fine, _ = by_depth(wall, depth_rig((780.0, 780.0), mount=mount), spec=spec, density=chosen)
    flat, _ = by_depth(wall, depth_rig((500.0, 620.0), mount=mount), spec=spec, density=chosen)
    lidar, _ = by_lidar(wall, mount, spec=spec, density=chosen)
    dense = [wall_density(grid, spec) for grid in (pair, fine, flat, lidar)]
    assert min(dense) > 100.0
    assert dense[1:] == pytest.approx([dense[0]] * 3, rel=0.15)


@pytest.mark.parametrize("step_deg", [0.1, 0.2, 0.4])
def test_a_wall_is_an_obstacle_however_sparse_the_lidar(step_deg: float) -> None:
    wall: list[Ground | Box] = [Ground(), Box((-3.0, 3.0), (12.0, 12.4), (0.0, 2.0))]
    grid, _ = by_lidar(wall, step_deg=step_deg)
    x, y = axes(SPEC)
    front = obstacles(grid) & (y > 11.85) & (y < 12.2)
    across = np.abs(x[0]) < 2.9
    assert maximum_filter(front.any(axis=0), 3)[across].mean() > 0.95
    assert not grid.density[y < 11.7].any()


# --- the mount


@settings(deadline=None, max_examples=8)
@given(st.floats(-3.0, 20.0), st.floats(-8.0, 8.0), st.floats(-30.0, 30.0))
@example(13.957965181185124, 0.0, 0.0)
def test_the_grid_does_not_depend_on_how_a_lidar_hangs(
    tilt_deg: float, roll_deg: float, yaw_deg: float
) -> None:
    """The same points, told in the frame of a sensor that is turned, and mounted so."""
    points = sweep(MOUNT, THINGS)
    turned = Mount(2.0, tilt_deg, roll_deg, yaw_deg)
    R = turned.rotation().T @ MOUNT.rotation()
    seen = (points.astype(np.float64) @ R.T).astype(np.float32)
    one, flat = LocalGridder(lidar_rig(80_000.0, MOUNT), SPEC).from_cloud(points)
    other, level = LocalGridder(lidar_rig(80_000.0, turned), SPEC).from_cloud(seen)
    assert level.camera_height_m == pytest.approx(flat.camera_height_m, abs=0.01)
    # Rounding takes single points over the edge of a cell, and all of a flat ground over that of
    # a bin of heights, which turns the plane by a tenth of a degree.
    assert level.pitch_deg == pytest.approx(flat.pitch_deg, abs=0.12)
    assert (one.density != other.density).mean() < 0.002
    assert (one.observed != other.observed).mean() < 0.04


@settings(deadline=None, max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_points_does_not_matter(seed: int) -> None:
    points = sweep(MOUNT, THINGS, 0.4)
    gridder = LocalGridder(lidar_rig(20_000.0, MOUNT), SPEC)
    one, ground = gridder.from_cloud(points)
    turned = points[np.random.default_rng(seed).permutation(len(points))]
    other, ground_again = gridder.from_cloud(turned)
    assert np.array_equal(one.density, other.density)
    assert np.array_equal(one.observed, other.observed)
    assert ground[:4] == ground_again[:4]
    for one, other_one in zip(ground[4:], ground_again[4:], strict=True):
        np.testing.assert_array_equal(one, other_one)


# --- ranges


def test_what_is_nearest_is_the_vehicle_itself() -> None:
    bonnet = Box((-0.8, 0.8), (0.5, 1.4), (0.8, 1.0))
    things: list[Ground | Box] = [Ground(), bonnet]
    _, y = axes(SPEC)
    near = DensitySettings(min_range_m=0.0)
    far = DensitySettings(min_range_m=2.0)
    assert obstacles(by_lidar(things, density=near)[0]).any()
    grid, _ = by_lidar(things, density=far)
    assert not grid.density.any()
    assert grid.observed[y > 4.0].any()
    x, y = axes(SPEC)
    assert not grid.observed[np.hypot(x, y) < 2.0].any()


def test_what_is_nearest_to_a_pair_is_for_the_matcher_to_say() -> None:
    things: list[Ground | Box] = [Ground()]
    steep = replace(paper_rig(), mount=Mount(2.8, 45.0))
    grids = []
    for min_range_m in (0.0, 3.0):
        chosen = DensitySettings(min_range_m=min_range_m)
        gridder = LocalGridder(steep, SPEC, StereoSettings(min_range_m=2.0), chosen)
        region = gridder.region
        values = render(steep, things, region.num_disparities, row_start=region.row_start)
        grids.append(gridder.from_disparity(Disparity(values, region.row_start))[0])
    assert np.array_equal(grids[0].observed, grids[1].observed)
    x, y = axes(SPEC)
    assert grids[0].observed[np.hypot(x, y) < 3.0].any()


def test_the_reliable_range_of_each_sensor() -> None:
    wide = GridSpec(40.0, 60.0, 0.25)
    stereo, chosen = StereoSettings(), DensitySettings(max_range_m=50.0)
    pair = reliable_range_m(paper_rig(), wide, stereo, chosen)
    assert reliable_range_m(depth_rig(baseline_m=0.2), wide, stereo, chosen) == pair
    assert pair < 12.0
    for rig in (depth_rig(), lidar_rig(10_000.0)):
        assert reliable_range_m(rig, wide, stereo, chosen) == 50.0
        near = reliable_range_m(rig, GridSpec(6.0, 4.0, 0.05), stereo, chosen)
        assert near == pytest.approx(5.0)


def test_a_grid_beyond_the_finest_codes_is_filled() -> None:
    """Beyond 32.767 m a code is more than a millimetre."""
    wall: list[Ground | Box] = [Ground(), Box((-20.0, 20.0), (40.0, 41.0), (0.0, 2.5))]
    far = DensitySettings(max_range_m=60.0)
    spec = GridSpec(20.0, 50.0, 0.25)
    grid, _ = by_depth(wall, depth_rig(mount=Mount(2.8, 5.0)), spec=spec, density=far)
    rows = np.flatnonzero(obstacles(grid).any(axis=1))
    assert rows.min() * 0.25 == pytest.approx(40.0, abs=0.3)


# --- how many points it takes


def test_pairs_and_depths_need_what_the_settings_say() -> None:
    chosen = DensitySettings(min_points=7, min_ground_points=3)
    for rig in (paper_rig(), depth_rig()):
        needed = points_needed(rig, SPEC, chosen)
        assert needed.shape == (2, *SPEC.shape)
        assert (needed[0] == 3).all()
        assert (needed[1] == 7).all()


def test_a_lidar_needs_few_points_and_fewer_where_it_is_far() -> None:
    needed = points_needed(lidar_rig(8000.0), SPEC, DensitySettings())
    x, y = axes(SPEC)
    wall = 8000.0 * 0.05 * 2.0 / (x * x + y * y)  # what one through the cell would give
    assert np.array_equal(needed[1], np.where(wall > 10.0, SPARSE_POINTS, 1))
    assert {1, SPARSE_POINTS} == set(needed[1].ravel().tolist())
    assert (needed[0, y[:, 0] > 3.0] == 1).all()
    one = points_needed(lidar_rig(1e8), SPEC, DensitySettings(min_points=1, min_ground_points=1))
    assert (one == 1).all()


# --- what does not fit


def test_a_sensor_gives_what_it_gives() -> None:
    pair, depth, lidar = paper_rig(), depth_rig(), lidar_rig(1000.0)
    image = np.ones((480, 640), np.float32)
    cloud = np.ones((9, 3), np.float32)
    grey = np.zeros((480, 640), np.uint8)
    match = "gives no {}; give what it does"
    for rig in (depth, lidar):
        with pytest.raises(CalibrationError, match=match.format("pairs")):
            LocalGridder(rig)(grey, grey)
        with pytest.raises(CalibrationError, match=match.format("pairs")):
            _ = LocalGridder(rig).region
        with pytest.raises(CalibrationError, match=match.format("disparities")):
            LocalGridder(rig).from_disparity(Disparity(np.zeros((480, 640), np.int16), 0))
    for rig in (pair, lidar):
        with pytest.raises(CalibrationError, match=match.format("depth images")):
            LocalGridder(rig).from_depth(image)
    for rig in (pair, depth):
        with pytest.raises(CalibrationError, match=match.format("clouds")):
            LocalGridder(rig).from_cloud(cloud)


@pytest.mark.parametrize("shape", [(640, 480), (480, 639), (480, 640, 1)])
def test_a_depth_image_has_the_calibrated_size(shape: tuple[int, ...]) -> None:
    with pytest.raises(CalibrationError, match="calibration is for 640 x 480"):
        LocalGridder(depth_rig()).from_depth(np.ones(shape, np.float32))


@pytest.mark.parametrize("shape", [(9,), (9, 4), (3, 9), (9, 3, 1)])
def test_a_cloud_is_rows_of_three(shape: tuple[int, ...]) -> None:
    with pytest.raises(CalibrationError, match=r"give its points as \[n, 3\]"):
        LocalGridder(lidar_rig(1000.0)).from_cloud(np.ones(shape, np.float32))


@pytest.mark.parametrize("count", [0, 1, 5])
def test_without_points_nothing_is_claimed(count: int) -> None:
    points = np.full((count, 3), np.nan, np.float32)
    grid, ground = LocalGridder(lidar_rig(1000.0)).from_cloud(points)
    assert not ground.refined
    assert not grid.observed.any()
    nothing = np.full((480, 640), np.nan, np.float32)
    grid, ground = LocalGridder(depth_rig()).from_depth(nothing)
    assert not ground.refined
    assert not grid.observed.any()


def test_points_that_are_not_finite_are_left_out() -> None:
    points = sweep(MOUNT, THINGS, 0.4)
    gridder = LocalGridder(Rig(Lidar(20_000.0), MOUNT, LeverArm(0.0, 0.0, 3.0)), SPEC)
    clean, _ = gridder.from_cloud(points)
    bad = np.array([[np.nan, 0.0, 5.0], [0.0, np.inf, 5.0], [0.0, 0.0, -np.inf]], np.float32)
    spoilt, _ = gridder.from_cloud(np.vstack([bad, points]))
    assert np.array_equal(clean.density, spoilt.density)
    assert np.array_equal(clean.observed, spoilt.observed)
    assert math.isfinite(float(clean.density.max()))
