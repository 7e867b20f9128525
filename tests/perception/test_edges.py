"""Drops: what falls away from the vehicle, what does not, and what lies beyond."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import BEYOND_DROP, DROP_CHANNEL, NO_DROP_TOLD, OBSTACLE_ABOVE
from fieldgrid.perception.edges import Edges, find_edges
from tests.perception.test_ground_steps import FIELD, GRIDDER, SEEN, Scene, X, Y, bend, strips, view
from tests.scenes import Ground

_Float64 = npt.NDArray[np.float64]
DEEP = {"wall": ([0.0], [0.0, -1.6])}


def look(scene: Scene, seed: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    """What a frame says of drops, and the cells that it saw."""
    grid, ground = view(scene, seed)
    return ground.channels()[DROP_CHANNEL], grid.observed


def falls(cm: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    return np.asarray((cm > 0) & (cm < BEYOND_DROP))


@pytest.mark.parametrize(
    ("name", "axis"),
    [
        *(("down", "y"), ("bank", "x"), ("ditch", "x"), ("terrace", "y"), ("wall", "x")),
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in (
                ("down", "x"),
                ("bank", "y"),
                ("ditch", "y"),
                ("terrace", "x"),
                ("wall", "y"),
            )
        ),
    ],
)
def test_most_frames_mark_the_edge_of_a_drop_and_nothing_else(name: str, axis: str) -> None:
    edges_m, heights_m = (FIELD | DEEP)[name]
    marked, elsewhere, behind = [], [], []
    for seed, at_m in enumerate(np.linspace(5.1, 7.2, 6) if axis == "y" else (0.2, 0.55, 0.9, 1.3)):
        cm, observed = look(strips(axis, [at_m + edge for edge in edges_m], heights_m), seed)
        away = (Y if axis == "y" else X) * np.ones(cm.shape) - at_m
        told = SEEN & (cm != NO_DROP_TOLD)
        marked.append(falls(cm)[told & (np.abs(away) < 0.1)].mean())
        before = told & observed & (away < -0.75) & (np.abs(away) < 3.0)
        elsewhere.append((cm[before] > 0).sum() / max(before.sum(), 1))
        low = SEEN & observed & (away > 0.6) & (away < (0.9 if name == "ditch" else 2.5))
        if low.any():
            behind.append((cm[low] > 0).mean())
    assert np.mean(marked) > (0.8 if name in ("bank", "ditch", "terrace") else 0.5)
    assert np.mean(elsewhere) < 0.02
    assert not behind or np.mean(behind) > (0.6 if name == "down" else 0.95)


@pytest.mark.parametrize(
    "scene",
    [
        [Ground()],
        [Ground(slope_x=np.tan(np.radians(15.0)))],
        [Ground(slope_x=np.tan(np.radians(-15.0)))],
        bend("x", 0.7, 0.0, -15.0),
        bend("x", -0.7, 8.0, -8.0),
        bend("y", 7.6, 0.0, -15.0),
        bend("y", 7.6, 6.0, -9.0),
        bend("y", 6.1, -10.0, 5.0),
        strips("y", [7.3], [0.0, 0.15]),
        strips("x", [0.6], [0.0, 0.15]),
    ],
)
def test_no_slope_no_crest_and_no_rise_is_a_drop(scene: Scene) -> None:
    for seed in range(4):
        cm, observed = look(scene, seed)
        told = observed & (cm != NO_DROP_TOLD)
        assert told.sum() > 5000
        assert falls(cm)[told].mean() < 0.005
        assert (cm[told] == BEYOND_DROP).mean() < 0.005


def edges_of(height: _Float64, *, steep: bool = True) -> Edges:
    """Where drops can be told, and the line of sight is steep everywhere, or nowhere."""
    return find_edges(height, np.ones(height.shape, np.bool_), np.full(height.shape, steep))


def across(heights: list[float]) -> Edges:
    """Of rows of patches that are alike from side to side, from the vehicle on."""
    column = np.array(heights)[:, None]
    return edges_of(np.repeat(column, 5, axis=1))


def test_the_equation_of_a_drop() -> None:
    found = across([0.0, 0.0, 0.0, -0.3, -0.3, -0.3, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.drops[:, 2], [0, 0, 0.3, 0.3, 0, 0, 0, 0, 0])
    # Behind the ditch the ground is back on its level.
    assert found.beyond[:, 2].tolist() == [False] * 3 + [True] * 3 + [False] * 3
    # Whatever rises as much is a step and no drop.
    assert not across([0.0, 0.0, 0.0, 0.3, 0.3, 0.3]).drops.any()
    assert across([0.0, 0.0, 0.0, 0.3, 0.3, 0.3]).steps[2, 2] == pytest.approx(0.3)
    # Of a single patch that is too high nothing falls; the lower of two counts.
    assert not across([0.0, 0.0, 0.0, 0.14, 0.0, 0.0, 0.0]).drops.any()
    assert across([0.0, 0.0, 0.05, -0.15, -0.15, -0.15]).drops.max() == pytest.approx(0.15)
    assert not across([0.0, 0.0, 0.0, -0.09, -0.09, -0.09]).drops.any()


def test_what_is_hidden_behind_an_edge_and_lower_is_beyond() -> None:
    nan = float("nan")
    found = across([0.0, 0.0, 0.0, nan, nan, -0.6, -0.6, -0.6])
    np.testing.assert_allclose(found.drops[:, 2], [0, 0, 0.6, 0.6, 0.6, 0, 0, 0])
    assert found.beyond[:, 2].tolist() == [False] * 3 + [True] * 5
    # Not steeper than the far side of a hill may be.
    low = np.repeat(np.array([0.0, 0.0, 0.0, nan, nan, -0.4, -0.4, -0.4])[:, None], 5, axis=1)
    hidden = edges_of(low, steep=False)
    assert not hidden.drops.any()
    assert not hidden.beyond.any()
    assert edges_of(low).drops[2, 2] == pytest.approx(0.4)
    # Nor where it is not known well enough.
    near = np.zeros(low.shape, np.bool_)
    near[:2] = True
    far = find_edges(low, near, ~np.isnan(np.zeros(low.shape)))
    assert not far.drops.any()
    assert not far.beyond.any()
    assert far.steps[2, 2] == pytest.approx(0.4)


def test_left_and_right_are_alike_and_what_lies_before_an_edge_is_not_beyond() -> None:
    random = np.random.default_rng(4)
    height = np.zeros((12, 12))
    height[:, 9:] = -0.4
    height += random.normal(0.0, 0.005, height.shape)
    found, other = edges_of(height), edges_of(height[:, ::-1])
    for one, mirrored in zip(found, other, strict=True):
        np.testing.assert_array_equal(one, mirrored[:, ::-1])
    assert (found.drops[:, 8:10] > 0.3).all()
    assert not (found.drops[:, :8] > 0.0).any()
    assert found.beyond[2:, 9:].all()
    assert not found.beyond[:, :9].any()
    # From below it is a rise.
    assert not edges_of(-height).drops.any()


def test_an_edge_goes_on_where_a_patch_of_it_was_not_found() -> None:
    height = np.zeros((12, 11))
    height[6:] = -0.3
    height[3:6, 5] = np.nan
    beyond = edges_of(height).beyond
    assert beyond[6:].all()
    assert not beyond[:6][np.isfinite(height[:6])].any()


def test_beyond_is_what_the_line_of_sight_has_passed() -> None:
    """Against lines that are followed in small steps."""
    height = np.zeros((16, 20))
    height[7:10, 4:9] = -0.35  # a pit
    rim = edges_of(height)
    j, i = np.nonzero(rim.beyond)
    assert len(j) >= 12
    for row, column in zip(j.tolist(), i.tolist(), strict=True):
        assert height[row, column] < 0.0
        line = np.linspace(0.0, 1.0, 200)[:, None] * [row + 0.5, column + 0.5 - 10.0]
        over = height[line[:, 0].astype(int), np.floor(line[:, 1] + 10.0).astype(int)]
        assert (over == 0.0).any()


def test_far_edges_are_not_told() -> None:
    cm, _ = look(strips("y", [11.5], [0.0, -0.4]), 0)
    assert not falls(cm).any()
    far = np.hypot(X, Y) > 11.0
    assert np.isin(cm[far], (NO_DROP_TOLD, BEYOND_DROP)).all()
    assert GRIDDER.max_range_m > 11.0


def test_on_a_bank_the_bank_is_ground_and_the_land_below_is_beyond() -> None:
    """Where the plane of a frame is that of the land below."""
    for height_m in (-0.3, -0.6):
        grid, ground = view(strips("y", [5.3], [0.0, height_m]), 0)
        assert not (grid.density[SEEN & (Y < 5.2)] > OBSTACLE_ABOVE).any()
        assert grid.observed[SEEN & (Y < 5.0)].mean() > 0.9
        below = SEEN & (Y > 6.5) & (Y < 9.0) & grid.observed
        cm = ground.channels()[DROP_CHANNEL]
        assert (cm[below] == BEYOND_DROP).mean() > 0.95 or not below.any()
