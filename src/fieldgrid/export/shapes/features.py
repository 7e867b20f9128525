"""What of a map has a shape: obstacles, trajectories, poses, footprints and squares, in layers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, Bool, ConfigError, quoted
from fieldgrid.export.options import QuadtreeOptions, ShapeOptions
from fieldgrid.export.shapes.clipping import at, stretches_inside
from fieldgrid.export.shapes.obstacles import trace_obstacles
from fieldgrid.geometry import FREE_UP_TO, OBSTACLE_ABOVE, Bounds, FeatureLayer, Trajectory
from fieldgrid.maps import (
    CostCurve,
    FrameRecord,
    MapFile,
    Quadtree,
    Selection,
    Squares,
    State,
    to_universal,
)

# The quadtree of a map as polygons, a square each.


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

    bounds = selection.bounds
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
    return FeatureLayer(
        "quadtree",
        "Polygon",
        np.asarray(
            shapely.box(west_m, south_m, west_m + side_m, south_m + side_m), dtype=np.object_
        ).reshape(-1),
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


LAYERS = ("footprint", "obstacle", "mark", "trajectory", "pose", "quadtree")
"""The layers of features there are, as they are to be drawn: footprints lie under obstacles. The
quadtree is for itself."""


def feature_layers(
    universal: MapFile,
    selection: Selection,
    options: ShapeOptions,
    names: Sequence[str],
    squares: QuadtreeOptions | None = None,
) -> list[FeatureLayer]:
    """The layers asked for, in that order, cut off at the selection's bounds; squares stay whole.

    Sessions are those in the map, as of the selection's moment. Raises ConfigError for a name that
    is no layer, and when shapely is not installed.
    """
    for name in names:
        if name not in LAYERS:
            raise ConfigError(
                f"{quoted(name)} is no layer of features; known are {', '.join(LAYERS)}."
            )
    sessions, area = selection.names(universal), selection.area(universal)
    drives = trajectories(universal, selection)
    quadtree, above = squares or QuadtreeOptions(), options.obstacle_above
    make: dict[str, Callable[[], FeatureLayer]] = {
        "mark": lambda: _within(_marks(universal), area),
        "obstacle": lambda: _obstacles(universal, selection, options),
        "trajectory": lambda: _lines(drives, area),
        "pose": lambda: _within(_poses(drives), area),
        "footprint": lambda: _within(_footprints(universal, sessions), area),
        "quadtree": lambda: square_layer(universal, selection, quadtree, above),
    }
    return [make[name]() for name in names]


def trajectories(universal: MapFile, selection: Selection) -> dict[str, Trajectory]:
    """The trajectories of the sessions in the selection by name, in the order of their drives; a
    session may have been stored without one."""
    stored = {info.name for info in universal.sessions() if info.heading_source}
    return {
        name: universal.trajectory(name) for name in selection.names(universal) if name in stored
    }


def _within(layer: FeatureLayer, area: Bounds | None) -> FeatureLayer:
    """The parts of polygons, and the points, that lie in the area."""
    import shapely

    if area is None or not len(layer.geometry):
        return layer
    cut = shapely.intersection(layer.geometry, shapely.box(*area))
    # What only touches the area is not in it.
    points = shapely.get_dimensions(layer.geometry) == 0
    kept = np.where(points, ~shapely.is_empty(cut), shapely.area(cut) > 0.0)
    return layer._replace(
        geometry=cut[kept], columns={name: values[kept] for name, values in layer.columns.items()}
    )


def _marks(universal: MapFile) -> FeatureLayer:
    """What people said of places; it stands beside what the drives saw."""
    marks = universal.marks()
    return FeatureLayer(
        "mark",
        "Unknown",
        _objects([mark.geometry for mark in marks]),
        {
            key: _texts([getattr(mark, key) for mark in marks])
            for key in ("kind", "name", "note", "author", "created")
        },
    )


def _obstacles(universal: MapFile, selection: Selection, options: ShapeOptions) -> FeatureLayer:
    with selection.blocks(universal, decide="density") as blocks:
        found = list(trace_obstacles(blocks.views, options))
    import shapely

    # As multipolygons all: a layer has one type of geometry.
    outlines = [
        outline if outline.geom_type == "MultiPolygon" else shapely.MultiPolygon([outline])
        for outline, *_ in found
    ]
    return FeatureLayer(
        "obstacle",
        "MultiPolygon",
        _objects(outlines),
        {
            "area_m2": np.array([one.area_m2 for one in found], dtype=np.float64),
            "mean_density": np.array([one.mean_density for one in found], dtype=np.float64),
            "max_density": np.array([one.max_density for one in found], dtype=np.int32),
        },
    )


def _lines(drives: dict[str, Trajectory], area: Bounds | None) -> FeatureLayer:
    """A line for each stretch of a drive in one gear on which no pose was rejected."""
    import shapely

    found: list[tuple[Any, str, int, int, int]] = []
    for name, track in drives.items():
        for first, last in _stretches(track):
            rows = slice(first, last)
            places = np.c_[track.east_m[rows], track.north_m[rows]]
            passed_s = (track.time_ns[rows] - track.time_ns[first]) / 1e9
            for positions in stretches_inside(places[:, 0], places[:, 1], area):
                line = shapely.LineString(np.column_stack([at(v, positions) for v in places.T]))
                passed_ns = np.rint(at(passed_s, positions) * 1e9).astype(np.int64)
                times_ns = (track.time_ns[first] + passed_ns).tolist()
                found.append((line, name, int(track.gear[first + 1]), times_ns[0], times_ns[-1]))
    lines, names, gears, starts, stops = ([row[k] for row in found] for k in range(5))
    return FeatureLayer(
        "trajectory",
        "LineString",
        _objects(lines),
        {
            "session": np.array(names, dtype=np.object_),
            "gear": np.array(gears, dtype=np.int32),
            "first_ns": np.array(starts, dtype=np.int64),
            "last_ns": np.array(stops, dtype=np.int64),
            "first_time": _iso(starts),
            "last_time": _iso(stops),
        },
    )


def _stretches(track: Trajectory) -> Iterator[tuple[int, int]]:
    """First row and row after the last of each stretch; neighbours share the row of the cusp."""
    first = None
    for k in range(len(track)):
        if not track.accepted[k]:
            if first is not None and k - first > 1:
                yield first, k
            first = None
        elif first is None:
            first = k
        elif k - first > 1 and track.gear[k] != track.gear[k - 1]:
            yield first, k
            first = k - 1
    if first is not None and len(track) - first > 1:
        yield first, len(track)


def _poses(drives: dict[str, Trajectory]) -> FeatureLayer:
    """A point for each row of the trajectories, the rejected ones with their reasons."""
    import shapely

    tracks = list(drives.values())

    def joined(column: str) -> AnyArray:
        return np.concatenate([getattr(track, column) for track in tracks] or [np.zeros(0)])

    def known(column: str) -> AnyArray:
        return np.ma.masked_invalid(joined(column))

    # Of a row without a position, the point is empty.
    points = shapely.points(np.c_[joined("east_m"), joined("north_m")])
    return FeatureLayer(
        "pose",
        "Point",
        np.asarray(points, dtype=np.object_).reshape(-1),
        {
            "session": _texts([name for name, track in drives.items() for _ in range(len(track))]),
            "time_ns": joined("time_ns").astype(np.int64),
            "time": _iso(joined("time_ns")),
            "up_m": known("up_m"),
            "heading_deg": known("heading_deg"),
            "heading_sigma_deg": known("heading_sigma_deg"),
            "position_sigma_m": known("position_sigma_m"),
            "speed_mps": known("speed_mps"),
            "gear": joined("gear").astype(np.int32),
            "quality": joined("quality").astype(np.int32),
            "status": _texts([status.value for track in tracks for status in track.status]),
            "reason": _texts([reason for track in tracks for reason in track.reason]),
        },
    )


def _footprints(universal: MapFile, sessions: Sequence[str]) -> FeatureLayer:
    """The ground that each local grid covers, of the frames that have a pose."""
    frames = [
        frame
        for frame in universal.frames()
        if frame.session in sessions and np.isfinite(frame.pose.heading_deg)
    ]
    return FeatureLayer(
        "footprint",
        "Polygon",
        _objects([_rectangle(frame) for frame in frames]),
        {
            "session": _texts([frame.session for frame in frames]),
            "frame_id": _texts([frame.frame_id for frame in frames]),
            "time_ns": np.array([frame.pose.time_ns for frame in frames], dtype=np.int64),
            "time": _iso([frame.pose.time_ns for frame in frames]),
            "status": _texts([frame.pose.status.value for frame in frames]),
        },
    )


def _rectangle(frame: FrameRecord) -> Any:
    import shapely

    half_m, length_m = frame.spec.width_m / 2.0, frame.spec.length_m
    x = np.array([-half_m, half_m, half_m, -half_m])
    y = np.array([0.0, 0.0, length_m, length_m])
    return shapely.Polygon(np.c_[to_universal(x, y, frame.pose)])


def _iso(time_ns: npt.ArrayLike) -> npt.NDArray[np.object_]:
    """Times in UTC as ISO 8601 has them: JavaScript rounds nanoseconds to a quarter of a
    microsecond."""
    stamps = np.asarray(time_ns, dtype=np.int64).astype("datetime64[ns]")
    return _texts([f"{text}Z" for text in np.datetime_as_string(stamps).tolist()])


def _texts(values: list[str]) -> npt.NDArray[np.object_]:
    return np.array(values, dtype=np.object_)


def _objects(geometries: list[Any]) -> npt.NDArray[np.object_]:
    """Geometries in an array of one dimension, which NumPy would not make of them by itself."""
    array = np.empty(len(geometries), dtype=np.object_)
    array[:] = geometries
    return array
