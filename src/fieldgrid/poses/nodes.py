"""The instants at which a drive is estimated: fixes, images, and what lies between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Motion

FILL_NS = 250_000_000
"""No two nodes are farther apart: the vehicle turns on between the fixes of a slow receiver."""

UNSEEN_NS = 10_000_000_000
"""Over longer holes nothing is known of the way, and no node is filled in."""

FARTHEST_NS = 10**15
"""Poses of another program lead on however long the fixes are away: their sigmas say what they are
worth there."""

GYRO_HOLE_NS = 500_000_000
"""Over a longer hole in its samples the gyro's integral says nothing."""


class Nodes(NamedTuple):
    """`time_ns` [n] increases. `fix` [n] is the accepted fix taken there, or -1.

    `turned_rad` [n - 1] is the gyro's integral to the next node, NaN without one.
    """

    time_ns: Int64
    fix: Int64
    turned_rad: Float64

    def has_gyro(self) -> bool:
        """Whether a gyro saw any of the drive."""
        return bool(np.isfinite(self.turned_rad).any())


def nodes(accepted_ns: Int64, all_ns: Int64, motion: Motion) -> Nodes:
    """Nodes from the first accepted fix to the last one, and as far beyond as the camera saw
    the way from them.

    `all_ns` are the times of all fixes: a rejected one gets the pose of its time too.
    """
    first_ns, last_ns = int(accepted_ns[0]), int(accepted_ns[-1])
    wanted = [accepted_ns, all_ns]
    if motion.steps is not None:
        wanted += [motion.steps.start_ns, motion.steps.stop_ns]
        # How far a chain of steps leads beyond the first and the last fix, but not too far.
        beyond_ns = UNSEEN_NS if motion.poses is None else FARTHEST_NS
        earliest_ns, latest_ns = first_ns - beyond_ns, last_ns + beyond_ns
        chain = list(
            zip(motion.steps.start_ns.tolist(), motion.steps.stop_ns.tolist(), strict=True)
        )
        for start, stop in chain:
            if earliest_ns <= start and start <= last_ns < stop <= latest_ns:
                last_ns = stop
        for start, stop in reversed(chain):
            if stop <= latest_ns and earliest_ns <= start < first_ns <= stop:
                first_ns = start
    times = np.unique(np.concatenate(wanted))
    times = filled(times[(times >= first_ns) & (times <= last_ns)])
    fix = np.full(len(times), -1, dtype=np.int64)
    fix[np.searchsorted(times, accepted_ns)] = np.arange(len(accepted_ns))
    return Nodes(times, fix, _turned(times, motion))


def filled(times: Int64) -> Int64:
    """Instants with more of them evenly between, but in a long hole."""
    steps = np.diff(times)
    parts = np.where(steps <= UNSEEN_NS, -(-steps // FILL_NS), 1)
    start = np.repeat(times[:-1], parts)
    share = (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)) / np.repeat(
        parts, parts
    )
    filled = start + np.round(share * np.repeat(steps, parts)).astype(np.int64)
    return np.append(filled, times[-1:])


def _turned(times: Int64, motion: Motion) -> Float64:
    gyro = motion.gyro
    if gyro is None or len(gyro.time_ns) < 2:
        return np.full(max(len(times) - 1, 0), np.nan)
    at, since = gyro.time_ns, gyro.time_ns[0]
    seconds, nodes_s = (at - since) / 1e9, (times - since) / 1e9
    rises = np.diff(seconds) * (gyro.rate_rad_s[1:] + gyro.rate_rad_s[:-1]) / 2.0
    angle = np.interp(nodes_s, seconds, np.concatenate([[0.0], np.cumsum(rises)]))
    holes = np.concatenate([[0], np.cumsum(np.diff(at) > GYRO_HOLE_NS)])
    before = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 1)
    after = np.clip(np.searchsorted(at, times), 0, len(at) - 1)
    inside = (times >= at[0]) & (times <= at[-1])
    whole = (holes[after[1:]] == holes[before[:-1]]) & inside[1:] & inside[:-1]
    return np.where(whole, np.diff(angle), np.nan)


def seconds(time_ns: Int64) -> Float64:
    """Seconds since the first of the instants."""
    return np.asarray((time_ns - time_ns[0]) / 1e9)
