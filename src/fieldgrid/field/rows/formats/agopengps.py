"""A planting as a field of AgOpenGPS: its origin, its boundaries, and a track a lane.

AgOpenGPS keeps a field as text files in metres of a plane of its own, which is not that of a
datum: degrees from the origin, times the metres that a degree has there. Older releases take the
metres that a degree has at each point's own latitude, and differ by millimetres at 100 m from the
origin; so the origin is put into the middle of the field.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import ConfigError, Float64, mentions, replacing_folder
from fieldgrid.field.rows.result import Planting
from fieldgrid.geometry import Datum, continued_deg, project, resampled

_STRAIGHT_M = 0.05
"""A lane that bends less is an AB line, another one a curve."""

_AB, _CURVE = 2, 4
_HOLE_M2 = 1.0
_CLOSED_M = 0.3


class FieldPlane(NamedTuple):
    """The plane of a field: metres from an origin in degrees."""

    lat_deg: float
    lon_deg: float

    def metres(self, points_m: Float64, datum: Datum) -> Float64:
        """Metres east and north [n, 2] of points in the plane of a datum."""
        lat, lon, _ = datum.to_geodetic(points_m[:, 0], points_m[:, 1], np.zeros(len(points_m)))
        lon = continued_deg(lon, self.lon_deg)
        a = math.radians(self.lat_deg)
        a_degree_north = (
            111132.92 - 559.82 * math.cos(2.0 * a) + 1.175 * math.cos(4.0 * a)
            - 0.0023 * math.cos(6.0 * a)
        )  # fmt: skip
        a_degree_east = (
            111412.84 * math.cos(a) - 93.5 * math.cos(3.0 * a) + 0.118 * math.cos(5.0 * a)
        )
        return np.column_stack(
            [(lon - self.lon_deg) * a_degree_east, (lat - self.lat_deg) * a_degree_north]
        )


def write_agopengps(planting: Planting, folder: Path, *, overwrite: bool = False) -> None:
    """Write a field folder: `Field.txt`, `Boundary.txt` and `TrackLines.txt`.

    The boundary encloses blocks and headlands; inside it are those of holes in that ground from
    1 m² and of obstacles. A lane is an AB line, or a curve where it bends, in the direction of its
    line. Raises ConfigError for a planting without lanes or in several places, MapExistsError for a
    folder that may not be overwritten, MapWriteError where it cannot be written.
    """
    if not planting.lanes:
        raise ConfigError("A field of AgOpenGPS needs lanes, and none was found; see --crop.")
    ground = shapely.union_all(
        [*(b.area for b in planting.blocks), *(h.area for h in planting.headlands),
         *(lane.area for lane in planting.lanes)]
    ).buffer(_CLOSED_M, join_style="mitre").buffer(-_CLOSED_M, join_style="mitre")  # fmt: skip
    places = [
        part
        for part in shapely.get_parts(ground)
        if any(part.intersects(lane.line) for lane in planting.lanes)
    ]
    if len(places) > 1:
        raise ConfigError(
            f"The lanes lie in {len(places)} places that do not touch, and a field of AgOpenGPS "
            "has one boundary; give --bounds around one of them."
        )
    outer = places[0]
    holes = [ring for ring in outer.interiors if shapely.Polygon(ring).area >= _HOLE_M2]
    holes += [
        part.exterior
        for thing in planting.obstacles
        if shapely.intersects(outer, thing.area)
        for part in shapely.get_parts(thing.area)
    ]
    middle = np.array([shapely.get_coordinates(outer.centroid)[0]])
    lat, lon, _ = planting.datum.to_geodetic(middle[:, 0], middle[:, 1], np.zeros(1))
    plane = FieldPlane(round(float(lat[0]), 9), round(float(lon[0]), 9))
    origin = [
        f"{datetime.now():%Y-%b-%d %I:%M:%S %p}",
        *("$FieldDir", "fieldgrid", "$Offsets", "0,0", "Convergence", "0", "StartFix"),
        f"{plane.lat_deg:.9f},{plane.lon_deg:.9f}",
    ]
    with replacing_folder(
        folder,
        overwrite=overwrite,
        ours=lambda old: mentions(old / "Field.txt", b"fieldgrid"),
        what="a field of AgOpenGPS",
    ) as draft:
        for name, lines in (
            ("Field.txt", origin),
            ("Boundary.txt", _boundary([outer.exterior, *holes], plane, planting.datum)),
            ("TrackLines.txt", _tracks(planting, plane)),
        ):
            (draft / name).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _boundary(rings: list[shapely.LinearRing], plane: FieldPlane, datum: Datum) -> Iterator[str]:
    yield "$Boundary"
    for ring in rings:
        # Closed by itself: the first point is not repeated.
        points = plane.metres(shapely.get_coordinates(shapely.segmentize(ring, 2.0))[:-1], datum)
        yield "False"  # no vehicle drives through what it encloses
        yield str(len(points))
        yield from _points(points, np.roll(points, -1, axis=0) - points)


def _tracks(planting: Planting, plane: FieldPlane) -> Iterator[str]:
    yield "$TrackLines"
    for lane in planting.lanes:
        line = np.asarray(lane.line.coords, dtype=np.float64)[:, :2]
        is_straight = np.abs(project(line, line[[0, -1]])[1]).max() <= _STRAIGHT_M
        points = plane.metres(
            line[[0, -1]] if is_straight else resampled(line, 1.0), planting.datum
        )
        along = points[-1] - points[0]
        yield lane.id
        yield f"{_heading_rad(along):.6f}"
        yield from (f"{east:.3f},{north:.3f}" for east, north in points[[0, -1]].tolist())
        yield "0"  # not nudged
        yield str(_AB if is_straight else _CURVE)
        yield "True"  # visible
        if is_straight:
            yield "0"
        else:
            yield str(len(points))
            yield from _points(points, np.gradient(points, axis=0))


def _points(points: Float64, along: Float64) -> Iterator[str]:
    """East, north, and the heading in radians clockwise from north, 0..2π."""
    for (east, north), way in zip(points.tolist(), along, strict=True):
        yield f"{east:.3f},{north:.3f},{_heading_rad(way):.5f}"


def _heading_rad(along: Float64) -> float:
    return float(np.arctan2(along[0], along[1]) % (2.0 * math.pi))
