"""The ground of a map against the true ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from fieldgrid.core import Float64
from fieldgrid.maps import MapFile

CELL_M = 0.25
"""Cells that are compared, unless the map's own are larger."""


@dataclass(frozen=True, slots=True)
class TrueGround:
    """Heights of the ground at cell centres, metres above the datum's plane, [north, east], NaN
    where unknown; `west_m` and `south_m` are the outer south-west corner."""

    up_m: Float64
    west_m: float
    south_m: float
    cell_m: float


@dataclass(frozen=True, slots=True)
class TerrainScores:
    """Errors of the layer `ground`, map minus truth, metres, in `cells` of `cell_m`.

    `within_3_sigma` is the share of them that are at most three times `ground_sigma`.
    """

    cell_m: float
    cells: int
    rmse_m: float
    bias_m: float
    median_m: float
    p95_m: float
    max_m: float
    within_3_sigma: float


def score_terrain(universal: MapFile, true: TrueGround) -> TerrainScores | None:
    """Compare a map's ground with the truth, which is interpolated at the middle of each cell; None
    where the map has no ground in it."""
    cell_m = max(CELL_M, universal.cell_m)
    view = universal.read(cell_m=cell_m, layers=("ground", "ground_sigma"))
    found = view.layer("ground").astype(np.float64)
    row, column = np.nonzero(np.isfinite(found))
    east, north = view.lattice.centres(view.window)
    at = np.stack(
        [
            (north[row] - true.south_m) / true.cell_m - 0.5,
            (east[column] - true.west_m) / true.cell_m - 0.5,
        ]
    )
    error = found[row, column] - map_coordinates(true.up_m, at, order=1, cval=np.nan)
    known = np.isfinite(error)
    if not known.any():
        return None
    error, sigma = error[known], view.layer("ground_sigma")[row, column][known]
    away = np.abs(error)
    return TerrainScores(
        cell_m=cell_m,
        cells=int(error.size),
        rmse_m=float(np.sqrt(np.mean(error**2))),
        bias_m=float(error.mean()),
        median_m=float(np.median(away)),
        p95_m=float(np.percentile(away, 95)),
        max_m=float(away.max()),
        within_3_sigma=float(np.mean(away <= 3.0 * sigma)),
    )
