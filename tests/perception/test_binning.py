"""From what a sensor saw to counts by cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import GridSpec, Mount
from fieldgrid.perception import SUBPIXELS
from fieldgrid.perception.binning import bin_pixels, bin_points
from fieldgrid.perception.depth import depth_table, rays
from tests.counting import bin_pixels_reference, bin_points_reference
from tests.scenes import paper_rig

RIG = paper_rig()
COARSE = GridSpec(4.0, 6.0, 0.25)


# --- images of depths


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 60),
    st.sampled_from([0.0, 3.0, -3.0]),
    st.sampled_from([0.05, 0.25, 0.3]),
    st.floats(-5.0, 25.0),
    st.floats(-8.0, 8.0),
    st.floats(0.05, 0.5),
    st.floats(0.0, 2.5),
)
def test_the_kernel_is_the_reference(
    seed: int,
    row_start: int,
    offset_px: float,
    cell_m: float,
    tilt_deg: float,
    roll_deg: float,
    bottom_m: float,
    slice_m: float,
) -> None:
    rng = np.random.default_rng(seed)
    base = paper_rig(focal_px=120.0, size_px=(96, 80))
    camera = replace(base.camera, cx_right_px=base.camera.cx_px - offset_px)
    rig = replace(base, sensor=camera, mount=Mount(1.4, tilt_deg, roll_deg))
    disparity = rng.integers(-16, 16 * SUBPIXELS, (80 - row_start, 96)).astype(np.int16)
    n_x, n_y = round(6.0 / cell_m), round(9.0 / cell_m)
    ground = rng.normal(0.0, 0.15, (n_y, n_x)).astype(np.float32)
    ground[rng.random(ground.shape) < 0.1] = np.nan
    arguments = (
        disparity,
        row_start,
        depth_table(rig, 16, SUBPIXELS),
        *rays(rig, rig.mount.rotation(), 1.4),
        ground,
        cell_m,
        np.float32(bottom_m),
        np.float32(bottom_m + slice_m),
    )
    counts = bin_pixels(*arguments)
    with np.errstate(invalid="ignore"):  # infinite depths
        reference = bin_pixels_reference(*arguments)
    assert counts.shape == reference.shape == (2, n_y, n_x)
    assert np.array_equal(counts, reference)


def one_point(x_m: float, y_m: float, z_m: float, ground_m: float = 0.0) -> npt.NDArray[np.int32]:
    """Counts of a single pixel that sees a point of the vehicle frame, in slice 0.2-2.2 m."""
    # A ray that ends at the point at the depth of disparity 10 px, whatever the camera.
    table = depth_table(RIG, 64, SUBPIXELS)
    depth = float(table[160])
    zero = np.zeros(3, np.float32)
    ray = (np.array([x_m, y_m, z_m]) / depth).astype(np.float32)
    disparity = np.array([[160]], np.int16)
    ground = np.full(COARSE.shape, ground_m, np.float32)
    bottom_m, top_m = np.float32(0.2), np.float32(2.2)
    return bin_pixels(disparity, 0, table, ray, zero, zero, zero, ground, 0.25, bottom_m, top_m)


@pytest.mark.parametrize(
    ("point", "cell"),
    [
        ((-1.9, 0.1), (0, 0)),
        ((1.9, 0.1), (0, 15)),
        ((0.1, 5.9), (23, 8)),
        ((-0.1, 3.1), (12, 7)),
    ],
)
def test_a_point_is_counted_in_its_cell(point: tuple[float, float], cell: tuple[int, int]) -> None:
    counts = one_point(*point, 1.0)
    assert counts.sum() == 1
    assert counts[:, *cell].tolist() == [0, 1]


@pytest.mark.parametrize("point", [(-2.1, 3.0), (2.1, 3.0), (0.0, -0.1), (0.0, 6.1)])
def test_a_point_outside_is_not_counted(point: tuple[float, float]) -> None:
    assert not one_point(*point, 1.0).any()


@pytest.mark.parametrize(
    ("above_m", "expected"),
    [(-0.6, [0, 0]), (-0.4, [1, 0]), (0.1, [1, 0]), (0.3, [0, 1]), (2.1, [0, 1]), (2.3, [0, 0])],
)
@pytest.mark.parametrize("ground_m", [0.0, 0.35, -0.8])
def test_the_slice_is_taken_above_the_cell_s_ground(
    above_m: float, expected: list[int], ground_m: float
) -> None:
    counts = one_point(0.1, 3.1, ground_m + above_m, ground_m)
    assert counts[:, 12, 8].tolist() == expected
    assert counts.sum() == sum(expected)


def test_a_pixel_without_a_match_is_not_counted() -> None:
    table = depth_table(RIG, 64, SUBPIXELS)
    ground = np.zeros(COARSE.shape, np.float32)
    for value in (-16, -1, 0):
        disparity = np.full((50, 50), value, np.int16)
        geometry = rays(RIG, RIG.mount.rotation(), 2.8)
        counts = bin_pixels(
            disparity, 0, table, *geometry, ground, 0.25, np.float32(0.2), np.float32(2.2)
        )
        assert not counts.any()


# --- clouds


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 3000),
    st.sampled_from([0.05, 0.25, 0.3]),
    st.floats(0.05, 0.5),
    st.floats(0.0, 2.5),
)
def test_the_kernel_of_points_is_the_reference(
    seed: int, count: int, cell_m: float, bottom_m: float, slice_m: float
) -> None:
    rng = np.random.default_rng(seed)
    mount = Mount(1.7, rng.uniform(-10.0, 30.0), rng.uniform(-8.0, 8.0), rng.uniform(-40.0, 40.0))
    level = rng.normal((0.0, 4.0, 0.5 - 1.7), (3.0, 4.0, 1.0), (count, 3))
    points = (level @ mount.rotation()).astype(np.float32)
    points[rng.random(points.shape) < 0.02] = np.nan
    n_x, n_y = round(6.0 / cell_m), round(9.0 / cell_m)
    ground = rng.normal(0.0, 0.15, (n_y, n_x)).astype(np.float32)
    ground[rng.random(ground.shape) < 0.1] = np.nan
    pose = mount.rotation().astype(np.float32), 1.7
    above = ground, cell_m, np.float32(bottom_m), np.float32(bottom_m + slice_m)
    counts = bin_points(points, *pose, *above)
    with np.errstate(invalid="ignore"):
        reference = bin_points_reference(points, *pose, *above)
    assert counts.shape == reference.shape == (2, n_y, n_x)
    assert np.array_equal(counts, reference)
    shuffled = points[rng.permutation(count)]
    assert np.array_equal(counts, bin_points(shuffled, *pose, *above))


@pytest.mark.parametrize(
    ("above_m", "expected"),
    [(-0.6, [0, 0]), (-0.4, [1, 0]), (0.1, [1, 0]), (0.3, [0, 1]), (2.1, [0, 1]), (2.3, [0, 0])],
)
@pytest.mark.parametrize("ground_m", [0.0, 0.35, -0.8])
def test_a_point_of_a_cloud_is_counted_above_its_cell_s_ground(
    above_m: float, expected: list[int], ground_m: float
) -> None:
    ground = np.full(COARSE.shape, ground_m, np.float32)
    outside = [[-2.1, 3.0, 0.5], [2.1, 3.0, 0.5], [0.0, -0.1, 0.5], [0.0, 6.1, 0.5]]
    # The sensor looks along y, 1 m up: x right, y down, z forward.
    R = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)
    level = np.array([[0.1, 3.1, ground_m + above_m], *outside], np.float32)
    points = np.ascontiguousarray((level - np.float32([0.0, 0.0, 1.0])) @ R)
    counts = bin_points(points, R, 1.0, ground, 0.25, np.float32(0.2), np.float32(2.2))
    assert counts[:, 12, 8].tolist() == expected
    assert counts.sum() == sum(expected)
