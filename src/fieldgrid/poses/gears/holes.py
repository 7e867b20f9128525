"""What the two sides of a hole say: whether a vehicle that nobody saw turned back in it."""

from __future__ import annotations

from itertools import product

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import words

BRAKING_MPS2, LEAST_BACK_SHARE, BACK_SPREAD, CARRIED_CAP = 1.5, 0.2, 0.15, 6.0
"""Who turns back in a hole stops and starts no faster, and comes at least this share as far as its
speed makes; by what share it may come farther, and the most nats that this can say."""

HOLE_DISTANCE_SHARE, STOPPED_SHARE = 0.2, 0.3
"""By what share of it the distance across a hole differs from what the speed makes, and how often a
vehicle stops in it for other reasons than to turn back."""

TANGENT_TURNS_DEG = (-45.0, 0.0, 45.0)
"""How far it may turn beside that within a tangent's reach of a hole."""

STANDING_M, DRIVEN_SHARE = 0.5, 0.2
"""Who comes less far in a hole need not have turned; and by what share the way that its speed makes
may be longer."""

JUMPED_SPREADS, JUMPED_MPS2 = 4.0, 1.0
"""A vehicle that comes farther than this multiple of what its speed makes, and than this
acceleration explains, did not drive there: the positions have jumped, and their distance tells
nothing."""

EDGE_S = 0.5
"""The speed at the very edge of a hole is that over so long."""


def back_m(speeds_mps: tuple[float, float], edge_mps: tuple[float, float], gap_s: float) -> float:
    """How far a vehicle that turns back in a hole comes at most: it does so at one of its edges,
    where it has some speed left, and drives all the rest of it at the speed on the other side."""

    def reach_m(edge: float, other: float) -> float:
        lost_s, way_m = (edge + other) / BRAKING_MPS2, (other**2 - edge**2) / (2.0 * BRAKING_MPS2)
        return other * (gap_s - lost_s) + way_m

    (before, after), (at_start, at_end) = speeds_mps, edge_mps
    return max(reach_m(at_start, after), reach_m(at_end, before))


def carried_on_nats(moved_m: float, driven_m: float, back_m: float, sigma_m: float) -> float:
    """Log odds, by the distance across a hole, that a vehicle drove on rather than turned back:
    who turns back stops and comes no farther than `back_m`, less than its speed makes,
    `driven_m`."""
    if not driven_m > 4.0 * sigma_m:
        return 0.0
    spread_m = float(np.hypot(HOLE_DISTANCE_SHARE * driven_m, 2.0 * sigma_m))
    off = (moved_m - driven_m) / spread_m
    even = 1.0 / driven_m  # anything up to what the speed makes
    beyond = float(np.exp(-0.5 * max(off, 0.0) ** 2))
    drove_on = float(np.exp(-0.5 * off**2)) / (spread_m * np.sqrt(2.0 * np.pi))
    mixed = (1.0 - STOPPED_SHARE) * drove_on + STOPPED_SHARE * even * beyond
    most_m = max(back_m, LEAST_BACK_SHARE * driven_m)
    turned_back = (
        float(np.exp(-0.5 * (max(moved_m / most_m - 1.0, 0.0) / BACK_SPREAD) ** 2)) / most_m
    )
    return float(
        np.clip(np.log((mixed + 1e-12) / (turned_back + 1e-12)), -CARRIED_CAP, CARRIED_CAP)
    )


def edge_mps(points_m: Float64, time_s: Float64, edge: int, inner: int) -> float:
    """The speed at the edge of a hole, on the way to or from an inner point; 0 at a single one."""
    step = 1 if inner > edge else -1
    way = np.arange(edge, inner + step, step)
    since_s = np.abs(time_s[way] - time_s[edge])
    k = min(int(np.searchsorted(since_s, EDGE_S)), len(way) - 1)
    moved_m = float(np.hypot(*(points_m[way[k]] - points_m[edge])))
    return moved_m / max(float(since_s[k]), 1e-3)


def tight_nats(
    step_m: Float64,
    bearings_deg: tuple[float, float],
    radius_m: float,
    most_m: float,
    gap_s: float,
    sigma_m: float,
) -> float:
    """What it costs, in nats, to say that a vehicle came this far across a hole without turning
    back, from one bearing to another: the shortest way that turns no tighter than the radius may be
    longer than `most_m`, which its speed makes in `gap_s`."""
    spread_m = float(np.hypot(DRIVEN_SHARE * most_m, 2.0 * sigma_m))
    moved_m = float(np.hypot(*step_m))
    drivable_m = most_m + JUMPED_SPREADS * spread_m + JUMPED_MPS2 * gap_s**2 / 4.0
    if moved_m < STANDING_M or moved_m > drivable_m:
        return 0.0
    out, into = (np.radians(90.0 - bearing) for bearing in bearings_deg)
    needed_m = np.inf
    for first, last in product(np.radians(TANGENT_TURNS_DEG), repeat=2):
        sin, cos = np.sin(out + first), np.cos(out + first)
        x, y = (step_m @ [cos, sin]) / radius_m, (step_m @ [-sin, cos]) / radius_m
        ways = words(float(x), float(y), float(into + last - out - first), reverse=False)
        needed_m = min(needed_m, *(radius_m * sum(abs(part) for _, part in way) for way in ways))
    return float(0.5 * (max(needed_m - most_m, 0.0) / spread_m) ** 2)
