"""Heights as a relief: shaded from the north-west, with contours at round heights."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter

from fieldgrid.core import AnyArray, Bool, Float32, Float64, UInt8, palette
from fieldgrid.maps import MapView

SMOOTHED_M = 0.5
"""Sigma of the Gaussian that smooths heights: those of cells are noisy by centimetres, which would
be slopes."""

SEEN_SHARE = 0.25
"""Least share by weight of the cells around a smooth height that must be known; contours cross
smaller holes."""

LIGHT = np.array([-0.5, 0.5, math.sqrt(0.5)])
"""Where the light comes from, east, north, up: the north-west, 45° high, as on maps."""

EXAGGERATION = 3.0
"""Factor by which slopes are made steeper for shading."""

_TRUNCATED = 4.0
"""Sigmas at which the Gaussian ends."""

_BAND_CELLS = 1_000_000
"""Cells whose slopes are worked out at a time: they take some hundred bytes each."""

CONTOUR, LINES = palette.CONTOUR, 12
"""Their colour, and about how many contours there are at most."""


def draw_relief(axes: Axes, view: MapView, heights_m: AnyArray, known: Bool) -> None:
    """Shade heights [rows north, columns east] that are drawn in axes, and add their contours."""
    if min(heights_m.shape) < 2 or not known.any():
        return
    cell_m, bounds = view.lattice.cell_m, view.bounds
    smooth_m = smoothed(heights_m, known, SMOOTHED_M / cell_m)
    lighter, opacity = _shades(smooth_m, known, cell_m)
    axes.imshow(
        lighter,
        alpha=opacity,
        cmap="gray",
        vmin=0,
        vmax=1,
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        origin="lower",
        interpolation="none",
        interpolation_stage="data",  # the same picture, without four floats of colour a cell
        aspect="equal",
    )
    levels = contour_levels(float(heights_m[known].min()), float(heights_m[known].max()))
    if len(levels):
        east_m, north_m = view.lattice.centres(view.window)
        drawn = np.ma.masked_invalid(smooth_m, copy=False)
        lines = axes.contour(east_m, north_m, drawn, levels=levels, colors=CONTOUR, linewidths=0.7)
        axes.clabel(lines, fontsize=7, fmt="%g")


def smoothed(heights_m: AnyArray, known: Bool, sigma_cells: float) -> Float64:
    """The mean of the known heights about each cell by a Gaussian; NaN where they are few."""
    found = np.full(known.shape, np.nan)
    reach = math.ceil(_TRUNCATED * sigma_cells) + 1
    for rows, wide, inside in _bands(known.shape, reach):
        seen = known[wide]
        total = np.where(seen, heights_m[wide], 0.0).astype(np.float64)
        weight, total = (
            gaussian_filter(one, sigma_cells, truncate=_TRUNCATED)[inside]
            for one in (seen.astype(np.float64), total)
        )
        np.divide(total, weight, out=found[rows], where=weight >= SEEN_SHARE)
    return found


def _shades(smooth_m: Float64, known: Bool, cell_m: float) -> tuple[UInt8, Float32]:
    """What is laid over the heights: 1, white, where it is lighter than level ground, and 0, black,
    where it is darker; and how opaque that is, 0..1."""
    lighter = np.zeros(known.shape, dtype=np.uint8)
    opacity = np.zeros(known.shape, dtype=np.float32)
    for rows, wide, inside in _bands(known.shape, 1):
        shade = np.nan_to_num(hillshade(smooth_m[wide], cell_m)[inside])
        lighter[rows] = shade > 0.0
        opacity[rows] = np.where(known[rows], np.minimum(np.abs(shade), 0.6), 0.0)
    return lighter, opacity


def _bands(shape: tuple[int, ...], reach: int) -> Iterator[tuple[slice, slice, slice]]:
    """Bands of the rows of an array: the rows; the rows with those up to `reach` beside them; and
    where the first lie among these."""
    height, width = shape
    count = max(_BAND_CELLS // width, 2 * reach)
    for first in range(0, height, count):
        last, start = min(first + count, height), max(first - reach, 0)
        yield (
            slice(first, last),
            slice(start, min(last + reach, height)),
            slice(first - start, last - start),
        )


def hillshade(heights_m: Float64, cell_m: float) -> Float64:
    """How much lighter than level ground each cell is, from -1.7 to 0.3: the cosine of the angle
    between the light and the surface's normal, less that of level ground."""
    to_north, to_east = np.gradient(EXAGGERATION * heights_m, cell_m)
    lit = LIGHT[2] - LIGHT[0] * to_east - LIGHT[1] * to_north
    return np.asarray(lit / np.sqrt(1.0 + to_east**2 + to_north**2) - LIGHT[2])


def contour_levels(low_m: float, high_m: float) -> Float64:
    """Multiples of 1, 2 or 5 times a power of ten between two heights, about `LINES` at most."""
    span_m = high_m - low_m
    if not span_m > 1e-3:
        return np.empty(0)
    power = 10.0 ** math.floor(math.log10(span_m / LINES))
    step_m = next(power * k for k in (1, 2, 5, 10) if span_m / (power * k) <= LINES)
    return np.asarray(
        np.arange(math.ceil(low_m / step_m), math.floor(high_m / step_m) + 1) * step_m
    )
