"""The tables of a map file; `docs/map-format.md` explains each.

Those that start with `gpkg_` and the layers they announce are GeoPackage 1.3, for any GIS.
Those that start with `fieldgrid_` hold the evidence and the sums, for this package.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Sequence

from fieldgrid.geometry import TILE_CELLS, Datum
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.transfer import CELL_WEIGHT, Transfer
from fieldgrid.version import software_version

FORMAT_VERSION = 4
"""Of the `fieldgrid_` tables. Older maps are read, and upgraded when they are written."""

OTHER_TABLES_VERSION = 2
"""The format whose tables of evidence were others. Format 3 has those of today, and one more."""

APPLICATION_ID = 0x47504B47
"""'GPKG', in the header of the file."""

GEOPACKAGE_VERSION = 10300
"""1.3, in the header of the file: GDAL 3.6 warns at anything later."""

UNSETTLED = "overviews"
"""The setting of a map whose last commit left tiles above the base for later."""

SRS_ID = 100001
"""The map's own plane in gpkg_spatial_ref_sys."""

GEOMETRIES = {
    "trajectory": "POINT",
    "frame_position": "POINT",
    "footprint": "POLYGON",
}
"""Of the layers of features."""

NOW_SQL = "strftime('%Y-%m-%dT%H:%M:%fZ','now')"

_WGS84_WKT = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
    'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,'
    'AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],'
    'AXIS["Latitude",NORTH],AXIS["Longitude",EAST],AUTHORITY["EPSG","4326"]]'
)

_GEOPACKAGE = f"""
CREATE TABLE gpkg_spatial_ref_sys (
    srs_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL PRIMARY KEY,
    organization TEXT NOT NULL,
    organization_coordsys_id INTEGER NOT NULL,
    definition TEXT NOT NULL,
    description TEXT
);
CREATE TABLE gpkg_contents (
    table_name TEXT NOT NULL PRIMARY KEY,
    data_type TEXT NOT NULL,
    identifier TEXT UNIQUE,
    description TEXT DEFAULT '',
    last_change DATETIME NOT NULL DEFAULT ({NOW_SQL}),
    min_x DOUBLE,
    min_y DOUBLE,
    max_x DOUBLE,
    max_y DOUBLE,
    srs_id INTEGER REFERENCES gpkg_spatial_ref_sys (srs_id)
);
CREATE TABLE gpkg_geometry_columns (
    table_name TEXT NOT NULL UNIQUE REFERENCES gpkg_contents (table_name),
    column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys (srs_id),
    z TINYINT NOT NULL,
    m TINYINT NOT NULL,
    PRIMARY KEY (table_name, column_name)
);
CREATE TABLE gpkg_tile_matrix_set (
    table_name TEXT NOT NULL PRIMARY KEY REFERENCES gpkg_contents (table_name),
    srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys (srs_id),
    min_x DOUBLE NOT NULL,
    min_y DOUBLE NOT NULL,
    max_x DOUBLE NOT NULL,
    max_y DOUBLE NOT NULL
);
CREATE TABLE gpkg_tile_matrix (
    table_name TEXT NOT NULL REFERENCES gpkg_contents (table_name),
    zoom_level INTEGER NOT NULL,
    matrix_width INTEGER NOT NULL,
    matrix_height INTEGER NOT NULL,
    tile_width INTEGER NOT NULL,
    tile_height INTEGER NOT NULL,
    pixel_x_size DOUBLE NOT NULL,
    pixel_y_size DOUBLE NOT NULL,
    PRIMARY KEY (table_name, zoom_level)
);
CREATE TABLE density (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    zoom_level INTEGER NOT NULL,
    tile_column INTEGER NOT NULL,
    tile_row INTEGER NOT NULL,
    tile_data BLOB NOT NULL,
    UNIQUE (zoom_level, tile_column, tile_row)
);
"""

_FEATURES = """
CREATE TABLE trajectory (
    fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    geom POINT,
    session TEXT NOT NULL,
    time_ns INTEGER NOT NULL,
    time DATETIME NOT NULL,
    up_m DOUBLE,
    heading_deg DOUBLE,
    heading_sigma_deg DOUBLE,
    position_sigma_m DOUBLE,
    speed_mps DOUBLE,
    gear INTEGER,
    quality INTEGER,
    status TEXT NOT NULL,
    reason TEXT NOT NULL
);
CREATE INDEX trajectory_by_session ON trajectory (session, time_ns);
CREATE TABLE frame_position (
    fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    geom POINT,
    session TEXT NOT NULL,
    frame_id TEXT NOT NULL,
    time_ns INTEGER NOT NULL,
    time DATETIME NOT NULL,
    heading_deg DOUBLE,
    quality INTEGER,
    status TEXT NOT NULL,
    reason TEXT NOT NULL
);
CREATE INDEX frame_position_by_session ON frame_position (session);
CREATE TABLE footprint (
    fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    geom POLYGON,
    session TEXT NOT NULL,
    frame_id TEXT NOT NULL,
    time_ns INTEGER NOT NULL,
    time DATETIME NOT NULL,
    status TEXT NOT NULL
);
CREATE INDEX footprint_by_session ON footprint (session);
"""

OWN = """CREATE TABLE fieldgrid_meta (
    key TEXT NOT NULL PRIMARY KEY,
    value TEXT NOT NULL
);
CREATE TABLE fieldgrid_session (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    name TEXT NOT NULL UNIQUE,
    created DATETIME NOT NULL,
    removed DATETIME,
    transform TEXT,
    source TEXT NOT NULL,
    source_sha256 TEXT NOT NULL,
    config TEXT NOT NULL,
    software_version TEXT NOT NULL,
    heading_source TEXT NOT NULL,
    first_time_ns INTEGER,
    last_time_ns INTEGER,
    frames INTEGER NOT NULL,
    accepted INTEGER NOT NULL,
    grid_width_m DOUBLE,
    grid_length_m DOUBLE,
    grid_cell_m DOUBLE,
    digest TEXT NOT NULL
);
CREATE TABLE fieldgrid_array (
    session_id INTEGER NOT NULL REFERENCES fieldgrid_session (id),
    kind TEXT NOT NULL,
    name TEXT NOT NULL,
    part INTEGER NOT NULL,
    dtype TEXT NOT NULL,
    shape TEXT NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (session_id, kind, name, part)
);
CREATE TABLE fieldgrid_extent (
    session_id INTEGER NOT NULL REFERENCES fieldgrid_session (id),
    layer TEXT NOT NULL,
    west_m DOUBLE NOT NULL,
    south_m DOUBLE NOT NULL,
    east_m DOUBLE NOT NULL,
    north_m DOUBLE NOT NULL,
    PRIMARY KEY (session_id, layer)
);
CREATE TABLE fieldgrid_tile (
    zoom INTEGER NOT NULL,
    ty INTEGER NOT NULL,
    tx INTEGER NOT NULL,
    channels TEXT NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (zoom, ty, tx, channels)
);
CREATE TABLE fieldgrid_frame (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    session_id INTEGER NOT NULL REFERENCES fieldgrid_session (id),
    frame_id TEXT NOT NULL,
    time_ns INTEGER NOT NULL,
    east_m DOUBLE,
    north_m DOUBLE,
    up_m DOUBLE,
    heading_deg DOUBLE,
    position_sigma_m DOUBLE,
    heading_sigma_deg DOUBLE,
    speed_mps DOUBLE,
    status TEXT NOT NULL,
    reason TEXT NOT NULL,
    quality INTEGER,
    images TEXT NOT NULL,
    images_sha256 TEXT NOT NULL,
    cells_sha256 TEXT NOT NULL,
    digest TEXT NOT NULL,
    UNIQUE (session_id, frame_id)
);
CREATE TABLE fieldgrid_grid (
    frame INTEGER NOT NULL REFERENCES fieldgrid_frame (id),
    channel TEXT NOT NULL,
    dtype TEXT NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (frame, channel)
);
"""

TABLES = _GEOPACKAGE + _FEATURES + OWN
"""The statements that lay out the tables of a map."""

EVIDENCE_TABLES = (
    "fieldgrid_session", "fieldgrid_frame", "fieldgrid_grid", "fieldgrid_array",
)  # fmt: skip

COUNTED_TABLES = ("fieldgrid_session", "fieldgrid_frame", "density", *GEOMETRIES, "layer_styles")
"""Those whose rows have numbers that are never given again."""

DERIVED_TABLES = ("fieldgrid_extent", "fieldgrid_tile")
"""Those of our own that follow from the evidence."""

GEOPACKAGE_TABLES = (
    "gpkg_spatial_ref_sys", "gpkg_contents", "gpkg_geometry_columns", "gpkg_tile_matrix_set",
    "gpkg_tile_matrix",
)  # fmt: skip
"""Those of GeoPackage in which layers are announced, ours and others."""

GDAL_COUNTS = "gpkg_ogr_contents"
"""A table of GDAL's own, with the number of rows of layers."""

OWN_TABLES = ("fieldgrid_meta", *EVIDENCE_TABLES, *DERIVED_TABLES)
"""All tables of our own."""

LAYERS = {
    "density": ("tiles", "3D density 0..255, bright alpha where observed"),
    "trajectory": ("features", "Where the vehicle was: one point per fix"),
    "frame_position": ("features", "Where each local grid was taken"),
    "footprint": ("features", "The ground that each local grid covers"),
    # As the only table without geometry that is announced, it also keeps GDAL from listing
    # the binary tables as layers.
    "fieldgrid_session": ("attributes", "The drives in this map"),
}


def create(
    connection: sqlite3.Connection,
    datum: Datum,
    matrices: TileMatrixSet,
    transfer: Transfer,
    groups: Sequence[str],
) -> None:
    """Lay out an empty map whose tiles hold these channel groups, within one transaction."""
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {GEOPACKAGE_VERSION}")
    for statement in TABLES.split(";\n"):
        connection.execute(statement)
    connection.executemany(
        "INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", reference_systems(datum)
    )
    announce_layers(connection, matrices)
    connection.executemany(
        "INSERT INTO fieldgrid_meta VALUES (?, ?)",
        # repr gives the shortest text that reads back as the same number.
        {
            "format_version": str(FORMAT_VERSION),
            "software_version": software_version(),
            "datum_lat_deg": repr(float(datum.lat_deg)),
            "datum_lon_deg": repr(float(datum.lon_deg)),
            "datum_height_m": repr(float(datum.height_m)),
            "cell_m": repr(float(matrices.lattice.cell_m)),
            "transfer": transfer.value,
            "tile_cells": str(TILE_CELLS),
            "cell_weight": str(CELL_WEIGHT),
            "channel_groups": json.dumps(list(groups)),
        }.items(),
    )


def renew_features(connection: sqlite3.Connection) -> None:
    """Put empty tables of features in place of those there are, whatever their columns."""
    for table in GEOMETRIES:
        connection.execute(f"DROP TABLE IF EXISTS {table}")
    if has_table(connection, GDAL_COUNTS):
        # With the tables go GDAL's triggers; what is not known it counts itself.
        connection.execute(f"UPDATE {GDAL_COUNTS} SET feature_count = NULL")
    for statement in _FEATURES.split(";\n"):
        connection.execute(statement)


def announce_layers(connection: sqlite3.Connection, matrices: TileMatrixSet) -> None:
    """List the layers for a GIS, still without extents, in place of what was listed of them."""
    names = ", ".join(repr(layer) for layer in LAYERS)
    for table in ("gpkg_geometry_columns", "gpkg_tile_matrix_set", "gpkg_contents"):
        connection.execute(f"DELETE FROM {table} WHERE table_name IN ({names})")
    connection.execute(f"DELETE FROM gpkg_contents WHERE identifier IN ({names})")
    for table, (data_type, description) in LAYERS.items():
        srs_id = None if data_type == "attributes" else SRS_ID
        connection.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
            "VALUES (?, ?, ?, ?, ?)",
            (table, data_type, table, description, srs_id),
        )
        if data_type == "features":
            connection.execute(
                "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)",
                (table, GEOMETRIES[table], SRS_ID),
            )
    half_m = matrices.half_m
    connection.execute(
        "INSERT INTO gpkg_tile_matrix_set VALUES ('density', ?, ?, ?, ?, ?)",
        (SRS_ID, -half_m, -half_m, half_m, half_m),
    )


def has_table(connection: sqlite3.Connection, name: str) -> bool:
    """Whether a map has a table, of those that not every map has."""
    query = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE type = 'table' AND name = ?)"
    return bool(connection.execute(query, (name,)).fetchone()[0])


def set_groups(connection: sqlite3.Connection, groups: Sequence[str]) -> None:
    """Note which channel groups the tiles hold."""
    connection.execute(
        "INSERT OR REPLACE INTO fieldgrid_meta VALUES ('channel_groups', ?)",
        (json.dumps(list(groups)),),
    )


def reference_systems(datum: Datum) -> tuple[tuple[str, int, str, int, str, str], ...]:
    """The rows of gpkg_spatial_ref_sys; the last is that of the map's own plane."""
    return (
        ("Undefined cartesian SRS", -1, "NONE", -1, "undefined", "undefined, cartesian"),
        ("Undefined geographic SRS", 0, "NONE", 0, "undefined", "undefined, geographic"),
        ("WGS 84 geodetic", 4326, "EPSG", 4326, _WGS84_WKT, "latitude and longitude, degrees"),
        (
            f"fieldgrid LTP {datum.lat_deg:.9f} {datum.lon_deg:.9f} {datum.height_m:.3f}",
            SRS_ID,
            "fieldgrid",
            SRS_ID,
            datum.crs_wkt("WKT1_GDAL"),
            "metres east and north in the tangent plane of the map's datum",
        ),
    )
