"""How far the plants of a row stand from each other."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.evidence import OBSTACLE, Evidence
from fieldgrid.rows.extent import plants_among, runs

_STEP_M = 0.1
_JOINED_M = 0.5
"""Cells of one plant are no farther from each other."""


def plant_pitch_m(evidence: Evidence, line: Float64, half_width_m: float) -> float:
    """The median distance of neighbouring plants along a row [n, 2]; NaN for fewer than three."""
    strip = evidence.strip(line, half_width_m, half_width_m, _STEP_M)
    cells = (strip.cells == OBSTACLE).sum(axis=1).astype(np.float64)
    if not cells.any():
        return float("nan")
    edges = np.array(plants_among(cells, runs(cells > 0.0)), dtype=np.float64) * _STEP_M
    is_next = edges[1:, 0] - edges[:-1, 1] > _JOINED_M
    starts, stops = edges[np.r_[True, is_next], 0], edges[np.r_[is_next, True], 1]
    if len(starts) < 3:
        return float("nan")
    return float(np.median(np.diff(0.5 * (starts + stops))))
