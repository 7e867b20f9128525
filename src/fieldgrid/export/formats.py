"""The formats that a map is exported to, and which one a file name asks for."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast

from fieldgrid.errors import ConfigError, MapError, MapExistsError
from fieldgrid.export.selection import Selection
from fieldgrid.mapfile import MapFile, read_datum


class Exported(NamedTuple):
    """What an export has written: its files or folders, and rows (label, value) for a reader."""

    paths: tuple[Path, ...]
    rows: tuple[tuple[str, str], ...] = ()


class Writer(Protocol):
    """A format's own function; `options` are its keyword arguments beyond these."""

    def __call__(
        self,
        universal: MapFile,
        path: Path,
        selection: Selection,
        *,
        overwrite: bool = False,
        **options: Any,
    ) -> Exported:
        """Write the selection to `path`, whole or not at all."""


class Format(NamedTuple):
    """A format: the endings that ask for it, the module and the function that write it, what it
    is, and the options that it takes."""

    endings: tuple[str, ...]
    module: str
    function: str
    says: str
    options: tuple[str, ...] = ()

    def writer(self) -> Writer:
        """The function; its module, and the libraries behind it, are imported now."""
        return cast(Writer, getattr(importlib.import_module(self.module), self.function))


_COST_CURVE = ("free_up_to", "obstacle_above", "cost_shape")

FORMATS: dict[str, Format] = {
    "geotiff": Format(
        (".tif", ".tiff"),
        "fieldgrid.export.geotiff",
        "export_geotiff",
        "cloud-optimised GeoTIFF",
        ("epsg",),
    ),
    "png": Format(
        (".png",),
        "fieldgrid.export.png",
        "export_png",
        "picture with a world file",
        ("epsg",),
    ),
    "kmz": Format(
        (".kmz",),
        "fieldgrid.export.kmz",
        "export_kmz",
        "overlay and trajectories for Google Earth",
    ),
    "geojson": Format(
        (".geojson", ".json"),
        "fieldgrid.export.vector",
        "export_geojson",
        "obstacles, trajectory, poses and footprints as GeoJSON in WGS84",
        ("features", "obstacle_above", "min_area_m2", "simplify_m"),
    ),
    "gpkg": Format(
        (".gpkg",),
        "fieldgrid.export.vector",
        "export_geopackage",
        "the same as a GeoPackage in the map's plane",
        ("features", "obstacle_above", "min_area_m2", "simplify_m"),
    ),
    "shapefile": Format(
        (".shp.zip",),
        "fieldgrid.export.vector",
        "export_shapefile",
        "the same as shapefiles, zipped or in a folder",
        ("features", "obstacle_above", "min_area_m2", "simplify_m"),
    ),
    "isoxml": Format(
        ("taskdata",),
        "fieldgrid.export.taskdata",
        "export_taskdata",
        "ISO 11783-10 task data, a folder: field, obstacles, guidance curves, grid of zones",
        ("obstacle_above", "min_area_m2", "simplify_m"),
    ),
    "nav2": Format(
        (".yaml", ".yml"),
        "fieldgrid.export.nav2",
        "export_nav2",
        "Nav2 map: YAML, picture and georeference",
        ("mode", "image", *_COST_CURVE),
    ),
    "mcap": Format(
        (".mcap",),
        "fieldgrid.export.rosbag",
        "export_mcap",
        "MCAP for Foxglove: grids, paths, fixes, GeoJSON",
        _COST_CURVE,
    ),
    "rosbag2": Format(
        (".rosbag2",),
        "fieldgrid.export.rosbag",
        "export_rosbag2",
        "ROS 2 bag, a folder: occupancy grid, grid map, paths, fixes",
        ("storage", *_COST_CURVE),
    ),
    "csv": Format((".csv",), "fieldgrid.export.tables", "export_csv", "a row a cell as CSV"),
    "parquet": Format(
        (".parquet",), "fieldgrid.export.tables", "export_parquet", "a row a cell as Parquet"
    ),
    "npz": Format((".npz",), "fieldgrid.export.arrays", "export_npz", "arrays for NumPy"),
    "zarr": Format((".zarr",), "fieldgrid.export.arrays", "export_zarr", "a Zarr store for xarray"),
}


def format_of(path: Path, name: str | None = None) -> str:
    """The format by its name, or else by the ending of a path; ConfigError for neither."""
    if name is not None:
        if name not in FORMATS:
            raise ConfigError(f"{name!r} is no format; known are {', '.join(FORMATS)}.")
        return name
    for key, known in FORMATS.items():
        if path.name.lower().endswith(known.endings):
            return key
    endings = ", ".join(e for known in FORMATS.values() for e in known.endings)
    raise ConfigError(
        f"{path.name} ends in none of {endings}; choose one of them, or give --format."
    )


def _refuse_map(path: Path) -> None:
    """Raise MapExistsError when an export would replace a map: what that has is nowhere else."""
    if not path.is_file():
        return
    try:
        read_datum(path)
    except MapError:
        return
    raise MapExistsError(
        f"{path} is a map with its evidence, which no export replaces; give another name."
    )


def export_map(
    universal: MapFile,
    path: str | Path,
    selection: Selection | None = None,
    *,
    format: str | None = None,
    overwrite: bool = False,
    options: Mapping[str, Any] | None = None,
) -> Exported:
    """Write a part of a map in the format that `path` ends in, or that `format` names.

    The output appears when it is complete, or not at all. `options` are those of the format.
    Raises ConfigError for what cannot be asked, MapExistsError when `path` exists and may not be
    overwritten, MapWriteError when it cannot be written.
    """
    path = Path(path)
    chosen = FORMATS[key := format_of(path, format)]
    given = {name: value for name, value in (options or {}).items() if value is not None}
    for name in given:
        if name not in chosen.options:
            takes = ", ".join(chosen.options) or "none"
            raise ConfigError(f"The format {key} has no option {name!r}; it takes {takes}.")
    _refuse_map(path)
    writer = chosen.writer()
    return writer(universal, path, selection or Selection(), overwrite=overwrite, **given)
