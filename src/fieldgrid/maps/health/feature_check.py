"""The layers of features, and what is announced to a GIS, against the same made again."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from itertools import islice, zip_longest
from typing import Any

from fieldgrid.core import shortened
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.header import check_plane
from fieldgrid.maps.file.metadata import find
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.vector.features import announce_extents
from fieldgrid.maps.vector.styles import refresh_styles
from fieldgrid.maps.writing.derived import active, show_features
from fieldgrid.maps.writing.subject import Subject


def check_features(subject: Subject) -> Iterator[str]:
    """The layers of features against the same made again from the evidence."""
    connection, path, header, *_ = subject
    with closing(empty_map(subject)) as scratch:
        for session_id, name in active(connection):
            metadata = find(connection, path, header.datum, name).metadata
            show_features(scratch, session_id, metadata, evidence=connection)
        yield from differences(connection, scratch, _FEATURES)


def check_announced(subject: Subject) -> Iterator[str]:
    """What is announced to a GIS, against the same made of what sessions and the outermost tiles
    cover."""
    connection, path, header, *_ = subject
    tables = subject.tables
    with closing(empty_map(subject)) as scratch:
        scratch.executemany(
            "INSERT INTO fieldgrid_extent VALUES (?, ?, ?, ?, ?, ?)",
            connection.execute("SELECT * FROM fieldgrid_extent"),
        )
        scratch.executemany("INSERT INTO fieldgrid_tile VALUES (?, ?, ?, ?, ?)", tables.edges())
        Pyramid(TileTables(scratch, tables.matrices, tables.groups)).announce()
        announce_extents(scratch)
        refresh_styles(scratch, evidence=connection)
        yield from differences(connection, scratch, _ANNOUNCED)
    check_plane(connection, path, header.datum)


def empty_map(subject: Subject) -> sqlite3.Connection:
    """A map with the settings of another, and nothing in it; to be closed."""
    scratch = sqlite3.connect("", isolation_level=None, check_same_thread=False)
    header = subject.header
    scratch.execute("PRAGMA journal_mode = OFF")
    scratch.execute("BEGIN")
    matrices = TileMatrixSet(header.lattice)
    schema.create(scratch, header.datum, matrices, header.transfer, header.groups)
    return scratch


def differences(
    here: sqlite3.Connection, anew: sqlite3.Connection, queries: Mapping[str, str]
) -> Iterator[str]:
    """The first row of each query, in the order of their keys, that is another in two maps."""
    for what, query in queries.items():
        pairs = zip_longest(here.execute(query), anew.execute(query))
        for mine, theirs in islice((pair for pair in pairs if pair[0] != pair[1]), 1):
            if mine is None:
                yield f"The map lacks {what} {_key(theirs)}."
            else:
                yield f"The {what} {_key(mine)} is not what follows from the frames."


def _key(row: Any) -> str:
    shown = [value for value in row if not isinstance(value, bytes)][:4]
    return " ".join(shortened(value, 60) for value in shown)


_OURS = ", ".join(repr(layer) for layer in schema.LAYERS)

_ANNOUNCED = {
    "reference system": "SELECT srs_id, organization, organization_coordsys_id, srs_name, "
    "definition, description FROM gpkg_spatial_ref_sys WHERE srs_id IN (-1, 0, 4326) ORDER BY 1",
    "tile matrix set": "SELECT table_name, srs_id, min_x, min_y, max_x, max_y "
    "FROM gpkg_tile_matrix_set WHERE table_name = 'density'",
    "geometry of layer": "SELECT table_name, column_name, geometry_type_name, srs_id, z, m "
    f"FROM gpkg_geometry_columns WHERE table_name IN ({_OURS}) ORDER BY 1",
    "zoom level": "SELECT zoom_level, matrix_width, matrix_height, tile_width, tile_height, "
    "pixel_x_size, pixel_y_size FROM gpkg_tile_matrix WHERE table_name = 'density' ORDER BY 1",
    "extent of cells": "SELECT value FROM fieldgrid_meta WHERE key = 'data_window'",
    # One description has the root digest.
    "layer": "SELECT table_name, data_type, identifier, srs_id, datetime(last_change) IS NULL, "
    "CASE WHEN table_name <> 'fieldgrid_session' THEN description END "
    f"FROM gpkg_contents WHERE table_name IN ({_OURS}, 'layer_styles') ORDER BY 1",
    "extent of layer": "SELECT table_name, min_x, min_y, max_x, max_y FROM gpkg_contents "
    f"WHERE table_name IN ({_OURS}, 'layer_styles') ORDER BY 1",
    "style of layer": "SELECT f_table_name, f_geometry_column, f_table_catalog, f_table_schema, "
    "styleName, styleSLD, description, ui, useAsDefault IN (0, 1), styleQML FROM layer_styles "
    "WHERE owner = 'fieldgrid' ORDER BY 1",
}

_FEATURES = {
    "extent of session": "SELECT session_id, layer, west_m, south_m, east_m, north_m "
    "FROM fieldgrid_extent ORDER BY 1, 2",
    "fix": "SELECT session, time_ns, status, reason, geom, time, up_m, heading_deg, "
    "heading_sigma_deg, position_sigma_m, speed_mps, gear, quality FROM trajectory ORDER BY "
    "session, time_ns, status, reason, geom, up_m, heading_deg",
    "frame position": "SELECT session, frame_id, time_ns, status, reason, geom, time, "
    "heading_deg, quality FROM frame_position ORDER BY session, frame_id",
    "footprint": "SELECT session, frame_id, time_ns, status, geom, time FROM footprint "
    "ORDER BY session, frame_id",
}
