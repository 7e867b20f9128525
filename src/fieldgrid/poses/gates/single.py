"""Whether the fixes of a log are of one receiver with one clock."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import GnssError, utc_text
from fieldgrid.geometry import FixColumns
from fieldgrid.poses.faults.leaps.leaps import HOLE_S
from fieldgrid.poses.gates.scatter import M_PER_DEG

MOST_SHARE, FARTHER = 0.3, 1.5
"""Two receivers write most stamps twice, and so does one whose stamps are cut to whole seconds. Its
second position lies no farther from the first than the way to the next stamp: half of it."""


def check_single(fixes: FixColumns) -> None:
    """Raise GnssError for fixes, in the order of their log, that are of two receivers, or of a
    clock that was set back by more than a hole while they went on."""
    time_ns, middle_deg = fixes.time_ns, np.median(fixes.lat_deg) if len(fixes) else 0.0
    east_m = M_PER_DEG * np.cos(np.radians(middle_deg)) * fixes.lon_deg
    points_m = np.stack([east_m, M_PER_DEG * fixes.lat_deg], axis=1)
    twice = np.flatnonzero(np.diff(time_ns)[:-1] == 0)
    apart_m, onward_m = (
        float(np.median(np.hypot(*(points_m[twice + by] - points_m[twice]).T)))
        if len(twice) > MOST_SHARE * len(time_ns)
        else 0.0
        for by in (1, 2)
    )
    if apart_m > FARTHER * onward_m:
        raise GnssError(
            f"The log holds two receivers: {len(twice)} of its {len(time_ns)} rows have the stamp "
            f"of the next one and lie {apart_m:.2f} m beside it; give a log of one of them."
        )
    # What is in no order at all is put in order; a clock that is set goes back once.
    back = np.flatnonzero(np.diff(time_ns) < -HOLE_S * 1e9)
    if len(back) != 1:
        return
    before, after = np.split(time_ns, back + 1)
    begins_ns, ends_ns = max(before.min(), after.min()), min(before.max(), after.max())
    # A few stamps that are wrong, or come late, cover little of that time.
    period_ns = np.median(np.abs(np.diff(time_ns)))
    rows = min(int(np.sum((part > begins_ns) & (part < ends_ns))) for part in (before, after))
    if rows * period_ns > max(ends_ns - begins_ns, 0) / 2.0:
        raise GnssError(
            f"The stamps of the log go back by {(before[-1] - after[0]) / 1e9:.1f} s at "
            f"{utc_text(int(before[-1]))} and run through that time again: a clock was set, or the "
            "log holds two drives; cut it there, and give one part."
        )
