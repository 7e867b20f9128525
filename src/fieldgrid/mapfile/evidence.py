"""Reading what a map holds. Each function expects to run within `database.reading`."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds, TileIndex, Window, tile_window
from fieldgrid.mapfile.codec import decode_sums
from fieldgrid.mapfile.geometry import decode_point
from fieldgrid.mapfile.records import (
    FRAME_SQL,
    SESSION_SQL,
    FrameRecord,
    SessionInfo,
    frame_record,
    number,
    session_info,
)
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.view import MapView
from fieldgrid.trajectory import Status, Trajectory
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
        """The sessions in the order in which they were added."""
        rows = self._connection.execute(f"{SESSION_SQL} ORDER BY id").fetchall()
        return [session_info(row) for row in rows]

    def check_sessions(self, names: Collection[str]) -> None:
        """Raise ConfigError for the first name that is not in the map."""
        known = [row[0] for row in self._connection.execute("SELECT name FROM fieldgrid_session")]
        for name in names:
            if name not in known:
                raise ConfigError(
                    f"{self._path} has no session {name!r}; it has "
                    f"{', '.join(repr(other) for other in known) or 'none'}."
                )

    def has_session(self, name: str) -> bool:
        """Whether the map has a session of that name."""
        found = self._connection.execute("SELECT 1 FROM fieldgrid_session WHERE name = ?", (name,))
        return found.fetchone() is not None

    def frame_rows(
        self, sessions: Collection[str] | None, near: Bounds | None = None
    ) -> list[tuple[Any, ...]]:
        """Rows of `FRAME_SQL` in time order, of all frames that may reach into `near`."""
        where, values = ["1"], list[Any]()
        if sessions is not None:
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
            f"{FRAME_SQL} WHERE {' AND '.join(where)} ORDER BY f.time_ns, f.id", values
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

    def fill_from_tiles(self, view: MapView) -> None:
        """Fill a view of base cells from the stored sums."""
        corners = list(view.window.tiles())
        south, west, north, east = *corners[0], *corners[-1]
        cursor = self._connection.execute(
            "SELECT ty, tx, sums FROM fieldgrid_tile "
            "WHERE zoom = ? AND ty BETWEEN ? AND ? AND tx BETWEEN ? AND ?",
            (TileMatrixSet(view.lattice).base_zoom, south, north, west, east),
        )
        for ty, tx, blob in cursor:
            tile = tile_window(TileIndex(ty, tx))
            part = tile.intersect(view.window)
            if part is not None:
                sums = decode_sums(blob, f"tile ({ty}, {tx})")[tile.slices_of(part)]
                place = view.window.slices_of(part)
                view.density[place], view.observed[place] = mean_density(sums)

    def trajectory(self, session: str, datum: Datum) -> Trajectory:
        """The trajectory that was stored with a session."""
        self.check_sessions([session])
        rows = self._connection.execute(
            "SELECT geom, time_ns, up_m, heading_deg, position_sigma_m, heading_sigma_deg, "
            "speed_mps, quality, status, reason FROM trajectory WHERE session = ? "
            "ORDER BY time_ns",
            (session,),
        ).fetchall()
        (heading_source,) = self._connection.execute(
            "SELECT heading_source FROM fieldgrid_session WHERE name = ?", (session,)
        ).fetchone()
        if not rows:
            raise MapError(f"Session {session!r} of {self._path} has no trajectory stored with it.")
        try:
            return _trajectory(rows, datum, str(heading_source))
        except (TypeError, ValueError) as error:
            raise MapError(f"The trajectory of session {session!r} is damaged: {error}") from error

    def _why_empty(self) -> str:
        frames, rejected = self._connection.execute(
            "SELECT count(*), coalesce(sum(status <> 'ok'), 0) FROM fieldgrid_frame"
        ).fetchone()
        if frames == 0:
            return f"{self._path} has no frames yet; add a session to it."
        return (
            f"{self._path} has no observed cell: of its {frames} frames {rejected} were rejected "
            "and the others saw nothing. Look at the reasons of its frames."
        )


def _trajectory(rows: list[tuple[Any, ...]], datum: Datum, heading_source: str) -> Trajectory:
    geometry, time_ns, up, heading, sigma_m, sigma_deg, speed, quality, status, reason = zip(
        *rows, strict=True
    )
    east, north = zip(*(decode_point(blob) for blob in geometry), strict=True)

    def column(values: tuple[Any, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.array([number(value) for value in values], dtype=np.float64)

    return Trajectory(
        datum=datum,
        time_ns=np.array(time_ns, dtype=np.int64),
        east_m=column(east),
        north_m=column(north),
        up_m=column(up),
        heading_deg=column(heading),
        position_sigma_m=column(sigma_m),
        heading_sigma_deg=column(sigma_deg),
        speed_mps=column(speed),
        gear=np.sign(np.nan_to_num(column(speed))).astype(np.int64),
        quality=np.array(quality, dtype=np.int64),
        status=tuple(Status(value) for value in status),
        reason=tuple(str(value) for value in reason),
        heading_source=heading_source,
    )
