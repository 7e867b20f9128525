"""Sparse symmetric systems of nodes: their factor, solution, and the variances of their unknowns.

The unknowns of a node stand together, as a block. A node is coupled with itself, with the one
before it, and with few others farther back. Each row is stored from the first node that its node
is coupled with to the diagonal (an envelope, or skyline), so a far coupling costs where it is
and not all along the drive: row a of a node has `before` values of earlier nodes, and a + 1 of its
own. No BLAS is called: its threads cost more than these small blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64, kernel

STATES = 8
"""Unknowns of a node. It is a constant so that the loops over them are unrolled."""


class Envelope(NamedTuple):
    """The shape of a system of n nodes with :data:`STATES` unknowns each.

    `first` [n] is the first node that each is coupled with, `start` [n + 1] where the rows of each
    lie in the values. `below` [m] lists for each node the later nodes that reach back to it, from
    `below_start` [n + 1] on.
    """

    first: Int64
    start: Int64
    below: Int64
    below_start: Int64

    @property
    def nodes(self) -> int:
        """How many nodes there are."""
        return len(self.first)

    @property
    def size(self) -> int:
        """How many values a matrix in this shape has."""
        return int(self.start[-1])

    def own(self, values: Float64, a: int, b: int) -> Float64:
        """The element [n] of states a and b of each node, of a matrix in this shape."""
        high, low = max(a, b), min(a, b)
        return np.asarray(values[self.own_start(high) + low])

    def with_before(self, values: Float64, a: int, b: int) -> Float64:
        """The element [n - 1] of state a of each node but the first and state b of the one before
        it."""
        return np.asarray(values[(self.own_start(a) - STATES + b)[1:]])

    def own_start(self, state: int) -> Int64:
        """Where each node's own values of a row begin."""
        before = STATES * (np.arange(self.nodes) - self.first)
        return np.asarray(self.start[:-1] + (state + 1) * before + state * (state + 1) // 2)


def envelope(nodes: int, far: Int64) -> Envelope:
    """The shape in which neighbours are coupled, and the pairs `far` [m, 2] of nodes beside."""
    first = np.maximum(np.arange(nodes) - 1, 0)
    if len(far):
        np.minimum.at(first, far.max(axis=1), far.min(axis=1))
    reach = np.arange(nodes) - first
    own = STATES * (STATES + 1) // 2
    start = np.concatenate([[0], np.cumsum(STATES * STATES * reach + own)])
    row = np.repeat(np.arange(nodes), reach)
    column = (
        np.repeat(first, reach)
        + np.arange(reach.sum())
        - np.repeat(np.cumsum(reach) - reach, reach)
    )
    order = np.argsort(column, kind="stable")
    below_start = np.searchsorted(column[order], np.arange(nodes + 1))
    return Envelope(first, start, row[order], below_start)


@kernel
def factor(shape, values):  # type: ignore[no-untyped-def]
    """Replace the lower triangle of a matrix by its Cholesky factor, whose shape is the same.

    Returns 2 Σ log of the diagonal, the logarithm of the determinant; NaN for a matrix that is
    not positive definite, whose values are then spoilt.
    """
    first, start = shape[0], shape[1]
    log_determinant = 0.0
    most = 1
    for node in range(len(first)):
        most = max(most, node - first[node] + 1)
    # The node's rows side by side, so that one instruction works on several of them.
    rows = np.empty((most * STATES, STATES))
    for node in range(len(first)):
        f, at = first[node], start[node]
        before = STATES * (node - f)
        for k in range(before):
            for a in range(STATES):
                rows[k, a] = values[at + a * before + a * (a + 1) // 2 + k]
        for a in range(STATES):
            own = at + (a + 1) * before + a * (a + 1) // 2
            for b in range(STATES):
                rows[before + b, a] = values[own + b] if b <= a else 0.0
        for column in range(f, node + 1):
            fc, atc = first[column], start[column]
            beforec = STATES * (column - fc)
            shared = max(f, fc)  # before that one of the two rows is zero
            mine, theirs = STATES * (shared - f), STATES * (shared - fc)
            length = STATES * (column - shared)
            for b in range(STATES):
                other = atc + b * beforec + b * (b + 1) // 2 + theirs
                j = STATES * (column - f) + b
                # Eight sums in registers: an array of them would be stored at each step.
                t0, t1, t2, t3 = rows[j, 0], rows[j, 1], rows[j, 2], rows[j, 3]
                t4, t5, t6, t7 = rows[j, 4], rows[j, 5], rows[j, 6], rows[j, 7]
                for k in range(length + b):
                    i = mine + k
                    c = rows[i, b] if column == node else values[other + k]
                    t0 -= rows[i, 0] * c
                    t1 -= rows[i, 1] * c
                    t2 -= rows[i, 2] * c
                    t3 -= rows[i, 3] * c
                    t4 -= rows[i, 4] * c
                    t5 -= rows[i, 5] * c
                    t6 -= rows[i, 6] * c
                    t7 -= rows[i, 7] * c
                rows[j, 0], rows[j, 1], rows[j, 2], rows[j, 3] = t0, t1, t2, t3
                rows[j, 4], rows[j, 5], rows[j, 6], rows[j, 7] = t4, t5, t6, t7
                if column < node:
                    pivot = values[other + length + b]
                else:
                    squared = rows[j, b]
                    if not squared > 0.0:
                        return np.nan
                    pivot = np.sqrt(squared)
                    log_determinant += np.log(squared)
                for a in range(STATES):
                    rows[j, a] /= pivot
                if column == node:
                    rows[j, b] = pivot
        for k in range(before):
            for a in range(STATES):
                values[at + a * before + a * (a + 1) // 2 + k] = rows[k, a]
        for a in range(STATES):
            own = at + (a + 1) * before + a * (a + 1) // 2
            for b in range(a + 1):
                values[own + b] = rows[before + b, a]
    return log_determinant


def solve(shape: Envelope, values: Float64, x: Float64) -> None:
    """Replace right sides [n, m] by the solutions of the systems whose factor is in `values`."""
    forward(shape, values, x)
    backward(shape, values, x)


@kernel
def forward(shape, values, x):  # type: ignore[no-untyped-def]
    """Replace right sides [n, m] by the solutions with the factor alone."""
    first, start = shape[0], shape[1]
    # A node's own unknowns side by side, so that the processor works on several of them at once.
    own = np.empty(STATES)
    for node in range(len(first)):
        at, f, i = start[node], STATES * first[node], STATES * node
        before = i - f
        for m in range(x.shape[1]):
            for a in range(STATES):
                own[a] = x[i + a, m]
            for k in range(before):
                known = x[f + k, m]
                for a in range(STATES):
                    own[a] -= values[at + a * before + a * (a + 1) // 2 + k] * known
            for b in range(STATES):
                row = at + (b + 1) * before + b * (b + 1) // 2
                for k in range(b):
                    own[b] -= values[row + k] * own[k]
                own[b] /= values[row + b]
                x[i + b, m] = own[b]


@kernel
def backward(shape, values, x):  # type: ignore[no-untyped-def]
    """Replace right sides [n, m] by the solutions with the transposed factor alone."""
    first, start = shape[0], shape[1]
    own = np.empty(STATES)
    for node in range(len(first) - 1, -1, -1):
        at, f, i = start[node], STATES * first[node], STATES * node
        before = i - f
        for m in range(x.shape[1]):
            for a in range(STATES):
                own[a] = x[i + a, m]
            for b in range(STATES - 1, -1, -1):
                row = at + (b + 1) * before + b * (b + 1) // 2
                own[b] /= values[row + b]
                for k in range(b):
                    own[k] -= values[row + k] * own[b]
                x[i + b, m] = own[b]
            for k in range(before):
                rest = x[f + k, m]
                for a in range(STATES - 1, -1, -1):
                    rest -= values[at + a * before + a * (a + 1) // 2 + k] * own[a]
                x[f + k, m] = rest


@kernel
def invert(shape, values):  # type: ignore[no-untyped-def]
    """Replace the factor in `values` by the inverse, as far as it lies inside the envelope.

    Takahashi's recursion from the last node to the first: an element of the inverse inside the
    envelope needs only later ones inside the envelope, so the others are never made.
    """
    first, start = shape[0], shape[1]
    below, below_start = shape[2], shape[3]
    n = len(first)
    most = 1
    for node in range(n):
        most = max(most, below_start[node + 1] - below_start[node])
    own = np.empty((STATES, STATES))
    inverse = np.empty((STATES, STATES))
    scaled, product = np.empty((most * STATES, STATES)), np.empty((most * STATES, STATES))
    for node in range(n - 1, -1, -1):
        before = STATES * (node - first[node])
        for a in range(STATES):
            line = start[node] + (a + 1) * before + a * (a + 1) // 2
            for b in range(a + 1):
                own[a, b] = values[line + b]
        # The inverse of the node's own triangular block.
        for b in range(STATES):
            for a in range(b, STATES):
                total = 1.0 if a == b else 0.0
                for k in range(b, a):
                    total -= own[a, k] * inverse[k, b]
                inverse[a, b] = total / own[a, a]
        low, high = below_start[node], below_start[node + 1]
        for r in range(high - low):
            row = below[low + r]
            w = STATES * (row - first[row])
            at = start[row] + STATES * (node - first[row])
            for a in range(STATES):
                line = at + a * w + a * (a + 1) // 2
                for b in range(STATES):
                    total = 0.0
                    for k in range(b, STATES):
                        total += values[line + k] * inverse[k, b]
                    scaled[r * STATES + a, b] = total
        # Z[rows, node] = -Z[rows, rows] · scaled; the rows' inverse is in place already.
        for r in range(high - low):
            for a in range(STATES):
                for b in range(STATES):
                    product[r * STATES + a, b] = 0.0
        for r in range(high - low):
            row = below[low + r]
            w = STATES * (row - first[row])
            for s in range(r + 1):
                column = below[low + s]
                at = start[row] + STATES * (column - first[row])
                for a in range(STATES):
                    line = at + a * w + a * (a + 1) // 2
                    for k in range(STATES if s < r else a + 1):
                        z = values[line + k]
                        for b in range(STATES):
                            product[r * STATES + a, b] -= z * scaled[s * STATES + k, b]
                        if s != r or k != a:
                            for b in range(STATES):
                                product[s * STATES + k, b] -= z * scaled[r * STATES + a, b]
        for r in range(high - low):
            row = below[low + r]
            w = STATES * (row - first[row])
            at = start[row] + STATES * (node - first[row])
            for a in range(STATES):
                line = at + a * w + a * (a + 1) // 2
                for b in range(STATES):
                    values[line + b] = product[r * STATES + a, b]
        for a in range(STATES):
            line = start[node] + (a + 1) * before + a * (a + 1) // 2
            for b in range(a + 1):
                total = 0.0
                for k in range(a, STATES):
                    total += inverse[k, a] * inverse[k, b]
                for k in range((high - low) * STATES):
                    total -= scaled[k, a] * product[k, b]
                values[line + b] = total
