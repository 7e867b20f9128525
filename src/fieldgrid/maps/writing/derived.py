"""What follows from the evidence: a session's tiles and features, and what it has in the map.

Everything here can be rebuilt from the frames and arrays of the sessions; it is kept so that a
map can be shown, read and changed at a cost that does not grow with it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Sequence
from itertools import chain
from pathlib import Path

from fieldgrid.core import MapError
from fieldgrid.geometry import TileIndex
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.evidence import frames_of
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.metadata import SessionMetadata, find
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.file.schema import NOW_SQL
from fieldgrid.maps.layers.declaration import ChannelGroup
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.vector.features import hide_session, show_session
from fieldgrid.maps.vector.styles import drop_styles, refresh_styles
from fieldgrid.maps.writing.placing import (
    PlacedFrame,
    SessionTiles,
    TileSquares,
    encoded_of_session,
)
from fieldgrid.maps.writing.subject import PickledByArguments, Subject


def tables_of(connection: sqlite3.Connection, header: MapHeader, path: Path) -> TileTables:
    """The tile tables of a map that is to be changed."""
    return TileTables(connection, TileMatrixSet(header.lattice), header.writable_groups(path))


def show(
    connection: sqlite3.Connection,
    header: MapHeader,
    session_id: int,
    metadata: SessionMetadata,
    tiles: SessionTiles,
    path: Path,
) -> None:
    """Bring a session into the map, or up to date in it, within the caller's transaction."""
    show_features(connection, session_id, metadata)
    Pyramid(connection, tables_of(connection, header, path)).replace(session_id, tiles)
    touch(connection)


def show_features(
    connection: sqlite3.Connection,
    session_id: int,
    metadata: SessionMetadata,
    evidence: sqlite3.Connection | None = None,
) -> None:
    """Bring the features of a session up to date; its frames are those in `evidence`, where that
    is another database."""
    hide_session(connection, session_id, metadata.name)
    track = metadata.trajectory
    placed = None if track is None else metadata.transform.trajectory(track)
    frames = frames_of(evidence or connection, session_id)
    show_session(connection, session_id, metadata.name, frames, placed)


def hide(
    connection: sqlite3.Connection, header: MapHeader, session_id: int, name: str, path: Path
) -> None:
    """Take a session out of the map, within the caller's transaction; its evidence stays."""
    hide_session(connection, session_id, name)
    Pyramid(connection, tables_of(connection, header, path)).replace(session_id, None)
    touch(connection)


def is_settled(connection: sqlite3.Connection, header: MapHeader, path: Path) -> bool:
    """Whether no commit has left tiles for later."""
    return not tables_of(connection, header, path).unsettled()


def settle(connection: sqlite3.Connection, header: MapHeader, path: Path) -> None:
    """Fill in the tiles that commits have left for later, within the caller's transaction."""
    Pyramid(connection, tables_of(connection, header, path)).settle()


class SessionFold(PickledByArguments):
    """Folds squares of a session, from its stored frames, to encoded tiles. Pickled it is where the
    map lies: each worker of a cluster reads there."""

    def __init__(self, subject: Subject, session_id: int) -> None:
        self._of = subject, session_id
        self._groups = subject.header.writable_groups(subject.path)
        self.squares = squares_of(subject, session_id, self._groups)

    def __call__(self, place: tuple[int, int]) -> list[tuple[TileIndex, dict[str, bytes]]]:
        """The tiles of a square that the frames observed."""
        return self.squares.fold(
            place, lambda tile, cells: (tile, encoded_of_session(self._groups, cells))
        )


def squares_of(subject: Subject, session_id: int, groups: Sequence[ChannelGroup]) -> TileSquares:
    """The stored frames of a session, to be folded square by square."""
    frames = placed_frames(frames_of(subject.connection, session_id))
    return TileSquares(frames, subject.header.lattice, subject.header.transfer, groups)


def placed_frames(records: list[FrameRecord]) -> list[PlacedFrame]:
    """The accepted ones of some frames, as `placing` takes them."""
    return [
        PlacedFrame(record.pose, record.spec, record.cells) for record in records if record.accepted
    ]


def touch(connection: sqlite3.Connection) -> None:
    """Tell a GIS that the layers have changed, and how to show their sessions."""
    refresh_styles(connection)
    connection.execute(f"UPDATE gpkg_contents SET last_change = {NOW_SQL}")


def rebuild(subject: Subject) -> None:
    """Make all that follows from the evidence, its tiles with the channel groups of the header."""
    connection, path, header, run, _ = subject
    for table in (*schema.DERIVED_TABLES, "density"):
        connection.execute(f"DELETE FROM {table}")
    schema.renew_features(connection)
    for table in ("gpkg_tile_matrix", "gpkg_tile_matrix_set"):
        connection.execute(f"DELETE FROM {table} WHERE table_name = 'density'")
    connection.execute("DELETE FROM fieldgrid_meta WHERE key = 'data_window'")
    schema.announce_layers(connection, TileMatrixSet(header.lattice))
    schema.set_groups(connection, header.groups)
    tables = tables_of(connection, header, path)
    for session_id, name in active(connection):
        show_features(connection, session_id, find(connection, path, header.datum, name).metadata)
        fold = SessionFold(subject, session_id)
        with SessionTiles(tables.groups, header.lattice) as tiles:
            for tile, blobs in chain.from_iterable(run.in_order(fold, fold.squares.places())):
                tiles.put(tile, blobs)
            for tile in sorted(tiles.tiles):
                tables.put_session(session_id, tile, tiles.blobs(tile))
    Pyramid(connection, tables, run.here).rebuild()
    drop_styles(connection)
    touch(connection)


def add_groups(
    connection: sqlite3.Connection, path: Path, header: MapHeader, names: Collection[str]
) -> None:
    """Add channel groups to the tiles of a map that are up to date but for them, within the
    caller's transaction; those above the base are left for `settle`.

    Raises MapError, which names the session, when frames cannot be read.
    """
    tables = tables_of(connection, header, path)
    added = [group for group in tables.groups if group.name in names]
    groups = (tables.groups[0], *added)
    for session_id, name in active(connection):
        try:
            frames = placed_frames(frames_of(connection, session_id))
            tiles = SessionTiles.folded(frames, header.lattice, header.transfer, groups)
        except MapError as error:
            raise MapError(f"Session {name!r}: {error}") from error
        with tiles:
            for tile in sorted(tiles.tiles):
                blobs = tiles.blobs(tile)
                kept = {group.name: blobs[group.name] for group in added if group.name in blobs}
                tables.add_to_session(session_id, tile, kept)
    Pyramid(connection, tables).add_to_base(added)


def active(connection: sqlite3.Connection) -> list[tuple[int, str]]:
    """The row ids and names of the sessions that are in the map."""
    return [
        (int(session_id), str(name))
        for session_id, name in connection.execute(
            "SELECT id, name FROM fieldgrid_session WHERE removed IS NULL ORDER BY id"
        )
    ]
