"""Obstacles as polygons: the cells above a threshold that touch each other, traced and simplified.

Memory goes with the obstacles and not with the map: runs of cells are collected strip by strip,
joined into components by their neighbours, and each component is traced in a window of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Bool, ConfigError, Float64, Index, Int32, Int64, UInt8
from fieldgrid.export.options import ShapeOptions
from fieldgrid.export.registry import require
from fieldgrid.geometry import Lattice
from fieldgrid.maps import MapView

MAX_CELLS = 50_000_000
"""Obstacle cells that are traced at once."""

_ROUNDS = (0.75, 0.25, 0.0)
"""Which share of the tolerance each round of leaving corners out may use; the last takes those that
lie on a line."""

_AREA_SHARE = 0.1
"""An outline is simplified only if its area grows by no more than this share."""


class ObstacleOutline(NamedTuple):
    """One obstacle: its outline (a shapely polygon or multipolygon, metres east and north), the
    area of its cells, their mean and highest density."""

    outline: Any
    area_m2: float
    mean_density: float
    max_density: int


class _Runs(NamedTuple):
    """Obstacle cells that lie beside each other in a row of a lattice [n], ordered by row and
    column: the row, the first column and the one after the last of each, and the densities of its
    cells: their highest and their sum."""

    row: Int32
    first: Int32
    end: Int32
    highest: UInt8
    total: Int64

    @property
    def cells(self) -> int:
        """How many cells they are."""
        return int((self.end - self.first).sum(dtype=np.int64))

    def chosen(self, which: Index) -> _Runs:
        """Some of them, in this order."""
        return _Runs._make(column[which] for column in self)


def trace_obstacles(
    views: Iterable[MapView], options: ShapeOptions | None = None
) -> Iterator[ObstacleOutline]:
    """The obstacles in views of one lattice that do not overlap, from the south-west.

    A cell is an obstacle where one of the map's own in it is, and outlines enclose all of them.
    Cells that touch by a side or a corner are one obstacle. Raises ConfigError when there are too
    many, or when shapely or rasterio is not installed.
    """
    require("Tracing obstacles", "gis", "rasterio", "shapely")
    options = options or ShapeOptions()
    found = _collect(views, options.obstacle_above)
    if found is None:
        return
    lattice, runs = found
    for part in _components(runs):
        count = part.cells
        area_m2 = count * lattice.cell_m**2
        if area_m2 >= options.min_area_m2:
            yield ObstacleOutline(
                _outline(part, lattice, options.simplify_m),
                area_m2,
                int(part.total.sum()) / count,
                int(part.highest.max()),
            )


def _collect(views: Iterable[MapView], above: int) -> tuple[Lattice, _Runs] | None:
    """The runs of obstacle cells of all views; None where there is no view."""
    lattice: Lattice | None = None
    found, total = [], 0
    for view in views:
        lattice = view.lattice
        worst, seen, _ = view.decision()
        runs = _runs_of((worst > above) & (seen > 0.0), view)
        found.append(runs)
        total += runs.cells
        if total > MAX_CELLS:
            raise ConfigError(
                f"Over {MAX_CELLS / 1e6:.0f} million cells have a density above {above}; give "
                "smaller bounds, a larger cell or a higher threshold."
            )
    if lattice is None:
        return None
    joined = _Runs._make(np.concatenate(column) for column in zip(*found, strict=True))
    return lattice, joined.chosen(np.lexsort((joined.first, joined.row)))


def _runs_of(obstacle: Bool, view: MapView) -> _Runs:
    """The runs of a view's cells."""
    height, width = obstacle.shape
    apart = np.zeros((height, width + 1), dtype=np.bool_)  # no row runs into the next
    apart[:, :-1] = obstacle
    edges = np.flatnonzero(np.diff(apart.reshape(-1), prepend=False))
    start, end = edges[::2], edges[1::2]
    row, first = np.divmod(start, width + 1)
    highest, total = np.zeros(0, dtype=np.uint8), np.zeros(0, dtype=np.int64)
    if len(edges):  # what lies between two runs is added up, too, and left out
        density = np.zeros(apart.shape, dtype=np.uint8)
        density[:, :-1] = view.density
        highest = np.maximum.reduceat(density.reshape(-1), edges)[::2]
        total = np.add.reduceat(density.reshape(-1), edges, dtype=np.int64)[::2]
    i0, j0 = view.window.i0, view.window.j0
    return _Runs(
        (row + j0).astype(np.int32),
        (first + i0).astype(np.int32),
        (first + (end - start) + i0).astype(np.int32),
        highest,
        total,
    )


def _components(runs: _Runs) -> Iterator[_Runs]:
    """The cells by what touches, in the order of their first cells."""
    from scipy.sparse import coo_array  # 35 MB, for those who have outlines drawn
    from scipy.sparse.csgraph import connected_components

    count = len(runs.row)
    if count == 0:
        return
    left = runs.first.astype(np.int64) - runs.first.min() + 1
    right = left + (runs.end - runs.first)
    width = int(right.max()) + 2  # a free column on either side: no row runs into the next
    row = (runs.row - runs.row.min()).astype(np.int64) * width
    first, end = row + left, row + right
    number = np.arange(count)
    starts, ends = [], []
    # In its own row what begins at the end of a run, since views are cut; in the next those from
    # corner to corner of it.
    for low, up in ((number + 1, 0), (np.searchsorted(end, first + width), width)):
        touching = np.maximum(np.searchsorted(first, end + up, side="right") - low, 0)
        starts.append(np.repeat(number, touching))
        before = np.cumsum(touching) - touching
        ends.append(np.arange(len(starts[-1])) + np.repeat(low - before, touching))
    start, stop = np.concatenate(starts), np.concatenate(ends)
    graph = coo_array((np.ones(len(start), dtype=np.bool_), (start, stop)), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label, kind="stable")
    begin = np.flatnonzero(np.diff(label[order], prepend=-1))
    for part in sorted(np.split(order, begin[1:]), key=lambda part: int(part[0])):
        yield runs.chosen(part)


def _outline(runs: _Runs, lattice: Lattice, simplify_m: float | None) -> Any:
    """The outline of cells that touch, metres east and north, simplified and valid."""
    import shapely
    from rasterio.features import shapes

    i0, j0 = int(runs.first.min()), int(runs.row[0])
    steps = np.zeros((int(runs.row[-1]) - j0 + 1, int(runs.end.max()) - i0 + 1), dtype=np.int8)
    steps[runs.row - j0, runs.first - i0] += 1
    # Where views are cut, one run begins where another ends.
    np.subtract.at(steps, (runs.row - j0, runs.end - i0), 1)
    np.cumsum(steps, axis=1, out=steps)
    mask = np.ascontiguousarray(steps[:, :-1]).view(np.uint8)
    # By sides alone: where cells touch by a corner only, an outline that went through it twice
    # would not be valid.
    pieces = [
        shapely.geometry.shape(geometry)
        for geometry, _ in shapes(mask, mask=mask.astype(np.bool_), connectivity=4)
    ]
    outline = pieces[0] if len(pieces) == 1 else shapely.MultiPolygon(pieces)
    # In cells, whose corners are whole numbers: in metres a corner may miss by rounding the edge
    # that it touches, and the outline is no longer valid once it is rounded again, to degrees.
    tolerance = 1.0 if simplify_m is None else simplify_m * lattice.cells_per_m
    # What grows together or across itself is mended, and then holds all of the cells again.
    mended = shapely.get_parts(shapely.make_valid(_grown(outline, tolerance)))
    areas = mended[shapely.get_dimensions(mended) == 2]  # without the lines that are left over
    simple = shapely.union_all([*areas, outline])
    # A post of few cells would gain a good part of itself.
    kept = abs(simple.area - outline.area) <= _AREA_SHARE * outline.area
    return shapely.transform(
        simple if kept and simple.is_valid else outline,
        lambda corners: (corners + np.array([i0, j0])) / lattice.cells_per_m,
    )


def _grown(shape: Any, tolerance: float) -> Any:
    """A shape with fewer corners that encloses it, by up to `tolerance` larger."""
    import shapely

    polygons = [
        shapely.Polygon(
            _without_bays(polygon.exterior, tolerance),
            [_without_bays(hole, tolerance) for hole in polygon.interiors],
        )
        for polygon in getattr(shapely.orient_polygons(shape), "geoms", [shape])
    ]
    return polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)


def _without_bays(ring: Any, tolerance: float) -> Float64:
    """The corners of a ring, with the inside on its left, but for those where it turns right: what
    is left out there only adds to the inside."""
    corners = np.array(ring.coords[:-1])
    for share in _ROUNDS:
        before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
        (x1, y1), (x2, y2) = (corners - before).T, (after - corners).T
        depth = (y1 * x2 - x1 * y2) / np.maximum(np.hypot(*(after - before).T), 1e-12)
        shallow = (depth >= 0.0) & (depth <= share * tolerance)
        left_out = shallow & ~np.roll(shallow, 1)  # no two neighbours at once
        if np.count_nonzero(~left_out) < 3:
            break
        corners = corners[~left_out]
    return corners
