"""A QGIS project of a map: its layers in order, in their colours, at its place, through its time.

The project holds no data: it refers to the map file by a path relative to its own, so the two are
moved together.
"""

from __future__ import annotations

import os
import zipfile
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

from fieldgrid.core import ConfigError, Settings, palette, quoted, replacing
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format
from fieldgrid.export.together import is_zip
from fieldgrid.geometry import Bounds, check_inside
from fieldgrid.maps import GEOMETRIES, MapFile, Selection, qgis

_MOST_BYTES = 1 << 20
"""Of a project, in which its list of layers is found."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_TITLES = {
    "density": "3D density",
    "trajectory": "trajectories",
    "frame_position": "frames",
    "footprint": "footprints",
    "mark_area": "marked areas",
    "mark_point": "marked points",
}


def export_qgz(
    universal: MapFile, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a QGIS project (.qgz) of the map; `bounds` of the selection are what it shows at first.

    Raises ConfigError for other cells or another date than the map's: QGIS reads the map itself.
    """
    if selection.cell_m is not None or selection.at is not None:
        raise ConfigError(
            "A QGIS project shows the map file as it is; leave out --cell and --at, or export a "
            "GeoTIFF."
        )
    if not str(universal.path).isprintable():
        raise ConfigError(
            f"A QGIS project cannot name {quoted(universal.path.name)}; rename the map without "
            "control characters."
        )
    bounds = selection.bounds or universal.bounds
    check_inside(bounds, universal.bounds)
    document = _document(universal, path, bounds)
    ours = partial(is_zip, check=_is_ours)
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="a QGIS project") as file,
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        archive.writestr(f"{path.stem}.qgs", document)
    names = _names(universal)
    return Exported(
        (path,),
        (
            ("layers", ", ".join(_TITLES[name] for name in names)),
            ("datum", universal.datum.described()),
            ("map", universal.path.name),
        ),
        {"layers": names},
    )


def _is_ours(archive: zipfile.ZipFile) -> bool:
    """Whether a project names the layers as this module does."""
    first = archive.open(archive.namelist()[0]).read(_MOST_BYTES)
    return f'id="{_id("trajectory")}"'.encode() in first


def _names(universal: MapFile) -> list[str]:
    """The layers of the project, from the lowest to the uppermost."""
    kinds = {mark.is_point for mark in universal.marks()}
    return [*qgis.LAYERS, *(name for name in qgis.MARKS if (qgis.MARKS[name] == "Point") in kinds)]


def _document(universal: MapFile, path: Path, bounds: Bounds) -> bytes:
    sessions = [
        (info.name, palette.session_colour(k))
        for k, info in enumerate(universal.sessions())
        if info.active
    ]
    root = Element("qgis", version=qgis.VERSION, projectname=universal.path.stem)
    ET.SubElement(root, "title").text = universal.path.stem
    ET.SubElement(root, "projectCrs").append(_system(universal))
    tree = ET.SubElement(root, "layer-tree-group")
    layers = ET.SubElement(root, "projectlayers")
    order = ET.SubElement(root, "layerorder")
    names = _names(universal)
    for name in reversed(names):  # the uppermost first
        ET.SubElement(
            tree, "layer-tree-layer", id=_id(name), name=_TITLES[name],
            checked="Qt::Checked" if name != "frame_position" else "Qt::Unchecked",
            providerKey="gdal" if name == "density" else "ogr", expanded="0",
        )  # fmt: skip
        ET.SubElement(order, "layer", id=_id(name))
    for name in names:
        layers.append(_layer(universal, path, name, sessions))
    canvas = ET.SubElement(root, "mapcanvas", name="theMapCanvas", annotationsVisible="1")
    ET.SubElement(canvas, "units").text = "meters"
    _add_extent(canvas, bounds)
    ET.SubElement(canvas, "destinationsrs").append(_system(universal))
    _add_properties(root)
    _add_time(root, universal)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}".encode()


def _layer(universal: MapFile, path: Path, name: str, sessions: list[tuple[str, str]]) -> Element:
    is_raster = name == "density"
    layer = Element("maplayer", type="raster" if is_raster else "vector")
    if not is_raster:
        layer.set("geometry", qgis.MARKS.get(name) or GEOMETRIES[name].title())
    source = _relative(universal.path, path.parent)
    table = f"mark|geometrytype={qgis.MARKS[name]}" if name in qgis.MARKS else name
    ET.SubElement(layer, "id").text = _id(name)
    ET.SubElement(layer, "datasource").text = (
        f"GPKG:{source}:{name}" if is_raster else f"{source}|layername={table}"
    )
    ET.SubElement(layer, "layername").text = _TITLES[name]
    ET.SubElement(layer, "srs").append(_system(universal))
    encoding = {} if is_raster else {"encoding": "UTF-8"}
    ET.SubElement(layer, "provider", encoding).text = "gdal" if is_raster else "ogr"
    qgis.fill_style(layer, name, sessions)
    return layer


def _id(name: str) -> str:
    """What the project calls a layer; QGIS replaces an id of ten letters or fewer."""
    return f"fieldgrid_{name}"


def _system(universal: MapFile) -> Element:
    datum = universal.datum
    system = Element("spatialrefsys")
    for tag, text in (
        ("wkt", datum.crs_wkt("WKT2_2019")),
        ("proj4", datum.crs_proj4()),
        ("geographicflag", "false"),
    ):
        ET.SubElement(system, tag).text = text
    return system


def _add_extent(parent: Element, bounds: Bounds) -> None:
    extent = ET.SubElement(parent, "extent")
    margin_m = 0.03 * max(bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m)
    for tag, value in (
        ("xmin", bounds.west_m - margin_m),
        ("ymin", bounds.south_m - margin_m),
        ("xmax", bounds.east_m + margin_m),
        ("ymax", bounds.north_m + margin_m),
    ):
        ET.SubElement(extent, tag).text = repr(value)


def _add_properties(root: Element) -> None:
    """That the project has a system of its own, and the tint of what was never seen behind all."""
    properties = ET.SubElement(root, "properties")
    system = ET.SubElement(properties, "SpatialRefSys")
    ET.SubElement(system, "ProjectionsEnabled", type="int").text = "1"
    gui = ET.SubElement(properties, "Gui")
    names = ("CanvasColorRedPart", "CanvasColorGreenPart", "CanvasColorBluePart")
    for name, value in zip(names, palette.rgb(palette.UNSEEN), strict=True):
        ET.SubElement(gui, name, type="int").text = str(value)


def _add_time(root: Element, universal: MapFile) -> None:
    """The span of the drives, which the temporal controller goes through minute by minute."""
    times_ns = [
        time_ns
        for info in universal.sessions()
        if info.active
        for time_ns in (info.first_time_ns, info.last_time_ns)
        if time_ns is not None
    ]
    if not times_ns:
        return
    settings = ET.SubElement(
        root, "ProjectTimeSettings", timeStepUnit="min", timeStep="1", cumulativeTemporalRange="1"
    )
    span = ET.SubElement(settings, "TemporalRange")
    for tag, time_ns in (("start", min(times_ns)), ("end", max(times_ns))):
        moment = _EPOCH + timedelta(microseconds=time_ns // 1000)
        ET.SubElement(span, tag).text = moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def _relative(map_path: Path, folder: Path) -> str:
    """The map as seen from the project's folder; in full where no relative path leads there."""
    try:
        found = os.path.relpath(map_path.resolve(), folder.resolve())
    except ValueError:  # another drive
        return map_path.resolve().as_posix()
    text = Path(found).as_posix()
    return text if text.startswith("../") else f"./{text}"


register_export_format(
    ExportFormat(
        "qgz",
        (".qgz",),
        "project that shows the map file itself",
        export_qgz,
        holds=Holds.MAP,
        readers="QGIS",
        limits="the map's own cells",
    )
)
