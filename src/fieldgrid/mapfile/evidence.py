"""Reading what a map holds. Each function expects to run within `database.reading`."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds, TileIndex, Window, tile_window
from fieldgrid.mapfile.arrays import Array, Kind, read_arrays, trajectory_of
from fieldgrid.mapfile.asof import in_drive_order
from fieldgrid.mapfile.codec import decode_sums
from fieldgrid.mapfile.derived import stored_moments
from fieldgrid.mapfile.records import (
    FRAME_SQL,
    SESSION_SQL,
    FrameRecord,
    SessionInfo,
    frame_record,
    session_info,
)
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.view import MapView
from fieldgrid.moments import Moments
from fieldgrid.trajectory import Trajectory
from fieldgrid.transfer import mean_density


class Evidence:
    """The queries on one map."""

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self._connection = connection
        self._path = path

    def data_window(self) -> Window:
        """The base cells that hold data; MapError when there are none."""
        row = self._connection.execute(
            "SELECT value FROM fieldgrid_meta WHERE key = 'data_window'"
        ).fetchone()
        if row is None:
            raise MapError(self._why_empty())
        try:
            i0, j0, width, height = (int(value) for value in json.loads(row[0]))
            if min(width, height) < 1:
                raise ValueError(f"it has {width} x {height} cells")
        except (TypeError, ValueError) as error:
            raise MapError(f"The extent of {self._path} is damaged: {error}.") from error
        return Window(i0, j0, width, height)

    def sessions(self) -> list[SessionInfo]:
        """The sessions in the order in which they were added, removed ones included."""
        rows = self._connection.execute(f"{SESSION_SQL} ORDER BY id").fetchall()
        return [session_info(row) for row in rows]

    def active(self) -> list[SessionInfo]:
        """The sessions that are in the universal grid, in the order of their drives."""
        return in_drive_order(self.sessions())

    def check_sessions(self, names: Collection[str], *, active: bool = False) -> None:
        """Raise ConfigError for the first name that is not in the map, or, if asked, removed."""
        known = {
            str(name): removed
            for name, removed in self._connection.execute(
                "SELECT name, removed FROM fieldgrid_session ORDER BY id"
            )
        }
        for name in names:
            if name not in known:
                raise ConfigError(
                    f"{self._path} has no session {name!r}; it has "
                    f"{', '.join(repr(other) for other in known) or 'none'}."
                )
            if active and known[name] is not None:
                raise ConfigError(
                    f"Session {name!r} of {self._path} is removed; put it back with --restore, "
                    "or leave it out."
                )

    def find_name(self, name: str) -> bool | None:
        """Whether the session of that name is active; None when there is none."""
        row = self._connection.execute(
            "SELECT removed IS NULL FROM fieldgrid_session WHERE name = ?", (name,)
        ).fetchone()
        return None if row is None else bool(row[0])

    def frame_rows(
        self, sessions: Collection[str] | None, near: Bounds | None = None
    ) -> list[tuple[Any, ...]]:
        """Rows of `FRAME_SQL` in time order, of all frames that may reach into `near`.

        Without `sessions` those of the active ones.
        """
        where, values = ["1"], list[Any]()
        if sessions is None:
            where.append("s.removed IS NULL")
        else:
            self.check_sessions(sessions)
            where.append("s.name IN (SELECT value FROM json_each(?))")
            values.append(json.dumps(list(sessions)))
        if near is not None:
            # Width and length together are more than the distance of any corner.
            reach = "(s.grid_width_m + s.grid_length_m)"
            where.append(f"f.east_m BETWEEN ? - {reach} AND ? + {reach}")
            where.append(f"f.north_m BETWEEN ? - {reach} AND ? + {reach}")
            values += [near.west_m, near.east_m, near.south_m, near.north_m]
        return self._connection.execute(
            f"{FRAME_SQL} WHERE {' AND '.join(where)} ORDER BY f.time_ns, s.name, f.frame_id",
            values,
        ).fetchall()

    def blobs(self, row: tuple[Any, ...]) -> tuple[object, object]:
        """The density and observed blobs of a frame row."""
        blobs = self._connection.execute(
            "SELECT density, observed FROM fieldgrid_frame WHERE id = ?", (row[0],)
        ).fetchone()
        if blobs is None:
            raise MapError(f"A frame of {self._path} was removed meanwhile; read it again.")
        return blobs[0], blobs[1]

    def accepted(
        self,
        near: Bounds,
        sessions: Collection[str] | None,
        frame_filter: Callable[[FrameRecord], bool] | None,
    ) -> list[FrameRecord]:
        """The accepted frames that may reach into `near`; their grids load when asked for."""
        records = [
            # The default argument binds this row, not the loop's last.
            frame_record(row, lambda row=row: self.blobs(row))  # type: ignore[misc]
            for row in self.frame_rows(sessions, near)
        ]
        return [
            record
            for record in records
            if record.accepted and (frame_filter is None or frame_filter(record))
        ]

    def levels(self) -> int:
        """How many zoom levels there are above the base."""
        (levels,) = self._connection.execute(
            "SELECT max(zoom) - min(zoom) FROM fieldgrid_tile"
        ).fetchone()
        return int(levels or 0)

    def fill_from_tiles(self, view: MapView, level: int) -> None:
        """Fill a view of the cells of a level, 0 for the base cells, from the stored sums."""
        corners = list(view.window.tiles())
        south, west, north, east = *corners[0], *corners[-1]
        cursor = self._connection.execute(
            "SELECT ty, tx, sums FROM fieldgrid_tile WHERE zoom = (SELECT max(zoom) FROM "
            "fieldgrid_tile) - ? AND ty BETWEEN ? AND ? AND tx BETWEEN ? AND ?",
            (level, south, north, west, east),
        )
        for ty, tx, blob in cursor:
            tile = tile_window(TileIndex(ty, tx))
            part = tile.intersect(view.window)
            if part is not None:
                sums = decode_sums(blob, f"tile ({ty}, {tx})")[tile.slices_of(part)]
                place = view.window.slices_of(part)
                view.density[place], view.observed[place] = mean_density(sums)

    def pictures(
        self, window: Window, matrices: TileMatrixSet, level: int
    ) -> list[tuple[TileIndex, object]]:
        """The pictures of the tiles of a level, 0 for the base, that a window touches."""
        corners, zoom = list(window.tiles()), matrices.base_zoom - level
        west, south = matrices.column_row(zoom, corners[0])
        east, north = matrices.column_row(zoom, corners[-1])
        rows = self._connection.execute(
            "SELECT tile_column, tile_row, tile_data FROM density WHERE zoom_level = ? "
            "AND tile_row BETWEEN ? AND ? AND tile_column BETWEEN ? AND ?",
            (zoom, north, south, west, east),
        )
        return [(matrices.tile(zoom, column, row), blob) for column, row, blob in rows]

    def session_tiles(
        self, window: Window, sessions: Sequence[str]
    ) -> Iterator[tuple[TileIndex, str, Moments]]:
        """What each of the sessions has in the base tiles of a window.

        Tile by tile, and in a tile in the order in which the sessions are given.
        """
        order = {name: k for k, name in enumerate(sessions)}
        corners = list(window.tiles())
        (south, west), (north, east) = corners[0], corners[-1]
        rows = self._connection.execute(
            "SELECT t.ty, t.tx, s.name, t.session_id FROM fieldgrid_session_tile AS t "
            "JOIN fieldgrid_session AS s ON s.id = t.session_id "
            "WHERE t.ty BETWEEN ? AND ? AND t.tx BETWEEN ? AND ?",
            (south, north, west, east),
        )
        wanted = [row for row in rows if row[2] in order]
        for ty, tx, name, session_id in sorted(wanted, key=lambda r: (r[0], r[1], order[r[2]])):
            tile = TileIndex(ty, tx)
            moments = stored_moments(self._connection, session_id, tile)
            if moments is not None:
                yield tile, name, moments

    def trajectory(self, session: str, datum: Datum) -> Trajectory:
        """The trajectory that was stored with a session."""
        session_id, heading_source = self._row_of(session)
        columns = read_arrays(self._connection, session_id, Kind.TRAJECTORY)
        if not columns:
            raise MapError(f"Session {session!r} of {self._path} has no trajectory stored with it.")
        return trajectory_of(columns, datum, heading_source)

    def inputs(self, session: str) -> dict[str, Array]:
        """The arrays that were given with a session."""
        session_id, _ = self._row_of(session)
        return read_arrays(self._connection, session_id, Kind.INPUT)

    def _row_of(self, session: str) -> tuple[int, str]:
        self.check_sessions([session])
        session_id, heading_source = self._connection.execute(
            "SELECT id, heading_source FROM fieldgrid_session WHERE name = ?", (session,)
        ).fetchone()
        return int(session_id), str(heading_source)

    def _why_empty(self) -> str:
        frames, rejected, removed = self._connection.execute(
            "SELECT count(*), coalesce(sum(f.status <> 'ok'), 0), "
            "coalesce(sum(s.removed IS NOT NULL), 0) FROM fieldgrid_frame AS f "
            "JOIN fieldgrid_session AS s ON s.id = f.session_id"
        ).fetchone()
        if frames == 0:
            return f"{self._path} has no frames yet; add a session to it."
        if removed == frames:
            return f"{self._path} has no observed cell: all its sessions are removed; restore one."
        return (
            f"{self._path} has no observed cell: of its {frames} frames {rejected} were rejected "
            "and the others saw nothing. Look at the reasons of its frames."
        )
