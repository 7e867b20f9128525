"""From disparities to local grids of 3D density."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from pydantic import ValidationError

from fieldgrid.core import DensitySettings, StereoSettings
from fieldgrid.geometry import NO_GROUND_CM, OBSTACLE_ABOVE, GridSpec, LocalGrid, Mount, Rig, Tilt
from fieldgrid.perception import LocalGridder, reliable_range_m
from fieldgrid.perception.localgrid import density_gain, local_ground, scale_density
from fieldgrid.perception.stereo import Disparity
from tests.scenes import Box, Ground, paper_rig, render

RIG = paper_rig()
SPEC = GridSpec(10.0, 15.0, 0.05)


# --- counts to density


def scaled(
    counts: dict[tuple[int, int], tuple[int, int]],
    gain: float = 10.0,
    shape: tuple[int, int] = (5, 5),
) -> LocalGrid:
    """Cells given as (ground, slice) counts; at least 4 in the slice, 2 on the ground."""
    array = np.zeros((2, *shape), np.int32)
    for cell, value in counts.items():
        array[:, *cell] = value
    needed = np.stack([np.full(shape, 2, np.int32), np.full(shape, 4, np.int32)])
    density, observed = scale_density(array, np.full(shape, gain, np.float32), needed)
    spec = GridSpec(shape[1] * 0.5, shape[0] * 0.5, 0.5)
    return LocalGrid(spec, density, observed)


@pytest.mark.parametrize(
    ("ground", "in_slice", "density", "observed"),
    [
        (0, 0, 0, False),  # nothing seen
        (1, 0, 0, False),  # too little ground
        (2, 0, 0, True),  # free
        (50, 0, 0, True),
        (50, 1, 0, False),  # neither free nor an obstacle: in doubt
        (0, 3, 0, False),
        (0, 4, 40, True),
        (50, 4, 40, True),  # ground beside it does not dilute it
        (0, 25, 250, True),
        (0, 26, 255, True),  # saturated
        (0, 100_000, 255, True),
    ],
)
def test_a_cell_by_itself(ground: int, in_slice: int, density: int, observed: bool) -> None:
    grid = scaled({(2, 2): (ground, in_slice)})
    assert grid.density[2, 2] == density
    assert grid.observed[2, 2] == observed
    assert grid.observed.sum() == int(observed)
    assert grid.density.sum() == density


def test_density_is_rounded() -> None:
    assert scaled({(2, 2): (0, 5)}, gain=1.08).density[2, 2] == 5
    assert scaled({(2, 2): (0, 5)}, gain=1.12).density[2, 2] == 6


def test_the_neighbour_of_an_obstacle_is_not_free() -> None:
    free = {(r, c): (9, 0) for r in range(5) for c in range(5)}
    grid = scaled({**free, (1, 2): (0, 4)})
    expected = np.ones((5, 5), bool)
    expected[0:3, 1:4] = False
    expected[1, 2] = True
    assert np.array_equal(grid.observed, expected)
    corner = scaled({**free, (4, 4): (0, 4)})
    assert corner.observed.sum() == 22
    # Too few points for an obstacle put only their own cell in doubt.
    assert scaled({**free, (1, 2): (0, 3)}).observed.sum() == 24


def test_one_mismatch_far_away_is_no_obstacle() -> None:
    """A single wrong disparity, worth most where it is farthest, must not become a cell."""
    gridder = LocalGridder(RIG)
    region = gridder.region
    values = render(RIG, [Ground()], region.num_disparities, row_start=region.row_start)
    clean, _ = gridder.from_disparity(Disparity(values, region.row_start))
    assert not clean.density.any()
    rng = np.random.default_rng(0)
    for v, u in zip(rng.integers(20, 300, 40), rng.integers(40, 600, 40), strict=True):
        if values[v, u] > 0:
            values[v, u] += 64
    spoilt, _ = gridder.from_disparity(Disparity(values, region.row_start))
    assert not spoilt.density.any()


# --- gain


@pytest.mark.parametrize("exponent", [0.0, 2.0, 3.0])
def test_the_gain_follows_the_range_up_to_its_cap(exponent: float) -> None:
    chosen = DensitySettings(range_exponent=exponent, reference_range_m=8.0, max_gain=4.0)
    gain = density_gain(RIG, SPEC, chosen)
    assert gain.shape == SPEC.shape
    assert gain.dtype == np.float32
    x, y = SPEC.centres_m()

    def at(x_m: float, y_m: float) -> tuple[float, float]:
        c, r = int(np.argmin(np.abs(x - x_m))), int(np.argmin(np.abs(y - y_m)))
        return float(gain[r, c]), math.hypot(x[c], y[r])

    (worth_a, range_a), (worth_b, range_b) = at(-3.0, 4.0), at(2.0, 9.0)
    assert worth_a / worth_b == pytest.approx((range_a / range_b) ** exponent, rel=1e-5)
    worth_8, range_8 = at(0.0, 8.0)
    capped = at(5.0, 15.0)[0]
    expected = min((math.hypot(5.0, 15.0) / range_8) ** exponent, 4.0)
    assert capped / worth_8 == pytest.approx(expected, rel=0.02)
    assert float(gain.max()) / worth_8 * (range_8 / 8.0) ** exponent <= 4.0 + 1e-4


def test_a_point_is_worth_what_a_pixel_sees_at_the_reference_range() -> None:
    """One point at 8 m is (8/780)² m² of facing surface, in a column of 0.05² · 2 m³."""
    chosen = DensitySettings(saturation_m2_per_m3=0.5)
    spec = GridSpec(0.05, 15.0, 0.05)
    worth = float(density_gain(RIG, spec, chosen)[160, 0])  # 8.025 m ahead
    surface_m2_per_m3 = (8.025 / 780.0) ** 2 / (0.05**2 * 2.0)
    assert worth == pytest.approx(255.0 * surface_m2_per_m3 / 0.5, rel=1e-3)


# --- range and settings


def test_the_reliable_range_is_where_the_range_error_reaches_its_limit() -> None:
    wide = GridSpec(40.0, 60.0, 0.25)
    chosen = DensitySettings(max_range_m=100.0, max_range_sigma_m=0.2)
    for sigma_px in (0.25, 0.5):
        stereo = StereoSettings(disparity_sigma_px=sigma_px)
        range_m = reliable_range_m(RIG, wide, stereo, chosen)
        assert RIG.camera.range_sigma_m(range_m, sigma_px) == pytest.approx(0.2)
    assert range_m == pytest.approx(math.sqrt(0.2 * 156.0 / 0.5))


def test_the_reliable_range_ends_with_the_setting_or_the_grid() -> None:
    stereo = StereoSettings()
    near = DensitySettings(max_range_m=6.0)
    assert reliable_range_m(RIG, SPEC, stereo, near) == 6.0
    sure = DensitySettings(max_range_m=100.0, max_range_sigma_m=5.0)
    assert reliable_range_m(RIG, GridSpec(6.0, 4.0, 0.05), stereo, sure) == pytest.approx(5.0)


@pytest.mark.parametrize(("bottom_m", "top_m"), [(1.0, 1.0), (1.0, 0.5), (1.0, 1.04)])
def test_an_empty_slice_is_refused(bottom_m: float, top_m: float) -> None:
    with pytest.raises(ValidationError, match="has no height") as caught:
        DensitySettings(slice_bottom_m=bottom_m, slice_top_m=top_m)
    assert f"{bottom_m} to {top_m}" in str(caught.value)


def test_the_slice_s_thickness() -> None:
    assert DensitySettings(slice_bottom_m=0.5, slice_top_m=2.0).slice_m == 1.5
    with pytest.raises(ValidationError):
        DensitySettings(slice_botom_m=0.5)  # type: ignore[call-arg]


# --- the ground of cells


def test_the_ground_of_cells_lies_between_that_of_patches() -> None:
    # A tilted plane, given at the centres of patches of 0.5 m, is met at every inner cell.
    j, i = np.mgrid[0:30, 0:20]
    patches = 0.02 * ((i + 0.5) * 0.5 - 5.0) - 0.03 * (j + 0.5) * 0.5
    ground = local_ground(patches, SPEC, np.ones(SPEC.shape, np.bool_))
    x, y = SPEC.centres_m()
    expected = 0.02 * x[None, :] - 0.03 * y[:, None]
    assert ground.shape == SPEC.shape
    inner = (slice(6, -6), slice(6, -6))
    assert ground[inner] == pytest.approx(expected[inner], abs=1e-5)
    assert np.abs(ground - expected).max() < 0.03


def test_beyond_the_range_there_is_no_ground() -> None:
    x, y = SPEC.centres_m()
    within = np.hypot(x[None, :], y[:, None]) <= 9.0
    ground = local_ground(np.zeros((30, 20)), SPEC, within)
    assert np.array_equal(~np.isnan(ground), within)


# --- whole frames


def frame(
    things: list[Ground | Box],
    rig: Rig = RIG,
    spec: GridSpec = SPEC,
    density: DensitySettings | None = None,
    mount: Mount | None = None,
) -> LocalGrid:
    gridder = LocalGridder(rig, spec, StereoSettings(), density)
    region = gridder.region
    values = render(rig, things, region.num_disparities, row_start=region.row_start, mount=mount)
    grid, _ = gridder.from_disparity(Disparity(values, region.row_start))
    return grid


@pytest.mark.parametrize("left_m", [-2.0, 0.75])
@pytest.mark.parametrize("mount", [None, Mount(2.84, 16.0, -1.0)])
def test_a_box_appears_where_it_stands(left_m: float, mount: Mount | None) -> None:
    box = Box((left_m, left_m + 1.0), (8.0, 9.0), (0.0, 1.5))
    grid = frame([Ground(), box], mount=mount)
    x, y = (axis[None, :] if k == 0 else axis[:, None] for k, axis in enumerate(SPEC.centres_m()))

    columns = (grid.density > OBSTACLE_ABOVE) & (y > 7.85) & (y < 8.2)
    assert columns.any(axis=0)[((x > left_m + 0.1) & (x < left_m + 0.9))[0]].all()
    away = (x < left_m - 0.25) | (x > left_m + 1.25) | (y < 7.7) | (y > 9.3)
    assert not grid.density[away & np.ones(SPEC.shape, bool)].any()

    before = (np.abs(x - left_m - 0.5) < 0.5) & (y > 6.5) & (y < 7.5)
    assert grid.observed[before].mean() > 0.97
    assert not grid.density[before].any()
    hidden = (np.abs(x - left_m - 0.5) < 0.3) & (y > 9.5) & (y < 11.0)
    assert not grid.observed[hidden].any()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_verge_is_no_obstacle_and_a_post_on_it_is_one(side: float) -> None:
    """A bank to 30 cm, three times as high as the slice begins: that is above the bank."""
    low_slice = DensitySettings(slice_bottom_m=0.1)
    low, high = (1.0, 2.0) if side > 0 else (-2.0, -1.0)
    outside = (high, math.inf) if side > 0 else (-math.inf, low)
    inside = (-math.inf, low) if side > 0 else (high, math.inf)
    things: list[Ground | Box] = [
        Ground(x_from_m=inside[0], x_to_m=inside[1]),
        Ground(-0.3, 0.3 * side, x_from_m=low, x_to_m=high),
        Ground(0.3, x_from_m=outside[0], x_to_m=outside[1]),
    ]
    grid = frame(things, density=low_slice)
    assert not (grid.density > OBSTACLE_ABOVE).any()
    assert np.count_nonzero(grid.density) < 10
    post = Box((2.3 * side - 0.1, 2.3 * side + 0.1), (9.0, 9.2), (0.3, 1.5))
    rows, columns = np.nonzero(frame([*things, post]).density > OBSTACLE_ABOVE)
    assert rows.size > 0
    assert np.abs((columns + 0.5) * 0.05 - 5.0 - 2.3 * side).max() < 0.25
    assert np.abs((rows + 0.5) * 0.05 - 9.1).max() < 0.3


def test_the_blind_strip_and_what_is_out_of_range_are_unseen() -> None:
    grid = frame([Ground()])
    _, y = SPEC.centres_m()
    nearest_m = 2.8 / math.tan(math.radians(15.0 + math.degrees(math.atan(240 / 780))))
    assert not grid.observed[y < nearest_m - 0.1].any()
    farthest_m = reliable_range_m(RIG, SPEC, StereoSettings(), DensitySettings())
    assert not grid.observed[y > farthest_m].any()
    middle = grid.observed[(y > 6.0) & (y < 10.0), 80:120]
    assert middle.mean() > 0.97
    assert not grid.density.any()


def facing_density(focal_px: float, range_m: float, **changes: float) -> float:
    """Sum of the densities of a wall of 1 m x 1.5 m across the way, in a grid of 25 cm."""
    wall = Box((-0.5, 0.5), (range_m, range_m + 0.3), (0.0, 1.5))
    chosen = DensitySettings(slice_top_m=1.4, saturation_m2_per_m3=40.0, max_gain=100.0, **changes)
    rig = paper_rig(focal_px=focal_px, size_px=(960, 720), tilt_deg=12.0)
    stereo = StereoSettings(disparity_sigma_px=0.05)
    gridder = LocalGridder(rig, GridSpec(10.0, 15.0, 0.25), stereo, chosen)
    region = gridder.region
    things = [Ground(), wall]
    values = render(rig, things, region.num_disparities, row_start=region.row_start)
    grid, _ = gridder.from_disparity(Disparity(values, region.row_start))
    assert grid.density.max() < 255
    return float(grid.density.sum())


def test_density_does_not_depend_on_the_camera_or_the_range() -> None:
    reference = facing_density(780.0, 8.0)
    # 1 m x 1.2 m of wall, in cells of 0.25 m and a slice of 1.2 m: 16 m² per m³ over all cells.
    assert reference == pytest.approx(255.0 * 16.0 / 40.0, rel=0.15)
    assert facing_density(1170.0, 8.0) == pytest.approx(reference, rel=0.15)
    assert facing_density(780.0, 11.0) == pytest.approx(reference, rel=0.15)
    assert facing_density(1170.0, 11.0) == pytest.approx(reference, rel=0.15)


def test_without_compensation_density_falls_with_the_range() -> None:
    near, far = (facing_density(780.0, y, range_exponent=0.0) for y in (8.0, 11.0))
    assert far / near == pytest.approx((8.0 / 11.0) ** 2, rel=0.15)


def test_the_same_frame_from_two_threads_is_the_same() -> None:
    gridder = LocalGridder(RIG)
    region = gridder.region
    frames = []
    for y in (6.5, 7.5, 8.5, 9.5):
        things = [Ground(), Box((-1.0, 0.5), (y, y + 1.0), (0.0, 1.5))]
        values = render(RIG, things, region.num_disparities, row_start=region.row_start)
        frames.append(Disparity(values, region.row_start))
    alone = [gridder.from_disparity(disparity)[0] for disparity in frames]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda d: gridder.from_disparity(d)[0], frames * 3))
    for k, grid in enumerate(together):
        assert np.array_equal(grid.density, alone[k % 4].density)
        assert np.array_equal(grid.observed, alone[k % 4].observed)


def test_a_pair_of_images_becomes_a_grid() -> None:
    """Images of a textured plane facing the camera, 7.8 m away: a wall where it stands."""
    rig = paper_rig(tilt_deg=0.0, height_m=1.2)
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (480, 700), dtype=np.uint8)
    left, right = texture[:, :640], texture[:, 20:660]  # 156 / 20 = 7.8 m
    grid, ground = LocalGridder(rig)(left.copy(), right.copy())
    assert grid.spec == SPEC
    rows, columns = np.nonzero(grid.density > OBSTACLE_ABOVE)
    assert np.abs((rows + 0.5) * 0.05 - 7.8).max() < 0.15
    x = (columns + 0.5) * 0.05 - 5.0
    assert x.min() < -2.0
    assert x.max() > 2.0
    assert ground.camera_height_m == pytest.approx(1.2, abs=0.3)


def test_nothing_matched_is_nothing_seen() -> None:
    gridder = LocalGridder(RIG)
    start = gridder.region.row_start
    empty = Disparity(np.full((480 - start, 640), -16, np.int16), start)
    grid, ground = gridder.from_disparity(empty)
    assert not grid.observed.any()
    assert not grid.density.any()
    assert not ground.refined
    assert ground.camera_height_m == 2.8


def test_heights_of_the_ground_are_kept_of_a_lean_that_is_sure() -> None:
    """Uphill by 8° with the vehicle: level in its own axes."""
    gridder = LocalGridder(RIG)
    region = gridder.region
    values = render(RIG, [Ground()], region.num_disparities, row_start=region.row_start)
    disparity = Disparity(values, region.row_start)
    _, ground = gridder.from_disparity(disparity, Tilt(0.0, 8.0, 0.3))
    assert ground.heights_cm is not None
    known = ground.heights_cm != NO_GROUND_CM
    rows, _ = np.nonzero(known)
    y = (rows + 0.5) * 0.05
    near = (y > 4.0) & (y < 10.0)
    assert near.sum() > 5000
    slope = math.radians(8.0)
    true_m = 2.8 * (1.0 - 1.0 / math.cos(slope)) + math.tan(slope) * y
    off_m = ground.heights_cm[known] / 100.0 - true_m
    assert np.abs(np.median(off_m[near])) < 0.02
    assert np.abs(off_m[near]).max() < 0.1
    for tilt in (None, Tilt(0.0, 8.0, 0.6)):
        assert gridder.from_disparity(disparity, tilt)[1].heights_cm is None
