"""Which frames are looked at: about a metre apart, and of a long drive some stretches of it."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import DatumError, Int64, Quality
from fieldgrid.geometry import Datum, FixColumns

APART_M = 1.0
"""Nearer frames say the same again; over a longer way the camera's motion is harder to tell."""

STRETCHES, OF_FRAMES = 8, 30
"""Number of stretches of a longer drive, spread over it, and of the frames in each."""

MOVING_MPS = 0.2
PAIR_NS = 1_000_000_000


def usual_every(frame_times_ns: Int64, fixes: FixColumns) -> int:
    """Every which frame, for frames to be about a metre apart; 1 where no fixes tell the speed."""
    if len(frame_times_ns) < 2:
        return 1
    speed_mps = _usual_speed_mps(fixes)
    period_s = float(np.median(np.diff(frame_times_ns))) / 1e9
    if speed_mps is None or period_s <= 0.0:
        return 1
    return max(int(APART_M / (speed_mps * period_s)), 1)


def _usual_speed_mps(fixes: FixColumns) -> float | None:
    """The median speed over seconds in which the vehicle moved."""
    usable = fixes[fixes.quality != Quality.NONE]
    if len(usable) < 2:
        return None
    try:
        datum = Datum(*usable[0][1:4])
    except DatumError:
        return None
    time_ns = usable.time_ns
    east, north, _ = datum.to_enu(usable.lat_deg, usable.lon_deg, usable.height_m)
    later = np.minimum(np.searchsorted(time_ns, time_ns + PAIR_NS), len(time_ns) - 1)
    span_s = (time_ns[later] - time_ns) / 1e9
    whole = (span_s > 0.5) & (span_s < 5.0)
    speeds = np.hypot(east[later] - east, north[later] - north)[whole] / span_s[whole]
    moving = speeds[speeds > MOVING_MPS]
    return float(np.median(moving)) if len(moving) else None


def stretches(frame_count: int, every: int) -> list[range]:
    """The frames to look at, as ranges in which each is followed by the next to look at."""
    wanted = range(0, frame_count, every)
    if len(wanted) <= STRETCHES * OF_FRAMES:
        return [wanted]
    starts = np.linspace(0, len(wanted) - OF_FRAMES, STRETCHES).astype(int)
    return [wanted[start : start + OF_FRAMES] for start in starts.tolist()]
