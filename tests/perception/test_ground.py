"""The ground found in rendered scenes of which it is known."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import OBSTACLE_ABOVE, Mount, Rig, Tilt
from fieldgrid.perception import CodedDepth, LocalGridder
from fieldgrid.perception.depth import depth_table, rays
from fieldgrid.perception.ground import PATCH_M, GroundPlane, estimate_ground, follow_ground
from fieldgrid.perception.stereo import Disparity
from tests.scenes import Box, Ground, paper_rig, render

_Float64 = npt.NDArray[np.float64]

RIG = paper_rig()
HALF_WIDTH_M, LENGTH_M, DISPARITIES = 5.0, 15.0, 64
LEVEL = [Ground()]


def estimate(
    things: Sequence[Ground | Box],
    mount: Mount | None = None,
    rig: Rig = RIG,
    noise_px: float = 0.0,
) -> tuple[GroundPlane, _Float64]:
    disparity = render(rig, things, DISPARITIES, mount=mount)
    if noise_px:
        noise = np.random.default_rng(3).normal(0.0, 16.0 * noise_px, disparity.shape)
        noisy = np.clip(np.rint(disparity + noise), 1, 16 * DISPARITIES)
        disparity = np.where(disparity > 0, noisy, disparity).astype(np.int16)
    table = depth_table(rig, DISPARITIES, 16)
    return estimate_ground(CodedDepth(disparity, 0, table), rig, HALF_WIDTH_M, LENGTH_M)[:2]


def up_error_deg(plane: GroundPlane, mount: Mount) -> float:
    """The angle between the vertical that was found and the true one, in camera axes."""
    found, true = plane.A_grid_sensor[2], mount.rotation()[2]
    return math.degrees(math.asin(min(1.0, float(np.linalg.norm(np.cross(found, true))))))


def true_heights(
    plane: GroundPlane, patches: _Float64, mount: Mount
) -> tuple[_Float64, _Float64, _Float64]:
    """Where the patches' centres really are: (x, y, z), each [ny, nx], above true level."""
    ny, nx = patches.shape
    x, y = np.meshgrid(
        (np.arange(nx) + 0.5) * PATCH_M - HALF_WIDTH_M, (np.arange(ny) + 0.5) * PATCH_M
    )
    level = np.stack([x, y, patches - plane.height_m])
    in_vehicle = np.tensordot(mount.rotation() @ plane.A_grid_sensor.T, level, axes=1)
    return in_vehicle[0], in_vehicle[1], in_vehicle[2] + mount.height_m


def seen(x: _Float64, y: _Float64, far_m: float = 12.0) -> npt.NDArray[np.bool_]:
    """Patches well inside the field of view of the paper's rig."""
    return (y > 6.0) & (y < far_m) & (np.abs(x) < 0.36 * y)


# --- rays and depths


@given(st.floats(0.0, 639.0), st.floats(0.0, 479.0), st.floats(2.0, 20.0))
def test_a_ray_carries_a_pixel_to_its_point(u: float, v: float, depth_m: float) -> None:
    """Checked by the way back: from the point to the pixel of the left camera."""
    mount = Mount(2.3, 14.0, 3.0, -6.0)
    rig = Rig(RIG.camera, mount, RIG.antenna)
    ray, du, dv, offset = (part.astype(float) for part in rays(rig, mount.rotation(), 2.3))
    point = depth_m * (ray + u * du + v * dv) + offset
    x, y, z = mount.rotation().T @ (point - np.array([0.0, 0.0, 2.3])) + np.array([0.1, 0.0, 0.0])
    assert z == pytest.approx(depth_m, rel=1e-5)
    assert 320.0 + 780.0 * x / z == pytest.approx(u, abs=0.01)
    assert 240.0 + 780.0 * y / z == pytest.approx(v, abs=0.01)


def test_depths_are_focal_times_baseline_over_disparity() -> None:
    table = depth_table(RIG, 64, 16)
    assert len(table) == 65 * 16
    assert table[16 * 13] == pytest.approx(12.0)
    assert table[8] == pytest.approx(312.0)
    assert np.isinf(table[0])


@pytest.mark.parametrize("offset_px", [5.0, -5.0])
def test_depths_mind_the_offset_of_the_right_camera(offset_px: float) -> None:
    camera = type(RIG.camera)(640, 480, 780.0, 320.0, 240.0, 0.2, 320.0 - offset_px)
    table = depth_table(Rig(camera, RIG.mount, RIG.antenna), 64, 16)
    assert table[round(16 * (13 + offset_px))] == pytest.approx(12.0)
    if offset_px > 0:
        assert np.isinf(table[: 16 * 5 + 1]).all()
    assert np.isinf(table[0])
    assert (table > 0).all()


# --- the plane

changes = st.tuples(st.floats(-0.05, 0.05), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))


@settings(deadline=None, max_examples=15)
@given(changes)
def test_a_plane_off_the_mount_is_recovered(change: tuple[float, float, float]) -> None:
    d_height, d_tilt, d_roll = change
    mount = Mount(2.8 + d_height, 15.0 + d_tilt, d_roll)
    plane, patches = estimate(LEVEL, mount)
    assert plane.refined
    assert up_error_deg(plane, mount) < 0.15
    # Heights come in bins of 2.5 cm: ground right on an edge of one is found 2.2 cm off.
    assert plane.height_m == pytest.approx(mount.height_m, abs=0.025)
    assert plane.pitch_deg == pytest.approx(d_tilt, abs=0.2)
    assert plane.roll_deg == pytest.approx(d_roll, abs=0.2)
    assert np.abs(plane.A_grid_sensor @ plane.A_grid_sensor.T - np.eye(3)).max() < 1e-9
    x, y, z = true_heights(plane, patches, mount)
    assert np.abs(z[seen(x, y)]).max() < 0.03


@settings(deadline=None, max_examples=10)
@given(changes)
def test_noisy_disparities_spoil_the_plane_little(change: tuple[float, float, float]) -> None:
    mount = Mount(2.8 + change[0], 15.0 + change[1], change[2])
    plane, patches = estimate(LEVEL, mount, noise_px=0.25)
    assert plane.refined
    assert up_error_deg(plane, mount) < 0.3
    assert plane.height_m == pytest.approx(mount.height_m, abs=0.02)
    x, y, z = true_heights(plane, patches, mount)
    assert np.abs(z[seen(x, y)]).max() < 0.08


def test_levelling_does_not_turn_the_vehicle() -> None:
    mount = Mount(2.8, 16.5, 1.5)
    plane, _ = estimate(LEVEL, mount)
    ahead = plane.A_grid_sensor @ mount.rotation().T @ np.array([0.0, 1.0, 0.0])
    assert abs(math.degrees(math.atan2(ahead[0], ahead[1]))) < 1.0


def test_a_canopy_does_not_lift_the_plane() -> None:
    rows = [Box((side, side + 0.8), (3.0, 16.0), (0.0, 1.6)) for side in (-2.4, 1.6)]
    mount = Mount(2.83, 14.2, 0.8)
    plane, _ = estimate([Ground(), *rows], mount, noise_px=0.25)
    assert plane.refined
    assert up_error_deg(plane, mount) < 0.3
    assert plane.height_m == pytest.approx(2.83, abs=0.04)


def test_grass_does_not_lift_the_ground() -> None:
    """Every other pixel sees blades of up to 20 cm, the rest the ground between them."""
    rng = np.random.default_rng(4)
    image = render(RIG, LEVEL, DISPARITIES)
    for height_m in (0.05, 0.1, 0.15, 0.2):
        blades = render(RIG, [Ground(height_m)], DISPARITIES)
        image = np.where(rng.random(image.shape) < 0.16, blades, image)
    table = depth_table(RIG, DISPARITIES, 16)
    plane, patches, _ = estimate_ground(CodedDepth(image, 0, table), RIG, HALF_WIDTH_M, LENGTH_M)
    assert up_error_deg(plane, RIG.mount) < 0.15
    x, y, z = true_heights(plane, patches, RIG.mount)
    assert np.abs(z[seen(x, y)]).max() < 0.04


# --- following the ground


def test_a_raised_verge_is_followed() -> None:
    """A road, a bank of 25 cm over 0.75 m, and the verge on top of it."""
    road = Ground(x_to_m=1.25)
    bank = Ground(height_m=-1.25 / 3.0, slope_x=1.0 / 3.0, x_from_m=1.25, x_to_m=2.0)
    verge = Ground(height_m=0.25, x_from_m=2.0)
    mount = RIG.mount
    plane, patches = estimate([road, bank, verge], mount)
    x, y, z = true_heights(plane, patches, mount)
    inside = seen(x, y)
    on_verge, on_road = inside & (x > 2.3), inside & (x < 0.9)
    assert on_verge.sum() > 10
    assert on_road.sum() > 50
    assert np.abs(z[on_verge] - 0.25).max() < 0.05
    assert np.abs(z[on_road]).max() < 0.05


@pytest.mark.parametrize("slope", [0.08, -0.08])
def test_ground_that_bends_away_is_followed(slope: float) -> None:
    """The patches carry what one plane cannot: a slope that begins 9 m ahead."""
    mount = RIG.mount
    bend = Ground(height_m=-9.0 * slope, slope_y=slope)
    things = [Ground(), bend]
    # Nearer wins where the ground rises; where it falls away, the farther of the two planes.
    nearer_or_farther = np.maximum if slope > 0 else np.minimum
    image = nearer_or_farther(*(render(RIG, [thing], DISPARITIES) for thing in things))
    table = depth_table(RIG, DISPARITIES, 16)
    plane, patches, _ = estimate_ground(CodedDepth(image, 0, table), RIG, HALF_WIDTH_M, LENGTH_M)
    x, y, z = true_heights(plane, patches, mount)
    expected = np.where(y > 9.0, slope * (y - 9.0), 0.0)
    inside = seen(x, y, 13.0)
    assert np.abs((z - expected)[inside]).max() < 0.06


def test_a_box_is_not_taken_for_ground() -> None:
    box = Box((-1.0, 1.0), (8.0, 10.0), (0.0, 1.0))
    plane, patches = estimate([Ground(), box])
    assert up_error_deg(plane, RIG.mount) < 0.3
    x, y, z = true_heights(plane, patches, RIG.mount)
    under = (np.abs(x) < 1.0) & (y > 8.0) & (y < 10.0)
    assert under.sum() >= 12
    assert np.abs(z[under]).max() < 0.1
    assert np.abs(z[seen(x, y)]).max() < 0.1


def test_a_step_is_ground_up_to_a_limit() -> None:
    low = np.zeros((6, 9))
    low[:, 6:] = 0.15  # a kerb
    assert follow_ground(low, 0.0)[:, 7:] == pytest.approx(0.15, abs=0.03)
    low[:, 6:] = 0.6  # a wall
    assert np.abs(follow_ground(low, 0.0)).max() < 0.01
    low[:, 6:] = -0.25  # a bank down
    assert follow_ground(low, 0.0)[:, 7:] == pytest.approx(-0.25, abs=0.04)


def test_ground_goes_on_behind_a_ditch() -> None:
    low = np.zeros((20, 9))
    low[6:9] = -0.3
    assert np.abs(follow_ground(low, 0.0)[10:]).max() < 0.03
    across = np.zeros((20, 21))
    across[:, 14:16] = -0.3
    assert np.abs(follow_ground(across, 0.0)[:, 17:]).max() < 0.03
    # What is higher than the level before the drop is not: a canopy on the far side.
    low[9:] = 0.2
    assert follow_ground(low, 0.0)[11:].max() < 0.0
    # Nor is what begins farther behind it than ditches are wide.
    low[6:12], low[12:] = -0.3, 0.0
    assert follow_ground(low, 0.0)[12].max() < -0.2


def test_an_unseen_patch_takes_the_height_of_its_neighbours() -> None:
    low = np.full((8, 9), 0.1)
    low[3:5, 2:6] = np.nan
    assert follow_ground(low, 0.0)[1:, :] == pytest.approx(0.1, abs=0.02)


def test_heights_do_not_depend_on_left_and_right() -> None:
    low = np.random.default_rng(0).uniform(-0.05, 0.05, (8, 9))
    low[:, 7:] += 0.12
    mirrored = follow_ground(low[:, ::-1].copy(), 0.0)[:, ::-1]
    # The middle goes first and its right before its left: alike, not the same.
    assert mirrored == pytest.approx(follow_ground(low, 0.0), abs=0.02)


# --- nothing to see


def test_without_data_the_mount_is_kept() -> None:
    empty = np.full((480, 640), -16, dtype=np.int16)
    table = depth_table(RIG, DISPARITIES, 16)
    plane, patches, _ = estimate_ground(CodedDepth(empty, 0, table), RIG, HALF_WIDTH_M, LENGTH_M)
    assert not plane.refined
    assert np.array_equal(plane.A_grid_sensor, RIG.mount.rotation())
    assert plane.height_m == 2.8
    assert (plane.pitch_deg, plane.roll_deg) == (0.0, 0.0)
    assert patches.shape == (30, 20)
    assert not patches.any()


def test_a_scrap_of_ground_does_not_overrule_the_mount() -> None:
    disparity = render(RIG, LEVEL, DISPARITIES, mount=Mount(2.8, 17.0))
    scrap = np.full_like(disparity, -16)
    scrap[300:330, 300:340] = disparity[300:330, 300:340]
    table = depth_table(RIG, DISPARITIES, 16)
    plane, *_ = estimate_ground(CodedDepth(scrap, 0, table), RIG, HALF_WIDTH_M, LENGTH_M)
    assert not plane.refined
    assert plane.height_m == 2.8


def test_the_first_row_is_minded() -> None:
    whole = render(RIG, LEVEL, DISPARITIES, mount=Mount(2.83, 15.8))
    table = depth_table(RIG, DISPARITIES, 16)
    start = 90  # a multiple of the sampling step, so that the same rows are read
    a, *_ = estimate_ground(CodedDepth(whole, 0, table), RIG, HALF_WIDTH_M, LENGTH_M)
    cut = render(RIG, LEVEL, DISPARITIES, row_start=start, mount=Mount(2.83, 15.8))
    assert np.array_equal(cut, whole[start:])
    b, *_ = estimate_ground(CodedDepth(cut, start, table), RIG, HALF_WIDTH_M, LENGTH_M)
    assert b.height_m == pytest.approx(a.height_m, abs=0.01)
    assert b.pitch_deg == pytest.approx(a.pitch_deg, abs=0.05)


# --- vertical columns where the vehicle's tilt is known


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0.0, 9.0), (0.0, -9.0), (7.0, 0.0)])
def test_with_the_tilt_known_the_plane_keeps_its_slope(roll_deg: float, pitch_deg: float) -> None:
    """A vehicle that stands on a slope: the camera leans by its tilt, the ground by the slope."""
    rise = -math.tan(math.radians(roll_deg)), math.tan(math.radians(pitch_deg))
    above_m = RIG.mount.height_m / math.cos(math.radians(max(roll_deg, pitch_deg, -pitch_deg)))
    leaning = Mount(above_m, RIG.mount.tilt_deg - pitch_deg, roll_deg)
    scene = [Ground(0.0, *rise)]
    disparity = render(RIG, scene, DISPARITIES, mount=leaning)
    coded = CodedDepth(disparity, 0, depth_table(RIG, DISPARITIES, 16))
    tilt = Tilt(roll_deg, pitch_deg)
    plane, patches, _ = estimate_ground(coded, RIG, HALF_WIDTH_M, LENGTH_M, tilt)
    assert plane.refined
    assert plane.tilt == tilt
    np.testing.assert_allclose(plane.rise, rise, atol=0.005)
    np.testing.assert_allclose(plane.A_grid_sensor[:2], leaning.rotation()[:2], atol=1e-12)
    assert plane.height_m == pytest.approx(above_m, abs=0.02)
    y, x = np.mgrid[0 : patches.shape[0], 0 : patches.shape[1]]
    near = seen((x + 0.5) * PATCH_M - HALF_WIDTH_M, (y + 0.5) * PATCH_M)
    assert float(np.nanmax(np.abs(patches[near]))) < 0.03


@pytest.mark.parametrize("pitch_deg", [10.0, -10.0])
def test_a_post_on_a_slope_stands_where_it_is_seen_from_above(pitch_deg: float) -> None:
    """With the tilt its face is at its own distance; without it, at that along the slope."""
    slope, up = math.tan(math.radians(pitch_deg)), math.cos(math.radians(pitch_deg))
    leaning = Mount(RIG.mount.height_m / up, RIG.mount.tilt_deg - pitch_deg)
    post = Box((-0.3, 0.3), (9.02, 9.3), (9.0 * slope - 1.0, 9.0 * slope + 1.6))
    gridder = LocalGridder(RIG)
    region = gridder.region
    values = render(
        RIG, [Ground(0.0, 0.0, slope), post], region.num_disparities,
        row_start=region.row_start, mount=leaning,
    )  # fmt: skip
    seen_m = []
    for tilt in (Tilt(0.0, pitch_deg), None):
        grid, ground = gridder.from_disparity(Disparity(values, region.row_start), tilt)
        assert ground.refined
        rows = np.flatnonzero((grid.density > OBSTACLE_ABOVE).any(axis=1))
        seen_m.append(float(rows[0]) * grid.spec.cell_m)
    assert seen_m[0] == pytest.approx(9.0, abs=0.051)
    assert abs(seen_m[1] - 9.0) > 0.25
