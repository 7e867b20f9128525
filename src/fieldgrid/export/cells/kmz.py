"""A map as KMZ: pictures that Google Earth lays over the ground, and where the vehicle drove.

The cells are rows and columns of the datum's plane, which is turned against latitude and longitude
beside the datum's own meridian. So each picture is placed by its four corners (gx:LatLonQuad), and
cut so small that between them nothing bends by more than a few millimetres.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import count as count_from
from pathlib import Path

import numpy as np

from fieldgrid.core import ConfigError, Float64, Settings, palette, replacing
from fieldgrid.export.cells.png import grey_png
from fieldgrid.export.georeference import extent
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format
from fieldgrid.export.shapes.clipping import at, stretches_inside
from fieldgrid.export.together import is_zip
from fieldgrid.geometry import Lattice, Window, add_placemarks, continued_deg, in_degrees
from fieldgrid.maps import LAYERS, MapFile, MapView, Selection, features

PICTURE_PX = 2048
"""Side of a picture; larger ones are scaled down by older graphics."""

MAX_PICTURES = 64

_KML = "http://www.opengis.net/kml/2.2"
_GX = "http://www.google.com/kml/ext/2.2"
_LINE_STYLE = "drive"
_MOST_BYTES = 1 << 16
"""Of a document, in which its datum is found."""

_SHOWN_FROM_PX = "64"
"""A picture is loaded when it is this large on the screen."""


def export_kmz(
    universal: MapFile, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write the density, or `max`, as overlays, with each session's drive as a line, and the marks.

    Grey is the value, and what was not observed is transparent. Both lie on the terrain of the
    viewer; the datum is in the description and, as data, in the document. Raises ConfigError for
    more than 64 pictures of 2048 x 2048 cells, MapExistsError when `path` exists and may not be
    overwritten, MapWriteError when it cannot be written.
    """
    mark = b"datum_lat_deg"
    ours = partial(is_zip, check=lambda old: mark in old.open("doc.kml").read(_MOST_BYTES))
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="a KMZ") as file,
        selection.blocks(universal) as blocks,
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        lattice, whole = blocks.lattice, blocks.window
        windows = list(_cut(whole, lattice))
        document, folder = _document(universal, selection, lattice)
        count = 0
        for window in windows:
            view = replace(selection, bounds=lattice.bounds(window)).view(universal)
            if not view.observed.any():
                continue
            name = f"pictures/{count:02d}.png"
            grey, alpha = view.layer(selection.layer), view.observed * np.uint8(255)
            archive.writestr(name, grey_png(grey[::-1], alpha[::-1], level=1), zipfile.ZIP_STORED)
            _add_overlay(folder, name, view, alone=len(windows) == 1)
            count += 1
        lines = _lines(document, universal, selection)
        marks = universal.marks(within=selection.area(universal))
        add_placemarks(document[0], features(marks), universal.datum)
        archive.writestr(
            "doc.kml", ElementTree.tostring(document, encoding="utf-8", xml_declaration=True)
        )
    rows = (
        ("layer", f"{selection.layer}: {LAYERS[selection.layer].meaning}"),
        ("cells", f"{whole.width} x {whole.height} of {lattice.cell_m:g} m"),
        ("pictures, lines, marks", f"{count}, {lines}, {len(marks)}"),
        ("datum", universal.datum.described()),
    )
    return Exported(
        (path,),
        rows,
        {
            "layer": selection.layer,
            **extent(lattice, whole, universal.datum),
            "pictures": count,
            "lines": lines,
            "marks": len(marks),
        },
    )


def _cut(whole: Window, lattice: Lattice) -> Iterator[Window]:
    """The windows of the pictures, from the south-west."""
    count, cell_m = _pictures(whole, 1), lattice.cell_m
    if count > MAX_PICTURES:
        times = next(2**k for k in count_from(1) if _pictures(whole, 2**k) <= MAX_PICTURES)
        raise ConfigError(
            f"A KMZ of {whole.width} x {whole.height} cells would have {count} pictures, more than "
            f"the {MAX_PICTURES} that viewers bear; give smaller bounds, or cells of "
            f"{cell_m * times:g} m."
        )
    for j0 in range(whole.j0, whole.j0 + whole.height, PICTURE_PX):
        for i0 in range(whole.i0, whole.i0 + whole.width, PICTURE_PX):
            part = whole.intersect(Window(i0, j0, PICTURE_PX, PICTURE_PX))
            assert part is not None
            yield part


def _pictures(whole: Window, times: int) -> int:
    """Number of the pictures of a window, with cells `times` as wide."""
    side = PICTURE_PX * times
    return -(-whole.width // side) * -(-whole.height // side)


def _document(
    universal: MapFile, selection: Selection, lattice: Lattice
) -> tuple[ElementTree.Element, ElementTree.Element]:
    """The root, and the folder that pictures go into."""
    ElementTree.register_namespace("", _KML)
    ElementTree.register_namespace("gx", _GX)
    datum, names = universal.datum, selection.names(universal)
    root = ElementTree.Element(f"{{{_KML}}}kml")
    document = _add(root, "Document")
    _add(document, "name", universal.path.stem)
    _add(
        document,
        "description",
        f"{selection.layer}: {LAYERS[selection.layer].meaning}. "
        f"Cells of {lattice.cell_m:g} m in the "
        f"plane that touches the WGS84 datum {datum.described()}, {len(names)} sessions up to "
        f"{names[-1]}.",
    )
    line = _add(_add(document, "Style", id=_LINE_STYLE), "LineStyle")
    _add(line, "color", palette.kml(palette.FEATURES["trajectory"]))
    _add(line, "width", "2")
    data = _add(document, "ExtendedData")
    for name, value in (
        ("datum_lat_deg", datum.lat_deg),
        ("datum_lon_deg", datum.lon_deg),
        ("datum_height_m", datum.height_m),
        ("cell_m", lattice.cell_m),
    ):
        _add(_add(data, "Data", name=name), "value", repr(float(value)))
    folder = _add(document, "Folder")
    _add(folder, "name", selection.layer)
    return root, folder


def _add_overlay(folder: ElementTree.Element, name: str, view: MapView, *, alone: bool) -> None:
    """A picture on the ground; of many, those are loaded that are in sight."""
    west_m, south_m, east_m, north_m = view.bounds
    lat_deg, lon_deg, _ = view.datum.to_geodetic(
        [west_m, east_m, east_m, west_m], [south_m, south_m, north_m, north_m], 0.0
    )
    # KML has overlays that overlap the meridian of 180° reach beyond it.
    lon_deg = continued_deg(lon_deg, view.datum.lon_deg)
    overlay = _add(folder, "GroundOverlay")
    _add(overlay, "name", Path(name).stem)
    if not alone:
        region = _add(overlay, "Region")
        box = _add(region, "LatLonAltBox")
        for side, value in (
            ("north", lat_deg.max()),
            ("south", lat_deg.min()),
            ("east", lon_deg.max()),
            ("west", lon_deg.min()),
        ):
            _add(box, side, f"{value:.10f}")
        _add(_add(region, "Lod"), "minLodPixels", _SHOWN_FROM_PX)
    _add(_add(overlay, "Icon"), "href", name)
    _add(
        ElementTree.SubElement(overlay, f"{{{_GX}}}LatLonQuad"),
        "coordinates",
        _coordinates(lon_deg, lat_deg),
    )


def _lines(root: ElementTree.Element, universal: MapFile, selection: Selection) -> int:
    """A line for each stretch of a drive in the part, two where it crosses the meridian of 180°;
    returns how many there are."""
    import shapely

    folder = _add(root[0], "Folder")
    _add(folder, "name", "drives")
    count = 0
    for session in selection.names(universal):
        drive = _drive(universal, session)
        for positions in stretches_inside(*drive, selection.area(universal)):
            line = shapely.LineString(np.stack([at(v, positions) for v in drive], axis=1))
            for part in shapely.get_parts(in_degrees(line, universal.datum)):
                placemark = _add(folder, "Placemark")
                _add(placemark, "name", session)
                _add(placemark, "styleUrl", f"#{_LINE_STYLE}")
                shown = _add(placemark, "LineString")
                for tag, text in (
                    ("tessellate", "1"),
                    ("altitudeMode", "clampToGround"),
                    ("coordinates", _coordinates(*shapely.get_coordinates(part).T)),
                ):
                    _add(shown, tag, text)
                count += 1
    return count


def _drive(universal: MapFile, session: str) -> tuple[Float64, Float64]:
    """East and north of the accepted poses: of the trajectory, or else of the frames."""
    metadata = universal.metadata(session)
    if metadata.trajectory is not None:
        track = metadata.transform.trajectory(metadata.trajectory)
        return track.east_m[track.accepted], track.north_m[track.accepted]
    poses = [frame.pose for frame in universal.frames(session) if frame.accepted]
    return np.array([p.east_m for p in poses]), np.array([p.north_m for p in poses])


def _coordinates(lon_deg: Float64, lat_deg: Float64) -> str:
    """Longitude and latitude to a hundredth of a millimetre; heights are the viewer's."""
    pairs = zip(lon_deg.tolist(), lat_deg.tolist(), strict=True)
    return " ".join(f"{lon:.10f},{lat:.10f}" for lon, lat in pairs)


def _add(
    parent: ElementTree.Element, tag: str, text: str | None = None, **attributes: str
) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{_KML}}}{tag}", attributes)
    # XML has no place for what a file name may have in it.
    child.text = text and "".join(c if c.isprintable() else "\ufffd" for c in text)
    return child


register_export_format(
    ExportFormat(
        "kmz",
        (".kmz",),
        "overlay, the drives as lines, marks",
        export_kmz,
        holds=Holds.GREY,
        readers="Google Earth",
        limits="64 pictures of 2048 x 2048",
    )
)
