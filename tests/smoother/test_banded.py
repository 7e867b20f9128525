"""Banded systems beside the dense ones that they stand for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldgrid.smoother.banded import factor, inverse_blocks, solve

_Float64 = npt.NDArray[np.float64]


def random_system(blocks: int, size: int, width: int, seed: int) -> tuple[_Float64, _Float64]:
    """A positive definite matrix, dense and in lower banded form with `width` diagonals."""
    random = np.random.default_rng(seed)
    n = blocks * size
    lower = 0.3 * np.tril(random.normal(size=(n, n)))
    lower[np.subtract.outer(np.arange(n), np.arange(n)) >= width] = 0.0
    lower[np.diag_indices(n)] = random.uniform(0.5, 2.0, n)
    dense = lower @ lower.T
    band = np.zeros((width, n))
    for k in range(min(width, n)):
        band[k, : n - k] = np.diagonal(dense, -k)
    return dense, band


systems = st.tuples(st.integers(1, 9), st.integers(1, 4), st.integers(1, 3), st.integers(0, 10**6))


@settings(deadline=None, max_examples=60)
@given(systems)
def test_the_solution_is_that_of_the_dense_system(case: tuple[int, int, int, int]) -> None:
    blocks, size, reach, seed = case
    dense, band = random_system(blocks, size, size * reach, seed)
    right = np.random.default_rng(seed + 1).normal(size=len(dense))
    expected = np.linalg.solve(dense, right)
    found = solve(factor(band), right)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@settings(deadline=None, max_examples=60)
@given(systems)
def test_the_blocks_are_those_of_the_dense_inverse(case: tuple[int, int, int, int]) -> None:
    blocks, size, reach, seed = case
    dense, band = random_system(blocks, size, size * reach, seed)
    inverse = np.linalg.inv(dense)
    found, onward = inverse_blocks(factor(band), size)
    assert found.shape == (blocks, size, size)
    assert onward.shape == (blocks, size)
    close = {"rel": 1e-6, "abs": 1e-7 * np.abs(inverse).max()}
    for k in range(blocks):
        own = slice(k * size, (k + 1) * size)
        assert found[k] == pytest.approx(inverse[own, own], **close)
    assert np.array_equal(found, found.swapaxes(1, 2))


@settings(deadline=None, max_examples=60)
@given(st.tuples(st.integers(1, 9), st.integers(1, 4), st.integers(2, 4), st.integers(0, 10**6)))
def test_the_onward_covariances_are_those_of_the_dense_inverse(
    case: tuple[int, int, int, int],
) -> None:
    """Each unknown with its like in the next block, which the band must reach: 2 blocks wide."""
    blocks, size, reach, seed = case
    dense, band = random_system(blocks, size, size * reach, seed)
    inverse = np.linalg.inv(dense)
    found, onward = inverse_blocks(factor(band), size)
    expected = np.append(np.diagonal(inverse, -size), np.zeros(size)).reshape(blocks, size)
    assert onward == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(inverse).max())
    # Never more than the two variances allow.
    variance = np.diagonal(found, axis1=1, axis2=2)
    bound = np.sqrt(variance[:-1] * variance[1:])
    assert (np.abs(onward[:-1]) <= bound * (1.0 + 1e-9)).all()


def test_what_is_not_positive_definite_is_no_system() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        factor(np.array([[1.0, -1.0, 1.0], [0.0, 0.0, 0.0]]))
