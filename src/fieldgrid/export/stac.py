"""The maps of a farm as a STAC catalogue, as there are of satellite and drone pictures.

An item a map: where it lies in WGS84, when it was driven, and the files that hold it. Items are
called as their maps, as far as a name can be a part of an address; what they refer to is a URI.
"""

from __future__ import annotations

import os
import re
import shutil
import urllib.parse
from collections.abc import Iterable
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import (
    ConfigError,
    MapError,
    MapWriteError,
    mentions,
    parse_json,
    printable,
    replacing_folder,
)
from fieldgrid.export.registry import export_map, require
from fieldgrid.geometry import Bounds, Lattice, in_degrees
from fieldgrid.maps import Farm, FarmBlock, MapFile, open_map
from fieldgrid.recordings import read_text

_MOST_CELLS = 64
"""Cells along a side of the grid from which the outline of a map is traced."""

_COLLECTION = "maps"
_GEOPACKAGE = "application/geopackage+sqlite3"
_MARK = "fieldgrid:root_sha256"
_ROOT = "/catalogue"
"""Where the catalogue lies while its links are made, all of which are relative. The true place may
have a ? in it, behind which pystac would look for no path."""
_LONGEST_ID = 200
_UNSAFE = re.compile(r"[^\w.-]+")
_UNSAFE_IN_PATH = re.compile(r"[^\w.~/-]")


class WrittenCatalogue(NamedTuple):
    """A catalogue: its file, the maps that are in it, and those that are not, with the reason."""

    file: Path
    items: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...]


def write_stac(
    farm: Farm, folder: str | Path, *, with_cog: bool = False, overwrite: bool = False
) -> WrittenCatalogue:
    """Write a STAC catalogue of a farm's maps to a folder, whole or not at all.

    Maps stay where they are, and the items refer to them by relative paths. `with_cog` writes the
    density of each beside its item, as a cloud-optimised GeoTIFF in the map's own plane. A map that
    cannot be read as far as that is left out, with the reason. Raises
    ConfigError when pystac is not installed or no map has seen anything, MapExistsError when the
    folder exists and may not be overwritten.
    """
    require("A STAC catalogue", "stac", "pystac")
    import pystac

    folder = Path(folder)
    usable = [block for block in farm.blocks if block.header and block.bounds]
    left_out = [
        (block.path.name, block.problem or "nothing was observed")
        for block in farm.blocks
        if block not in usable
    ]
    with replacing_folder(
        folder, overwrite=overwrite, ours=_is_ours, what="a STAC catalogue of a farm"
    ) as draft:
        items = []
        for block, id_ in zip(usable, _ids(block.name for block in usable), strict=True):
            place = Path(_COLLECTION, id_)
            try:
                with open_map(block.path) as universal:
                    item = _item(universal, block, id_, folder / place)
                    if with_cog:
                        (draft / place).mkdir(parents=True)
                        made = export_map(universal, draft / place / f"{id_}.tif")
                        density = pystac.Asset(
                            f"./{id_}.tif",
                            title="3D density, 0..255, and alpha where a cell was observed",
                            media_type=pystac.MediaType.COG,
                            roles=["data", "visual"],
                        )
                        item.add_asset("density", density)
                        bounds = Bounds(*made.about["bounds_m"].values())
                        _place(density, universal, bounds)
            except MapWriteError:
                raise
            except MapError as error:
                shutil.rmtree(draft / place, ignore_errors=True)
                left_out.append((block.path.name, str(error)))
            else:
                items.append(item)
        if not items:
            raise ConfigError(f"No map of {farm.path} can be in a catalogue: {left_out[0][1]}")
        name = printable(farm.path.resolve().name) or "farm"
        extent = pystac.Extent.from_items(items)
        if any(item.bbox[0] > item.bbox[2] for item in items):
            # Of maps on either side of the meridian of 180° only all longitudes are sure to hold.
            (_, south, _, north), *_ = extent.spatial.bboxes
            extent.spatial = pystac.SpatialExtent([[-180.0, south, 180.0, north]])
        collection = pystac.Collection(
            id=_COLLECTION,
            title=f"Maps of {name}",
            description="A map of obstacles and ground for each field, made from drives.",
            extent=extent,
            license="other",
        )
        collection.add_items(items)
        catalog = pystac.Catalog(_id(name), f"The farm {name}, as fieldgrid has mapped it.")
        catalog.add_child(collection)
        catalog.normalize_hrefs(_ROOT)
        catalog.save(pystac.CatalogType.SELF_CONTAINED, stac_io=_writing_to(draft))
    return WrittenCatalogue(
        folder / "catalog.json", tuple(item.id for item in items), tuple(left_out)
    )


def _writing_to(draft: Path) -> Any:
    """What pystac writes with, which would take a folder for an address itself."""
    import pystac

    class Files(pystac.StacIO):
        def read_text(self, source: Any, *_: Any, **__: Any) -> str:
            raise NotImplementedError(source)

        def write_text(self, dest: Any, txt: str, *_: Any, **__: Any) -> None:
            file = draft / str(dest).partition(f"{_ROOT}/")[2]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(txt, encoding="utf-8")

    return Files()


def _ids(names: Iterable[str]) -> list[str]:
    """Of each map its item's, no two alike, also where a file system knows no capitals."""
    ids: dict[str, str] = {}
    for name in names:
        first = _id(name)
        spare = (f"{first}-{k}" for k in count(2))
        id_ = next(one for one in chain([first], spare) if one.casefold() not in ids)
        ids[id_.casefold()] = id_
    return list(ids.values())


def _id(name: str) -> str:
    """A name as it can be a folder's, and a part of an address without being quoted."""
    safe = _UNSAFE.sub("_", name).encode()[:_LONGEST_ID].decode(errors="ignore")
    return safe if safe.strip("._") else "map"


def _reference(path: str) -> str:
    """A relative path as a URI; letters of any language stay as they are."""
    return _UNSAFE_IN_PATH.sub(lambda one: urllib.parse.quote(os.fsencode(one[0])), path)


def _item(universal: MapFile, block: FarmBlock, id_: str, folder: Path) -> Any:
    import pystac

    assert block.bounds is not None
    geometry, bounds = _footprint(universal), block.bounds
    item = pystac.Item(
        id=id_,
        geometry=geometry.__geo_interface__,
        bbox=_bbox(geometry),
        datetime=None if block.first else datetime.fromtimestamp(block.path.stat().st_mtime, UTC),
        start_datetime=block.first,
        end_datetime=block.last,
        properties={
            "title": printable(block.name),
            "gsd": universal.cell_m,
            "fieldgrid:area_m2": round(block.area_m2, 4),
            "fieldgrid:sessions": [info.name for info in block.sessions],
            "fieldgrid:health": block.health.value,
            _MARK: block.root_sha256,
            "fieldgrid:datum": {
                "lat_deg": universal.datum.lat_deg,
                "lon_deg": universal.datum.lon_deg,
                "height_m": universal.datum.height_m,
            },
        },
    )
    _place(item, universal, bounds)
    item.add_asset(
        "map",
        pystac.Asset(
            _reference(Path(os.path.relpath(block.path.absolute(), folder.absolute())).as_posix()),
            title="Map with its evidence: GeoPackage",
            media_type=_GEOPACKAGE,
            roles=["data"],
            extra_fields={"file:size": block.size_bytes},
        ),
    )
    return item


def _place(item: Any, universal: MapFile, bounds: Bounds) -> None:
    """Say where the cells of an item or of an asset lie."""
    from pystac.extensions.projection import ProjectionExtension

    cell_m, window = universal.cell_m, Lattice(universal.cell_m).window(bounds)
    ProjectionExtension.ext(item, add_if_missing=True).apply(
        code=None,
        wkt2=universal.datum.crs_wkt("WKT2_2019"),
        projjson=universal.datum.crs_json(),
        bbox=list(bounds),
        shape=[window.height, window.width],
        transform=[cell_m, 0.0, bounds.west_m, 0.0, -cell_m, bounds.north_m],
    )


def _footprint(universal: MapFile) -> Any:
    """The outline of what was seen, in degrees: of cells of which `_MOST_CELLS` lie along it."""
    import numpy as np
    import shapely

    bounds = universal.bounds
    side_m = max(bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m)
    factor = 1
    while side_m / (universal.cell_m * factor) > _MOST_CELLS:
        factor *= 2
    view = universal.read(cell_m=universal.cell_m * factor)
    rows, columns = np.nonzero(view.observed)
    # In whole cells, so that neighbours share their edges exactly.
    seen = shapely.union_all(shapely.box(columns, rows, columns + 1, rows + 1)).simplify(0.0)
    corner, cell_m = view.bounds[:2], view.lattice.cell_m
    seen = shapely.transform(seen, lambda points: points * cell_m + corner)

    return shapely.orient_polygons(in_degrees(seen & shapely.box(*bounds), universal.datum))


def _bbox(geometry: Any) -> list[float]:
    """West, south, east and north of a shape; west is more than east where it has parts on either
    side of the meridian of 180°."""
    import shapely

    west, south, east, north = geometry.bounds
    if east - west > 180.0:
        lons = shapely.get_coordinates(geometry)[:, 0]
        west, east = lons[lons > 0.0].min(), lons[lons < 0.0].max()
    return [float(west), south, float(east), north]


def _is_ours(folder: Path) -> bool:
    collection = folder / _COLLECTION / "collection.json"
    if not collection.is_file():
        return False
    try:
        found = parse_json(read_text(collection))
        items = [str(link["href"]) for link in found["links"] if link["rel"] == "item"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return all(mentions(folder / _COLLECTION / item, _MARK.encode()) for item in items)
