"""The layers of features, and what is announced to a GIS, against the same made again."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from typing import Any

from fieldgrid.core import shortened
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.header import check_plane
from fieldgrid.maps.file.metadata import find
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.vector.features import announce_extents
from fieldgrid.maps.vector.styles import refresh_styles
from fieldgrid.maps.writing.derived import active, show_features
from fieldgrid.maps.writing.subject import Subject


def check_features(subject: Subject) -> Iterator[str]:
    """The layers of features, and what is announced to a GIS, against the same made again."""
    connection, path, header, *_ = subject
    with closing(_empty(subject)) as scratch:
        for session_id, name in active(connection):
            metadata = find(connection, path, header.datum, name).metadata
            show_features(scratch, session_id, metadata, evidence=connection)
        refresh_styles(scratch, evidence=connection)
        for what, query in _OLD if header.has_other_tables else _ANNOUNCED + _FEATURES:
            yield from _differences(what, connection.execute(query), scratch.execute(query))
    check_plane(connection, path, header.datum)


def check_announced(subject: Subject) -> Iterator[str]:
    """What is announced to a GIS, against the same made of what sessions cover."""
    connection, path, header, *_ = subject
    with closing(_empty(subject)) as scratch:
        scratch.executemany(
            "INSERT INTO fieldgrid_extent VALUES (?, ?, ?, ?, ?, ?)",
            connection.execute("SELECT * FROM fieldgrid_extent"),
        )
        announce_extents(scratch)
        refresh_styles(scratch, evidence=connection)
        for what, query in _ANNOUNCED:
            yield from _differences(what, connection.execute(query), scratch.execute(query))
    check_plane(connection, path, header.datum)


def _empty(subject: Subject) -> sqlite3.Connection:
    """A map with the settings of another, and nothing in it; to be closed."""
    scratch, header = sqlite3.connect("", isolation_level=None), subject.header
    matrices = TileMatrixSet(header.lattice)
    schema.create(scratch, header.datum, matrices, header.transfer, header.groups)
    return scratch


def _differences(what: str, here: Iterator[Any], anew: Iterator[Any]) -> Iterator[str]:
    """How the rows of two queries differ; both are in the order of their keys."""
    while True:
        mine, theirs = next(here, None), next(anew, None)
        if mine is None and theirs is None:
            return
        if mine is None or theirs is None:
            surplus = "lacks" if mine is None else "has, beyond what follows from its frames,"
            yield f"The map {surplus} {what} {_key(theirs if mine is None else mine)}."
            return
        if mine != theirs:
            yield f"The {what} {_key(mine)} is not what follows from the frames."
            if mine[:2] != theirs[:2]:
                return


def _key(row: Any) -> str:
    shown = [value for value in row if not isinstance(value, bytes)][:4]
    return " ".join(shortened(value, 60) for value in shown)


_OURS = ", ".join(repr(layer) for layer in schema.LAYERS)

_ANNOUNCED: tuple[tuple[str, str], ...] = (
    (
        "reference system",
        "SELECT srs_id, organization, organization_coordsys_id, srs_name, definition, description "
        "FROM gpkg_spatial_ref_sys WHERE srs_id IN (-1, 0, 4326) ORDER BY 1",
    ),
    (
        "tile matrix set",
        "SELECT table_name, srs_id, min_x, min_y, max_x, max_y FROM gpkg_tile_matrix_set "
        "WHERE table_name = 'density'",
    ),
    (
        "geometry of layer",
        "SELECT table_name, column_name, geometry_type_name, srs_id, z, m "
        f"FROM gpkg_geometry_columns WHERE table_name IN ({_OURS}) ORDER BY 1",
    ),
    (
        "layer",
        "SELECT table_name, data_type, identifier, srs_id, CASE WHEN table_name <> "
        "'fieldgrid_session' THEN description END FROM gpkg_contents "  # which has the root digest
        f"WHERE table_name IN ({_OURS}, 'layer_styles') ORDER BY 1",
    ),
    (
        "extent of layer",
        "SELECT table_name, min_x, min_y, max_x, max_y FROM gpkg_contents "
        f"WHERE table_name IN ({_OURS}) AND table_name <> 'density' ORDER BY 1",
    ),
    (
        "extent of the styles",
        "SELECT table_name, min_x, min_y, max_x, max_y FROM gpkg_contents "
        "WHERE table_name = 'layer_styles'",
    ),
    (
        "extent of session",
        "SELECT session_id, layer, west_m, south_m, east_m, north_m FROM fieldgrid_extent "
        "ORDER BY 1, 2",
    ),
    (
        "style of layer",
        "SELECT f_table_name, f_geometry_column, f_table_catalog, f_table_schema, styleName, "
        "styleSLD, description, ui, useAsDefault IN (0, 1), styleQML FROM layer_styles "
        "WHERE owner = 'fieldgrid' ORDER BY 1",
    ),
)

_FEATURES: tuple[tuple[str, str], ...] = (
    (
        "fix",
        "SELECT session, time_ns, status, reason, geom, time, up_m, heading_deg, "
        "heading_sigma_deg, position_sigma_m, speed_mps, gear, quality FROM trajectory ORDER BY "
        "session, time_ns, status, reason, geom, up_m, heading_deg",
    ),
    (
        "frame position",
        "SELECT session, frame_id, time_ns, status, reason, geom, time, heading_deg, quality "
        "FROM frame_position ORDER BY session, frame_id",
    ),
    (
        "footprint",
        "SELECT session, frame_id, time_ns, status, geom, time FROM footprint "
        "ORDER BY session, frame_id",
    ),
)

_OLD = tuple(
    (what, query.replace("geom, time,", "geom,").replace("geom, time ", "geom "))
    for what, query in _ANNOUNCED + _FEATURES
    if "layer_styles" not in query
)
"""The queries for format 2, which has neither styles nor the time of a feature as text."""
