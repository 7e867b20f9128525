"""The quadtree of a map as polygons, a square each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fieldgrid.array_types import Bool
from fieldgrid.cost import CostCurve
from fieldgrid.errors import ConfigError
from fieldgrid.export.options import QuadtreeOptions
from fieldgrid.export.selection import Selection
from fieldgrid.grids import FREE_UP_TO, OBSTACLE_ABOVE
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import MapFile
from fieldgrid.quadtree import Quadtree, Squares, State
from fieldgrid.vectors import FeatureLayer

MAX_SQUARES = 2_000_000
"""Squares of a file, of which each takes a kilobyte while it is written."""


def square_layer(
    universal: MapFile,
    selection: Selection,
    options: QuadtreeOptions,
    obstacle_above: int = OBSTACLE_ABOVE,
) -> FeatureLayer:
    """The squares that reach into the selection, whole, as their columns are of all of a square.

    Raises ConfigError for options that cannot be, and for more than 2 million squares.
    """
    import shapely

    bounds = selection.checked_bounds(universal)
    found = Quadtree.from_map(
        universal,
        bounds,
        selection.cell_m,
        loss=options.quadtree_loss,
        sides_m=options.sides_m(),
        least_seen=options.quadtree_seen,
        at=selection.at,
        curve=CostCurve(min(FREE_UP_TO, obstacle_above), obstacle_above),
    )
    if bounds is not None:
        kept = _reaching(found, bounds)
        found = replace(found, squares=Squares._make(column[kept] for column in found.squares))
    if len(found) > MAX_SQUARES:
        raise ConfigError(
            f"{len(found)} squares are over {MAX_SQUARES / 1e6:g} million; give smaller --bounds, "
            "a larger --cell, or a larger --quadtree-loss."
        )
    west_m, south_m, side_m, part = found.west_m, found.south_m, found.side_m, found.squares
    names = np.array([state.name.lower() for state in State], dtype=np.object_)
    shapes = shapely.box(west_m, south_m, west_m + side_m, south_m + side_m)
    return FeatureLayer(
        "quadtree",
        "Polygon",
        np.asarray(shapes, dtype=np.object_).reshape(-1),
        {
            "side_m": side_m,
            "state": names[part.state],
            "mean_density": np.ma.masked_invalid(part.mean.astype(np.float64)),
            "min_density": part.lowest.astype(np.int32),
            "max_density": part.highest.astype(np.int32),
            "seen_share": part.seen_share.astype(np.float64),
        },
    )


def _reaching(found: Quadtree, bounds: Bounds) -> Bool:
    """Which squares hold one of the cells that cover the bounds."""
    part, asked = found.squares, found.lattice.window(bounds)
    side = 1 << part.level.astype(np.int64)
    return (
        (part.column < asked.i0 + asked.width)
        & (part.column + side > asked.i0)
        & (part.row < asked.j0 + asked.height)
        & (part.row + side > asked.j0)
    )
