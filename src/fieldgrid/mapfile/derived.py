"""What follows from the evidence: a session's cells and features, and what it has in the map.

Everything here can be made anew from the frames and arrays of the sessions; it is kept so that
a map can be shown, read and changed at a cost that does not grow with it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable

import numpy as np

from fieldgrid.lattice import TILE_CELLS, TileIndex
from fieldgrid.mapfile.codec import decode_moments, encode_moments
from fieldgrid.mapfile.layers import hide_session, show_session
from fieldgrid.mapfile.pyramid import Backlog, Pyramid, Sums
from fieldgrid.mapfile.records import FRAME_SQL, FrameRecord, frame_record
from fieldgrid.mapfile.schema import NOW_SQL
from fieldgrid.mapfile.staging import SessionFold, Staging
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.moments import SQUARES, WEIGHT, Moments
from fieldgrid.trajectory import Trajectory
from fieldgrid.transfer import Transfer


def show(
    connection: sqlite3.Connection,
    matrices: TileMatrixSet,
    session_id: int,
    name: str,
    track: Trajectory | None,
    fold: SessionFold,
    *,
    evidence: sqlite3.Connection | None = None,
) -> None:
    """Bring a session into the map, or up to date in it, within the caller's transaction.

    Its frames are read from `evidence` where that is another database.
    """
    hide_session(connection, session_id, name)
    frames = frames_of(evidence or connection, session_id)
    show_session(connection, session_id, name, frames, track)
    _put_cells(connection, matrices, session_id, fold)


def hide(
    connection: sqlite3.Connection, matrices: TileMatrixSet, session_id: int, name: str
) -> None:
    """Take a session out of the map, within the caller's transaction; its evidence stays."""
    hide_session(connection, session_id, name)
    _put_cells(connection, matrices, session_id, None)


def fold_evidence(
    connection: sqlite3.Connection, matrices: TileMatrixSet, transfer: Transfer, session_id: int
) -> SessionFold:
    """The fold over the stored frames of a session; to be closed."""
    fold = SessionFold(matrices.lattice, transfer, Staging())
    try:
        for record in frames_of(connection, session_id):
            if record.accepted:
                fold.add(record.grid(), record.pose)
    except BaseException:
        fold.close()
        raise
    return fold


def frames_of(connection: sqlite3.Connection, session_id: int) -> list[FrameRecord]:
    """The stored frames of a session in the order in which they were added."""
    rows = connection.execute(
        f"{FRAME_SQL} WHERE f.session_id = ? ORDER BY f.id", (session_id,)
    ).fetchall()
    return [frame_record(row, blobs_of(connection, row[0])) for row in rows]


def blobs_of(connection: sqlite3.Connection, frame_id: int) -> Callable[[], tuple[object, object]]:
    """What fetches the density and observed blobs of the frame with this row id."""

    def fetch() -> tuple[object, object]:
        blobs = connection.execute(
            "SELECT density, observed FROM fieldgrid_frame WHERE id = ?", (frame_id,)
        ).fetchone()
        return (None, None) if blobs is None else blobs

    return fetch


def _put_cells(
    connection: sqlite3.Connection,
    matrices: TileMatrixSet,
    session_id: int,
    fold: SessionFold | None,
) -> None:
    """Replace the tiles of a session, and bring those of the map up to date."""
    rows = connection.execute(
        "SELECT ty, tx FROM fieldgrid_session_tile WHERE session_id = ?", (session_id,)
    )
    before = {TileIndex(*row) for row in rows}
    after = set() if fold is None else fold.tiles()
    backlog = Backlog()

    def insert(tile: TileIndex, blob: bytes) -> None:
        connection.execute(
            "INSERT INTO fieldgrid_session_tile VALUES (?, ?, ?, ?) "
            "ON CONFLICT (session_id, ty, tx) DO UPDATE SET moments = excluded.moments",
            (session_id, *tile, blob),
        )

    def delta(tile: TileIndex) -> Sums:
        old = stored_moments(connection, session_id, tile) if tile in before else None
        new = fold.moments(tile) if fold is not None and tile in after else None
        if new is not None and new[..., WEIGHT].any():
            backlog.put(encode_moments, new, lambda blob: insert(tile, blob))
        elif old is not None:
            connection.execute(
                "DELETE FROM fieldgrid_session_tile WHERE session_id = ? AND ty = ? AND tx = ?",
                (session_id, *tile),
            )
        # Unsigned, so what is taken away is added modulo 2^64.
        return _sums(new) if old is None else _sums(new) - _sums(old)

    try:
        pyramid = Pyramid(connection, matrices, backlog)
        pyramid.change(before | after, delta, shrinks=bool(before))
    finally:
        backlog.close()
    connection.execute(f"UPDATE gpkg_contents SET last_change = {NOW_SQL}")


def stored_moments(
    connection: sqlite3.Connection, session_id: int, tile: TileIndex
) -> Moments | None:
    """What a session has in a tile, as stored."""
    row = connection.execute(
        "SELECT moments FROM fieldgrid_session_tile WHERE session_id = ? AND ty = ? AND tx = ?",
        (session_id, *tile),
    ).fetchone()
    return None if row is None else decode_moments(row[0], f"session tile {tuple(tile)}")


def _sums(moments: Moments | None) -> Sums:
    """Weight and weighted sum alone, which the tiles of the whole map hold."""
    if moments is None:
        return np.zeros((TILE_CELLS, TILE_CELLS, 2), dtype=np.uint64)
    return moments[..., WEIGHT:SQUARES]
