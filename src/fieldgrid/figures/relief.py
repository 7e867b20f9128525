"""Heights as a relief: shaded from the north-west, with contours at round heights."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter

from fieldgrid import palette
from fieldgrid.array_types import AnyArray, Bool, Float64
from fieldgrid.mapfile import MapView

SMOOTHED_M = 0.5
"""Heights of cells are noisy by centimetres, which would be slopes: they are smoothed so far."""

SEEN_SHARE = 0.25
"""A smooth height needs so much of what is about it, by weight; contours cross smaller holes."""

LIGHT = np.array([-0.5, 0.5, math.sqrt(0.5)])
"""Where the light comes from, east, north, up: the north-west, 45° high, as on maps."""

EXAGGERATION = 3.0
"""Slopes are shaded as if they were so much steeper."""

CONTOUR, LINES = palette.CONTOUR, 12
"""Their colour, and about how many contours there are at most."""


def draw_relief(axes: Axes, view: MapView, heights_m: AnyArray, known: Bool) -> None:
    """Shade heights [rows north, columns east] that are drawn in axes, and add their contours."""
    if min(heights_m.shape) < 2 or not known.any():
        return
    cell_m, bounds = view.lattice.cell_m, view.bounds
    smooth_m = smoothed(heights_m, known, SMOOTHED_M / cell_m)
    shade = np.nan_to_num(hillshade(smooth_m, cell_m))
    # White where it is lighter than level ground, black where it is darker.
    grey = np.zeros((*shade.shape, 4))
    grey[..., :3] = (shade > 0.0)[..., None]
    grey[..., 3] = np.where(known, np.minimum(np.abs(shade), 0.6), 0.0)
    axes.imshow(
        grey,
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        origin="lower",
        interpolation="none",
        aspect="equal",
    )
    levels = contour_levels(float(heights_m[known].min()), float(heights_m[known].max()))
    if len(levels):
        east_m, north_m = view.lattice.centres(view.window)
        drawn = np.ma.masked_invalid(smooth_m)
        lines = axes.contour(east_m, north_m, drawn, levels=levels, colors=CONTOUR, linewidths=0.7)
        axes.clabel(lines, fontsize=7, fmt="%g")


def smoothed(heights_m: AnyArray, known: Bool, sigma_cells: float) -> Float64:
    """The mean of the known heights about each cell by a Gaussian; NaN where they are few."""
    weight = gaussian_filter(known.astype(np.float64), sigma_cells)
    total = gaussian_filter(np.where(known, heights_m, 0.0).astype(np.float64), sigma_cells)
    enough = weight >= SEEN_SHARE
    return np.asarray(np.divide(total, weight, out=np.full_like(total, np.nan), where=enough))


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
