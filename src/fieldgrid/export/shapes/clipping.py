"""What of a line lies within bounds: Liang and Barsky's parameters of each segment."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Bounds


def stretches_inside(east_m: Float64, north_m: Float64, bounds: Bounds | None) -> list[Float64]:
    """The stretches of a line [n] within bounds, each as rising positions in its rows.

    Position 2.25 is a quarter of the way from row 2 to row 3, so that any column of the line can
    be interpolated there. Without bounds the whole line is one stretch. A stretch has two
    positions or more.
    """
    if len(east_m) < 2:
        return []
    if bounds is None:
        return [np.arange(len(east_m), dtype=np.float64)]
    enter, leave = np.zeros(len(east_m) - 1), np.ones(len(east_m) - 1)
    for values, low, high in (
        (east_m, bounds.west_m, bounds.east_m),
        (north_m, bounds.south_m, bounds.north_m),
    ):
        start, way = values[:-1], np.diff(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            first, last = np.sort([(low - start) / way, (high - start) / way], axis=0)
        # A segment along the side is inside for all of its length, or for none.
        along = way == 0.0
        inside = (start >= low) & (start <= high)
        first[along], last[along] = np.where(inside[along], [[-np.inf], [np.inf]], np.nan)
        enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    found: list[list[float]] = []
    rows = np.arange(len(enter))
    # A touch of the edge may be too short to tell in rows; False where something is not a number.
    for k in np.flatnonzero(rows + enter < rows + leave).tolist():
        if not (found and found[-1][-1] == k and enter[k] == 0.0):
            found.append([k + float(enter[k])])
        found[-1].append(k + float(leave[k]))
    return [np.array(positions) for positions in found]


def at(values: Float64, positions: Float64) -> Float64:
    """A column of a line at positions in its rows."""
    return np.interp(positions, np.arange(len(values)), values)
