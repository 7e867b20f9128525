"""Adding a drive to a map: all of it, or nothing."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from fieldgrid.errors import ConfigError, DatumError
from fieldgrid.geodesy import MAX_DISTANCE_M
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.mapfile import derived
from fieldgrid.mapfile.arrays import Array, Kind, array_rows, trajectory_arrays
from fieldgrid.mapfile.database import explained, writing
from fieldgrid.mapfile.digest import session_digest
from fieldgrid.mapfile.records import FrameRecord, frame_row, is_accepted
from fieldgrid.mapfile.schema import NOW_SQL, software_version
from fieldgrid.mapfile.staging import SessionFold, Staging
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.quality import Quality
from fieldgrid.trajectory import Pose, Trajectory
from fieldgrid.transfer import Transfer, check_cell_sizes


class About(NamedTuple):
    """What is kept of a session beside its frames. `created` is empty for one of now."""

    name: str
    trajectory: Trajectory | None
    config: str
    source: str
    source_sha256: str
    inputs: Mapping[str, Array]
    software_version: str
    created: str = ""

    @property
    def heading_source(self) -> str:
        """How the headings of the trajectory were found."""
        return "" if self.trajectory is None else self.trajectory.heading_source

    @property
    def arrays(self) -> dict[Kind, Mapping[str, Array]]:
        """All arrays, by kind."""
        track = self.trajectory
        return {
            Kind.TRAJECTORY: {} if track is None else trajectory_arrays(track),
            Kind.INPUT: self.inputs,
        }


def about_session(
    name: str,
    trajectory: Trajectory | None,
    config: Mapping[str, Any] | None,
    source: str,
    source_sha256: str,
    inputs: Mapping[str, Array] | None,
) -> About:
    """A session of now; ConfigError for a name, config or array that cannot be stored."""
    if not name or not name.isprintable():
        raise ConfigError(f"A session cannot be called {name!r}; give --name a printable one.")
    about = About(
        name,
        trajectory,
        as_json(config or {}),
        source,
        source_sha256,
        {key: np.array(value) for key, value in (inputs or {}).items()},
        software_version(),
    )
    array_rows(Kind.INPUT, about.inputs)
    return about


class Session:
    """One drive on its way into a map; made by `MapFile.add_session`, used with `with`.

    Nothing is in the map before the end of the block, and nothing ever when it raises.
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        path: Path,
        about: About,
        *,
        matrices: TileMatrixSet,
        transfer: Transfer,
        on_end: Callable[[bool], None],
    ) -> None:
        self.name = about.name
        self._about = about
        self._connection = connection
        self._path = path
        self._matrices = matrices
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
        images_sha256: Sequence[str] = (),
    ) -> None:
        """Keep one frame: its local grid and pose, and, when accepted, its share of the map.

        Without `frame_id` frames are numbered from "000000". `images` names the files that the
        grid was made from, `images_sha256` are their hashes. Raises ConfigError for a grid unlike
        the session's others, cells larger than the map's or a frame that is there already,
        DatumError for a pose too far from the datum.
        """
        if not self._open:
            raise ConfigError(f"Session {self.name!r} has ended; add frames inside its block.")
        self._check(grid, pose)
        identity = f"{self._count:06d}" if frame_id is None else str(frame_id)
        quality = quality_at(self._about.trajectory, pose.time_ns)
        names = [str(image) for image in images]
        self._keep(grid, pose, frame_row(grid, pose, identity, quality, names, images_sha256))

    def add_record(self, frame: FrameRecord) -> None:
        """Keep a frame of another map as it is there."""
        grid, pose = frame.grid(), frame.pose
        self._check(grid, pose)
        row = frame_row(
            grid, pose, frame.frame_id, frame.quality, frame.images, frame.images_sha256
        )
        self._keep(grid, pose, row)

    def _keep(self, grid: LocalGrid, pose: Pose, row: tuple[Any, ...]) -> None:
        with explained(self._path, writing=True):
            self._staging.add_frame(row)
            if is_accepted(pose):
                self._fold.add(grid, pose)
        self._spec = grid.spec
        self._count += 1

    def discard(self) -> None:
        """Forget everything that was added; nothing happens when it is in the map already."""
        if self._open:
            self._open = False
            self._fold.close()
            self._on_end(self._committed)

    def _check(self, grid: LocalGrid, pose: Pose) -> None:
        if self._spec is not None and grid.spec != self._spec:
            raise ConfigError(
                f"Session {self.name!r} has local grids of {_described(self._spec)}, and cannot "
                f"take one of {_described(grid.spec)}; make them alike, or use two sessions."
            )
        check_cell_sizes(self._matrices.lattice.cell_m, grid.spec.cell_m)
        check_pose(pose)

    def _commit(self) -> None:
        with writing(self._connection, self._path):
            session_id = self._insert_session()
            self._connection.executemany(
                f"INSERT INTO fieldgrid_frame VALUES (NULL, ?{', ?' * 17})",
                ((session_id, *row) for row in self._staging.frames()),
            )
            put_arrays(self._connection, session_id, self._about.arrays)
            sum_up(self._connection, session_id, self._about)
            derived.show(
                self._connection,
                self._matrices,
                session_id,
                self.name,
                self._about.trajectory,
                self._fold,
            )

    def _insert_session(self) -> int:
        about, spec = self._about, self._spec
        try:
            cursor = self._connection.execute(
                "INSERT INTO fieldgrid_session (name, created, source, source_sha256, config, "
                "software_version, heading_source, frames, accepted, grid_width_m, grid_length_m, "
                f"grid_cell_m, digest) VALUES (?, coalesce(nullif(?, ''), {NOW_SQL}), "
                "?, ?, ?, ?, ?, 0, 0, ?, ?, ?, '')",
                (
                    about.name,
                    about.created,
                    about.source,
                    about.source_sha256,
                    about.config,
                    about.software_version,
                    about.heading_source,
                    *((spec.width_m, spec.length_m, spec.cell_m) if spec else (None, None, None)),
                ),
            )
        except sqlite3.IntegrityError as error:  # added by another program since this one began
            raise name_is_taken(self.name, self._path) from error
        assert cursor.lastrowid is not None
        return cursor.lastrowid


def put_arrays(
    connection: sqlite3.Connection, session_id: int, arrays: Mapping[Kind, Mapping[str, Array]]
) -> None:
    """Store arrays with a session in place of those of the same kind."""
    for kind, named in arrays.items():
        connection.execute(
            "DELETE FROM fieldgrid_array WHERE session_id = ? AND kind = ?",
            (session_id, kind.value),
        )
        connection.executemany(
            "INSERT INTO fieldgrid_array VALUES (?, ?, ?, ?, ?, ?, ?)",
            ((session_id, *row) for row in array_rows(kind, named)),
        )


def sum_up(connection: sqlite3.Connection, session_id: int, about: About) -> None:
    """Bring a session's own row up to date with its frames and arrays."""
    connection.execute(
        "UPDATE fieldgrid_session SET (frames, accepted, first_time_ns, last_time_ns) = "
        "(SELECT count(*), coalesce(sum(status = 'ok'), 0), min(time_ns), max(time_ns) "
        "FROM fieldgrid_frame WHERE session_id = ?1) WHERE id = ?1",
        (session_id,),
    )
    (*grid, heading_source) = connection.execute(
        "SELECT grid_width_m, grid_length_m, grid_cell_m, heading_source FROM fieldgrid_session "
        "WHERE id = ?",
        (session_id,),
    ).fetchone()
    frames = connection.execute(
        "SELECT digest FROM fieldgrid_frame WHERE session_id = ?", (session_id,)
    )
    connection.execute(
        "UPDATE fieldgrid_session SET digest = ? WHERE id = ?",
        (digest_of(about, grid, heading_source, [row[0] for row in frames]), session_id),
    )


def digest_of(
    about: About, grid: Sequence[float | None], heading_source: str, frames: Sequence[str]
) -> str:
    """The digest of a session; `grid` is its width, length and cell, or three times None."""
    values = (
        about.source, about.source_sha256, about.config, about.software_version, heading_source,
        *grid,
    )  # fmt: skip
    return session_digest(values, about.arrays, frames)


def check_pose(pose: Pose) -> None:
    """Raise for an accepted pose that cannot be folded: without numbers, or far from the datum."""
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


def quality_at(track: Trajectory | None, time_ns: int) -> int | None:
    """The quality of the accepted fix nearest in time, None where there is none.

    Poses between fixes, whose quality is that of an estimate, are not asked.
    """
    if track is None:
        return None
    accepted = np.flatnonzero(track.accepted & (track.quality != Quality.ESTIMATED))
    if accepted.size == 0:
        return None
    times_ns = track.time_ns[accepted]
    after = int(np.searchsorted(times_ns, time_ns))
    near = [k for k in (after - 1, after) if 0 <= k < accepted.size]
    nearest = min(near, key=lambda k: abs(int(times_ns[k]) - time_ns))
    return int(track.quality[accepted[nearest]])


def name_is_taken(name: str, path: Path, *, removed: bool = False) -> ConfigError:
    """The error for a second session of one name."""
    if removed:
        return ConfigError(
            f"{path} has a session {name!r} that was removed; put it back with --restore, or give "
            "another name with --name."
        )
    return ConfigError(f"{path} has a session {name!r} already; give another name with --name.")


def as_json(config: Mapping[str, Any]) -> str:
    """A session's config as it is stored; ConfigError when it is no JSON."""
    try:
        return json.dumps(dict(config), ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"The session's config cannot be stored as JSON ({error}); "
            "use numbers, texts, lists and dictionaries."
        ) from error


def _described(spec: GridSpec) -> str:
    return f"{spec.width_m} x {spec.length_m} m in cells of {spec.cell_m} m"
