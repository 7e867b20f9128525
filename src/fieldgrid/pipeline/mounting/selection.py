"""Which frames are looked at: about a metre apart, and of a long drive some stretches of it."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Int64, Quality
from fieldgrid.geometry import FixColumns, geodetic_to_ecef

APART_M = 1.0
"""Nearer frames say the same again; over a longer way the camera's motion is harder to tell."""

STRETCHES, OF_FRAMES = 8, 30
"""Number of stretches of a longer drive, spread over it, and of the frames in each."""

MOVING_MPS, PAIR_NS = 0.2, 1_000_000_000


def usual_every(frame_times_ns: Int64, fixes: FixColumns) -> int:
    """Every which frame, for frames to be about a metre apart, by the median speed over seconds in
    which the vehicle moved; 1 where no fixes tell it."""
    usable = fixes[fixes.quality != Quality.NONE]
    time_ns = usable.time_ns
    at_m = np.column_stack(geodetic_to_ecef(usable.lat_deg, usable.lon_deg, np.zeros(len(usable))))
    later = np.minimum(np.searchsorted(time_ns, time_ns + PAIR_NS), len(time_ns) - 1)
    span_s = (time_ns[later] - time_ns) / 1e9
    whole = (span_s > 0.5) & (span_s < 5.0)
    speeds_mps = np.linalg.norm(at_m[later] - at_m, axis=1)[whole] / span_s[whole]
    moving_mps = speeds_mps[speeds_mps > MOVING_MPS]
    if len(frame_times_ns) < 2 or not len(moving_mps):
        return 1
    way_m = float(np.median(moving_mps) * np.median(np.diff(frame_times_ns))) / 1e9
    return max(int(APART_M / way_m), 1) if way_m > 0.0 else 1


def stretches(frame_count: int, every: int) -> list[range]:
    """The frames to look at, as ranges in which each is followed by the next to look at."""
    wanted = range(0, frame_count, every)
    if len(wanted) <= STRETCHES * OF_FRAMES:
        return [wanted]
    starts = np.linspace(0, len(wanted) - OF_FRAMES, STRETCHES).astype(int)
    return [wanted[start : start + OF_FRAMES] for start in starts.tolist()]
