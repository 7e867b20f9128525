"""When a square of a quadtree stays whole, as it was asked for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Bool, ConfigError, Float64
from fieldgrid.geometry import MAX_DISTANCE_M, Bounds, Lattice, Window
from fieldgrid.maps.cost import CostCurve

LOSS = 16.0
"""Largest difference between the density of a cell and the mean of its square, of 255."""

MAX_LEVEL = 8
"""The largest squares are 2^8 cells wide, as tiles are: the blocks of a map cut none of them."""


class Near(NamedTuple):
    """Where squares are as small as cells: within `within_m` metres of a line, float [n, 2] east
    and north, such as a route, or of one point, such as a vehicle."""

    line_m: npt.ArrayLike
    within_m: float


class Rule(NamedTuple):
    """The loss of density that is allowed, the levels that there are (the smallest first; a square
    of level k has a side of 2^k cells), the least share that must be seen, where squares are small
    (a line [n, 2] and a distance, metres), and what cells count as."""

    loss: float
    levels: tuple[int, ...]
    least_seen: float
    near: tuple[Float64, float] | None
    curve: CostCurve


def checked_rule(
    lattice: Lattice,
    loss: float,
    sides_m: Sequence[float] | None,
    least_seen: float,
    near: Near | None,
    curve: CostCurve | None,
) -> Rule:
    """The rule for the cells of a lattice; ConfigError for one that cannot be."""
    if not 0.0 <= loss <= 255.0:
        raise ConfigError(f"A loss of {loss} is outside 0..255, as densities are.")
    if not 0.0 < least_seen <= 1.0:
        raise ConfigError(
            f"A least share seen of {least_seen} is not above 0 and up to 1; 1 asks for all cells."
        )
    levels = tuple(range(MAX_LEVEL + 1))
    if sides_m is not None:
        levels = tuple(_level(lattice, side_m) for side_m in sides_m)
        if levels[:1] != (0,) or list(levels) != sorted(set(levels)):
            raise ConfigError(
                f"The sides {', '.join(f'{side:g}' for side in sides_m)} m do not rise from that "
                f"of the cells; begin with {lattice.cell_m:g}."
            )
    line = None if near is None else _checked_line(near)
    return Rule(float(loss), levels, float(least_seen), line, curve or CostCurve())


def _level(lattice: Lattice, side_m: float) -> int:
    """The level of squares of a side; ConfigError, which names the nearest, where there is none."""
    cells = side_m * lattice.cells_per_m
    level = 0
    if math.isfinite(cells) and cells > 0.0:
        level = min(max(round(math.log2(cells)), 0), MAX_LEVEL)
    if not math.isclose(cells, 1 << level, rel_tol=1e-6):
        raise ConfigError(
            f"A side of {side_m:g} m is not 1, 2, 4, ... {1 << MAX_LEVEL} cells of "
            f"{lattice.cell_m:g} m; the nearest is {lattice.cell_m * (1 << level):g}."
        )
    return level


def _checked_line(near: Near) -> tuple[Float64, float]:
    line = np.atleast_2d(np.asarray(near.line_m, dtype=np.float64))
    if line.ndim != 2 or line.shape[1] != 2 or not len(line) or not np.isfinite(line).all():
        raise ConfigError(
            f"A line of shape {line.shape} is none near which squares are small; give finite "
            "points [n, 2], metres east and north."
        )
    farthest_m = float(np.abs(line).max())
    if farthest_m > MAX_DISTANCE_M:
        raise ConfigError(
            f"A line near which squares are small goes {farthest_m:g} m from the datum, and maps "
            f"end at {MAX_DISTANCE_M:g}; give points in metres east and north of it."
        )
    if not 0.0 <= near.within_m <= MAX_DISTANCE_M:
        raise ConfigError(
            f"Squares cannot be small within {near.within_m} m; give 0 to {MAX_DISTANCE_M:g}."
        )
    return line, float(near.within_m)


def whole_squares(window: Window, level: int) -> Window:
    """The smallest window of whole squares of a level that covers a window."""
    i0, j0 = window.i0 >> level << level, window.j0 >> level << level
    width, height = window.i0 + window.width - i0, window.j0 + window.height - j0
    return Window(i0, j0, -(-width >> level) << level, -(-height >> level) << level)


def close_cells(near: tuple[Float64, float], lattice: Lattice, window: Window) -> Bool:
    """The cells of a window whose centres are within the distance of the line."""
    line, within_m = near
    close = np.zeros(window.shape, dtype=np.bool_)
    starts, ends = (line[:-1], line[1:]) if len(line) > 1 else (line, line)
    low, high = np.minimum(starts, ends) - within_m, np.maximum(starts, ends) + within_m
    edges = lattice.bounds(window)
    # Of a long line few segments come near a window.
    for k in np.flatnonzero(((low < edges[2:]) & (high > edges[:2])).all(axis=1)):
        start, end = starts[k], ends[k]
        reach = lattice.window(Bounds(*low[k].tolist(), *(high[k] + lattice.cell_m).tolist()))
        part = reach.intersect(window)
        if part is None:
            continue
        east, north = lattice.centres(part)
        x, y = east[None, :] - start[0], north[:, None] - start[1]
        way = end - start
        share = np.clip((x * way[0] + y * way[1]) / max(float(way @ way), 1e-12), 0.0, 1.0)
        distance_m = np.hypot(x - share * way[0], y - share * way[1])
        close[window.slices_of(part)] |= distance_m <= within_m
    return close
