"""The kernel of distances against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from fieldgrid.field.route.astar import spread


@pytest.mark.parametrize("through", [math.inf, 50.0])
@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_dijkstra(seed: int, through: float) -> None:
    rng = np.random.default_rng(seed)
    passable = (rng.random((23, 31)) < 0.7).astype(np.uint8)
    passable[7, 11] = 1
    left = np.full(passable.shape, np.inf, dtype=np.float32)
    spread(passable, np.int64(7), np.int64(11), 0.3, through, left)
    number = np.arange(passable.size).reshape(passable.shape)
    edges: list[tuple[int, int, float]] = []
    for dj, di in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = number[: 23 - dj, max(-di, 0) : 31 - max(di, 0)].ravel()
        b = number[dj:, max(di, 0) : 31 + min(di, 0)].ravel()
        for start, stop in ((a, b), (b, a)):
            cost = 0.3 * math.hypot(dj, di) * np.where(passable.flat[stop] > 0, 1.0, through)
            edges += list(zip(start.tolist(), stop.tolist(), cost.tolist(), strict=True))
    start, stop, cost = (np.array(column) for column in zip(*edges, strict=True))
    known = np.isfinite(cost)
    graph = coo_array((cost[known], (start[known], stop[known])), shape=(passable.size,) * 2)
    true = dijkstra(graph.tocsr(), indices=number[7, 11]).reshape(passable.shape)
    assert np.allclose(left, true, rtol=1e-5)
