"""Opening a map file: to read it, to add to it, or to make a new one."""

from __future__ import annotations

import math
import sqlite3
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds, Lattice
from fieldgrid.mapfile import revision, schema
from fieldgrid.mapfile.arrays import Array
from fieldgrid.mapfile.cells import check_layers
from fieldgrid.mapfile.change import ChangeView
from fieldgrid.mapfile.database import (
    clear_journal,
    connect,
    explained,
    keep_one_file,
    reading,
    writing,
)
from fieldgrid.mapfile.evidence import Evidence
from fieldgrid.mapfile.header import Header, read_header
from fieldgrid.mapfile.pieces import Pieces, read_pieces
from fieldgrid.mapfile.provenance import Provenance, trace
from fieldgrid.mapfile.reading import (
    Request,
    extent_of,
    read_change,
    read_view,
    sessions_at,
)
from fieldgrid.mapfile.records import FrameRecord, SessionInfo, frame_record
from fieldgrid.mapfile.session import About, Session, about_session, name_is_taken
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.verification import Verdict, repair, verify
from fieldgrid.mapfile.view import MapView
from fieldgrid.publish import Draft
from fieldgrid.trajectory import Pose, Trajectory
from fieldgrid.transfer import Averaging, Transfer, check_cell_sizes

DEFAULT_CELL_M = 0.05


def open_map(
    path: str | Path,
    *,
    datum: Datum | None = None,
    cell_m: float | None = None,
    transfer: Transfer | None = None,
    writable: bool = False,
) -> MapFile:
    """Open a map: to read it, or with `datum` or `writable` to change it.

    `writable` is for a map that exists, whatever its datum. With `datum` a map that does not
    exist is made, with cells of `cell_m` (0.05 m when not given) and the `transfer` rule (centre
    when not given). A map that exists keeps its own: another datum raises DatumError, another
    cell size or rule ConfigError. A file that is absent, foreign, damaged or of another format
    raises MapError.
    """
    path = Path(path)
    if datum is not None and not path.exists():
        return create_map(path, datum, cell_m=cell_m, transfer=transfer)
    if not path.is_file():
        raise MapError(f"There is no map {path}; check the name, or build it first.")
    writable = writable or datum is not None
    connection = connect(path, path, writable=writable)
    try:
        with reading(connection, path):
            header = read_header(connection, path)
        if datum is not None:
            header.check_datum(path, datum)
        header.check_settings(path, cell_m, transfer)
        if writable:
            with explained(path, writing=True):
                keep_one_file(connection, durable=True)
    except BaseException:
        connection.close()
        raise
    return MapFile(path, connection, header, writable=writable)


def create_map(
    path: str | Path,
    datum: Datum,
    *,
    cell_m: float | None = None,
    transfer: Transfer | None = None,
    overwrite: bool = False,
) -> MapFile:
    """Make a new map, which appears at `path` when its block ends with a session in it.

    Until then it is a file of another name beside `path`, and a map that is to be overwritten
    is untouched. Raises MapExistsError when `path` exists and may not be overwritten.
    """
    path = Path(path)
    lattice = Lattice(DEFAULT_CELL_M if cell_m is None else cell_m)
    header = Header(datum, lattice, transfer or Transfer.CENTRE)
    draft = Draft(path, overwrite=overwrite, advice="--append to add a session to it, ")
    try:
        connection = connect(draft.file, path, writable=True)
    except BaseException:
        draft.discard()
        raise
    universal = MapFile(path, connection, header, writable=True, draft=draft)
    try:
        with explained(path, writing=True):
            keep_one_file(connection, durable=False)  # it is synced once, before it is published
        with writing(connection, path):
            schema.create(connection, datum, TileMatrixSet(lattice), header.transfer)
    except BaseException:
        universal.discard()
        raise
    return universal


def read_datum(path: str | Path) -> Datum:
    """The datum of an existing map, for what is to be added to it."""
    with open_map(path) as universal:
        return universal.datum


class MapFile:
    """A map that is open: read it, and add sessions to it when it was opened with a datum.

    Use it with `with`, or close it. Made by `open_map` and `create_map`. It may be used by one
    thread at a time.
    """

    def __init__(
        self,
        path: Path,
        connection: sqlite3.Connection,
        header: Header,
        *,
        writable: bool,
        draft: Draft | None = None,
    ) -> None:
        self.path = path
        self._connection = connection
        self._header = header
        self._evidence = Evidence(connection, path)
        self._draft = draft
        self._writable = writable
        self._session: Session | None = None
        self._has_new_session = False
        # Also a map that is forgotten gives up its file, and its draft.
        self._release = weakref.finalize(self, _release, connection, draft)

    @property
    def datum(self) -> Datum:
        """The origin of the map's plane; it never changes."""
        return self._header.datum

    @property
    def cell_m(self) -> float:
        """Side of the base cells, L_U, in metres."""
        return self._header.lattice.cell_m

    @property
    def transfer(self) -> Transfer:
        """The rule by which local cells were carried into the base cells."""
        return self._header.transfer

    @property
    def bounds(self) -> Bounds:
        """The extent of the observed cells in metres; MapError when there are none."""
        with reading(self._connection, self.path):
            return self._header.lattice.bounds(self._evidence.data_window())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def close(self) -> None:
        """Close the map. A new one gets its name now, if it has a session."""
        self._abandon_session()
        try:
            if self._draft is not None and self._has_new_session and self._release.alive:
                self._connection.close()
                clear_journal(self.path.resolve())  # of a map that is to be replaced
                self._draft.publish()
        finally:
            self._release()

    def discard(self) -> None:
        """Close the map, and give up a new one; what an existing map was given stays."""
        self._abandon_session()
        self._release()

    def add_session(
        self,
        name: str,
        *,
        trajectory: Trajectory | None = None,
        config: Mapping[str, Any] | None = None,
        source: str = "",
        source_sha256: str = "",
        inputs: Mapping[str, Array] | None = None,
    ) -> Session:
        """A session to add frames to, inside `with`: all of it is added at the end, or nothing.

        `trajectory` is stored, and shown as a layer of points; `config` is kept as JSON; `source`
        names the log of fixes, `source_sha256` is its hash. `inputs` are named arrays that the
        map keeps without looking into them. Raises ConfigError when the map has a session of
        that name, DatumError when the trajectory has another datum.
        """
        return self.add_about(
            about_session(name, trajectory, config, source, source_sha256, inputs)
        )

    def add_about(self, about: About) -> Session:
        """`add_session` of what is known already, as when it comes from another map."""
        self._require_writable()
        if about.trajectory is not None:
            self._header.check_datum(self.path, about.trajectory.datum)
        with reading(self._connection, self.path):
            is_active = self._evidence.find_name(about.name)
        if is_active is not None:
            raise name_is_taken(about.name, self.path, removed=not is_active)
        self._session = Session(
            self._connection,
            self.path,
            about,
            matrices=TileMatrixSet(self._header.lattice),
            transfer=self._header.transfer,
            on_end=self._session_ended,
        )
        return self._session

    def remove_session(self, name: str) -> None:
        """Take a session out: the map is as if it had never had it. The evidence is kept.

        Raises ConfigError when there is none of that name, or it is removed already.
        """
        with self._changing():
            revision.remove(self._connection, self.path, self._header, name)

    def restore_session(self, name: str) -> None:
        """Put back a session that was removed: the map is as if it had never been."""
        with self._changing():
            revision.restore(self._connection, self.path, self._header, name)

    def repose(
        self,
        name: str,
        poses: Mapping[str, Pose],
        trajectory: Trajectory | None = None,
        config: Mapping[str, Any] | None = None,
    ) -> None:
        """Give the frames of a session other poses and verdicts, without their images.

        `poses` has one for each frame_id. `trajectory` and `config` replace those of the session
        where they are given. The map is then as if the session had been added so. Raises
        ConfigError when a frame is left out, DatumError for a trajectory of another datum.
        """
        if trajectory is not None:
            self._header.check_datum(self.path, trajectory.datum)
        with self._changing():
            revision.repose(
                self._connection, self.path, self._header, name, poses, trajectory, config
            )

    def sessions(self) -> list[SessionInfo]:
        """The sessions, in the order in which they were added, removed ones included."""
        with reading(self._connection, self.path):
            return self._evidence.sessions()

    def about(self, name: str) -> About:
        """All that is kept of a session beside its frames, for `add_about` of another map."""
        with reading(self._connection, self.path):
            return revision.find(self._connection, self.path, self.datum, name).about

    def has_datum(self, datum: Datum) -> bool:
        """Whether a datum is that of the map, up to rounding."""
        return self._header.is_datum(datum)

    def verify(self) -> Verdict:
        """Check the file, the evidence against its hashes, and that all else follows from it."""
        with reading(self._connection, self.path):
            return verify(self._connection, self.path, self._header)

    def repair(self) -> None:
        """Make everything anew that follows from the evidence: tiles, pictures, layers.

        Raises MapError when the evidence itself is damaged.
        """
        with self._changing():
            repair(self._connection, self.path, self._header)

    def sessions_at(self, at: str | int) -> list[str]:
        """The names of the active sessions as of a moment, in the order of their drives.

        `at` is a session, a date or time as in ISO 8601 (UTC), or UTC in nanoseconds.
        """
        with reading(self._connection, self.path):
            return list(sessions_at(self._evidence, at, self.path))

    def session_inputs(self, name: str) -> dict[str, Array]:
        """The arrays that `add_session` was given as `inputs`, bit for bit."""
        with reading(self._connection, self.path):
            return self._evidence.inputs(name)

    def frames(
        self, session: str | None = None, *, with_grid: bool = False
    ) -> Iterator[FrameRecord]:
        """The frames of one or of all active sessions, rejected ones included, in time order.

        With `with_grid` each carries its compressed local grid, for `FrameRecord.grid`.
        """
        with reading(self._connection, self.path):
            rows = self._evidence.frame_rows(None if session is None else [session])
        # The map is not locked between two frames, however long the caller takes.
        return (frame_record(row, self._blobs(row) if with_grid else _no_blobs) for row in rows)

    def trajectory(self, session: str) -> Trajectory:
        """The trajectory that was stored with a session, bit for bit."""
        with reading(self._connection, self.path):
            return self._evidence.trajectory(session, self.datum)

    def read(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        averaging: Averaging = Averaging.MEAN,
        transfer: Transfer | None = None,
        sessions: Collection[str] | None = None,
        frame_filter: Callable[[FrameRecord], bool] | None = None,
    ) -> MapView:
        """The universal grid within `bounds` (all of it when not given) as arrays.

        `layers` adds to the density: count, variance, max, sessions, persistence, height. `at` is a
        session or a date: the map as of then; `sessions` are some of them by name.

        With the map's own cell, or that times a power of two, and its own rule it comes from
        the stored tiles, of which only those within `bounds` are touched. Anything else is folded
        anew from the accepted frames: another `cell_m` (not below the local grids':
        ConfigError), another `transfer`, the `averaging` of the paper (in time order, by cell
        centres), only frames for which `frame_filter` is true. Raises MapError when the map has
        no observed cell, ConfigError when the view would exceed 400 million cells.
        """
        if averaging is Averaging.PAPER and transfer is Transfer.AREA:
            raise ConfigError(
                "The paper's averaging goes by cell centres; leave out transfer='area', or take "
                "the mean."
            )
        names = check_layers(layers)
        with reading(self._connection, self.path):
            request = self._request(bounds, cell_m, transfer)
            request = request._replace(
                averaging=averaging,
                sessions=self._chosen(at, sessions),
                frame_filter=frame_filter,
                layers=names,
            )
            return read_view(self._evidence, self._header, request)

    @contextmanager
    def pieces(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
    ) -> Iterator[Pieces]:
        """What `read` gives, in views of some million cells, for maps of any size.

        One state of the map for as long as the block lasts: nobody can change it meanwhile.
        Errors as in `read`, but that ten thousand million cells are allowed.
        """
        names = check_layers(layers)
        with reading(self._connection, self.path):
            request = self._request(bounds, cell_m, None)
            request = request._replace(sessions=self._chosen(at, None), layers=names)
            yield read_pieces(self._evidence, self._header, request)

    def diff(
        self,
        from_: str | int,
        to: str | int,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
    ) -> ChangeView:
        """What the drives after `from_` and up to `to` found, beside what was known by `from_`.

        Both are sessions or dates. In each cell the latest drive that observed it counts.
        """
        with reading(self._connection, self.path):
            request = self._request(bounds, cell_m, None)
            return read_change(self._evidence, self._header, request, (from_, to), self.path)

    def query(self, east_m: float, north_m: float, cell_m: float | None = None) -> Provenance:
        """Which sessions and frames observed the cell at a point, and what each said of it."""
        if not (math.isfinite(east_m) and math.isfinite(north_m)):
            raise ConfigError(f"A point at {east_m}, {north_m} is nowhere; give metres.")
        lattice = self._header.lattice_of(cell_m)
        half_m = lattice.cell_m
        near = Bounds(east_m - half_m, north_m - half_m, east_m + half_m, north_m + half_m)
        with reading(self._connection, self.path):
            frames = self._evidence.accepted(near, None, None)
            for frame in frames:
                check_cell_sizes(lattice.cell_m, frame.spec.cell_m)
            return trace(east_m, north_m, lattice, self.transfer, frames)

    def _request(
        self, bounds: Bounds | None, cell_m: float | None, transfer: Transfer | None
    ) -> Request:
        lattice = self._header.lattice_of(cell_m)
        extent = extent_of(self._evidence, self._header)
        return Request(lattice, lattice.window(bounds or extent), transfer or self.transfer)

    def _chosen(
        self, at: str | int | None, sessions: Collection[str] | None
    ) -> tuple[str, ...] | None:
        """The sessions that are asked for in the order of their drives; None for all."""
        if at is None and sessions is None:
            return None
        every = [info.name for info in self._evidence.active()]
        chosen = set(every if at is None else sessions_at(self._evidence, at, self.path))
        if sessions is not None:
            self._evidence.check_sessions(sessions, active=True)
            chosen &= set(sessions)
        return None if chosen == set(every) else tuple(n for n in every if n in chosen)

    def _blobs(self, row: tuple[Any, ...]) -> Callable[[], tuple[object, object]]:
        with reading(self._connection, self.path):
            blobs = self._evidence.blobs(row)
        return lambda: blobs

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """One transaction in which the map is changed."""
        self._require_writable()
        with writing(self._connection, self.path):
            yield

    def _require_writable(self) -> None:
        if not self._release.alive:
            raise ConfigError(f"{self.path} is closed; open it again to change it.")
        if not self._writable:
            raise ConfigError(
                f"{self.path} was opened for reading; open it with datum=... or writable=True to "
                "change it."
            )
        if self._session is not None:
            raise ConfigError(
                f"Session {self._session.name!r} has not ended; make one change at a time."
            )

    def _session_ended(self, committed: bool) -> None:
        self._session = None
        self._has_new_session |= committed

    def _abandon_session(self) -> None:
        if self._session is not None:
            self._session.discard()


def _release(connection: sqlite3.Connection, draft: Draft | None) -> None:
    connection.close()
    if draft is not None:
        draft.discard()


def _no_blobs() -> tuple[object, object]:
    raise ConfigError("The frame was read without its grid; ask for frames(with_grid=True).")
