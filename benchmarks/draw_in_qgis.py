"""What Debian's GDAL reads of a GeoTIFF, and what QGIS draws of it; run by the system's Python.

Standard input is a JSON object: `raster` and `vector`, the files; `point`, its latitude and
longitude; `boxes`, what is drawn (west, south, east, north in the map's plane); `folder`. In the
folder come `gdal.npz` and a picture for each box. Standard output is a JSON object.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

import numpy as np
from osgeo import gdal, osr
from qgis.core import (
    Qgis,
    QgsApplication,
    QgsContrastEnhancement,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsFillSymbol,
    QgsLineSymbol,
    QgsMapRendererSequentialJob,
    QgsMapSettings,
    QgsPointXY,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsSingleBandGrayRenderer,
    QgsSingleSymbolRenderer,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

SIDE_PX = 900

OUTLINE, DRIVE = "#e07b00", "#1f4e9c"


def read_by_gdal(path: str, lat_lon: list[float], folder: str) -> dict[str, Any]:
    gdal.UseExceptions()
    dataset = gdal.Open(path)
    values, alpha = (dataset.GetRasterBand(k).ReadAsArray() for k in (1, 2))
    np.savez(f"{folder}/gdal.npz", values=values, alpha=alpha)
    plane = osr.SpatialReference(wkt=dataset.GetProjection())
    plane.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    earth = osr.SpatialReference()
    earth.ImportFromEPSG(4326)  # latitude first
    place = osr.CoordinateTransformation(earth, plane).TransformPoint(*lat_lon)
    return {
        "version": gdal.__version__,
        "transform": dataset.GetGeoTransform(),
        "place": place[:2],
    }


def draw_in_qgis(asked: dict[str, Any]) -> dict[str, Any]:
    cells = QgsRasterLayer(asked["raster"], "density", "gdal")
    renderer = QgsSingleBandGrayRenderer(cells.dataProvider(), 1)
    renderer.setGradient(QgsSingleBandGrayRenderer.WhiteToBlack)
    stretch = QgsContrastEnhancement(Qgis.Byte)
    stretch.setContrastEnhancementAlgorithm(QgsContrastEnhancement.StretchToMinimumMaximum)
    stretch.setMinimumValue(0)
    stretch.setMaximumValue(255)
    renderer.setContrastEnhancement(stretch)
    renderer.setAlphaBand(2)
    cells.setRenderer(renderer)
    obstacles = _lines(asked["vector"], "obstacle", OUTLINE)
    drive = _lines(asked["vector"], "trajectory", DRIVE)
    pictures = []
    for number, box in enumerate(asked["boxes"]):
        settings = QgsMapSettings()
        settings.setLayers([drive, obstacles, cells])
        settings.setDestinationCrs(cells.crs())
        settings.setBackgroundColor(QColor(asked["background"]))
        width = round(SIDE_PX * (box[2] - box[0]) / (box[3] - box[1]))
        settings.setFlag(QgsMapSettings.Antialiasing)
        settings.setOutputSize(QSize(width, SIDE_PX))
        settings.setExtent(QgsRectangle(*box))
        job = QgsMapRendererSequentialJob(settings)
        job.start()
        job.waitForFinished()
        drawn = settings.visibleExtent()
        path = f"{asked['folder']}/qgis{number}.png"
        job.renderedImage().save(path)
        edges = (drawn.xMinimum(), drawn.xMaximum(), drawn.yMinimum(), drawn.yMaximum())
        pictures.append({"path": path, "extent": edges})
    earth = QgsCoordinateReferenceSystem("EPSG:4326")
    to_map = QgsCoordinateTransform(earth, cells.crs(), QgsProject.instance())
    lat, lon = asked["point"]
    place = to_map.transform(QgsPointXY(lon, lat))
    value, _ = cells.dataProvider().sample(place, 1)
    return {
        "version": Qgis.QGIS_VERSION.split("-")[0],
        "place": [place.x(), place.y()],
        "value": value,
        "pictures": pictures,
    }


def _lines(path: str, name: str, colour: str) -> Any:
    layer = QgsVectorLayer(f"{path}|layername={name}", name, "ogr")
    symbol: Any = QgsLineSymbol.createSimple({"color": colour, "width": "0.7"})
    if name == "obstacle":
        symbol = QgsFillSymbol.createSimple(
            {"style": "no", "outline_color": colour, "outline_width": "0.5"}
        )
    layer.setRenderer(QgsSingleSymbolRenderer(symbol))
    return layer


def main() -> None:
    asked = json.load(sys.stdin)
    application = QgsApplication([], False)
    application.initQgis()
    found = {
        "gdal": read_by_gdal(asked["raster"], asked["point"], asked["folder"]),
        "qgis": draw_in_qgis(asked),
    }
    print(json.dumps(found))
    sys.stdout.flush()
    os._exit(0)  # QGIS may crash when it is taken down in the wrong order


if __name__ == "__main__":
    main()
