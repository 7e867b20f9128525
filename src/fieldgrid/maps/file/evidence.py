"""Reading what a map holds. Each function expects to run within `database.reading`."""

from __future__ import annotations

import json
import math
import sqlite3
import threading
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from fieldgrid.core import ConfigError, FieldgridError, MapError, quoted
from fieldgrid.geometry import Bounds, Datum, TileIndex, Trajectory, Window
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.arrays import Array, ArrayKind, read_arrays, trajectory_of
from fieldgrid.maps.file.codec import EncodedChannel
from fieldgrid.maps.file.history import in_drive_order
from fieldgrid.maps.file.metadata import no_session
from fieldgrid.maps.file.records import (
    FRAME_SQL,
    SESSION_SQL,
    FrameRecord,
    SessionInfo,
    frame_record,
    session_info,
)
from fieldgrid.maps.tiles.tiling import TileMatrixSet, window_of
from fieldgrid.maps.writing.transform import Transform, transform_of


class EvidenceTables:
    """The queries on one map."""

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self.connection = connection
        self.path = path

    def data_window(self) -> Window:
        """The base cells that hold data; MapError when there are none."""
        row = self.connection.execute(
            "SELECT value FROM fieldgrid_meta WHERE key = 'data_window'"
        ).fetchone()
        if row is None:
            raise MapError(self._why_empty())
        try:
            return window_of(row[0])
        except ValueError as error:
            raise MapError(f"The extent of {self.path} is damaged: {error}.") from error

    def sessions(self) -> list[SessionInfo]:
        """The sessions in the order in which they were added, removed ones included."""
        rows = self.connection.execute(f"{SESSION_SQL} ORDER BY id")
        return [session_info(row) for row in rows.fetchall()]

    def active(self) -> list[SessionInfo]:
        """The sessions that are in the universal grid, in the order of their drives."""
        return in_drive_order(self.sessions())

    def check_sessions(self, names: Collection[str], *, active: bool = False) -> None:
        """Raise ConfigError for the first name that is not in the map, or, if asked, removed."""
        known = {
            str(name): removed
            for name, removed in self.connection.execute(
                "SELECT name, removed FROM fieldgrid_session ORDER BY id"
            )
        }
        for name in names:
            if name not in known:
                raise no_session(self.connection, self.path, name)
            if active and known[name] is not None:
                raise ConfigError(
                    f"Session {quoted(name)} of {self.path} is removed; put it back with "
                    "--restore, or leave it out."
                )

    def has_channel(self, name: str) -> bool:
        """Whether any frame keeps a channel."""
        found = self.connection.execute(
            "SELECT EXISTS (SELECT 1 FROM fieldgrid_grid WHERE channel = ?)", (name,)
        ).fetchone()
        return bool(found[0])

    def frame_rows(self, sessions: Collection[str] | None) -> list[tuple[Any, ...]]:
        """Rows of `FRAME_SQL` in time order; without `sessions` those of the active ones."""
        where, values = self._chosen(sessions)
        return self.connection.execute(
            f"{FRAME_SQL} WHERE {where} ORDER BY f.time_ns, s.name, f.frame_id", values
        ).fetchall()

    def _chosen(self, sessions: Collection[str] | None) -> tuple[str, list[Any]]:
        """A condition on the sessions `s`, and its values: some, or the active ones."""
        if sessions is None:
            return "s.removed IS NULL", []
        self.check_sessions(sessions)
        return "s.name IN (SELECT value FROM json_each(?))", [json.dumps(list(sessions))]

    def accepted(
        self,
        near: Bounds,
        sessions: Collection[str] | None,
        frame_filter: Callable[[FrameRecord], bool] | None,
    ) -> list[FrameRecord]:
        """The accepted frames that may reach into `near`, in time order; their grids load when
        asked for."""
        where, values = self._chosen(sessions)
        chosen = self.connection.execute(
            f"SELECT id, grid_width_m, grid_length_m, transform FROM fieldgrid_session AS s "
            f"WHERE {where}",
            values,
        ).fetchall()
        # Of places that are no numbers, too: reading those tells what is wrong with them.
        rows = (
            row
            for session_id, *placing in chosen
            for row in self.connection.execute(
                f"{FRAME_SQL} WHERE f.session_id = :id "
                "AND (typeof(f.east_m) <> 'real' OR f.east_m BETWEEN :west_m AND :east_m) "
                "AND (typeof(f.north_m) <> 'real' OR f.north_m BETWEEN :south_m AND :north_m)",
                {"id": session_id, **_driven_near(near, *placing)._asdict()},
            ).fetchall()
        )
        records = (frame_record(row, loader(self.connection, row[0])) for row in rows)
        found = [
            record
            for record in records
            if record.accepted
            and reaches(record, near)
            and (frame_filter is None or frame_filter(record))
        ]
        return sorted(found, key=lambda one: (one.pose.time_ns, one.session, one.frame_id))

    def levels(self) -> int:
        """How many zoom levels there are above the base; none while some of their tiles are left
        for later."""
        (levels,) = self.connection.execute(
            "SELECT max(zoom_level) - min(zoom_level) FROM density "
            "WHERE NOT EXISTS (SELECT 1 FROM fieldgrid_meta WHERE key = ?)",
            (schema.UNSETTLED,),
        ).fetchone()
        return int(levels or 0)

    def pictures(
        self, window: Window, matrices: TileMatrixSet, level: int
    ) -> list[tuple[TileIndex, object]]:
        """The pictures of the tiles of a level, 0 for the base, that a window touches."""
        corners, zoom = list(window.tiles()), matrices.base_zoom - level
        west, south = matrices.column_row(zoom, corners[0])
        east, north = matrices.column_row(zoom, corners[-1])
        rows = self.connection.execute(
            "SELECT tile_column, tile_row, tile_data FROM density WHERE zoom_level = ? "
            "AND tile_row BETWEEN ? AND ? AND tile_column BETWEEN ? AND ?",
            (zoom, north, south, west, east),
        )
        return [(matrices.tile(zoom, column, row), blob) for column, row, blob in rows]

    def trajectory(self, session: str, datum: Datum) -> Trajectory:
        """The trajectory that was stored with a session, as driven."""
        session_id, heading_source, _ = self._row_of(session)
        columns = read_arrays(self.connection, session_id, ArrayKind.TRAJECTORY)
        if not columns:
            raise MapError(
                f"Session {quoted(session)} of {self.path} has no trajectory stored with it."
            )
        return trajectory_of(columns, datum, heading_source)

    def transform(self, session: str) -> Transform:
        """The transform of a session."""
        return self._row_of(session)[2]

    def inputs(self, session: str) -> dict[str, Array]:
        """The arrays that were given with a session."""
        return read_arrays(self.connection, self._row_of(session)[0], ArrayKind.INPUT)

    def _row_of(self, session: str) -> tuple[int, str, Transform]:
        row = self.connection.execute(
            # By the rows themselves, and not by their index, which may be damaged.
            "SELECT id, heading_source, transform FROM fieldgrid_session WHERE +name = ?",
            (session,),
        ).fetchone()
        if row is None:
            raise no_session(self.connection, self.path, session)
        return int(row[0]), str(row[1]), transform_of(row[2])

    def _why_empty(self) -> str:
        frames, rejected, removed = self.connection.execute(
            "SELECT count(*), coalesce(sum(f.status <> 'ok'), 0), "
            "coalesce(sum(s.removed IS NOT NULL), 0) FROM fieldgrid_frame AS f "
            "JOIN fieldgrid_session AS s ON s.id = f.session_id"
        ).fetchone()
        if frames == 0:
            return f"{self.path} has no frames yet; add a session to it."
        if removed == frames:
            return f"{self.path} has no observed cell: all its sessions are removed; restore one."
        return (
            f"{self.path} has no observed cell: of its {frames} frames {rejected} were rejected "
            "and the others saw nothing. Look at the reasons of its frames."
        )


_ONE_AT_A_TIME = threading.Lock()


def loader(connection: sqlite3.Connection, frame: int) -> Callable[[], tuple[EncodedChannel, ...]]:
    """What fetches the stored channels of the frame with this row id; any thread may call it."""

    def fetch() -> tuple[EncodedChannel, ...]:
        with _ONE_AT_A_TIME:
            rows = connection.execute(
                "SELECT channel, dtype, data FROM fieldgrid_grid WHERE frame = ? ORDER BY channel",
                (frame,),
            ).fetchall()
        return tuple(EncodedChannel(*row) for row in rows)

    return fetch


def frames_of(connection: sqlite3.Connection, session_id: int) -> Iterator[FrameRecord]:
    """The stored frames of a session, ordered by time and frame_id; they are not to be changed
    meanwhile."""
    query = f"{FRAME_SQL} WHERE f.session_id = ? ORDER BY f.time_ns, f.frame_id"
    for row in connection.execute(query, (session_id,)):
        yield frame_record(row, loader(connection, row[0]))


def _driven_near(near: Bounds, width_m: Any, length_m: Any, transform: Any) -> Bounds:
    """Where frames of a session were driven that may reach into `near`; everywhere for a session
    that is damaged, as reading its first frame tells."""
    try:
        reach_m = math.hypot(width_m / 2.0, length_m)
        west, south, east, north = near
        grown = Bounds(west - reach_m, south - reach_m, east + reach_m, north + reach_m)
        return transform_of(transform).driven(grown)
    except (TypeError, ValueError, FieldgridError):
        return Bounds(-math.inf, -math.inf, math.inf, math.inf)


def reaches(record: FrameRecord, near: Bounds) -> bool:
    """Whether any cell of a frame may lie within bounds."""
    pose, reach_m = record.pose, record.spec.reach_m
    return (
        near.west_m - reach_m <= pose.east_m <= near.east_m + reach_m
        and near.south_m - reach_m <= pose.north_m <= near.north_m + reach_m
    )
