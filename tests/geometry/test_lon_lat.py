"""Shapes in longitude and latitude, also where longitudes begin anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapely

from fieldgrid.geometry import Datum, continued_deg, in_degrees

TAVEUNI = Datum(-16.8, 179.9999, 40.0)
"""The meridian of 180° is 10.7 m to the east."""

FIELD = shapely.box(-50.0, 10.0, 50.0, 40.0)


@pytest.mark.parametrize("lon_deg", [179.9999, -179.9999])
@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        (FIELD, "MultiPolygon"),
        (FIELD.exterior, "MultiLineString"),
        (shapely.LineString([(-50.0, 0.0), (50.0, 0.0)]), "MultiLineString"),
        (shapely.MultiPoint([(-50.0, 0.0), (50.0, 0.0)]), "MultiPoint"),
        (shapely.Point(50.0, 0.0), "Point"),
        (shapely.Point(-50.0, 0.0), "Point"),
    ],
)
def test_shapes_are_cut_at_the_meridian_of_180_degrees(
    lon_deg: float, shape: Any, kind: str
) -> None:
    datum = Datum(-16.8, lon_deg, 40.0)
    found = in_degrees(shape, datum)
    assert found.geom_type == kind
    parts = shapely.get_parts(found)
    for part in parts:
        west, _, east, _ = part.bounds
        assert -180.0 <= west <= east <= 180.0
        assert east - west < 0.001
    if kind != "Point":
        assert {bool(part.bounds[0] > 0.0) for part in parts} == {True, False}
    # Nothing is lost: together they are the shape again.
    back = shapely.transform(
        parts, lambda at: np.stack(datum.to_enu(at[:, 1], at[:, 0], datum.height_m)[:2], axis=1)
    )
    for measure in (shapely.area, shapely.length) if "Point" not in kind else ():
        if shape is not FIELD or measure is shapely.area:
            assert sum(measure(back)) == pytest.approx(measure(shape), rel=1e-4)
    assert max(shapely.distance(shape, part) for part in back) < 0.001


def test_the_parts_of_a_line_are_in_its_order() -> None:
    """There and back across the meridian, from the east."""
    line = shapely.LineString([(50.0, 0.0), (-50.0, 10.0), (50.0, 20.0)])
    lon_deg, lat_deg = shapely.get_coordinates(in_degrees(line, TAVEUNI)).T
    east, north, _ = TAVEUNI.to_enu(lat_deg, lon_deg, TAVEUNI.height_m)
    there = shapely.LineString(np.column_stack([east, north]))
    assert there.length == pytest.approx(line.length, abs=0.01)
    assert (np.diff(north) >= -0.001).all()


def test_of_many_shapes_only_those_across_it_are_cut() -> None:
    shapes = np.array([FIELD, shapely.box(-50.0, 10.0, -20.0, 40.0), shapely.Point(30.0, 0.0)])
    kinds = [shape.geom_type for shape in in_degrees(shapes, TAVEUNI)]
    assert kinds == ["MultiPolygon", "Polygon", "Point"]
    assert {shape.geom_type for shape in in_degrees(shapes[:2], Datum(41.0, 2.0, 0.0))} == {
        "Polygon"
    }


def test_longitudes_go_on_from_one_nearby() -> None:
    assert continued_deg([179.0, -179.0], 178.0).tolist() == [179.0, 181.0]
    assert continued_deg([179.0, -179.0], -178.0).tolist() == [-181.0, -179.0]
    assert continued_deg([10.0, -10.0], 0.0).tolist() == [10.0, -10.0]
