"""Features with a geometry, and the files that other programs take them from.

A feature is a shapely geometry in metres east and north of a datum, with properties. GeoJSON and
KML are in longitude and latitude, CSV, GeoPackage and DXF in the metres of the datum's plane.
"""

from __future__ import annotations

import csv
import json
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import (
    AnyArray,
    ConfigError,
    Float64,
    MapWriteError,
    check_document,
    file_bytes,
    made_elsewhere,
    mentions,
    palette,
    printable,
    replacing,
    working_beside,
)
from fieldgrid.geometry.geodesy import Datum
from fieldgrid.geometry.lon_lat import DECIMALS, in_degrees

_KML = "http://www.opengis.net/kml/2.2"


class Feature(NamedTuple):
    """One feature: its kind, which is also its layer, a shapely geometry, and its properties.

    A property is a string, a number (NaN for one that is not known), a truth value, or a list of
    strings.
    """

    kind: str
    geometry: Any
    properties: Mapping[str, Any]


def write_features(
    path: Path, features: Sequence[Feature], datum: Datum, *, overwrite: bool = False
) -> None:
    """Write features in the format that the path ends in.

    Raises ConfigError for another ending or a library that is not installed, MapExistsError for a
    file that may not be overwritten, MapWriteError when it cannot be written.
    """
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ConfigError(f"{path.name} ends in none of {', '.join(_WRITERS)}; choose one of them.")
    writer(path, features, datum, overwrite)


def geojson(features: Sequence[Feature], datum: Datum) -> dict[str, Any]:
    """A FeatureCollection as RFC 7946 has it: longitude, latitude, nine decimals, the datum
    beside it as a foreign member."""
    import shapely

    return {
        "type": "FeatureCollection",
        "datum": {
            "lat_deg": datum.lat_deg, "lon_deg": datum.lon_deg, "height_m": datum.height_m,
        },
        "features": [
            {
                "type": "Feature",
                "properties": {"kind": f.kind, **plain_properties(f)},
                # RFC 7946: outer rings run counter-clockwise.
                "geometry": json.loads(
                    shapely.to_geojson(shapely.orient_polygons(in_degrees(f.geometry, datum)))
                ),
            }
            for f in features
        ],
    }  # fmt: skip


def plain_properties(feature: Feature) -> dict[str, Any]:
    """The properties as JSON has them: null for what is not known, lists for tuples."""
    return {key: _plain(value, key) for key, value in feature.properties.items()}


def read_shapes(path: Path, datum: Datum) -> list[Any]:
    """The geometries of a GeoJSON in longitude and latitude, in the datum's plane; of a CSV with
    the columns east_m and north_m one line through its points.

    Raises ConfigError for a file that is neither, or is too large.
    """
    import shapely

    def turned(degrees: Float64) -> Float64:
        if (np.abs(degrees) > [180.0, 90.0]).any():
            raise ConfigError(f"{path} is not in longitude and latitude, as GeoJSON asks.")
        east_m, north_m, _ = datum.to_enu(degrees[:, 1], degrees[:, 0], datum.height_m)
        return np.column_stack([east_m, north_m])

    try:
        check_document(file_bytes(path), path, ConfigError)
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix.lower() == ".csv":
            rows = [(row["east_m"], row["north_m"]) for row in csv.DictReader(text.splitlines())]
            return [shapely.LineString(np.array(rows, dtype=np.float64))]
        found = shapely.get_parts(shapely.force_2d(shapely.from_geojson(text))).tolist()
        return [shapely.transform(shape, turned) for shape in found]
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror}); check its name.") from error
    except (ValueError, KeyError, csv.Error, shapely.errors.ShapelyError) as error:
        raise ConfigError(
            f"{path} is no GeoJSON in longitude and latitude, nor a CSV with the columns east_m "
            f"and north_m ({error})."
        ) from error


def _plain(value: Any, key: str = "") -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        digits = DECIMALS if key in ("lat_deg", "lon_deg") else 4
        return round(value, digits) if math.isfinite(value) else None
    return list(value) if isinstance(value, tuple) else value


def _write_geojson(path: Path, features: Sequence[Feature], datum: Datum, overwrite: bool) -> None:
    with _replacing(path, overwrite) as file:
        file.write_text(json.dumps(geojson(features, datum), allow_nan=False), encoding="utf-8")


def _write_csv(path: Path, features: Sequence[Feature], datum: Datum, overwrite: bool) -> None:
    import shapely

    columns = ["kind", *_columns(features), "wkt_m"]
    with _replacing(path, overwrite) as file, file.open("w", newline="") as table:
        writer = csv.DictWriter(table, columns, restval="")
        writer.writeheader()
        for feature in features:
            row = {k: _text(v, k) for k, v in feature.properties.items()}
            wkt = shapely.to_wkt(feature.geometry, rounding_precision=3)
            writer.writerow({"kind": feature.kind, **row, "wkt_m": wkt})


def _columns(features: Sequence[Feature]) -> list[str]:
    return list(dict.fromkeys(key for f in features for key in f.properties))


def _text(value: Any, key: str = "") -> Any:
    plain = _plain(value, key)
    if isinstance(plain, list):
        return " ".join(str(one) for one in plain)
    return "" if plain is None else plain


def _write_kml(path: Path, features: Sequence[Feature], datum: Datum, overwrite: bool) -> None:
    root = ElementTree.Element("kml", xmlns=_KML)
    document = ElementTree.SubElement(root, "Document", id="fieldgrid")
    ElementTree.SubElement(document, "name").text = printable(path.stem)
    add_placemarks(document, features, datum)
    with _replacing(path, overwrite) as file:
        ElementTree.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)


def add_placemarks(
    document: ElementTree.Element, features: Sequence[Feature], datum: Datum
) -> None:
    """Add features to a document of KML: a style and a folder for each kind."""
    kinds = list(dict.fromkeys(f.kind for f in features))
    for kind in kinds:
        style = ElementTree.SubElement(document, "Style", id=kind)
        line = ElementTree.SubElement(style, "LineStyle")
        colour = palette.FEATURES.get(kind, palette.OTHER)
        ElementTree.SubElement(line, "color").text = palette.kml(colour)
        ElementTree.SubElement(line, "width").text = "2"
        fill = ElementTree.SubElement(style, "PolyStyle")
        ElementTree.SubElement(fill, "color").text = palette.kml(colour, "40")
    for kind in kinds:
        folder = ElementTree.SubElement(document, "Folder")
        ElementTree.SubElement(folder, "name").text = kind
        for feature in features:
            if feature.kind == kind:
                _placemark(folder, feature, datum)


def _placemark(folder: ElementTree.Element, feature: Feature, datum: Datum) -> None:
    mark = ElementTree.SubElement(folder, "Placemark")
    name = feature.properties.get("name") or feature.properties.get("id", "")
    ElementTree.SubElement(mark, "name").text = printable(str(name))
    ElementTree.SubElement(mark, "styleUrl").text = f"#{feature.kind}"
    extended = ElementTree.SubElement(mark, "ExtendedData")
    for key, value in feature.properties.items():
        data = ElementTree.SubElement(extended, "Data", name=key)
        ElementTree.SubElement(data, "value").text = printable(str(_text(value, key)))
    shape = in_degrees(feature.geometry, datum)
    parts = list(getattr(shape, "geoms", [shape]))
    holder = mark if len(parts) == 1 else ElementTree.SubElement(mark, "MultiGeometry")
    for part in parts:
        if part.geom_type == "Polygon":
            polygon = ElementTree.SubElement(holder, "Polygon")
            for ring, tag in ((part.exterior, "outerBoundaryIs"),
                              *((r, "innerBoundaryIs") for r in part.interiors)):  # fmt: skip
                boundary = ElementTree.SubElement(polygon, tag)
                _coordinates(ElementTree.SubElement(boundary, "LinearRing"), ring)
        else:
            line = ElementTree.SubElement(holder, part.geom_type)
            ElementTree.SubElement(line, "tessellate").text = "1"
            _coordinates(line, part)


def _coordinates(parent: ElementTree.Element, line: Any) -> None:
    text = " ".join(f"{lon:.9f},{lat:.9f}" for lon, lat in line.coords)
    ElementTree.SubElement(parent, "coordinates").text = text


def _write_gpkg(path: Path, features: Sequence[Feature], datum: Datum, overwrite: bool) -> None:
    if not features:
        raise ConfigError(
            f"There is nothing to write to {path.name}, and a GeoPackage needs a feature; "
            "write .geojson instead."
        )
    with (
        _replacing(path, overwrite) as file,
        made_elsewhere(file, "features.gpkg") as written,
    ):
        for kind in dict.fromkeys(f.kind for f in features):
            _by_gdal(
                written, path, [f for f in features if f.kind == kind], kind, "GPKG", datum,
                append=written.exists(), dataset_options={"VERSION": "1.3"},
                layer_options={"DESCRIPTION": "found by fieldgrid"},
            )  # fmt: skip


def _write_dxf(path: Path, features: Sequence[Feature], datum: Datum, overwrite: bool) -> None:
    with (
        _replacing(path, overwrite) as file,
        working_beside(file) as folder,
    ):
        written = Path(folder) / "features.dxf"
        # The driver knows these two columns, and draws outlines of areas.
        outlines = [
            Feature(
                "entities",
                f.geometry.boundary if f.geometry.geom_type.endswith("Polygon") else f.geometry,
                {"Layer": f.kind, "Text": str(f.properties.get("id", ""))},
            )
            for f in features
        ]
        _by_gdal(written, path, outlines, "entities", "DXF", datum)
        # A comment, by which the file is known as ours; a drawing has no system of coordinates.
        about = f"999\nfound by fieldgrid, metres from the datum {datum.described()}\n"
        file.write_bytes(about.encode() + written.read_bytes())


def _by_gdal(
    file: Path, target: Path, features: Sequence[Feature], layer: str, driver: str, datum: Datum,
    **options: Any,
) -> None:  # fmt: skip
    kinds = {f.geometry.geom_type for f in features}
    found = FeatureLayer(
        layer,
        kinds.pop() if len(kinds) == 1 else "Unknown",
        np.array([f.geometry for f in features], dtype=object),
        {
            name: _column([_plain(f.properties.get(name), name) for f in features])
            for name in _columns(features)
        },
    )
    write_layer(file, target, found, driver, datum.crs_wkt("WKT1_GDAL"), **options)


class FeatureLayer(NamedTuple):
    """Features of one kind, metres east and north: shapely's geometries [n], whose type may be
    Unknown, and their attributes [n] by name; masked where nothing is known."""

    name: str
    geometry_type: str
    geometry: npt.NDArray[np.object_]
    columns: dict[str, AnyArray]


_DROPPED = frozenset("\t\r\n")
"""What pyogrio takes out of a path, as of an address."""


def write_layer(
    file: Path | BytesIO, target: Path, layer: FeatureLayer, driver: str, crs: str, **options: Any
) -> None:
    """Write a layer by GDAL.

    Raises MapWriteError, which names the target, when that fails; ConfigError without pyogrio.
    """
    import shapely

    try:
        from pyogrio.errors import DataLayerError, DataSourceError
        from pyogrio.raw import write
    except ImportError as error:
        raise ConfigError(
            f"Writing {target.suffix} needs pyogrio, which is not installed; "
            "run: pip install 'fieldgrid[gis]'"
        ) from error
    if isinstance(file, Path) and _DROPPED & set(str(file)):
        # It would be written elsewhere, and what is left here be empty.
        raise MapWriteError(
            f"{target} was not written: GDAL cannot write a path with a line break or a tab in it; "
            "give another name or folder."
        )
    values = list(layer.columns.values())
    try:
        write(
            file,
            geometry=shapely.to_wkb(layer.geometry),
            field_data=[np.ma.getdata(column) for column in values],
            field_mask=[
                np.ma.getmaskarray(column) if np.ma.isMaskedArray(column) else None
                for column in values
            ],
            fields=list(layer.columns),
            layer=layer.name,
            driver=driver,
            geometry_type=layer.geometry_type,
            crs=crs,
            encoding="UTF-8",
            **options,
        )
    except (DataSourceError, DataLayerError, RuntimeError) as error:
        why = str(error).replace(str(file), target.name)  # the draft's name says nothing
        raise MapWriteError(
            f"{target} could not be written ({why}); check the space on the disk."
        ) from error


def _column(values: list[Any]) -> AnyArray:
    """A column as GDAL takes it, masked where values are missing."""
    missing = np.array([v is None for v in values], dtype=np.bool_)
    known = [v for v in values if v is not None]
    column: AnyArray
    if known and all(isinstance(v, bool) for v in known):
        column = np.array([bool(v) for v in values])
    elif known and all(isinstance(v, int | float) for v in known):
        dtype = np.int64 if all(isinstance(v, int) for v in known) else np.float64
        column = np.array([0 if v is None else v for v in values], dtype=dtype)
    else:
        column = np.array(["" if v is None else str(_text(v)) for v in values], dtype=object)
    return np.ma.MaskedArray(column, missing) if missing.any() else column


def _replacing(path: Path, overwrite: bool) -> AbstractContextManager[Path]:
    """A file in the place of `path`; of older ones only those that were written here go."""
    ending = path.suffix.lower()
    return replacing(
        path,
        overwrite=overwrite,
        ours=partial(mentions, mark=_MARKS[ending]),
        what=f"features in a {ending}",
    )


_MARKS = {
    ".geojson": b'"datum": {"lat_deg"',
    ".json": b'"datum": {"lat_deg"',
    ".csv": b"wkt_m",
    ".kml": b'id="fieldgrid"',
    ".gpkg": b"found by fieldgrid",
    ".dxf": b"found by fieldgrid",
}
"""What a file of each ending holds that was written here."""

_WRITERS: dict[str, Callable[[Path, Sequence[Feature], Datum, bool], None]] = {
    ".geojson": _write_geojson,
    ".json": _write_geojson,
    ".csv": _write_csv,
    ".kml": _write_kml,
    ".gpkg": _write_gpkg,
    ".dxf": _write_dxf,
}
"""By the ending of a path."""

FEATURE_SUFFIXES = tuple(_WRITERS)
"""What the name of a file of features may end in."""
