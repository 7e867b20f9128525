"""A plane through most of some points, whatever the others are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fieldgrid.core import Float64

ROUNDS = 8
NO_PRIOR = (1e6, 1e6, 1e6)


def robust_plane(
    x: Float64,
    y: Float64,
    z: Float64,
    sigma: Float64,
    cutoff: Callable[[int, Float64], Float64 | float] | None = None,
    *,
    prior_sigma: tuple[float, float, float] = NO_PRIOR,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Float64, int]:
    """(c0, c1, c2) of z = c0 + c1·x + c2·y, and how many points agree.

    `sigma` [n] is that of each z. A point enters with Tukey's weight: not at all where its
    residual is beyond `cutoff(round, residuals)`; by default all enter first, and then those within
    5 to 2.5 sigma. The prior is a plane of zeros with errors `prior_sigma`; the first residuals are
    those from `start`.
    """
    columns = np.column_stack([np.ones_like(x), x, y])
    prior = np.diag(1.0 / np.square(prior_sigma))
    c: Float64 = np.array(start)
    agreeing = 0
    for round_ in range(ROUNDS):
        residuals = z - (c[0] + c[1] * x + c[2] * y)
        widest = cutoff(round_, residuals) if cutoff else narrowing(round_, sigma)
        share = np.minimum(np.abs(residuals) / widest, 1.0)
        weights = ((1.0 - share * share) / sigma) ** 2
        agreeing = int(np.count_nonzero(weights))
        weighted = columns * weights[:, None]
        c = np.linalg.solve(prior + weighted.T @ columns, weighted.T @ z)
    return c, agreeing


def narrowing(round_: int, sigma: Float64, first: Float64 | float = np.inf) -> Float64 | float:
    """The usual cutoff: `first`, then 5 sigma, narrowing to 2.5."""
    return first if round_ == 0 else max(6.0 - round_, 2.5) * sigma
