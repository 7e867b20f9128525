"""Seconds that a log counts twice: its clock was set back, or logs of two receivers were joined.

In order of time the positions of both passes through such seconds alternate, and tell of no drive.
Rows that come late, or parts in another order, are no such thing: in order of time each follows the
one before it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Index, Int64
from fieldgrid.geometry import FixColumns
from fieldgrid.poses.gates.scatter import M_PER_DEG

FEWEST_IN_PASS, FEWEST_TWICE = 10, 3
"""Least number of rows of a pass in order of time, and of rows that two passes have of the same
seconds. Rows that come late make shorter passes."""

MOST_PASSES = 200
"""A log of more passes is in no order at all."""

SAME_M, SAME_SCATTERS = 0.05, 3.0
"""Passes no farther apart than this distance, or than this multiple of the scatter of their own
rows, are one log whose rows come late or twice, or of a vehicle that stood."""


class CountedTwice(NamedTuple):
    """Seconds that are counted twice: from when, in a log that is in order of time, how many, and
    how many rows there are of both passes."""

    start_ns: int
    seconds: float
    rows: int


def counted_twice(fixes: FixColumns) -> tuple[Bool, tuple[CountedTwice, ...]]:
    """The rows of a log, in its own order, whose seconds it counts twice, and these seconds."""
    twice, found = np.zeros(len(fixes), dtype=np.bool_), []
    rows = np.flatnonzero(np.isfinite(fixes.lat_deg) & np.isfinite(fixes.lon_deg))
    time_ns = fixes.time_ns[rows]
    if not (np.diff(time_ns) < 0).any():
        return twice, ()
    lat_deg = fixes.lat_deg[rows]
    lon_deg = fixes.lon_deg[rows]
    shrink = math.cos(math.radians(float(lat_deg[0])))
    east_deg = np.mod(lon_deg - lon_deg[0] + 180.0, 360.0) - 180.0
    place_m = M_PER_DEG * np.stack([lat_deg - lat_deg[0], shrink * east_deg])
    edges = np.flatnonzero(np.concatenate([[True], np.diff(time_ns) < 0, [True]]))
    long = np.diff(edges) >= FEWEST_IN_PASS
    first, last = edges[:-1][long], edges[1:][long] - 1
    if len(first) > MOST_PASSES:
        return twice, ()
    for k in range(1, len(first)):
        start, stop = time_ns[first[k]], time_ns[last[k]]
        for j in np.flatnonzero((time_ns[first[:k]] < stop) & (time_ns[last[:k]] > start)).tolist():
            from_ns = max(int(start), int(time_ns[first[j]]))
            to_ns = min(int(stop), int(time_ns[last[j]]))
            one, two = (
                np.arange(first[i], last[i] + 1)[
                    (time_ns[first[i] : last[i] + 1] >= from_ns)
                    & (time_ns[first[i] : last[i] + 1] <= to_ns)
                ]
                for i in (j, k)
            )
            whole = [slice(first[i], last[i] + 1) for i in (j, k)]
            same_m = max(SAME_M, SAME_SCATTERS * max(_scatter_m(place_m[:, i]) for i in whole))
            if _alternate(time_ns, one, two) and _apart_m(time_ns, place_m, one, two) > same_m:
                twice[rows[one]] = twice[rows[two]] = True
                seconds = (to_ns - from_ns) / 1e9
                found.append(CountedTwice(from_ns, seconds, len(one) + len(two)))
    return twice, tuple(found)


def _alternate(time_ns: Int64, one: Index, two: Index) -> bool:
    """Whether rows of two passes come by turns in order of time."""
    if min(len(one), len(two)) < FEWEST_TWICE:
        return False
    of_two = np.repeat([False, True], [len(one), len(two)])
    order = np.argsort(np.concatenate([time_ns[one], time_ns[two]]), kind="stable")
    return int(np.count_nonzero(np.diff(of_two[order]))) >= 2 * FEWEST_TWICE - 1


def _apart_m(time_ns: Int64, place_m: Float64, one: Index, two: Index) -> float:
    """How far the second pass lies from the first at its times, median."""
    since_s, known_s = ((time_ns[some] - time_ns[one[0]]) / 1e9 for some in (two, one))
    north, east = (np.interp(since_s, known_s, axis[one]) - axis[two] for axis in place_m)
    return float(np.median(np.hypot(north, east)))


def _scatter_m(place_m: Float64) -> float:
    """How far rows of a pass lie from the middle of their neighbours, median."""
    off_m = place_m[:, 1:-1] - (place_m[:, :-2] + place_m[:, 2:]) / 2.0
    return float(np.median(np.hypot(*off_m)))
