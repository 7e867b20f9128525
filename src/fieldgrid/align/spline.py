"""Cubic splines through the cells of an array, read at the crossings of rows and columns."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from fieldgrid.array_types import Float64

PAD = 12
"""Cells that are added beyond each border, with the values at the border;
`scipy.ndimage.map_coordinates` adds as many."""


def between_cells(values: Float64, rows: Float64, columns: Float64) -> Float64:
    """The cubic spline [m, n] through `values` [h, w] at places along either axis [m], [n], in
    cells.

    It equals `scipy.ndimage.map_coordinates` with `mode="nearest"`. As the places are crossings of
    rows and columns, two products of matrices give it in a quarter of the time.
    """
    padded = np.pad(values, PAD, mode="edge")
    coefficients = ndimage.spline_filter(padded, order=3, mode="nearest")
    along_rows, along_columns = (
        _weights(places, count) for places, count in zip((rows, columns), padded.shape, strict=True)
    )
    return np.asarray(along_rows @ coefficients @ along_columns.T)


def _weights(places: Float64, count: int) -> Float64:
    """What each coefficient counts for each place [m, count]."""
    at = np.clip(places + PAD, 1.0, count - 3.0)
    first = np.floor(at).astype(np.intp)
    t = at - first
    weights = np.zeros((len(at), count))
    every = np.arange(len(at))
    weights[every, first - 1] = (1.0 - t) ** 3 / 6.0
    weights[every, first] = 2.0 / 3.0 - t**2 * (2.0 - t) / 2.0
    weights[every, first + 1] = 2.0 / 3.0 - (1.0 - t) ** 2 * (1.0 + t) / 2.0
    weights[every, first + 2] = t**3 / 6.0
    return weights
