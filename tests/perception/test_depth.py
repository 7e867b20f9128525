"""Images of depths: their codes and their rays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import CalibrationError, Float32
from fieldgrid.geometry import DepthCamera, LeverArm, Mount, Rig
from fieldgrid.perception import CodedDepth
from fieldgrid.perception.depth import (
    FLYING_SHARE,
    encode_depth,
    metric_table,
    points_per_rad,
    rays,
)
from tests.scenes import depth_rig, lidar_rig, paper_rig


def encode_depth_reference(depth_m: Float32, table_m: Float32) -> CodedDepth:
    """The same as `encode_depth`, in NumPy."""
    per_code = np.float32((len(table_m) - 1) / float(table_m[-1]))
    near, far = depth_m - FLYING_SHARE * depth_m, depth_m + FLYING_SHARE * depth_m
    padded = np.pad(depth_m, 1, mode="edge")
    around = (padded[1:-1, :-2], padded[1:-1, 2:]), (padded[:-2, 1:-1], padded[2:, 1:-1])
    flying = np.zeros(depth_m.shape, dtype=np.bool_)
    for one, other in around:
        flying |= (one < near) & (other > far) | (one > far) & (other < near)
    code = depth_m * per_code + np.float32(0.5)
    known = (code >= 1.0) & (code < len(table_m) - 1) & ~flying
    return CodedDepth(np.where(known, code, 0.0).astype(np.int16), 0, table_m)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(1.0, 400.0), st.sampled_from([(1, 1), (1, 9), (7, 5)]))
def test_the_kernel_is_the_reference(seed: int, farthest_m: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    depth_m = (farthest_m * rng.choice([0.3, 0.32, 0.5, 1.1], shape)).astype(np.float32)
    depth_m[rng.random(shape) < 0.2] = np.nan
    depth_m[rng.random(shape) < 0.1] = rng.choice([0.0, -1.0, np.inf, 1e30])
    table = metric_table(farthest_m)
    coded = encode_depth(depth_m, table)
    with np.errstate(all="ignore"):
        reference = encode_depth_reference(depth_m, table)
    assert np.array_equal(coded.codes, reference.codes)
    assert coded.codes.dtype == np.int16
    assert coded.row_start == 0


@given(st.floats(0.002, 32.7))
def test_a_depth_is_told_to_a_millimetre(depth_m: float) -> None:
    table = metric_table(15.0)
    ((code,),) = encode_depth(np.array([[depth_m]], np.float32), table).codes
    assert table[code] == pytest.approx(depth_m, abs=0.000503)


def test_a_table_reaches_as_far_as_asked() -> None:
    for farthest_m in (1.0, 32.767, 40.0, 400.0):
        table = metric_table(farthest_m)
        assert len(table) == 1 << 15
        assert table[-1] >= farthest_m * (1 - 1e-6)
        assert np.isinf(table[0])
        assert (np.diff(table[1:]) > 0).all()
    assert metric_table(15.0)[1000] == pytest.approx(1.0)


@pytest.mark.parametrize("depth_m", [np.nan, 0.0, -3.0, np.inf, 33.0])
def test_what_is_no_depth_has_no_code(depth_m: float) -> None:
    coded = encode_depth(np.full((4, 4), depth_m, np.float32), metric_table(15.0))
    assert not coded.codes.any()


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mixture_of_foreground_and_background_is_dropped(upright: bool, mirrored: bool) -> None:
    row = np.array([5.0, 5.0, 5.0, 7.0, 10.0, 10.0], np.float32)
    image = np.tile(row[::-1] if mirrored else row, (6, 1))
    codes = encode_depth(
        np.ascontiguousarray(image.T if upright else image), metric_table(15.0)
    ).codes
    codes = codes.T if upright else codes
    expected = [5000, 5000, 5000, 0, 10000, 10000]
    assert codes[2].tolist() == (expected[::-1] if mirrored else expected)


def test_an_edge_a_slope_and_a_post_are_no_mixtures() -> None:
    edge = [5.0, 5.0, 10.0, 10.0, 10.0]
    slope = [5.0, 5.4, 5.8, 6.2, 6.7]
    post = [10.0, 10.0, 5.0, 10.0, 10.0]
    beside_nothing = [5.0, 7.0, np.nan, 10.0, 10.0]
    for row in (edge, slope, post, beside_nothing):
        image = np.tile(np.array(row, np.float32), (3, 1))
        codes = encode_depth(image, metric_table(15.0)).codes
        assert np.array_equal(codes > 0, ~np.isnan(image))


@given(st.floats(0.0, 639.0), st.floats(0.0, 479.0), st.floats(0.5, 20.0))
def test_a_ray_of_a_depth_camera_carries_a_pixel_to_its_point(
    u: float, v: float, depth_m: float
) -> None:
    mount = Mount(2.3, 14.0, 3.0, -6.0)
    rig = Rig(DepthCamera(640, 480, 600.0, 610.0, 310.0, 250.0), mount, LeverArm(0.0, 0.0, 3.0))
    ray, du, dv, offset = (part.astype(float) for part in rays(rig, mount.rotation(), 2.3))
    point = depth_m * (ray + u * du + v * dv) + offset
    x, y, z = mount.rotation().T @ (point - np.array([0.0, 0.0, 2.3]))
    assert z == pytest.approx(depth_m, rel=1e-5)
    assert 310.0 + 600.0 * x / z == pytest.approx(u, abs=0.01)
    assert 250.0 + 610.0 * y / z == pytest.approx(v, abs=0.01)


def test_how_many_points_are_in_a_radian() -> None:
    assert points_per_rad(paper_rig(focal_px=780.0)) == 780.0
    assert points_per_rad(depth_rig((400.0, 900.0))) == pytest.approx(600.0)
    assert points_per_rad(lidar_rig(40_000.0)) == pytest.approx(200.0)


def test_a_lidar_has_no_rays() -> None:
    with pytest.raises(CalibrationError, match="has no pixels"):
        rays(lidar_rig(1000.0), np.eye(3), 2.0)
