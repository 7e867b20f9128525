"""The maps of a farm as a STAC catalogue, as there are of satellite and drone pictures.

An item a map: where it lies in WGS84, when it was driven, and the files that hold it.
"""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.errors import ConfigError
from fieldgrid.export import Selection, export_geotiff
from fieldgrid.farm import Block, Farm
from fieldgrid.lattice import Window
from fieldgrid.mapfile import MapFile, open_map
from fieldgrid.publish import mentions, replacing_folder

_MOST_CELLS = 64
"""Cells along a side of the grid from which the outline of a map is traced."""

_COLLECTION = "maps"
_GEOPACKAGE = "application/geopackage+sqlite3"
_MARK = "fieldgrid:root_sha256"


class Written(NamedTuple):
    """A catalogue: its file, the maps that are in it, and those that are not, with the reason."""

    file: Path
    items: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...]


def write_stac(
    farm: Farm, folder: str | Path, *, with_cog: bool = False, overwrite: bool = False
) -> Written:
    """Write a STAC catalogue of a farm's maps to a folder, whole or not at all.

    Maps stay where they are, and the items refer to them by relative paths. `with_cog` writes the
    density of each beside its item, as a cloud-optimised GeoTIFF in the map's own plane. Raises
    ConfigError when pystac is not installed or no map has seen anything, MapExistsError when the
    folder exists and may not be overwritten.
    """
    try:
        import pystac
    except ImportError as error:
        raise ConfigError(
            "A STAC catalogue needs pystac, which is not installed; "
            "run: pip install 'fieldgrid[stac]'"
        ) from error
    folder = Path(folder)
    usable = [block for block in farm.blocks if block.header and block.bounds]
    left_out = tuple(
        (block.path.name, block.problem or "nothing was observed")
        for block in farm.blocks
        if block not in usable
    )
    if not usable:
        raise ConfigError(f"No map of {farm.path} can be in a catalogue: {left_out[0][1]}")
    with replacing_folder(
        folder, overwrite=overwrite, ours=_is_ours, what="a STAC catalogue of a farm"
    ) as draft:
        items = []
        for block in usable:
            place = Path(_COLLECTION, block.name)
            with open_map(block.path) as universal:
                item = _item(universal, block, folder / place)
                if with_cog:
                    (draft / place).mkdir(parents=True)
                    item.add_asset("density", _cog(universal, draft / place, block))
            items.append(item)
        name = farm.path.resolve().name
        collection = pystac.Collection(
            id=_COLLECTION,
            title=f"Maps of {name}",
            description="A map of obstacles and ground for each field, made from drives.",
            extent=pystac.Extent.from_items(items),
            license="other",
        )
        collection.add_items(items)
        catalog = pystac.Catalog(name, f"The farm {name}, as fieldgrid has mapped it.")
        catalog.add_child(collection)
        catalog.normalize_hrefs(str(folder.absolute()))
        catalog.save(pystac.CatalogType.SELF_CONTAINED, dest_href=str(draft))
    return Written(folder / "catalog.json", tuple(item.id for item in items), left_out)


def _item(universal: MapFile, block: Block, folder: Path) -> Any:
    import pystac
    from pystac.extensions.projection import ProjectionExtension

    assert block.bounds is not None
    geometry = _footprint(universal)
    first, last = block.first, block.last
    item = pystac.Item(
        id=block.name,
        geometry=geometry.__geo_interface__,
        bbox=list(geometry.bounds),
        datetime=None if first else datetime.fromtimestamp(block.path.stat().st_mtime, UTC),
        start_datetime=first,
        end_datetime=last,
        properties={
            "title": block.name,
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
    bounds = block.bounds
    window = block.header.lattice.window(bounds) if block.header else Window(0, 0, 0, 0)
    ProjectionExtension.ext(item, add_if_missing=True).apply(
        code=None,
        wkt2=universal.datum.crs_wkt("WKT2_2019"),
        projjson=universal.datum.crs_json(),
        bbox=list(bounds),
        shape=[window.height, window.width],
        transform=[universal.cell_m, 0.0, bounds.west_m, 0.0, -universal.cell_m, bounds.north_m],
    )
    item.add_asset(
        "map",
        pystac.Asset(
            Path(os.path.relpath(block.path.absolute(), folder.absolute())).as_posix(),
            title="Map with its evidence: GeoPackage",
            media_type=_GEOPACKAGE,
            roles=["data"],
            extra_fields={"file:size": block.size_bytes},
        ),
    )
    return item


def _cog(universal: MapFile, folder: Path, block: Block) -> Any:
    import pystac

    name = f"{block.name}.tif"
    export_geotiff(universal, folder / name, Selection())
    return pystac.Asset(
        f"./{name}",
        title="3D density, 0..255, and alpha where a cell was observed",
        media_type=pystac.MediaType.COG,
        roles=["data", "visual"],
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

    def in_degrees(points: Any) -> Any:
        lat, lon, _ = universal.datum.to_geodetic(points[:, 0], points[:, 1], 0.0)
        return np.round(np.column_stack([lon, lat]), 9)

    seen = shapely.transform(seen & shapely.box(*bounds), in_degrees)
    return shapely.orient_polygons(seen)


def _is_ours(folder: Path) -> bool:
    try:
        found = json.loads((folder / _COLLECTION / "collection.json").read_text(encoding="utf-8"))
        items = [str(link["href"]) for link in found["links"] if link["rel"] == "item"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return all(mentions(folder / _COLLECTION / item, _MARK.encode()) for item in items)
