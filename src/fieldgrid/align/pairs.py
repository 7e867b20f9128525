"""Which submaps saw the same ground, and how they do so."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.align.submaps import Picture
from fieldgrid.array_types import Float64

LEAST_SHARE = 0.25
"""Submaps are compared when this share of the smaller one was seen by the other, too."""

MOST_MATCHES = 3
"""A submap is compared with so many of each other session, those that share most."""

APART = 3
"""Submaps of one drive are compared when so many lie between them: before, they see the same from
the same way."""

SAME_LANE_M = 1.2
"""Vehicles whose tracks lie farther apart see the opposite faces of what stands between them."""


class Pair(NamedTuple):
    """Submap `k` of drive `a` and submap `l` of drive `b`. `at_m` [2] is the middle of the ground
    that both saw; `across` [2] the unit vector from the track of the one to that of the other
    where they lie in different lanes, else zero; `facing` [2] the way that `a` looks less that of
    `b`, as unit vectors."""

    a: int
    k: int
    b: int
    l: int  # noqa: E741 - the letter after k
    at_m: Float64
    across: Float64
    facing: Float64


def overlapping(pictures: Sequence[Sequence[Picture]]) -> Iterator[Pair]:
    """The pairs worth comparing, of different drives and of the same one; `pictures` has those of
    each drive."""
    for a, of_a in enumerate(pictures):
        for b in range(a, len(pictures)):
            for k, one in enumerate(of_a):
                others = range(k + APART, len(of_a)) if a == b else range(len(pictures[b]))
                shared = [(_shared(one, pictures[b][l]), l) for l in others]  # noqa: E741
                best = sorted((s for s in shared if s[0] >= LEAST_SHARE), reverse=True)
                for _, other in best[:MOST_MATCHES]:
                    at_m, across = _place(one, pictures[b][other])
                    facing = one.facing - pictures[b][other].facing
                    yield Pair(a, k, b, other, at_m, across, facing)


def _shared(a: Picture, b: Picture) -> float:
    """The share of the smaller picture that both saw."""
    part = a.window.intersect(b.window)
    if part is None:
        return 0.0
    both = a.seen[a.window.slices_of(part)] & b.seen[b.window.slices_of(part)]
    return float(both.sum()) / max(min(float(a.seen.sum()), float(b.seen.sum())), 1.0)


def _place(a: Picture, b: Picture) -> tuple[Float64, Float64]:
    part = a.window.intersect(b.window)
    assert part is not None  # they share cells
    both = a.seen[a.window.slices_of(part)] & b.seen[b.window.slices_of(part)]
    east, north = a.lattice.centres(part)
    n = both.sum()
    at = np.array([(both.sum(axis=0) * east).sum() / n, (both.sum(axis=1) * north).sum() / n])
    # The direction in which the track of `a` runs; across it lies that of `b`.
    centred = a.track_m - a.track_m.mean(axis=0)
    along = np.linalg.svd(centred)[2][0] if len(centred) > 1 else np.zeros(2)
    left = np.array([-along[1], along[0]])
    apart_m = float(left @ (b.track_m.mean(axis=0) - a.track_m.mean(axis=0)))
    return at, left * np.sign(apart_m) if abs(apart_m) > SAME_LANE_M else np.zeros(2)
