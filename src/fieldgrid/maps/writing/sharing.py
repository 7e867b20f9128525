"""A map that the workers of a cluster read: it travels as its path, and is opened where it arrives.

Its file is never opened but by SQLite: whoever closes it otherwise lets go of the locks that
this process has on it.
"""

from __future__ import annotations

import hashlib
import platform
import sqlite3
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import ClusterError, check_is_here, quoted
from fieldgrid.maps.file.database import connect, explained
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.layers.registry import GROUPS, LAYERS


class SharedMap(NamedTuple):
    """Where a map lies for all, its size in bytes, and a digest that tells its state."""

    path: Path
    size: int
    state: str


def shared(connection: sqlite3.Connection) -> SharedMap:
    """A map that is open here; ClusterError when others cannot read what is read here."""
    (*_, file) = connection.execute("PRAGMA database_list").fetchone()
    (mode,) = connection.execute("PRAGMA journal_mode").fetchone()
    if not file or mode != "delete":
        raise ClusterError(
            f"{file or 'A map in memory'} cannot be read by the workers of a cluster: its journal "
            f"is of the kind {quoted(mode)}. Close other programs that have it open, or leave out "
            "--scheduler."
        )
    path = Path(file)
    return SharedMap(path, path.stat().st_size, _state(connection))


def known_groups(header: MapHeader) -> tuple[str, ...]:
    """The names of the channel groups of a map that are known here, for `check_known`."""
    return tuple(group.name for group in header.known_groups())


def check_known(groups: Collection[str], layers: Collection[str] = ()) -> None:
    """Raise ClusterError for a channel group or a layer that this worker does not know."""
    for what, names, known in (
        ("channel group", groups, GROUPS),
        ("layer", layers, {"density", *LAYERS}),
    ):
        for name in names:
            if name not in known:
                raise ClusterError(
                    f"The worker on {platform.node()} does not know the {what} {quoted(name)}; "
                    "start it with --preload and the module that registers it."
                )


def opened(there: SharedMap) -> sqlite3.Connection:
    """The map on a worker, for reading. ClusterError when it has none, or another one.

    It is opened for each work anew: a file that was replaced by another of the same name and state
    would else be read on, and frames that are damaged since be taken for sound.
    """
    check_is_here(there.path, there.size, "map")
    connection = connect(there.path, there.path, writable=False)
    with explained(there.path, writing=False):
        state = _state(connection)
    if state != there.state:
        connection.close()
        raise ClusterError(
            f"{there.path} on the worker {platform.node()} is another state of the map; mount or "
            "copy the map to the same path on every worker."
        )
    return connection


def _state(connection: sqlite3.Connection) -> str:
    """A digest of settings, sessions and, where they are kept, of the sums of all rows."""
    query = "SELECT name FROM sqlite_schema WHERE name IN ('fieldgrid_meta', 'fieldgrid_sum')"
    tables = sorted(name for (name,) in connection.execute(query))
    rows = [connection.execute(f"SELECT * FROM {table} ORDER BY 1").fetchall() for table in tables]
    return hashlib.sha256(repr(rows).encode()).hexdigest()
