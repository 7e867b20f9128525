"""Point clouds: float32 [n, 3], metres, and how dense they are."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from fieldgrid.core import CalibrationError, Float32

Cloud = Float32
"""Points [n, 3], metres."""

FEWEST_POINTS = 100
"""Fewer points than this say nothing of how dense a sensor looks."""

AZIMUTHS, BANDS = 72, 24
"""Directions are told apart in 72 x 24 bins of equal solid angle: 5° of azimuth by a twelfth of
the sine of elevation, so that a bin holds several rings of a lidar whose rings are 2° apart."""


def points_per_sr(points: npt.ArrayLike) -> float:
    """How many points of a cloud lie in a steradian of what its sensor looks at.

    `points` [n, 3] in the sensor's frame (x right, y down, z forward), metres, its origin where
    the sensor is. It is the density around the median point: the sky, of which few points come
    back, and rings that lie closer in places do not matter much. The order of the points does
    not matter. Raises CalibrationError for too few points.
    """
    xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    range_m = np.sqrt((xyz * xyz).sum(axis=1))
    xyz, range_m = xyz[range_m > 0.0], range_m[range_m > 0.0]  # false for NaN, too
    if len(xyz) < FEWEST_POINTS:
        raise CalibrationError(
            f"A cloud of {len(xyz)} points does not tell how dense its sensor looks; record whole "
            "sweeps, or say points_per_sr."
        )
    azimuth = np.arctan2(xyz[:, 0], xyz[:, 2]) / (2.0 * math.pi) + 0.5
    band = (xyz[:, 1] / range_m + 1.0) / 2.0
    column = np.minimum((azimuth * AZIMUTHS).astype(np.intp), AZIMUTHS - 1)
    row = np.minimum((band * BANDS).astype(np.intp), BANDS - 1)
    counts = np.bincount(row * AZIMUTHS + column, minlength=AZIMUTHS * BANDS)
    in_order = np.sort(counts)
    median = in_order[np.searchsorted(np.cumsum(in_order), len(xyz) / 2.0)]
    return float(median) * AZIMUTHS * BANDS / (4.0 * math.pi)
