"""How high what stands reaches, and how low it begins: kernels, scenes, and a map of them."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import (
    FOOT_CHANNEL,
    GROUND_BELOW,
    TOP_CHANNEL,
    GridSpec,
    LocalGrid,
    Mount,
    Pose,
)
from fieldgrid.maps import MapView, Transfer, create_map, open_map
from fieldgrid.perception import SUBPIXELS
from fieldgrid.perception.depth import depth_table, rays
from fieldgrid.perception.standing import STEP_PX, reach_dm, stack_pixels, stack_points
from tests.maps.file.maps import DATUM
from tests.perception.test_ground_steps import X, Y, view
from tests.scenes import Box, Ground, paper_rig

_Float32 = npt.NDArray[np.float32]


def stacked(xyz: _Float32, ground_m: _Float32, block_m: float, bins: int) -> npt.NDArray[np.int32]:
    """Points [n, 3] of the grid's frame by block and height, the slow way."""
    counts = np.zeros((*ground_m.shape, bins), np.int32)
    for x, y, z in xyz:
        j, i = np.floor(y / block_m), np.floor(x / block_m + 0.5 * ground_m.shape[1])
        if not (0 <= j < ground_m.shape[0] and 0 <= i < ground_m.shape[1]):
            continue
        above = z - ground_m[int(j), int(i)]
        if -0.2 < above < 2.2:
            counts[int(j), int(i), max(int(10.0 * above), 1) if above > 0.2 else 0] += 1
    return counts


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_the_kernels_count_what_the_slow_way_counts(seed: int) -> None:
    random = np.random.default_rng(seed)
    ground_m = random.normal(0.0, 0.1, (30, 20)).astype(np.float32)
    ground_m[random.random(ground_m.shape) < 0.1] = np.nan
    mount = Mount(1.5, random.uniform(0.0, 20.0), random.uniform(-5.0, 5.0))
    rig = paper_rig(focal_px=120.0, size_px=(48, 40), height_m=1.5)
    above = ground_m, 0.2, np.float32(0.2), np.float32(2.2)
    found, found_of_points = np.zeros((2, 30, 20, 22), np.int32)
    table = depth_table(rig, 16, SUBPIXELS)
    disparity = random.integers(-16, 16 * SUBPIXELS, (30, 48)).astype(np.int16)
    ray, du, dv, offset = rays(rig, mount.rotation(), 1.5)
    stack_pixels(disparity, 10, table, ray, du, dv, offset, *above, found)
    v, u = np.mgrid[0:30:STEP_PX, 0:48:STEP_PX].reshape(2, -1)
    d = disparity[v, u]
    v, u, d = v[d > 0, None], u[d > 0, None], d[d > 0]
    points = table[d][:, None] * (ray + np.float32(v + 10) * dv + np.float32(u) * du) + offset
    close(found, stacked(points, ground_m, 0.2, 22))
    cloud = random.normal((0.0, 0.0, 4.0), (2.0, 0.8, 2.0), (800, 3)).astype(np.float32)
    R = mount.rotation().astype(np.float32)
    level = cloud @ R.T + np.float32([0.0, 0.0, 1.5])
    stack_points(cloud, R, 1.5, *above, found_of_points)
    close(found_of_points, stacked(level, ground_m, 0.2, 22))


def close(found: npt.NDArray[np.int32], expected: npt.NDArray[np.int32]) -> None:
    """But for points on the very edge of a bin or block."""
    assert expected.sum() > 10
    assert np.abs(found - expected).sum() <= 4


def test_a_bin_counts_from_enough_points_on() -> None:
    counts = np.zeros((1, 4, 22), np.int32)
    counts[0, 0, [2, 8]] = 5
    counts[0, 1, [0, 12, 17, 20]] = 2, 9, 5, 4
    counts[0, 2, [0, 5]] = 9, 4
    counts[0, 3, [0, 21]] = 1, 5
    needed = np.array([2, 5])[:, None, None] * np.ones((1, 1, 4), np.int32)
    top, foot = reach_dm(counts, needed)
    assert top.tolist() == [[9, 18, 0, 22]]
    assert foot.tolist() == [[2, 12 + GROUND_BELOW, 0, 21]]


def test_posts_boxes_and_what_hangs_have_their_heights() -> None:
    post = Box((-1.0, -0.8), (6.0, 6.2), (0.0, 1.5))
    box = Box((0.2, 0.8), (6.5, 7.0), (0.0, 0.6))
    hanging = Box((1.2, 2.0), (6.0, 7.0), (1.3, 1.7))
    grid, ground = view([Ground(), post, box, hanging], 0)
    top, foot = (ground.channels()[name] for name in (TOP_CHANNEL, FOOT_CHANNEL))
    for thing, reaches in ((post, 15), (box, 6), (hanging, 17)):
        (left, right), (near, far), (low, _) = thing
        inside = (left - 0.05 < X) & (right + 0.05 > X) & (near - 0.05 < Y) & (far + 0.05 > Y)
        stands = inside & (grid.density > 0) & (top > 0)
        assert stands.any()
        assert abs(int(top[stands].max()) - reaches) <= 1
        begins = foot[stands] % GROUND_BELOW
        assert begins.min() >= 10 * low - 1
        if low == 0.0:
            assert begins.min() <= 3
    under = (X > 1.3) & (X < 1.9) & (Y > 6.1) & (Y < 6.7) & (top > 0)
    assert (foot[under] >= GROUND_BELOW).mean() > 0.3
    bare = (Y > 5.0) & (Y < 9.0) & (X < -1.5) & (X > -2.0)
    assert not top[bare].any()


SPEC = GridSpec(width_m=4.0, length_m=4.0, cell_m=0.1)
Said = tuple[int, int, int]
"""Density, top and foot of all cells of a frame; no top is that of a session of before."""


def write(path: Path, drives: list[list[Said]], without: str = "") -> Path:
    with create_map(path, DATUM, cell_m=0.1, transfer=Transfer.AREA) as universal:
        for number, frames in enumerate(drives):
            with universal.add_session(str(number)) as session:
                for k, (density, top, foot) in enumerate(frames):
                    values = {TOP_CHANNEL: top, FOOT_CHANNEL: foot} if top >= 0 else {}
                    seen = LocalGrid(
                        SPEC, np.full(SPEC.shape, density, np.uint8), np.ones(SPEC.shape, np.bool_)
                    )
                    session.add(
                        seen,
                        Pose(1_000_000_000, 0.05, 2.05, 3.0, 0.0, 0.02, 0.3, 1.0),
                        frame_id=str(k),
                        channels={
                            name: np.full(SPEC.shape, value, np.uint8)
                            for name, value in values.items()
                        },
                    )
        if without:
            universal.remove_session(without)
        assert universal.verify(deep=True).problems == ()
    return path


def read(path: Path, cell_m: float = 0.1) -> MapView:
    with open_map(path) as universal:
        return universal.read(cell_m=cell_m, layers=("max_height", "clearance"))


HANGS, STANDS, NOTHING, OLD = (90, 18, 12 + GROUND_BELOW), (200, 9, 2), (0, 30, 2), (80, -1, 0)


@pytest.mark.parametrize(
    ("drives", "height_m", "clearance_m"),
    [
        ([[HANGS]], 1.8, 1.2),
        ([[STANDS]], 0.9, np.nan),
        ([[NOTHING]], 0.0, np.nan),  # heights count where the frame has a density
        ([[OLD]], np.nan, np.nan),
        ([[OLD], [HANGS]], 1.8, 1.2),
        ([[HANGS, STANDS, NOTHING]], 1.8, np.nan),
        ([[HANGS], [STANDS]], 1.8, np.nan),
        ([[HANGS, (60, 15, 14)], [(60, 20, 11)]], 2.0, 1.1),
        ([[(60, 15, 14)]], 1.5, np.nan),  # nobody saw the ground below
        ([[(60, 4, 2 + GROUND_BELOW)]], 0.4, np.nan),
    ],
)
def test_the_highest_top_and_the_lowest_foot_count(
    tmp_path: Path, drives: list[list[Said]], height_m: float, clearance_m: float
) -> None:
    for number, order in enumerate(list(permutations(drives))[:2]):
        frames = [list(reversed(one)) if number else one for one in order]
        path = write(tmp_path / f"{number}.gpkg", frames)
        for cell_m in (0.1, 0.2, 0.25):
            found = read(path, cell_m)
            for name, value in (("max_height", height_m), ("clearance", clearance_m)):
                inside = np.unique(found.layer(name)[4:-4, 4:-4])
                np.testing.assert_allclose(inside, [value], atol=1e-6)


def test_a_drive_that_leaves_takes_its_heights_along(tmp_path: Path) -> None:
    left = read(write(tmp_path / "left.gpkg", [[HANGS], [STANDS]], without="1"))
    never = read(write(tmp_path / "never.gpkg", [[HANGS]]))
    for name in ("max_height", "clearance"):
        np.testing.assert_array_equal(left.layer(name), never.layer(name))
