"""Symmetric banded systems: their solution by LAPACK, and the variances of their unknowns."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.kernel import kernel


def factor(band: Float64) -> Float64:
    """Cholesky factor of a positive definite matrix in LAPACK's lower banded form.

    `band[i - j, j]` is element (i, j), i >= j; the factor has the same form.
    """
    from scipy.linalg import cholesky_banded  # late: most drives have no IMU

    result: Float64 = cholesky_banded(band, lower=True, check_finite=False)
    return result


def solve(lower: Float64, right: Float64) -> Float64:
    """Solution of the system whose factor is `lower`."""
    from scipy.linalg import cho_solve_banded

    result: Float64 = cho_solve_banded((lower, True), right, check_finite=False)
    return result


def inverse_blocks(lower: Float64, size: int) -> Float64:
    """The diagonal blocks [n/size, size, size] of the inverse, from the factor of the matrix."""
    width, n = lower.shape
    columns = np.ascontiguousarray(lower.T)  # neighbours in a column lie side by side
    inverse, blocks = np.zeros((n + width, 2 * width - 1)), np.empty((n // size, size, size))
    _fill_inverse(columns, inverse, blocks)
    return blocks


@kernel
def _fill_inverse(columns, inverse, blocks):  # type: ignore[no-untyped-def]
    """Takahashi's recursion from the last column to the first: an element of the inverse inside
    the band needs only later ones inside the band, so the others are never made.

    Row j of the `inverse` holds its elements from column j - width + 1 to j + width - 1, so that
    the sums run along rows.
    """
    n, width = columns.shape
    middle, size = width - 1, blocks.shape[1]
    for j in range(n - 1, -1, -1):
        top = min(width, n - j)
        pivot = columns[j, 0]
        for i in range(1, top):
            total = 0.0
            for k in range(1, top):
                total += columns[j, k] * inverse[j + i, middle + k - i]
            inverse[j, middle + i] = inverse[j + i, middle - i] = -total / pivot
        total = 0.0
        for k in range(1, top):
            total += columns[j, k] * inverse[j, middle + k]
        inverse[j, middle] = (1.0 / pivot - total) / pivot
    for block in range(len(blocks)):
        for a in range(size):
            for b in range(a + 1):
                value = inverse[block * size + b, middle + a - b]
                blocks[block, a, b] = value
                blocks[block, b, a] = value
