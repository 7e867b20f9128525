"""Steps, drops, ditches and slopes of a synthetic field: what is marked, and what is not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import StereoSettings
from fieldgrid.geometry import NO_STEP_KNOWN, OBSTACLE_ABOVE, STEP_CHANNEL, LocalGrid, Tilt
from fieldgrid.maps.layers.built_in.relief import LEAST_STEP_CM, STEP_VOTES
from fieldgrid.perception import FrameGround, LocalGridder
from fieldgrid.perception.edges import WIDEST_GAP, find_edges
from fieldgrid.perception.localgrid import step_range_m
from fieldgrid.perception.stereo import Disparity
from tests.scenes import Box, Ground, depth_rig, paper_rig, render

_Float64 = npt.NDArray[np.float64]
Scene = list[Ground | Box]

GRIDDER = LocalGridder(paper_rig())
_AXES = GRIDDER.spec.centres_m()
X, Y = _AXES[0][None, :], _AXES[1][:, None]
SEEN = (Y > 4.5) & (Y < 9.5) & (np.abs(X) < 0.36 * Y)
FAR = 50.0


def strips(axis: str, edges_m: Sequence[float], heights_m: Sequence[float]) -> Scene:
    """Level strips that meet at edges, with the faces between them, across an axis."""
    ends = [-math.inf, *edges_m, math.inf]
    scene: Scene = [
        Ground(height, **{f"{axis}_from_m": low, f"{axis}_to_m": high})
        for height, low, high in zip(heights_m, ends[:-1], ends[1:], strict=True)
    ]
    for edge, pair in zip(edges_m, pairwise(heights_m), strict=True):
        thin, wide = (edge - 0.005, edge + 0.005), (-FAR, FAR)
        sides = (thin, wide) if axis == "x" else (wide, thin)
        scene.append(Box(*sides, (min(pair), max(pair))))
    return scene


def bend(axis: str, at_m: float, before_deg: float, after_deg: float) -> Scene:
    """Two slopes that meet at a crest or in a valley, level with the vehicle where they do."""
    rises = [math.tan(math.radians(angle)) for angle in (before_deg, after_deg)]
    return [
        Ground(-rises[0] * at_m, **{f"slope_{axis}": rises[0], f"{axis}_to_m": at_m}),
        Ground(-rises[1] * at_m, **{f"slope_{axis}": rises[1], f"{axis}_from_m": at_m}),
    ]


@cache
def noise(seed: int) -> _Float64:
    """A quarter of a pixel, alike among neighbours as a matcher's is."""
    drawn = np.random.default_rng(seed).normal(0.0, 1.0, (480, 640)).astype(np.float32)
    blurred = cv2.GaussianBlur(drawn, (9, 9), 2.0)
    return np.asarray(4.0 * blurred / blurred.std())


def view(scene: Scene, seed: int) -> tuple[LocalGrid, FrameGround]:
    """The local grid of a frame with noise, and its ground."""
    region = GRIDDER.region
    exact = render(GRIDDER.rig, scene, region.num_disparities, row_start=region.row_start)
    noisy = np.rint(exact + noise(seed)[: len(exact)])
    values = np.where(exact > 0, np.maximum(noisy, 1), exact).astype(np.int16)
    grid, ground = GRIDDER.from_disparity(Disparity(values, region.row_start), Tilt(0.0, 0.0))
    assert ground.refined
    return grid, ground


def look(scene: Scene, seed: int) -> tuple[LocalGrid, npt.NDArray[np.uint8]]:
    """The local grid of a frame, and its steps as they are kept, in cells that it saw."""
    grid, ground = view(scene, seed)
    cm = np.where(grid.observed, ground.channels()[STEP_CHANNEL], NO_STEP_KNOWN)
    return grid, cm.astype(np.uint8)


FIELD = {
    "kerb": ([0.0], [0.0, 0.15]),
    "down": ([0.0], [0.0, -0.15]),
    "bank": ([0.0], [0.0, -0.3]),
    "ditch": ([0.0, 1.2], [0.0, -0.4, 0.0]),
    "terrace": ([0.0], [0.0, -0.8]),
}


@pytest.mark.parametrize(
    ("name", "axis"),
    [
        *(("kerb", "x"), ("down", "y"), ("bank", "x"), ("ditch", "y"), ("terrace", "x")),
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in (
                ("kerb", "y"),
                ("down", "x"),
                ("bank", "y"),
                ("ditch", "x"),
                ("terrace", "y"),
            )
        ),
    ],
)
def test_most_frames_mark_a_step_that_they_see(name: str, axis: str) -> None:
    """By the votes of frames that have the edge at different places, as cells of a map do."""
    marked, elsewhere = [], []
    for seed, at_m in enumerate(np.linspace(5.1, 8.3, 8) if axis == "y" else np.linspace(-1, 1, 8)):
        edges_m, heights_m = FIELD[name]
        edges_m = [at_m + edge for edge in edges_m]
        _, cm = look(strips(axis, edges_m, heights_m), seed)
        along = Y if axis == "y" else X
        away = np.min([np.abs(along - edge) for edge in edges_m], axis=0) * np.ones_like(cm)
        known = SEEN & (cm != NO_STEP_KNOWN)
        at_edge = cm[known & (away < 0.1)]
        marked.append(np.mean(at_edge >= LEAST_STEP_CM) if at_edge.size else np.nan)
        elsewhere.append(np.mean(cm[known & (away > 1.5)] >= LEAST_STEP_CM))
    assert np.nanmean(marked) > 1.0 / STEP_VOTES
    assert np.mean(elsewhere) < 0.03


@pytest.mark.parametrize(
    "scene",
    [
        [Ground(slope_x=math.tan(math.radians(15.0)))],
        [Ground(slope_x=math.tan(math.radians(-15.0)))],
        bend("x", 0.7, 0.0, 15.0),
        bend("x", -0.7, -8.0, -15.0),
        bend("y", 7.6, 0.0, -12.0),
        bend("y", 7.6, 0.0, 10.0),
    ],
)
def test_no_slope_is_a_step_or_an_obstacle(scene: Scene) -> None:
    for seed in range(3):
        grid, cm = look(scene, seed)
        obstacles = grid.density > OBSTACLE_ABOVE
        known = SEEN & (cm != NO_STEP_KNOWN)
        assert known.sum() > 0.5 * SEEN.sum()
        assert np.mean(cm[known] >= LEAST_STEP_CM) < 0.02
        # A few cells at the foot of a sudden rise, none in an even slope.
        most = 0.002 if len(scene) > 1 else 0.0
        assert obstacles[SEEN & np.ones_like(obstacles)].mean() <= most


@pytest.mark.parametrize("axis", ["x", "y"])
def test_what_the_edge_of_a_terrace_hides_is_unknown(axis: str) -> None:
    for seed, at_m in enumerate([0.2, 0.7] if axis == "x" else [5.7, 7.2]):
        grid, _ = look(strips(axis, [at_m], [0.0, -0.8]), seed)
        behind = (Y if axis == "y" else X) * np.ones(grid.spec.shape) - at_m
        # Noise of the range carries a few points of the edge past it.
        assert grid.observed[SEEN & (behind > 0.15) & (behind < 1.5)].mean() < 0.01
        assert grid.observed[SEEN & (behind < -0.05) & (behind > -1.0)].mean() > 0.9


def test_no_step_is_told_of_what_stands_or_lies_too_far() -> None:
    box = Box((-0.6, 0.6), (7.0, 7.8), (0.0, 0.15))
    _, cm = look([Ground(), Box((1.0, 1.6), (5.0, 9.0), (0.0, 1.2)), box], 0)
    beside = (X > 1.05) & (X < 1.4) & (Y > 5.6) & (Y < 8.4)
    assert (cm[beside] == NO_STEP_KNOWN).mean() > 0.6
    assert not ((cm[beside] >= LEAST_STEP_CM) & (cm[beside] != NO_STEP_KNOWN)).any()
    far = np.hypot(X, Y) > step_range_m(GRIDDER.rig, GRIDDER.max_range_m, StereoSettings())
    assert (cm[far] == NO_STEP_KNOWN).all()
    assert 9.0 < Y[~far.all(axis=1)].max() < 10.5
    assert step_range_m(depth_rig(), 12.0, StereoSettings()) == 12.0


def steps(low: _Float64) -> _Float64:
    everywhere = np.ones(low.shape, np.bool_)
    return find_edges(low, everywhere, everywhere).steps


def test_the_equation_of_a_step() -> None:
    """|(c - b) - (s + t) / 2|, with the slopes s and t on either side."""
    row = np.array([[0.0, 0.05, 0.10, 0.30, 0.32, 0.36]])
    found = steps(row)[0]
    assert found[2] == pytest.approx(0.2 - (0.05 + 0.03) / 2.0)
    np.testing.assert_array_equal(steps(row.T)[:, 0], found)
    assert np.isnan(found[[0, 5]]).all()  # the slope on one side is not known
    assert steps(np.tile(row, (4, 1)))[1, 2] == pytest.approx(0.16)
    np.testing.assert_array_equal(steps(-row), [found])
    beside = steps(np.array([[0.0, 0.01, 0.0, 0.0, 0.9, 0.9, 0.9]]))[0]
    assert beside[1] == pytest.approx(0.01)  # not a half of the step beside it


@pytest.mark.parametrize("gap", [1, WIDEST_GAP - 1, WIDEST_GAP])
def test_a_drop_that_hides_what_is_behind_it_has_its_edge_on_the_higher_side(gap: int) -> None:
    row = np.concatenate([0.02 * np.arange(4), np.full(gap, np.nan), [-0.9, -0.9, -0.9, -0.9]])[
        None
    ]
    for found in (steps(row)[0], steps(row[:, ::-1])[0, ::-1]):
        if gap == WIDEST_GAP:
            assert np.isnan(found[3 : gap + 5]).all()
            continue
        np.testing.assert_allclose(found[3 : gap + 4], 0.96)
        assert np.isnan(found[gap + 4])
        assert found[gap + 5] == 0.0
    shallow = steps(np.where(row < -0.5, 0.06 - 0.09 * (gap + 1), row))[0]
    assert np.isnan(shallow[3 : gap + 4]).all()  # less than 1:5
