"""Systems in the shape of an envelope beside the dense ones that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.poses.smoother.envelope import STATES, Envelope, envelope, factor, invert, solve


def positions(shape: Envelope) -> tuple[Int64, Int64]:
    """Row and column of each value."""
    rows, columns = [], []
    for node, first in enumerate(shape.first.tolist()):
        for a in range(STATES):
            reach = range(STATES * first, STATES * node + a + 1)
            rows += [STATES * node + a] * len(reach)
            columns += reach
    return np.array(rows, np.int64), np.array(columns, np.int64)


def dense(shape: Envelope, values: Float64) -> Float64:
    """The symmetric matrix whose lower triangle lies in the values."""
    full = np.zeros((STATES * shape.nodes, STATES * shape.nodes))
    full[positions(shape)] = values
    return full + np.tril(full, -1).T


def random_system(nodes: int, far: Int64, seed: int) -> tuple[Envelope, Float64, Float64]:
    """A positive definite matrix, as an envelope and dense."""
    random = np.random.default_rng(seed)
    shape = envelope(nodes, far)
    values = 0.3 * random.normal(size=int(shape.start[-1]))
    rows, columns = positions(shape)
    lower = np.zeros((STATES * nodes, STATES * nodes))
    lower[rows, columns] = values
    lower[np.diag_indices(STATES * nodes)] = random.uniform(0.8, 2.0, STATES * nodes)
    full = lower @ lower.T
    # A factor with this envelope has a product with the same.
    return shape, full[rows, columns], full


pairs = st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=4)
systems = st.tuples(st.integers(1, 9), pairs, st.integers(0, 10**6))


def ends(nodes: int, pairs: list[tuple[int, int]]) -> Int64:
    inside = [sorted(pair) for pair in pairs if max(pair) < nodes]
    return np.array(inside, np.int64).reshape(-1, 2)


@settings(deadline=None, max_examples=60)
@given(systems)
def test_the_solution_is_that_of_the_dense_system(
    case: tuple[int, list[tuple[int, int]], int],
) -> None:
    nodes, far, seed = case
    shape, values, full = random_system(nodes, ends(nodes, far), seed)
    right = np.random.default_rng(seed + 1).normal(size=(len(full), 2))
    expected = np.linalg.solve(full, right)
    assert factor(shape, values) == pytest.approx(np.linalg.slogdet(full)[1], rel=1e-6)
    found = right.copy()
    solve(shape, values, found)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@settings(deadline=None, max_examples=60)
@given(systems)
def test_the_blocks_are_those_of_the_dense_inverse(
    case: tuple[int, list[tuple[int, int]], int],
) -> None:
    nodes, far, seed = case
    shape, values, full = random_system(nodes, ends(nodes, far), seed)
    inverse = np.linalg.inv(full)
    factor(shape, values)
    invert(shape, values)
    close = {"rel": 1e-6, "abs": 1e-7 * np.abs(inverse).max()}
    for a in range(STATES):
        for b in range(STATES):
            own, before = shape.own(values, a, b), shape.with_before(values, a, b)
            assert own == pytest.approx(inverse[a::STATES, b::STATES].diagonal(), **close)
            earlier = inverse[a::STATES, b::STATES].diagonal(-1)
            assert before == pytest.approx(earlier, **close)


def test_a_far_coupling_costs_where_it_is() -> None:
    near, far = envelope(100, np.zeros((0, 2), np.int64)), envelope(100, np.array([[40, 60]]))
    wider: Bool = np.diff(far.start) > np.diff(near.start)
    assert np.flatnonzero(wider).tolist() == [60]
    assert far.first[60] == 40


def test_what_is_not_positive_definite_is_no_system() -> None:
    shape = envelope(2, np.zeros((0, 2), np.int64))
    values = np.zeros(shape.size)
    assert np.isnan(factor(shape, values))
