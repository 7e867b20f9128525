"""Obstacles as polygons: the cells above a threshold that touch each other, traced and simplified.

Memory goes with the obstacles and not with the map: cells are collected strip by strip, joined into
components by their neighbours, and each component is traced in a window of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int64, UInt8
from fieldgrid.errors import ConfigError
from fieldgrid.export.options import ShapeOptions
from fieldgrid.lattice import Lattice
from fieldgrid.mapfile import MapView

MAX_CELLS = 50_000_000
"""Obstacle cells that are traced at once: 2.5 GB of neighbours."""


_ROUNDS = (0.75, 0.25, 0.0)
"""Which share of the tolerance each round of leaving corners out may use; the last takes those that
lie on a line."""

_AREA_SHARE = 0.1
"""An outline is simplified only if its area grows by no more than this share."""


class Obstacle(NamedTuple):
    """One obstacle: its outline (a shapely polygon or multipolygon, metres east and north), the
    area of its cells, their mean and highest density."""

    outline: Any
    area_m2: float
    mean_density: float
    max_density: int


class _Cells(NamedTuple):
    """Cells of a lattice by column and row, ordered by row and column, and their densities."""

    i: Int64
    j: Int64
    density: UInt8


def trace_obstacles(
    views: Iterable[MapView], options: ShapeOptions | None = None
) -> Iterator[Obstacle]:
    """The obstacles in views of one lattice that do not overlap, from the south-west.

    A cell is an obstacle where one of the map's own in it is, and outlines enclose all of them.
    Cells that touch by a side or a corner are one obstacle. Raises ConfigError when there are too
    many, or when shapely or rasterio is not installed.
    """
    options = options or ShapeOptions()
    _require_libraries()
    lattice, cells = _collect(views, options.obstacle_above)
    if lattice is None:
        return
    for part in _components(cells):
        area_m2 = len(part.i) * lattice.cell_m**2
        if area_m2 >= options.min_area_m2:
            yield Obstacle(
                _outline(part, lattice, options.simplify_m),
                area_m2,
                float(part.density.mean()),
                int(part.density.max()),
            )


def _require_libraries() -> None:
    try:
        import rasterio  # noqa: F401
        import shapely  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            "Tracing obstacles needs rasterio and shapely, which are not installed; "
            "run: pip install 'fieldgrid[gis]'"
        ) from error


def _collect(views: Iterable[MapView], above: int) -> tuple[Lattice | None, _Cells]:
    lattice: Lattice | None = None
    rows, columns, densities, total = [], [], [], 0
    for view in views:
        lattice = view.lattice
        worst, seen, _ = view.decision()
        j, i = np.nonzero((worst > above) & (seen > 0.0))
        total += len(i)
        if total > MAX_CELLS:
            raise ConfigError(
                f"Over {MAX_CELLS / 1e6:.0f} million cells have a density above {above}; give "
                "smaller bounds, a larger cell or a higher threshold."
            )
        rows.append(j + view.window.j0)
        columns.append(i + view.window.i0)
        densities.append(view.density[j, i])
    if not rows:
        return None, _Cells(*(np.zeros(0, dtype=np.int64),) * 2, np.zeros(0, dtype=np.uint8))
    i, j = np.concatenate(columns), np.concatenate(rows)
    order = np.lexsort((i, j))
    return lattice, _Cells(i[order], j[order], np.concatenate(densities)[order])


def _components(cells: _Cells) -> Iterator[_Cells]:
    """The cells by what touches, in the order of their first cells."""
    from scipy.sparse import coo_array  # 35 MB, for those who have outlines drawn
    from scipy.sparse.csgraph import connected_components

    count = len(cells.i)
    if count == 0:
        return
    i = cells.i - cells.i.min() + 1  # a free column on either side: no row runs into the next
    j = cells.j - cells.j.min()
    width = int(i.max()) + 2
    keys = j * width + i
    starts, ends = [], []
    for step in (1, width - 1, width, width + 1):
        at = np.searchsorted(keys, keys + step)
        found = np.flatnonzero(keys[np.minimum(at, count - 1)] == keys + step)
        starts.append(found)
        ends.append(at[found])
    start, end = np.concatenate(starts), np.concatenate(ends)
    graph = coo_array((np.ones(len(start), dtype=np.bool_), (start, end)), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label, kind="stable")
    first = np.flatnonzero(np.diff(label[order], prepend=-1))
    parts = [order[a:b] for a, b in zip(first, [*first[1:], count], strict=True)]
    for part in sorted(parts, key=lambda part: int(part[0])):
        yield _Cells(cells.i[part], cells.j[part], cells.density[part])


def _outline(cells: _Cells, lattice: Lattice, simplify_m: float | None) -> Any:
    """The outline of cells that touch, metres east and north, simplified and valid."""
    import shapely
    from rasterio.features import shapes

    i0, j0 = int(cells.i.min()), int(cells.j.min())
    mask = np.zeros((int(cells.j.max()) - j0 + 1, int(cells.i.max()) - i0 + 1), dtype=np.uint8)
    mask[cells.j - j0, cells.i - i0] = 1
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
