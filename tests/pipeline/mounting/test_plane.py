"""The plane of the ground among whatever else stands there."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import Mount
from fieldgrid.pipeline.mounting.plane import SensorGround, low_patches, refined_plane, rough_plane

_Float64 = npt.NDArray[np.float64]

mounts = st.builds(
    Mount,
    height_m=st.floats(1.0, 4.0),
    tilt_deg=st.floats(0.0, 55.0),
    roll_deg=st.floats(-8.0, 8.0),
)


def plane_of(mount: Mount) -> SensorGround:
    return SensorGround(mount.rotation()[2], mount.height_m)


def seen(mount: Mount, level_m: _Float64) -> _Float64:
    """Points of the level frame, in the frame of a sensor that is mounted so."""
    return (level_m - [0.0, 0.0, mount.height_m]) @ mount.rotation()


def field(
    ground: int, wall: int, seed: int = 0, *, noise_m: float = 0.01, slope: float = 0.0
) -> _Float64:
    """Points of the ground ahead, and of a wall along the right side of the lane."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-2.0, 2.0, ground), random.uniform(3.0, 10.0, ground)
    on_ground = np.column_stack([x, y, slope * y + random.normal(0.0, noise_m, ground)])
    z = random.uniform(0.0, 2.0, wall)
    on_wall = np.column_stack([np.full(wall, 1.5), random.uniform(3.0, 10.0, wall), z])
    return np.concatenate([on_ground, on_wall])


@given(mounts)
def test_the_angles_of_a_plane_are_those_of_a_mount(mount: Mount) -> None:
    plane = plane_of(mount)
    assert plane.tilt_deg == pytest.approx(mount.tilt_deg, abs=1e-9)
    assert plane.roll_deg == pytest.approx(mount.roll_deg, abs=1e-9)
    np.testing.assert_allclose(plane.rotation(), mount.rotation(), atol=1e-12)


@given(mounts, st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.3, 0.3))
def test_a_corrected_plane_is_level_where_the_old_one_was_not(
    mount: Mount, c1: float, c2: float, c0: float
) -> None:
    x, y = np.meshgrid([-1.0, 0.0, 2.0], [1.0, 4.0, 9.0])
    points = np.column_stack([x.ravel(), y.ravel(), (c0 + c1 * x + c2 * y).ravel()])
    corrected = plane_of(mount).corrected(np.array([c0, c1, c2]))
    assert np.abs(corrected.level(seen(mount, points))[:, 2]).max() < 1e-9


@settings(max_examples=8, deadline=None)
@given(mounts, st.integers(0, 100))
def test_the_ground_is_found_among_more_points_of_a_wall(mount: Mount, seed: int) -> None:
    points = seen(mount, field(6000, 8000, seed))
    sigma = np.full(len(points), 0.02)
    rough = rough_plane(points, sigma)
    assert rough is not None
    assert rough.height_m == pytest.approx(mount.height_m, abs=0.25)
    plane = refined_plane(rough, points, sigma)
    assert plane is not None
    assert plane.height_m == pytest.approx(mount.height_m, abs=0.03)
    assert plane.tilt_deg == pytest.approx(mount.tilt_deg, abs=0.3)
    assert plane.roll_deg == pytest.approx(mount.roll_deg, abs=0.5)


def test_what_stands_on_the_ground_is_not_the_ground() -> None:
    """A flat canopy that hides most of the ground: nothing is seen through the ground."""
    mount, random = Mount(3.0, 20.0), np.random.default_rng(2)
    canopy = field(3000, 0)
    canopy[:, 2] += 1.0
    ground = field(1000, 0)
    points = seen(mount, np.concatenate([canopy, ground])[random.permutation(4000)])
    rough = rough_plane(points, np.full(4000, 0.02))
    assert rough is not None
    assert rough.height_m == pytest.approx(3.0, abs=0.1)


def test_a_wall_alone_is_no_ground() -> None:
    points = seen(Mount(2.0, 10.0), field(0, 3000))
    assert rough_plane(points, np.full(3000, 0.02)) is None


def test_a_few_points_are_no_plane() -> None:
    points = seen(Mount(2.0, 10.0), field(150, 0))
    assert rough_plane(points, np.full(150, 0.02)) is None


def test_a_plane_of_few_patches_is_not_believed() -> None:
    points = seen(Mount(2.0, 10.0), field(3000, 0) * [0.05, 0.05, 1.0] + [0.0, 5.0, 0.0])
    assert refined_plane(plane_of(Mount(2.0, 10.0)), points, np.full(3000, 0.02)) is None


def test_the_ground_of_a_patch_is_where_its_lowest_quarter_ends() -> None:
    z = np.arange(1.0, 41.0) / 100.0
    level = np.column_stack([np.full(40, 0.1), np.full(40, 4.1), z])
    mount = Mount(2.0, 10.0)
    (patch,) = low_patches(plane_of(mount), seen(mount, level), np.full(40, 0.02))
    np.testing.assert_allclose(patch[:3], [0.1, 4.1, z[10]], atol=1e-9)


def test_patches_far_above_the_plane_or_thin_ones_are_left_out() -> None:
    mount = Mount(2.0, 10.0)
    high = np.column_stack([np.full(20, 0.1), np.full(20, 4.1), np.full(20, 0.6)])
    thin = np.column_stack([np.full(5, 0.1), np.full(5, 6.1), np.zeros(5)])
    points = seen(mount, np.concatenate([high, thin]))
    assert len(low_patches(plane_of(mount), points, np.full(25, 0.02))) == 0
