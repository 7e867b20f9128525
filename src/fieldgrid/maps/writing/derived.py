"""What follows from the evidence: tiles, and the features of sessions.

Everything here can be rebuilt from the frames and arrays of the sessions; it is kept so that a
map can be shown, read and changed at a cost that does not grow with it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import chain
from pathlib import Path

from fieldgrid.core import ConfigError, MapError, quoted
from fieldgrid.geometry import Bounds, Datum, Lattice, TileIndex
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.codec import cells_sha256
from fieldgrid.maps.file.evidence import frames_of
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.metadata import (
    SessionMetadata,
    check_session,
    find,
    is_row_as_written,
)
from fieldgrid.maps.file.records import SESSION_SQL, FrameRecord, session_info
from fieldgrid.maps.file.schema import NOW_SQL
from fieldgrid.maps.layers.declaration import Combine
from fieldgrid.maps.layers.frame import FrameCells
from fieldgrid.maps.tiles.pyramid import EncodedTile, Pyramid, encoded_tile
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.transfer import footprint
from fieldgrid.maps.vector.features import hide_session, show_session
from fieldgrid.maps.vector.styles import drop_styles, refresh_styles
from fieldgrid.maps.writing.placing import FoldedTiles, PlacedFrame, TileSquares
from fieldgrid.maps.writing.subject import PickledByArguments, Subject


def tables_of(connection: sqlite3.Connection, header: MapHeader, path: Path) -> TileTables:
    """The tile tables of a map that is to be changed."""
    return TileTables(connection, TileMatrixSet(header.lattice), header.writable_groups(path))


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
    frames = partial(frames_of, evidence or connection, session_id)
    show_session(connection, session_id, metadata.name, frames, placed)


@contextmanager
def moving(
    connection: sqlite3.Connection,
    header: MapHeader,
    session_id: int,
    name: str,
    path: Path,
    *,
    is_out: bool = False,
) -> Iterator[Callable[[SessionMetadata | None], None]]:
    """A session leaves the map, comes back, or is placed anew, within the caller's transaction. The
    block begins before its rows change; what it is given must be called after that, with what is
    kept of the session, None where it is out of the map.

    The share of the session is folded again and subtracted. Where anything of it is not as it was
    stored, or the map keeps maxima, all of its tiles are folded again from the sessions that are
    there then. Of a session that `is_out` of the map, and stays so, nothing follows.
    """
    if is_out:
        yield lambda _: None
        return
    tables = tables_of(connection, header, path)
    base, rule = tables.matrices.base_zoom, (header.lattice, header.transfer, tables.groups)
    changed = _tiles_under(connection, header.lattice, session_id).intersection(tables.tiles(base))
    channels = (channel for group in tables.groups for channel in group.channels)

    def under(frame: PlacedFrame) -> Iterator[TileIndex]:
        return footprint(frame.spec, frame.pose, header.lattice).tiles()

    with ExitStack() as stack:
        leaving: FoldedTiles | None = None
        if not changed or all(channel.sessions is Combine.SUM for channel in channels):
            with suppress(MapError, ConfigError):
                frames = list[PlacedFrame]()
                if changed:  # else it has no share in the map
                    _check_as_stored(connection, path, header.datum, session_id)
                    frames = placed_frames(connection, session_id)
                leaving = stack.enter_context(FoldedTiles(frames, *rule))

        def place(metadata: SessionMetadata | None) -> None:
            joining = list[PlacedFrame]()
            if metadata is None:
                hide_session(connection, session_id, name)
            else:
                show_features(connection, session_id, metadata)
                joining = placed_frames(connection, session_id)
            pyramid = Pyramid(tables)
            if leaving is not None:
                pyramid.change(leaving, stack.enter_context(FoldedTiles(joining, *rule)))
            else:
                tiles = changed.union(*(under(frame) for frame in joining))
                every = active_frames(connection)
                near = [frame for frame in every if not tiles.isdisjoint(under(frame))]
                again = FoldedTiles(near, *rule, only=tiles)
                pyramid.change(None, stack.enter_context(again), cleared=tiles)
            touch(connection)

        yield place


def _check_as_stored(
    connection: sqlite3.Connection, path: Path, datum: Datum, session_id: int
) -> None:
    """Raise MapError where anything of a session but the cells of its frames is not as it was
    stored: another program may have changed its poses, or taken frames out."""
    row = connection.execute(f"{SESSION_SQL} WHERE id = ?", (session_id,)).fetchone()
    records = list(frames_of(connection, session_id))
    check_session(connection, path, datum, session_info(row), records)
    for record in records:
        if not is_row_as_written(record):
            raise MapError(f"Frame {quoted(record.frame_id)} is not as it was stored.")


def _tiles_under(
    connection: sqlite3.Connection, lattice: Lattice, session_id: int
) -> set[TileIndex]:
    """The tiles that the footprints of a session in the map may reach into."""
    row = connection.execute(
        "SELECT west_m, south_m, east_m, north_m FROM fieldgrid_extent "
        "WHERE session_id = ? AND layer = 'footprint'",
        (session_id,),
    ).fetchone()
    return set() if row is None else set(lattice.window(Bounds(*row)).grown(1).tiles())


class MapFold(PickledByArguments):
    """Folds squares of a map, from the stored frames of its sessions, to encoded tiles. Pickled it
    is where the map lies: each worker of a cluster reads there."""

    def __init__(self, subject: Subject) -> None:
        self._of = (subject,)
        self._groups, header = subject.tables.groups, subject.header
        frames = active_frames(subject.connection)
        self.squares = TileSquares(frames, header.lattice, header.transfer, self._groups)

    def __call__(self, place: tuple[int, int]) -> list[EncodedTile]:
        """The tiles of a square that the frames observed."""
        return self.squares.fold(place, partial(encoded_tile, groups=self._groups))


def fold_tiles(subject: Subject, into: TileTables) -> None:
    """Fold the frames of all active sessions into the tables of tiles of a map, which are empty
    before."""
    fold, run = MapFold(subject), subject.runner
    Pyramid(into, run.here).fill(
        tile for square in run.in_order(fold, fold.squares.places()) for tile in square
    )


def active_frames(connection: sqlite3.Connection) -> list[PlacedFrame]:
    """The accepted frames of all sessions that are in the map."""
    sessions = (session_id for session_id, _ in active(connection))
    return list(chain.from_iterable(placed_frames(connection, one) for one in sessions))


def placed_frames(connection: sqlite3.Connection, session_id: int) -> list[PlacedFrame]:
    """The accepted frames of a session, as `placing` takes them."""
    return [
        PlacedFrame(record.pose, record.spec, partial(_as_written, record), session_id)
        for record in frames_of(connection, session_id)
        if record.accepted
    ]


def _as_written(record: FrameRecord) -> FrameCells:
    """What a frame saw; MapError where that is not what was written."""
    cells = record.cells()
    if cells_sha256(cells) != record.cells_sha256:
        raise MapError(
            f"Frame {quoted(record.frame_id)} of session {quoted(record.session)} is not as it was "
            "stored."
        )
    return cells


def touch(connection: sqlite3.Connection) -> None:
    """Tell a GIS that the layers have changed, and how to show their sessions."""
    refresh_styles(connection)
    connection.execute(f"UPDATE gpkg_contents SET last_change = {NOW_SQL}")


def rebuild(subject: Subject) -> None:
    """Make all that follows from the evidence, its tiles with the channel groups of the header."""
    connection, path, header, *_ = subject
    for table in (*schema.DERIVED_TABLES, "density"):
        connection.execute(f"DELETE FROM {table}")
    schema.renew_features(connection)
    for table in ("gpkg_tile_matrix", "gpkg_tile_matrix_set"):
        connection.execute(f"DELETE FROM {table} WHERE table_name = 'density'")
    connection.execute("DELETE FROM fieldgrid_meta WHERE key = 'data_window'")
    schema.announce_layers(connection, TileMatrixSet(header.lattice))
    schema.set_groups(connection, header.groups)
    for session_id, name in active(connection):
        show_features(connection, session_id, find(connection, path, header.datum, name).metadata)
    fold_tiles(subject, subject.tables)
    drop_styles(connection)
    touch(connection)


def active(connection: sqlite3.Connection) -> list[tuple[int, str]]:
    """The row ids and names of the sessions that are in the map."""
    return [
        (int(session_id), str(name))
        for session_id, name in connection.execute(
            "SELECT id, name FROM fieldgrid_session WHERE removed IS NULL ORDER BY id"
        )
    ]
