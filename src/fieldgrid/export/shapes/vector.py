"""A map's features for any GIS: GeoJSON, GeoPackage, Shapefile, FlatGeobuf and DXF.

GeoJSON is in longitude and latitude as RFC 7946 asks, the others are in the map's own plane. All
are written by GDAL.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial, wraps
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import (
    AnyArray,
    Flag,
    made_elsewhere,
    mentions,
    replacing,
    replacing_folder,
    setting,
    working_beside,
)
from fieldgrid.export.options import QuadtreeOptions, ShapeOptions
from fieldgrid.export.registry import (
    Exported,
    ExportFormat,
    Holds,
    Writer,
    register_export_format,
    require,
)
from fieldgrid.export.shapes.features import LAYERS, feature_layers
from fieldgrid.export.together import is_zip
from fieldgrid.geometry import Datum, Feature, FeatureLayer, in_degrees, write_features, write_layer
from fieldgrid.maps import MapFile, Selection

_FLATGEOBUF = "features of a map of fieldgrid"
"""What a FlatGeobuf says that it is."""

_SHAPEFILE_NAMES = {
    "mean_density": "mean_dens",
    "min_density": "min_dens",
    "max_density": "max_dens",
    "heading_deg": "head_deg",
    "heading_sigma_deg": "head_sig",
    "position_sigma_m": "pos_sig_m",
}
"""Names of columns in a shapefile, which has ten letters for one."""
_SHAPEFILE_BYTES = 254
"""Of a text in UTF-8."""


class FeatureOptions(ShapeOptions, QuadtreeOptions):
    """Which features, how obstacles become polygons, and cells squares."""

    features: str | None = setting(
        None,
        "kinds of features: obstacle, trajectory, pose, footprint, quadtree",
        usual="all but quadtree",
        flag=Flag("--features", "A,B"),
    )


def _of_layers(write: Callable[[Sequence[FeatureLayer], Path, Datum, bool], None]) -> Writer:
    """What exports a selection as features, by what writes their layers to a path."""

    @wraps(write)
    def export(
        universal: MapFile,
        path: Path,
        selection: Selection,
        options: FeatureOptions,
        /,
        *,
        overwrite: bool,
    ) -> Exported:
        layers = _layers(universal, selection, options)
        write(layers, path, universal.datum, overwrite)
        counts = {layer.name: len(layer.geometry) for layer in layers}
        return Exported(
            (path,),
            tuple((f"features in {name}", str(count)) for name, count in counts.items()),
            {"features": counts},
        )

    return export


@_of_layers
def _export_geojson(
    layers: Sequence[FeatureLayer], path: Path, datum: Datum, overwrite: bool
) -> None:
    """Write one FeatureCollection in WGS84, nine decimals; the property `layer` tells features of
    different kinds apart."""
    ours = partial(mentions, mark=b'"name": "fieldgrid"')
    with replacing(path, overwrite=overwrite, ours=ours, what="a GeoJSON") as file:
        _write_geojson(file, path, layers, datum)


def geojson_text(
    universal: MapFile, target: Path, selection: Selection, options: FeatureOptions
) -> str:
    """The features of a selection as the text of a GeoJSON, for a message in `target`."""
    text = BytesIO()
    _write_geojson(text, target, _layers(universal, selection, options), universal.datum)
    return text.getvalue().decode()


def _write_geojson(
    file: Path | BytesIO, target: Path, layers: Sequence[FeatureLayer], datum: Datum
) -> None:
    merged = _merged(
        [layer._replace(geometry=in_degrees(layer.geometry, datum)) for layer in layers]
    )
    write_layer(
        file, target, merged, "GeoJSON", "EPSG:4326", RFC7946="YES", COORDINATE_PRECISION="9"
    )


@_of_layers
def _export_geopackage(
    layers: Sequence[FeatureLayer], path: Path, datum: Datum, overwrite: bool
) -> None:
    """Write a GeoPackage with a layer for each kind of feature."""
    ours = partial(mentions, mark=b"FIELDGRID_DATUM_LAT_DEG")
    tags = {
        "FIELDGRID_DATUM_LAT_DEG": repr(float(datum.lat_deg)),
        "FIELDGRID_DATUM_LON_DEG": repr(float(datum.lon_deg)),
        "FIELDGRID_DATUM_HEIGHT_M": repr(float(datum.height_m)),
    }
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="a GeoPackage") as file,
        # GDAL takes no empty file for a GeoPackage.
        made_elsewhere(file, "features.gpkg") as written,
    ):
        for layer in layers:
            write_layer(
                written,
                path,
                layer,
                "GPKG",
                datum.crs_wkt("WKT1_GDAL"),
                append=written.exists(),
                dataset_metadata=tags,
                # GDAL 3.6, of Debian stable, warns of newer versions.
                dataset_options={"VERSION": "1.3"},
            )


@_of_layers
def _export_flatgeobuf(
    layers: Sequence[FeatureLayer], path: Path, datum: Datum, overwrite: bool
) -> None:
    """Write one FlatGeobuf with a spatial index; the property `layer` tells features of different
    kinds apart."""
    ours = partial(mentions, mark=_FLATGEOBUF.encode())
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="a FlatGeobuf") as file,
        made_elsewhere(file, "features.fgb") as written,
    ):
        write_layer(
            written,
            path,
            _merged(layers),
            "FlatGeobuf",
            datum.crs_wkt("WKT1_GDAL"),
            layer_options={"DESCRIPTION": _FLATGEOBUF},
        )


@_of_layers
def _export_dxf(layers: Sequence[FeatureLayer], path: Path, datum: Datum, overwrite: bool) -> None:
    """Write a DXF drawing in metres east and north: a layer for each kind of feature, outlines of
    areas, no attributes."""
    write_features(
        path,
        [Feature(layer.name, shape, {}) for layer in layers for shape in layer.geometry],
        datum,
        overwrite=overwrite,
    )


@_of_layers
def _export_shapefile(
    layers: Sequence[FeatureLayer], path: Path, datum: Datum, overwrite: bool
) -> None:
    """Write a shapefile for each kind of feature: zipped into one file, which GDAL and QGIS open,
    when `path` ends in .zip, else into a folder. Names of columns are cut to ten letters."""
    if path.suffix.lower() != ".zip":
        with replacing_folder(
            path,
            overwrite=overwrite,
            ours=lambda folder: _are_shapefiles(os.listdir(folder)),
            what="exported shapefiles",
        ) as draft:
            _write_shapefiles(draft, path, layers, datum)
        return
    ours = partial(is_zip, check=lambda archive: _are_shapefiles(archive.namelist()))
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="a zip") as file,
        working_beside(file) as folder,
    ):
        _write_shapefiles(folder, path, layers, datum)
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for part in sorted(folder.iterdir()):
                archive.write(part, part.name)


def _write_shapefiles(
    folder: Path, target: Path, layers: Sequence[FeatureLayer], datum: Datum
) -> None:
    for layer in (part for whole in layers for part in _by_type(whole)):
        write_layer(
            folder / f"{layer.name}.shp",
            target,
            layer._replace(
                columns={
                    _SHAPEFILE_NAMES.get(key, key): _cut(v) for key, v in layer.columns.items()
                }
            ),
            "ESRI Shapefile",
            datum.crs_wkt("WKT1_GDAL"),
        )


def _cut(column: AnyArray) -> AnyArray:
    """Texts as long as a shapefile can hold them, which GDAL would cut with a warning for each."""
    if column.dtype != object:
        return column
    cut = column.copy()
    for k, text in enumerate(np.ma.getdata(column)):
        if isinstance(text, str):
            cut[k] = text.encode()[:_SHAPEFILE_BYTES].decode(errors="ignore")
    return cut


def _by_type(layer: FeatureLayer) -> Iterator[FeatureLayer]:
    """A layer of one type of geometry, which is all that a shapefile can hold, or two of them."""
    import shapely

    if layer.geometry_type != "Unknown":
        yield layer
        return
    points = shapely.get_dimensions(layer.geometry) == 0
    for name, kind, rows in (
        (layer.name, "Polygon", ~points), (f"{layer.name}_point", "Point", points)
    ):  # fmt: skip
        yield FeatureLayer(
            name,
            kind,
            layer.geometry[rows],
            {key: values[rows] for key, values in layer.columns.items()},
        )


def _are_shapefiles(names: Iterable[str]) -> bool:
    endings = {".shp", ".shx", ".dbf", ".prj", ".cpg"}
    # Shapefiles of other names are somebody's own.
    return all(
        path.stem in (*LAYERS, "mark_point") and path.suffix in endings for path in map(Path, names)
    )


def _layers(
    universal: MapFile, selection: Selection, options: FeatureOptions
) -> list[FeatureLayer]:
    """The layers that the options ask for. ConfigError for a name that is none, and when pyogrio is
    not installed."""
    require("Writing features", "gis", "pyogrio", "shapely")
    left_out = {"quadtree"} if universal.marks() else {"quadtree", "mark"}
    usual = ",".join(name for name in LAYERS if name not in left_out)
    names = tuple(name.strip() for name in (options.features or usual).split(","))
    return feature_layers(universal, selection, options, names, options)


def _merged(layers: Sequence[FeatureLayer]) -> FeatureLayer:
    """Features of all layers as one, which says of each where it is from."""
    sizes = [len(layer.geometry) for layer in layers]
    names = np.repeat(np.array([layer.name for layer in layers], dtype=np.object_), sizes)
    columns: dict[str, AnyArray] = {"layer": names}
    for key in dict.fromkeys(key for layer in layers for key in layer.columns):
        dtype = next(layer.columns[key].dtype for layer in layers if key in layer.columns)
        parts = [
            layer.columns.get(key, np.ma.MaskedArray(np.zeros(size, dtype), mask=True))
            for layer, size in zip(layers, sizes, strict=True)
        ]
        columns[key] = np.ma.MaskedArray(
            np.concatenate([np.ma.getdata(part) for part in parts]),
            np.concatenate([np.ma.getmaskarray(part) for part in parts]),
        )
    return FeatureLayer(
        "fieldgrid", "Unknown", np.concatenate([layer.geometry for layer in layers]), columns
    )


_SHARED: Any = {
    "options": FeatureOptions,
    "holds": Holds.SHAPES,
    "extras": ("gis",),
    "limits": "5·10^7 obstacle cells",
}

register_export_format(
    ExportFormat(
        "geojson",
        (".geojson", ".json"),
        "obstacles, marks, drives, poses in WGS84",
        _export_geojson,
        readers="GIS, web maps",
        **_SHARED,
    ),
    ExportFormat(
        "gpkg",
        (".gpkg",),
        "the same, GeoPackage in the map's plane",
        _export_geopackage,
        readers="GIS",
        **_SHARED,
    ),
    ExportFormat(
        "flatgeobuf",
        (".fgb",),
        "the same as one FlatGeobuf, with an index",
        _export_flatgeobuf,
        readers="GIS, web maps",
        **_SHARED,
    ),
    ExportFormat(
        "dxf",
        (".dxf",),
        "the same as a drawing, without attributes",
        _export_dxf,
        readers="CAD",
        **_SHARED,
    ),
    ExportFormat(
        "shapefile",
        (".shp.zip",),
        "the same, shapefiles in a zip or folder",
        _export_shapefile,
        readers="older GIS",
        folder=True,
        **_SHARED,
    ),
)
