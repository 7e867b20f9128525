"""Guidance of ISO 11783-10: drives, lanes between rows and parallel tracks to steer by."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from itertools import count
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from fieldgrid.core import Flag, setting
from fieldgrid.export.options import ShapeOptions
from fieldgrid.geometry import Datum, FeatureLayer, project

if TYPE_CHECKING:
    from fieldgrid.field import Lane, Planting

MIN_CURVE_M = 2.0
"""A guidance curve that is shorter guides nobody."""

NAME = 32
"""The most letters of a designator."""

DECIMALS = 9
"""Of degrees: 0.1 mm."""

_TOLERANCE_M = 0.05
_LANE_TOLERANCE_M = 0.01
_STRAIGHT_M = 0.02
"""A lane that bends less is a line from A to B, another one a curve."""


class TaskdataOptions(ShapeOptions):
    """What the terminal is to steer by."""

    guidance: Literal["drives", "lanes"] = setting(
        "drives", "source of the guidance lines", flag=Flag("--guidance", "drives|lanes")
    )
    crop: str = setting(
        "vineyard",
        "crop whose rows define the lanes, as in `fieldgrid rows`",
        flag=Flag("--crop", "NAME"),
    )


def points(line: Any, datum: Datum, kinds: Sequence[Any], says: str = "") -> list[Any]:
    """The corners of a line in metres as the library's points of these kinds."""
    from isoxml.models.base import v4 as iso

    places = np.asarray(line.coords)[:, :2]
    lat_deg, lon_deg, _ = datum.to_geodetic(places[:, 0], places[:, 1], np.zeros(len(places)))
    return [
        iso.Point(type=kind, designator=says[:NAME] or None, north=decimal(lat), east=decimal(lon))
        for kind, lat, lon in zip(kinds, lat_deg.tolist(), lon_deg.tolist(), strict=True)
    ]


def decimal(degrees: float) -> Decimal:
    """Degrees to 0.1 mm; the standard allows no more."""
    return Decimal(f"{degrees:.{DECIMALS}f}")


def polygon_of(shape: Any, kind: Any, says: str, datum: Datum) -> Any:
    """A polygon in metres as the library's."""
    from isoxml.models.base import v4 as iso

    rings = [
        (shape.exterior, iso.LineStringType.PolygonExterior),
        *((ring, iso.LineStringType.PolygonInterior) for ring in shape.interiors),
    ]
    return iso.Polygon(
        type=kind,
        designator=says[:NAME],
        area=round(shape.area),
        line_strings=[
            iso.LineString(
                type=ring_kind, points=points(ring, datum, [iso.PointType.Other] * len(ring.coords))
            )
            for ring, ring_kind in rings
        ],
    )


def polygons(shape: Any, kind: Any, says: str, datum: Datum) -> list[Any]:
    """The polygons of a shape in metres, of one part or several."""
    parts = getattr(shape, "geoms", [shape])
    return [polygon_of(part, kind, says, datum) for part in parts if not part.is_empty]


def drive_groups(drives: FeatureLayer, datum: Datum) -> list[Any]:
    """The forward stretches of the drives as guidance curves from A to B, in one group."""
    import shapely
    from isoxml.models.base import v4 as iso

    columns = (drives.geometry, drives.columns["session"], drives.columns["gear"])
    forward = [
        (line, session)
        for line, session, gear in zip(*columns, strict=True)
        if gear >= 0 and line.length >= MIN_CURVE_M
    ]
    curves = [
        iso.GuidancePattern(
            id=f"GPN{number}",
            designator=f"{session} {number}"[-NAME:],
            type=iso.GuidancePatternType.Curve,
            line_strings=[_line(shapely.simplify(line, _TOLERANCE_M), datum)],
        )
        for number, (line, session) in enumerate(forward, 1)
    ]
    group = iso.GuidanceGroup(id="GGP1", designator="drives", guidance_patterns=curves)
    return [group] if curves else []


def lane_groups(planting: Planting) -> list[Any]:
    """A group for each block: its boundary, and each lane or track as one swath.

    A swath has its width, is not carried on at its ends and not repeated beside it: the next one is
    a pattern of its own.
    """
    from isoxml.models.base import v4 as iso

    groups: list[Any] = []
    numbers = count(1)
    for block in planting.blocks:
        patterns = [
            _swath(lane, next(numbers), planting.datum)
            for lane in planting.lanes
            if lane.block == block.id
        ]
        if patterns:
            groups.append(
                iso.GuidanceGroup(
                    id=f"GGP{len(groups) + 1}",
                    designator=block.id[:NAME],
                    guidance_patterns=patterns,
                    boundary_polygons=polygons(
                        block.area, iso.PolygonType.PartfieldBoundary, "worked", planting.datum
                    ),
                )
            )
    return groups


def _swath(lane: Lane, number: int, datum: Datum) -> Any:
    import shapely
    from isoxml.models.base import v4 as iso

    corners = shapely.get_coordinates(lane.line)
    is_straight = float(np.abs(project(corners, corners[[0, -1]])[1]).max()) <= _STRAIGHT_M
    line = (
        shapely.LineString(corners[[0, -1]])
        if is_straight
        else shapely.simplify(lane.line, _LANE_TOLERANCE_M)
    )
    kind = iso.GuidancePatternType.AB if is_straight else iso.GuidancePatternType.Curve
    width_mm = round(1000.0 * lane.area.area / lane.length_m)
    return iso.GuidancePattern(
        id=f"GPN{number}",
        designator=lane.id[-NAME:],
        type=kind,
        propagation_direction=iso.GuidancePatternPropagationDirection.NoPropagation,
        extension=iso.GuidancePatternExtension.NoExtensions,
        number_of_swaths_left=0,
        number_of_swaths_right=0,
        line_strings=[_line(line, datum, width_mm)],
    )


def _line(line: Any, datum: Datum, width_mm: int | None = None) -> Any:
    """A line from A to B."""
    from isoxml.models.base import v4 as iso

    kinds = [iso.PointType.GuidancePoint] * len(line.coords)
    kinds[0], kinds[-1] = iso.PointType.GuidanceReferenceA, iso.PointType.GuidanceReferenceB
    return iso.LineString(
        type=iso.LineStringType.GuidancePattern, width=width_mm, points=points(line, datum, kinds)
    )
