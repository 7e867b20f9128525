"""The Local Tangent Plane against PROJ, and its reference system for a GIS."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from pyproj import CRS, Transformer

from fieldgrid.core import ConfigError, DatumError, FieldgridError
from fieldgrid.geometry import Datum, check_area_of_use, ecef_to_geodetic, geodetic_to_ecef

REQUENA = Datum(39.5, -1.1, 700.0)

datums = st.builds(
    Datum, st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.floats(-400.0, 5000.0)
)
offsets_m = st.lists(
    st.tuples(
        st.floats(-35_000.0, 35_000.0), st.floats(-35_000.0, 35_000.0), st.floats(-400.0, 2000.0)
    ),
    min_size=1,
    max_size=20,
)


def proj_enu(datum: Datum) -> Transformer:
    """PROJ's own way from longitude, latitude (degrees), height to east, north, up."""
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        "+step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={datum.lat_deg!r} +lon_0={datum.lon_deg!r} +h_0={datum.height_m!r}"
    )


@settings(deadline=None)
@given(datums, offsets_m)
def test_enu_agrees_with_proj(datum: Datum, offsets: list[tuple[float, float, float]]) -> None:
    proj = proj_enu(datum)
    enu = np.array(offsets).T
    lon, lat, height = proj.transform(*enu, direction="INVERSE")
    expected = np.array(proj.transform(lon, lat, height))
    assert np.abs(np.array(datum.to_enu(lat, lon, height)) - expected).max() < 1e-6


@settings(deadline=None)
@given(datums, offsets_m)
def test_geodetic_agrees_with_proj(datum: Datum, offsets: list[tuple[float, float, float]]) -> None:
    enu = np.array(offsets).T
    lon, lat, height = proj_enu(datum).transform(*enu, direction="INVERSE")
    found_lat, found_lon, found_height = datum.to_geodetic(*enu)
    assert np.abs(found_lat - lat).max() < 1e-9
    d_lon = (found_lon - lon + 180.0) % 360.0 - 180.0  # a metre is many degrees at a pole
    assert np.abs(d_lon * np.cos(np.radians(lat))).max() < 1e-9
    assert np.abs(found_height - height).max() < 1e-6
    assert np.abs(np.array(datum.to_enu(found_lat, found_lon, found_height)) - enu).max() < 1e-6


def test_a_published_example() -> None:
    lat, lon = 53 + 48 / 60 + 33.82 / 3600, 2 + 7 / 60 + 46.38 / 3600
    found = Datum(55.0, 5.0, 200.0).to_enu(lat, lon, 73.0)
    assert np.array(found) == pytest.approx([-189013.869, -128642.040, -4220.171], abs=5e-4)


def test_east_north_up_are_what_they_are_called() -> None:
    lat, lon, height = REQUENA.to_geodetic([100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 100.0])
    assert lon[0] > -1.1
    assert lat[1] > 39.5
    assert height[2] == pytest.approx(800.0)


@given(st.floats(-90.0, 90.0), st.floats(-179.9, 179.9), st.floats(-1000.0, 10_000.0))
def test_ecef_round_trip(lat_deg: float, lon_deg: float, height_m: float) -> None:
    found = ecef_to_geodetic(*geodetic_to_ecef(lat_deg, lon_deg, height_m))
    again = np.array(geodetic_to_ecef(*found))
    assert np.abs(again - np.array(geodetic_to_ecef(lat_deg, lon_deg, height_m))).max() < 1e-8
    assert abs(float(found[0]) - lat_deg) < 1e-9
    assert abs(float(found[2]) - height_m) < 1e-7


def test_shapes_broadcast() -> None:
    east, _, up = REQUENA.to_enu(np.full((3, 1), 39.5), np.full(2, -1.1), 700.0)
    assert east.shape == up.shape == (3, 2)
    assert np.abs(up).max() < 1e-9


@pytest.mark.parametrize("version", ["proj4", "WKT1_GDAL", "WKT2_2019"])
@pytest.mark.parametrize(("distance_m", "limit_mm"), [(200, 0.05), (2000, 0.55), (5000, 2.2)])
def test_the_reference_system_stands_for_the_plane(
    version: str, distance_m: float, limit_mm: float
) -> None:
    crs = (
        CRS.from_proj4(REQUENA.crs_proj4())
        if version == "proj4"
        else CRS.from_wkt(REQUENA.crs_wkt(version))
    )
    bearing = np.radians(np.arange(0.0, 360.0, 15.0))
    lat, lon, height = REQUENA.to_geodetic(
        distance_m * np.sin(bearing), distance_m * np.cos(bearing), np.zeros(bearing.size)
    )
    east, north, _ = REQUENA.to_enu(lat, lon, height)
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    assert 1000.0 * np.hypot(x - east, y - north).max() < limit_mm


def test_a_transverse_mercator_without_the_scale_would_be_off() -> None:
    lat, lon, _ = REQUENA.to_geodetic(2000.0, 0.0, 0.0)
    plain = CRS.from_proj4("+proj=tmerc +lat_0=39.5 +lon_0=-1.1 +k_0=1 +datum=WGS84")
    x, _ = Transformer.from_crs("EPSG:4326", plain, always_xy=True).transform(
        float(lon), float(lat)
    )
    assert abs(x - 2000.0) > 0.2
    assert REQUENA.tangent_scale() == pytest.approx(1.0 + 700.0 / 6_371_000.0, abs=1e-6)


def test_the_reference_system_names_its_datum() -> None:
    crs = CRS.from_wkt(Datum(39.123456789, -1.25, 700.125).crs_wkt())
    assert "39.123456789" in crs.name
    assert "-1.25" in crs.name
    assert "700.125" in crs.name


@pytest.mark.parametrize(
    ("lat", "lon", "height", "quoted"),
    [
        (90.5, 0.0, 0.0, "90.5"),
        (0.0, -180.5, 0.0, "-180.5"),
        (0.0, 0.0, 12_345.0, "12345"),
        (0.0, 0.0, -1500.0, "-1500"),
        (math.nan, 0.0, 0.0, "nan"),
        (0.0, 0.0, math.inf, "inf"),
    ],
)
def test_a_datum_that_cannot_be_is_refused(
    lat: float, lon: float, height: float, quoted: str
) -> None:
    with pytest.raises(DatumError, match=quoted) as caught:
        Datum(lat, lon, height)
    assert isinstance(caught.value, FieldgridError)
    assert isinstance(caught.value, ValueError)


def test_a_datum_does_not_change() -> None:
    with pytest.raises(AttributeError):
        REQUENA.lat_deg = 0.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("epsg", "lat_deg", "lon_deg"),
    [(25830, 41.6, -4.7), (32631, 41.6, -4.7), (4326, -80.0, 179.9), (3857, 41.6, -4.7),
     (2193, -41.0, 174.0), (2193, -41.0, -179.0), (32601, 60.0, 179.0)],
)  # fmt: skip
def test_a_reference_system_of_this_part_of_the_earth(
    epsg: int, lat_deg: float, lon_deg: float
) -> None:
    check_area_of_use(epsg, Datum(lat_deg, lon_deg, 0.0))


@pytest.mark.parametrize(
    ("epsg", "lat_deg", "lon_deg"),
    [(2193, 41.6, -4.7), (3031, 41.6, -4.7), (25830, 41.6, 25.0), (32601, 60.0, 0.0)],
)
def test_a_reference_system_of_another_part(epsg: int, lat_deg: float, lon_deg: float) -> None:
    with pytest.raises(ConfigError, match=f"EPSG:{epsg} .* is made for .*; choose a system"):
        check_area_of_use(epsg, Datum(lat_deg, lon_deg, 0.0))


def test_a_reference_system_is_known_in_other_words() -> None:
    datum = Datum(39.407121234, -1.219356789, 702.417)
    assert datum.is_crs_wkt(datum.crs_wkt("WKT2_2019"))
    assert datum.is_crs_wkt(datum.crs_wkt().replace("fieldgrid LTP", "another name"))
    assert not datum.is_crs_wkt(Datum(39.407121235, -1.219356789, 702.417).crs_wkt())
    assert not datum.is_crs_wkt(Datum(39.407121234, -1.219356789, 702.918).crs_wkt())
    assert not datum.is_crs_wkt("PROJCS[")


def test_a_plane_of_fewer_parameters_is_another() -> None:
    datum = Datum(39.407121234, -1.219356789, 702.417)
    text = datum.crs_wkt()
    lost = re.sub(r'PARAMETER\["false_easting",[^]]*\],?', "", text)
    assert lost != text
    assert not datum.is_crs_wkt(lost)
