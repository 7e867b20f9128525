"""In which order, and each in which direction, things are visited at the least cost.

A node is a thing in one direction: thing k has the nodes 2k and 2k + 1. `costs` [2n + 1, 2n + 1]
holds what it takes to go from node to node and to be done with the second; its last row is the
start and its last column the end. What cannot be is inf. What is left out costs its `worth`, which
is far more than any way, so that as much as possible is visited, and that at the least cost.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, kernel, part_of_kernel

_EFFORT = 9_000_000
"""Of the local search: it restarts so often, over the cube of the number of things."""


_SHUNNED = 5.0


class VisitOrder(NamedTuple):
    """Nodes in the order of visiting, and what they cost, with the worth of what is left out."""

    nodes: list[int]
    cost: float

    def left_out(self, count: int) -> set[int]:
        """The numbers of the things, of `count`, that are not visited."""
        return set(range(count)) - {node // 2 for node in self.nodes}


def best_order(
    costs: Float64,
    known: Bool,
    worth: Float64,
    look_up: Callable[[list[tuple[int, int]]], list[float]],
    *,
    enough: int | None = None,
) -> VisitOrder:
    """The best order by costs that are looked up as they are needed, for pairs of nodes.

    `costs` are lower bounds but where `known`; both are filled in. An order whose costs are all
    known is the best one, since no other can become cheaper, as far as a local search finds it.
    After `enough` costs were looked up, what is not
    known is shunned: it is taken for dearer, so that the order is made of what is known, as far as
    that leaves nothing out.
    """
    count = len(worth)
    sequence, thorough = np.arange(count), min(max(_EFFORT // count**3, 3), 400)
    kicks, looked_up = 1, 0
    while True:
        visit(sequence, costs, worth, np.int64(kicks))
        order = directed(sequence, costs, worth)
        ends = [len(costs) - 1, *order.nodes, len(costs) - 1]
        missing = [(a, b) for a, b in itertools.pairwise(ends) if not known[a, b]]
        if not missing and kicks == thorough:
            return order
        # Costs first; the search is thorough when those that it needs are known.
        kicks = 1 if missing else thorough
        for pair, cost in zip(missing, look_up(missing), strict=True):
            costs[pair], known[pair] = cost, True
        looked_up += len(missing)
        if enough is not None and looked_up >= enough:
            costs[~known] *= _SHUNNED
            enough = None


def directed(sequence: Int64, costs: Float64, worth: Float64) -> VisitOrder:
    """The best directions of things that are visited in a sequence, of which the last ones may be
    left out."""
    nodes, left = len(costs) - 1, float(worth.sum())
    best, stop = left, (-1, 0)
    at = [costs[nodes, 2 * sequence[0] + d] for d in (0, 1)]
    came: list[list[int]] = []
    for k, thing in enumerate(sequence.tolist()):
        if k:
            last = 2 * sequence[k - 1]
            ways = [[at[a] + costs[last + a, 2 * thing + d] for a in (0, 1)] for d in (0, 1)]
            came.append([int(np.argmin(way)) for way in ways])
            at = [min(way) for way in ways]
        left -= float(worth[thing])
        for d in (0, 1):
            if at[d] + costs[2 * thing + d, nodes] + left < best:
                best, stop = at[d] + costs[2 * thing + d, nodes] + left, (k, d)
    k, d = stop
    found: list[int] = []
    while k >= 0:
        found.append(2 * int(sequence[k]) + d)
        d = came[k - 1][d] if k else d
        k -= 1
    return VisitOrder(found[::-1], float(best))


@part_of_kernel
def _cost(sequence, costs, worth, total):  # type: ignore[no-untyped-def]
    """The cost of a sequence in its best directions; what follows its best end is left out."""
    nodes = len(costs) - 1
    left, best = total, total
    a, b = 0.0, 0.0
    for k in range(len(sequence)):
        node = 2 * sequence[k]
        if k == 0:
            a, b = costs[nodes, node], costs[nodes, node + 1]
        else:
            last = 2 * sequence[k - 1]
            c = min(a + costs[last, node], b + costs[last + 1, node])
            b = min(a + costs[last, node + 1], b + costs[last + 1, node + 1])
            a = c
        if not (np.isfinite(a) or np.isfinite(b)):
            break
        left -= worth[sequence[k]]
        best = min(best, left + a + costs[node, nodes], left + b + costs[node + 1, nodes])
    return best


@part_of_kernel
def _turned(sequence, low, high, by, found):  # type: ignore[no-untyped-def]
    """Write a sequence of which a part begins `by` places later, with what was before that behind
    it; 0 reverses the part."""
    for k in range(len(sequence)):
        found[k] = sequence[k]
    for k in range(high - low):
        found[low + k] = sequence[low + (k + by) % (high - low) if by else high - 1 - k]


@kernel
def visit(sequence, costs, worth, kicks):  # type: ignore[no-untyped-def]
    """Improve a sequence by reversing and moving parts of it; then break it up at random places, so
    many times, and improve it again."""
    n = len(sequence)
    total = 0.0
    for k in range(n):
        total += worth[k]
    now, trial = sequence.copy(), np.empty(n, dtype=np.int64)
    least = _cost(sequence, costs, worth, total)
    seed = np.uint64(12345)
    for _ in range(kicks):
        cost = _cost(now, costs, worth, total)
        is_better = True
        while is_better:
            is_better = False
            for size in range(4):  # 0 reverses, others move a part of that length
                for i in range(n):
                    for j in range(i + 1 if size == 0 else 0, n if size == 0 else n - size + 1):
                        if size > 0 and (j == i or i + size > n):
                            continue
                        high = max(i, j) + max(size, 1)
                        _turned(now, min(i, j), high, size if j > i else i - j, trial)
                        other = _cost(trial, costs, worth, total)
                        if other < cost - 1e-9:
                            cost, is_better = other, True
                            for k in range(n):
                                now[k] = trial[k]
        if cost < least - 1e-9:
            least = cost
            for k in range(n):
                sequence[k] = now[k]
        # A double bridge: A B C D becomes A C B D.
        cuts = np.empty(3, dtype=np.int64)
        for k in range(3):
            seed = seed * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
            cuts[k] = np.int64((seed >> np.uint64(33)) % np.uint64(n + 1))
        cuts.sort()
        _turned(sequence, cuts[0], cuts[2], max(cuts[1] - cuts[0], 1), now)
