"""What Debian's GDAL and QGIS find in exports; run by the system's own Python, not by ours.

Standard input is a JSON object: `points` [[lat, lon], ...] in degrees, `gdal` and `qgis`, the files
each of them reads. Standard output is one: for each reader and file, what it says at those points,
and where the poses are that it has.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

from osgeo import gdal, ogr, osr

gdal.UseExceptions()
Points = list[list[float]]


def by_gdal(path: str, points: Points) -> dict[str, Any]:
    """The value and the mask at each point, nothing outside; or the shapes of a vector file."""
    if path.endswith((".tif", ".png")):
        dataset = gdal.Open(path)
        plane = osr.SpatialReference(wkt=_system(dataset, path))
        return {"cells": _sampled(dataset, dataset.GetGeoTransform(), _into(plane, points))}
    if path.endswith(".kmz"):
        return _in_kmz(path, points)
    return _shapes_by_gdal(ogr.Open(path), points)


def _system(dataset: Any, path: str) -> str:
    """The plane of a raster; of a picture with a world file only, that of the .prj beside it."""
    if dataset.GetProjection():
        return str(dataset.GetProjection())
    system = osr.SpatialReference()
    with open(path[:-4] + ".prj", encoding="utf-8") as file:
        system.ImportFromESRI([file.read()])
    return str(system.ExportToWkt())


def _into(plane: Any, points: Points) -> Points:
    plane.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    return [list(place[:2]) for place in _from_earth(plane).TransformPoints(_lon_lat(points))]


def _from_earth(plane: Any) -> Any:
    return osr.CoordinateTransformation(_earth(), plane)


def _earth() -> Any:
    earth = osr.SpatialReference()
    earth.ImportFromEPSG(4326)
    earth.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    return earth


def _lon_lat(points: Points) -> Points:
    return [[lon, lat] for lat, lon in points]


def _sampled(dataset: Any, placed: Any, places: Points) -> list[list[int] | None]:
    back = gdal.InvGeoTransform(placed)
    values = dataset.GetRasterBand(1).ReadAsArray()
    alpha = dataset.GetRasterBand(dataset.RasterCount).ReadAsArray()
    found: list[list[int] | None] = []
    for place in places:
        column, row = (int(v // 1) for v in gdal.ApplyGeoTransform(back, *place))
        inside = 0 <= column < dataset.RasterXSize and 0 <= row < dataset.RasterYSize
        found.append([int(values[row, column]), int(alpha[row, column])] if inside else None)
    return found


def _in_kmz(path: str, points: Points) -> dict[str, Any]:
    """The picture by the corners that its overlay has, and the first drive."""
    folders = ogr.Open(path)
    overlay, drive = (  # the layers' features, which own their geometries
        folders.GetLayerByName(name).GetNextFeature() for name in ("density", "drives")
    )
    corners = overlay.geometry().GetGeometryRef(0)
    picture = gdal.Open(f"/vsizip/{path}/pictures/00.png")
    width, height = picture.RasterXSize, picture.RasterYSize
    # The quad begins in the lower left and goes counter-clockwise.
    pixels = ((0, height), (width, height), (width, 0), (0, 0))
    controls = [
        gdal.GCP(*corners.GetPoint(k)[:2], 0.0, column, row)
        for k, (column, row) in enumerate(pixels)
    ]
    return {
        "cells": _sampled(picture, gdal.GCPsToGeoTransform(controls), _lon_lat(points)),
        "poses": [[lat, lon] for lon, lat, *_ in drive.geometry().GetPoints()],
    }


def _shapes_by_gdal(source: Any, points: Points) -> dict[str, Any]:
    layers = {
        source.GetLayer(k).GetName(): source.GetLayer(k) for k in range(source.GetLayerCount())
    }
    if "fieldgrid" in layers:  # a GeoJSON has one layer, and says of each feature what it is
        layer = layers["fieldgrid"]
        obstacles = [f.geometry().Clone() for f in layer if f["layer"] == "obstacle"]
        poses = [f.geometry().Clone() for f in layer if f["layer"] == "pose"]
    else:
        layer = layers["obstacle"]
        obstacles = [f.geometry().Clone() for f in layer]
        poses = [f.geometry().Clone() for f in layers["pose"]]
    plane = layer.GetSpatialRef()
    plane.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    to_earth = osr.CoordinateTransformation(plane, _earth())
    together = ogr.Geometry(ogr.wkbMultiPolygon)
    for shape in map(ogr.ForceToMultiPolygon, obstacles):
        for k in range(shape.GetGeometryCount()):
            together.AddGeometry(shape.GetGeometryRef(k))
    prepared = together.CreatePreparedGeometry()
    inside = []
    for place in _into(plane, points):
        spot = ogr.Geometry(ogr.wkbPoint)
        spot.AddPoint_2D(*place)
        inside.append(prepared.Contains(spot))
    back = [to_earth.TransformPoint(p.GetX(), p.GetY()) for p in poses if not p.IsEmpty()]
    return {"obstacle": inside, "poses": [[lat, lon] for lon, lat, _ in back]}


def by_qgis(path: str, points: Points) -> dict[str, Any]:
    """As `by_gdal`, of what QGIS makes of the file as layers."""
    if path.endswith((".tif", ".png")):
        return _cells_in_qgis(path, points)
    return _shapes_in_qgis(path, points)


def _cells_in_qgis(path: str, points: Points) -> dict[str, Any]:
    from qgis.core import QgsPointXY, QgsRaster, QgsRasterLayer

    layer = QgsRasterLayer(path, "cells", "gdal")
    assert layer.isValid()
    to_plane, found = _qgis_transform(layer.crs(), back=False), []
    for lat, lon in points:
        place = to_plane.transform(QgsPointXY(lon, lat))
        said = layer.dataProvider().identify(place, QgsRaster.IdentifyFormatValue).results()
        # Out of its extent QGIS says nothing; nor does it of what alpha says is not there.
        found.append([said[1], said[2]] if said.get(2) is not None else None)
    return {"cells": found}


def _shapes_in_qgis(path: str, points: Points) -> dict[str, Any]:
    from qgis.core import QgsGeometry, QgsPoint, QgsPointXY, QgsVectorLayer

    if path.endswith(".geojson"):
        layers = {
            name: QgsVectorLayer(f"{path}|subset=\"layer\" = '{name}'", name, "ogr")
            for name in ("obstacle", "pose")
        }
    else:
        place = f"/vsizip/{path}" if path.endswith(".zip") else path
        layers = {
            name: QgsVectorLayer(f"{place}|layername={name}", name, "ogr")
            for name in ("obstacle", "pose")
        }
    assert all(layer.isValid() for layer in layers.values())
    outlines = QgsGeometry.collectGeometry([f.geometry() for f in layers["obstacle"].getFeatures()])
    engine = QgsGeometry.createGeometryEngine(outlines.constGet())
    engine.prepareGeometry()
    to_plane = _qgis_transform(layers["obstacle"].crs(), back=False)
    spots = [to_plane.transform(QgsPointXY(lon, lat)) for lat, lon in points]
    to_earth = _qgis_transform(layers["pose"].crs(), back=True)
    back = [
        to_earth.transform(f.geometry().asPoint())
        for f in layers["pose"].getFeatures()
        if not f.geometry().isEmpty()
    ]
    return {
        "obstacle": [engine.contains(QgsPoint(spot)) for spot in spots],
        "poses": [[place.y(), place.x()] for place in back],
    }


def _qgis_transform(plane: Any, *, back: bool) -> Any:
    from qgis.core import (
        QgsCoordinateReferenceSystem,
        QgsCoordinateTransform,
        QgsProject,
    )

    earth = QgsCoordinateReferenceSystem("EPSG:4326")
    ends = (plane, earth) if back else (earth, plane)
    return QgsCoordinateTransform(*ends, QgsProject.instance())


def main() -> None:
    asked = json.load(sys.stdin)
    found = {"gdal": {path: by_gdal(path, asked["points"]) for path in asked["gdal"]}}
    if asked["qgis"]:
        from qgis.core import QgsApplication

        application = QgsApplication([], False)
        application.initQgis()
        found["qgis"] = {path: by_qgis(path, asked["points"]) for path in asked["qgis"]}
    print(json.dumps(found))
    sys.stdout.flush()
    os._exit(0)  # QGIS may crash when it is taken down in the wrong order


if __name__ == "__main__":
    main()
