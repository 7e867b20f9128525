"""Adding a drive to a map: all of it, or nothing."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from fieldgrid.errors import ConfigError, DatumError
from fieldgrid.geodesy import MAX_DISTANCE_M
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.lattice import Bounds, Window
from fieldgrid.mapfile.database import explained, writing
from fieldgrid.mapfile.geometry import encode_point
from fieldgrid.mapfile.pyramid import Pyramid, union
from fieldgrid.mapfile.records import frame_row, is_accepted
from fieldgrid.mapfile.schema import NOW_SQL, software_version
from fieldgrid.mapfile.staging import SessionFold, Staging
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.trajectory import Pose, Trajectory
from fieldgrid.transfer import Transfer, check_cell_sizes


class Session:
    """One drive on its way into a map; made by `MapFile.add_session`, used with `with`.

    Nothing is in the map before the end of the block, and nothing ever when it raises.
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        path: Path,
        name: str,
        *,
        matrices: TileMatrixSet,
        transfer: Transfer,
        trajectory: Trajectory | None,
        config: Mapping[str, Any],
        source: str,
        on_end: Callable[[bool], None],
    ) -> None:
        self.name = name
        self._connection = connection
        self._path = path
        self._matrices = matrices
        self._trajectory = trajectory
        self._config = _as_json(config)
        self._source = source
        self._on_end = on_end
        self._spec: GridSpec | None = None
        self._count = 0
        self._open = True
        self._committed = False
        with explained(path, writing=True):
            self._staging = Staging()
        self._fold = SessionFold(matrices.lattice, transfer, self._staging)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None and self._open:
                self._commit()
                self._committed = True
        finally:
            self.discard()

    def add(
        self,
        grid: LocalGrid,
        pose: Pose,
        *,
        frame_id: str | None = None,
        images: Sequence[str] = (),
    ) -> None:
        """Keep one frame: its local grid and pose, and, when accepted, its share of the map.

        Without `frame_id` frames are numbered from "000000". `images` names the files that the
        grid was made from. Raises ConfigError for a grid unlike the session's others, cells
        larger than the map's or a frame that is there already, DatumError for a pose too far
        from the datum.
        """
        if not self._open:
            raise ConfigError(f"Session {self.name!r} has ended; add frames inside its block.")
        self._check(grid, pose)
        identity = f"{self._count:06d}" if frame_id is None else str(frame_id)
        with explained(self._path, writing=True):
            self._staging.add_frame(frame_row(grid, pose, identity, tuple(map(str, images))))
            if is_accepted(pose):
                self._fold.add(grid, pose)
        self._spec = grid.spec
        self._count += 1

    def discard(self) -> None:
        """Forget everything that was added; nothing happens when it is in the map already."""
        if self._open:
            self._open = False
            self._staging.close()
            self._on_end(self._committed)

    def _check(self, grid: LocalGrid, pose: Pose) -> None:
        if self._spec is not None and grid.spec != self._spec:
            raise ConfigError(
                f"Session {self.name!r} has local grids of {_described(self._spec)}, and cannot "
                f"take one of {_described(grid.spec)}; make them alike, or use two sessions."
            )
        check_cell_sizes(self._matrices.lattice.cell_m, grid.spec.cell_m)
        if not is_accepted(pose):
            return
        if not all(math.isfinite(v) for v in (pose.east_m, pose.north_m, pose.heading_deg)):
            raise ConfigError(
                f"A pose at east {pose.east_m}, north {pose.north_m}, heading {pose.heading_deg} "
                "is marked ok; reject it, or give it numbers."
            )
        if max(abs(pose.east_m), abs(pose.north_m)) > MAX_DISTANCE_M:
            raise DatumError(
                f"A pose {pose.east_m:.0f} m east and {pose.north_m:.0f} m north is over "
                f"{MAX_DISTANCE_M / 1000:.0f} km from the map's datum; start another map there."
            )

    def _commit(self) -> None:
        with writing(self._connection, self._path):
            session_id = self._insert_session()
            self._insert_frames(session_id)
            self._insert_trajectory()
            pyramid = Pyramid(self._connection, self._matrices)
            pyramid.add(self._fold.tiles(), self._fold.sums)
            self._extend(pyramid.extent)
            self._connection.execute(f"UPDATE gpkg_contents SET last_change = {NOW_SQL}")

    def _insert_session(self) -> int:
        spec, track = self._spec, self._trajectory
        try:
            cursor = self._connection.execute(
                "INSERT INTO fieldgrid_session (name, created, source, config, software_version, "
                "heading_source, frames, accepted, grid_width_m, grid_length_m, grid_cell_m) "
                f"VALUES (?, {NOW_SQL}, ?, ?, ?, ?, 0, 0, ?, ?, ?)",
                (
                    self.name,
                    self._source,
                    self._config,
                    software_version(),
                    "" if track is None else track.heading_source,
                    *((spec.width_m, spec.length_m, spec.cell_m) if spec else (None, None, None)),
                ),
            )
        except sqlite3.IntegrityError as error:  # added by another program since this one began
            raise name_is_taken(self.name, self._path) from error
        assert cursor.lastrowid is not None
        return cursor.lastrowid

    def _insert_frames(self, session_id: int) -> None:
        self._connection.executemany(
            f"INSERT INTO fieldgrid_frame VALUES (NULL, ?{', ?' * 14})",
            ((session_id, *row) for row in self._staging.frames()),
        )
        positions = self._connection.execute(
            "SELECT frame_id, time_ns, east_m, north_m, heading_deg, status, reason "
            "FROM fieldgrid_frame WHERE session_id = ? ORDER BY id",
            (session_id,),
        ).fetchall()
        self._insert_points(
            "frame_position",
            "session, frame_id, time_ns, heading_deg, status, reason",
            (
                (east, north, (self.name, frame_id, time_ns, *rest))
                for frame_id, time_ns, east, north, *rest in positions
            ),
        )
        self._connection.execute(
            "UPDATE fieldgrid_session SET (frames, accepted, first_time_ns, last_time_ns) = "
            "(SELECT count(*), coalesce(sum(status = 'ok'), 0), min(time_ns), max(time_ns) "
            "FROM fieldgrid_frame WHERE session_id = ?1) WHERE id = ?1",
            (session_id,),
        )

    def _insert_trajectory(self) -> None:
        track = self._trajectory
        if track is None:
            return
        columns = (
            track.time_ns, track.up_m, track.heading_deg, track.heading_sigma_deg,
            track.position_sigma_m, track.speed_mps, track.quality,
        )  # fmt: skip
        rows = zip(
            *(column.tolist() for column in columns), track.status, track.reason, strict=True
        )
        self._insert_points(
            "trajectory",
            "session, time_ns, up_m, heading_deg, heading_sigma_deg, position_sigma_m, speed_mps, "
            "quality, status, reason",
            (
                (east, north, (self.name, *row))
                for east, north, row in zip(
                    track.east_m.tolist(), track.north_m.tolist(), rows, strict=True
                )
            ),
        )

    def _insert_points(
        self, table: str, columns: str, rows: Iterable[tuple[Any, Any, tuple[Any, ...]]]
    ) -> None:
        """Add (east, north, attributes) to a layer, and widen the extent that it announces."""
        points = [
            (encode_point(*(math.nan if v is None else v for v in (east, north))), *attributes)
            for east, north, attributes in rows
        ]
        places = ", ?" * (columns.count(",") + 1)
        self._connection.executemany(
            f"INSERT INTO {table} (geom, {columns}) VALUES (?{places})", points
        )
        blobs = [point[0] for point in points if point[0] is not None]
        if blobs:
            # East and north are the last sixteen bytes of a point.
            positions = np.frombuffer(b"".join(blob[-16:] for blob in blobs), dtype="<f8")
            east, north = positions[0::2], positions[1::2]
            self._widen(table, Bounds(east.min(), north.min(), east.max(), north.max()))

    def _extend(self, seen: Window | None) -> None:
        """Record which base cells have data, and the raster's extent for a GIS."""
        if seen is None:
            return
        before = self._connection.execute(
            "SELECT value FROM fieldgrid_meta WHERE key = 'data_window'"
        ).fetchone()
        window = union(None if before is None else Window(*json.loads(before[0])), seen)
        self._connection.execute(
            "INSERT OR REPLACE INTO fieldgrid_meta VALUES ('data_window', ?)",
            (json.dumps(list(window)),),
        )
        (top,) = self._connection.execute(
            "SELECT min(zoom_level) FROM gpkg_tile_matrix WHERE table_name = 'density'"
        ).fetchone()
        self._connection.execute(
            "UPDATE gpkg_contents SET (min_x, min_y, max_x, max_y) = (?, ?, ?, ?) "
            "WHERE table_name = 'density'",
            self._matrices.lattice.bounds(self._matrices.whole_cells(window, top)),
        )

    def _widen(self, table: str, bounds: Bounds) -> None:
        self._connection.execute(
            "UPDATE gpkg_contents SET min_x = min(?1, coalesce(min_x, ?1)), "
            "min_y = min(?2, coalesce(min_y, ?2)), max_x = max(?3, coalesce(max_x, ?3)), "
            "max_y = max(?4, coalesce(max_y, ?4)) WHERE table_name = ?5",
            (*(float(v) for v in bounds), table),
        )


def name_is_taken(name: str, path: Path) -> ConfigError:
    """The error for a second session of one name."""
    return ConfigError(f"{path} has a session {name!r} already; give another name with --name.")


def _as_json(config: Mapping[str, Any]) -> str:
    try:
        return json.dumps(dict(config), ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"The session's config cannot be stored as JSON ({error}); "
            "use numbers, texts, lists and dictionaries."
        ) from error


def _described(spec: GridSpec) -> str:
    return f"{spec.width_m} x {spec.length_m} m in cells of {spec.cell_m} m"
