"""How QGIS shows the layers of a map, in the table that it looks into when it opens one.

The styles of this package are rows of its own, brought up to date with each change of the map;
styles that a user has saved, and which of them is the default, are left alone.
"""

from __future__ import annotations

import sqlite3

from fieldgrid.core import palette
from fieldgrid.maps.file.schema import NOW_SQL
from fieldgrid.maps.vector import qgis

_OWNER = "fieldgrid"

# As QGIS makes it.
_TABLE = """
CREATE TABLE IF NOT EXISTS layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    f_table_catalog TEXT(256),
    f_table_schema TEXT(256),
    f_table_name TEXT(256),
    f_geometry_column TEXT(256),
    styleName TEXT(30),
    styleQML TEXT,
    styleSLD TEXT,
    useAsDefault BOOLEAN,
    description TEXT,
    owner TEXT(30),
    ui TEXT(30),
    update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now'))
)
"""

_ANNOUNCE = (
    "INSERT INTO gpkg_contents (table_name, data_type, identifier, description) "
    "VALUES ('layer_styles', 'attributes', 'layer_styles', 'How QGIS shows the layers')"
)


def drop_styles(connection: sqlite3.Connection) -> None:
    """Forget the styles of this package, to be made again by `refresh_styles`."""
    connection.execute(_TABLE)
    connection.execute("DELETE FROM layer_styles WHERE owner = ?", (_OWNER,))


def refresh_styles(
    connection: sqlite3.Connection, evidence: sqlite3.Connection | None = None
) -> None:
    """Bring the styles up to date with the sessions, within the caller's transaction; these are
    those in `evidence`, where that is another database."""
    connection.execute(_TABLE)
    connection.execute("DELETE FROM gpkg_contents WHERE 'layer_styles' IN (table_name, identifier)")
    connection.execute(_ANNOUNCE)
    rows = (
        (evidence or connection)
        .execute("SELECT name, removed FROM fieldgrid_session ORDER BY id")
        .fetchall()
    )
    sessions = [
        (str(name), palette.session_colour(number))
        for number, (name, removed) in enumerate(rows)
        if removed is None
    ]
    for layer in qgis.LAYERS:
        geometry = "" if layer == "density" else "geom"
        document = qgis.style(layer, sessions)
        known = connection.execute(
            "SELECT id, styleQML FROM layer_styles WHERE f_table_name = ? AND owner = ?",
            (layer, _OWNER),
        ).fetchone()
        if known is None:
            connection.execute(
                "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
                "f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, "
                "owner) SELECT '', '', ?, ?, 'fieldgrid', ?, '', NOT EXISTS (SELECT 1 FROM "
                "layer_styles WHERE f_table_name = ? AND useAsDefault), '', ?",
                (layer, geometry, document, layer, _OWNER),
            )
        elif known[1] != document:
            connection.execute(
                f"UPDATE layer_styles SET styleQML = ?, update_time = {NOW_SQL} WHERE id = ?",
                (document, known[0]),
            )


def add_mark_style(connection: sqlite3.Connection) -> None:
    """Give the layer of marks a style, unless somebody has saved one. It names no session, so it is
    never brought up to date, and a user may change it."""
    connection.execute(_TABLE)
    connection.execute(
        "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
        "f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, owner) "
        "SELECT '', '', 'mark', 'geom', 'fieldgrid', ?, '', 1, '', '' WHERE NOT EXISTS "
        "(SELECT 1 FROM layer_styles WHERE f_table_name = 'mark')",
        (qgis.style("mark", ()),),
    )
