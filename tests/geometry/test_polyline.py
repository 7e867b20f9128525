"""Polylines: along, across, parts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.geometry import extended, first_beyond, lengths, normals, part, project, resampled

_TURN = st.floats(-0.4, 0.4)
_LINES = st.builds(
    lambda start, turns: np.cumsum(
        [
            (0.0, 0.0),
            *(
                (3.0 * np.cos(a), 3.0 * np.sin(a))
                for a in start + np.cumsum(np.asarray(turns, dtype=np.float64))
            ),
        ],
        axis=0,
    ),
    st.floats(-3.0, 3.0),
    st.lists(_TURN, min_size=2, max_size=12),
)


@given(_LINES, st.floats(0.0, 1.0), st.floats(-0.9, 0.9))
def test_a_point_beside_a_line_is_projected_back(line: np.ndarray, at: float, left: float) -> None:
    s = lengths(line)
    place = at * s[-1]
    k = min(int(np.searchsorted(s, place, side="right")), len(line) - 1)
    unit = (line[k] - line[k - 1]) / (s[k] - s[k - 1])
    foot = line[k - 1] + (place - s[k - 1]) * unit
    point = foot + left * np.array([-unit[1], unit[0]])
    along, across = project(point[None], line)
    # At a bend another piece may be nearer, never one that is farther.
    assert abs(across[0]) <= abs(left) + 1e-9
    assert abs(along[0] - place) < 1.0
    assert across[0] * left >= -1e-9 or abs(left) < 0.5


@given(_LINES, st.floats(0.3, 2.0))
def test_resampling_keeps_ends_and_lies_on_the_line(line: np.ndarray, step: float) -> None:
    fine = resampled(line, step)
    assert np.allclose(fine[[0, -1]], line[[0, -1]])
    assert np.abs(project(fine, line)[1]).max() < 1e-9


@given(_LINES, st.floats(0.1, 0.45), st.floats(0.55, 0.9))
def test_a_part_has_the_length_that_was_asked_for(
    line: np.ndarray, low: float, high: float
) -> None:
    total = lengths(line)[-1]
    inner = part(line, low * total, high * total)
    assert lengths(inner)[-1] == pytest.approx((high - low) * total)


@given(_LINES, st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_extending_adds_to_both_ends(line: np.ndarray, before: float, after: float) -> None:
    longer = extended(line, before, after)
    assert lengths(longer)[-1] == pytest.approx(lengths(line)[-1] + before + after)
    assert np.hypot(*(longer[0] - line[0])) == pytest.approx(before)
    assert np.hypot(*(longer[-1] - line[-1])) == pytest.approx(after)


def test_normals_point_to_the_left() -> None:
    north = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 2.0]])
    assert np.allclose(normals(north), [[-1.0, 0.0]] * 3)


def test_beyond_its_ends_a_line_goes_on() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0]])
    along, across = project(np.array([[-3.0, 1.0], [12.0, -2.0]]), line)
    assert np.allclose(along, [-3.0, 12.0])
    assert np.allclose(across, [1.0, -2.0])


def test_of_two_pieces_the_nearer_one_counts() -> None:
    """Against the same of all pieces at once, in NumPy."""
    rng = np.random.default_rng(0)
    line, points = np.cumsum(rng.normal(size=(20, 2)), axis=0), 5.0 * rng.normal(size=(200, 2))
    step = np.diff(line, axis=0)
    size = np.hypot(*step.T)
    offset = points[:, None] - line[None, :-1]
    at = (offset * step).sum(axis=2) / size
    low, high = np.zeros(19), size.copy()
    low[0], high[-1] = -np.inf, np.inf
    at = at.clip(low, high)
    best = np.linalg.norm(offset - (at / size)[:, :, None] * step, axis=2).argmin(axis=1)
    rows = np.arange(200)
    beside = (step[best, 0] * offset[rows, best, 1] - step[best, 1] * offset[rows, best, 0]) / size[
        best
    ]
    along, left = project(points, line)
    assert along == pytest.approx(lengths(line)[best] + at[rows, best])
    assert left == pytest.approx(beside)


def test_points_that_repeat_have_the_normal_of_their_neighbours() -> None:
    line = np.array([(0.0, 0.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 2.0), (0.0, 2.0)])
    assert normals(line) == pytest.approx(np.tile([-1.0, 0.0], (6, 1)))
    assert not normals(np.ones((3, 2))).any()
    # There and back again: the point at which it turns has that of the way back.
    back = normals(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 0.0)]))
    assert back == pytest.approx(np.array([(0.0, 1.0), (0.0, -1.0), (0.0, -1.0)]))


@given(_LINES)
def test_normals_are_unit_vectors_to_the_left(line: np.ndarray) -> None:
    left = normals(line)
    assert np.hypot(*left.T) == pytest.approx(np.ones(len(line)))
    step = np.gradient(line, axis=0)
    assert (step[:, 0] * left[:, 1] - step[:, 1] * left[:, 0] > 0.0).all()


@pytest.mark.parametrize("step", [-1, 1])
@pytest.mark.parametrize("has_parts", [True, False])
def test_the_first_point_that_is_so_far_away(step: int, has_parts: bool) -> None:
    """Of a vehicle that goes to and fro, in parts between holes."""
    random = np.random.default_rng(3)
    points, n = np.cumsum(random.normal(0.0, 0.4, (60, 2)), axis=0), 60
    parts = np.repeat(np.arange(3), 20) if has_parts else np.zeros(n, np.int64)
    found = first_beyond(points, 1.0, step, parts if has_parts else None)
    for k in range(n):
        rest = np.arange(k + 1, n) if step > 0 else np.arange(k)[::-1]
        far = np.hypot(*(points[rest] - points[k]).T) >= 1.0
        wanted = [i for i in rest[far].tolist() if parts[i] == parts[k]]
        assert found[k] == (wanted[0] if wanted else -1)
    assert (found >= 0).sum() > n // 2
    assert (found < 0).any()
