"""Opening a map file: to read it, to add to it, or to make a new one."""

from __future__ import annotations

import sqlite3
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds, Lattice
from fieldgrid.mapfile import schema
from fieldgrid.mapfile.database import connect, explained, keep_one_file, reading, writing
from fieldgrid.mapfile.evidence import Evidence
from fieldgrid.mapfile.header import Header, read_header
from fieldgrid.mapfile.publish import Draft
from fieldgrid.mapfile.records import FrameRecord, SessionInfo, frame_record
from fieldgrid.mapfile.session import Session, name_is_taken
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.view import MapView, empty_view, fold
from fieldgrid.trajectory import Trajectory
from fieldgrid.transfer import Averaging, Transfer, check_cell_sizes

DEFAULT_CELL_M = 0.05


def open_map(
    path: str | Path,
    *,
    datum: Datum | None = None,
    cell_m: float | None = None,
    transfer: Transfer | None = None,
) -> MapFile:
    """Open a map: without `datum` to read it, with one to add sessions to it.

    With `datum` a map that does not exist is made, with cells of `cell_m` (0.05 m when not
    given) and the `transfer` rule (centre when not given). A map that exists keeps its own:
    another datum raises DatumError, another cell size or rule ConfigError. A file that is
    absent, foreign, damaged or of a newer format raises MapError.
    """
    path = Path(path)
    if datum is not None and not path.exists():
        return create_map(path, datum, cell_m=cell_m, transfer=transfer)
    if not path.is_file():
        raise MapError(f"There is no map {path}; check the name, or build it first.")
    connection = connect(path, path, writable=datum is not None)
    try:
        with reading(connection, path):
            header = read_header(connection, path)
        if datum is not None:
            header.check_datum(path, datum)
            header.check_settings(path, cell_m, transfer)
            with explained(path, writing=True):
                keep_one_file(connection, durable=True)
    except BaseException:
        connection.close()
        raise
    return MapFile(path, connection, header, writable=datum is not None)


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
    ) -> Session:
        """A session to add frames to, inside `with`: all of it is added at the end, or nothing.

        `trajectory` is stored as a layer of points; `config` is kept as JSON; `source` names
        the recording, with its hash if there is one. Raises ConfigError when the map has a
        session of that name, DatumError when the trajectory has another datum.
        """
        self._require_writable()
        if not name or not name.isprintable():
            raise ConfigError(f"A session cannot be called {name!r}; give --name a printable one.")
        if trajectory is not None:
            self._header.check_datum(self.path, trajectory.datum)
        with reading(self._connection, self.path):
            if self._evidence.has_session(name):
                raise name_is_taken(name, self.path)
        self._session = Session(
            self._connection,
            self.path,
            name,
            matrices=TileMatrixSet(self._header.lattice),
            transfer=self._header.transfer,
            trajectory=trajectory,
            config=config or {},
            source=source,
            on_end=self._session_ended,
        )
        return self._session

    def sessions(self) -> list[SessionInfo]:
        """The sessions, in the order in which they were added."""
        with reading(self._connection, self.path):
            return self._evidence.sessions()

    def frames(
        self, session: str | None = None, *, with_grid: bool = False
    ) -> Iterator[FrameRecord]:
        """The frames of one or of all sessions, rejected ones included, in time order.

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
        averaging: Averaging = Averaging.MEAN,
        transfer: Transfer | None = None,
        sessions: Collection[str] | None = None,
        frame_filter: Callable[[FrameRecord], bool] | None = None,
    ) -> MapView:
        """The universal grid within `bounds` (all of it when not given) as arrays.

        With the map's own cell and rule and all its frames it comes from the stored tiles.
        Anything else is folded anew from the accepted frames: another `cell_m` (not below the
        local grids': ConfigError), another `transfer`, the `averaging` of the paper (in time
        order, by cell centres), only some `sessions`, only frames for which `frame_filter` is
        true. Raises MapError when the map has no observed cell, ConfigError when the view
        would exceed 400 million cells.
        """
        if averaging is Averaging.PAPER and transfer is Transfer.AREA:
            raise ConfigError(
                "The paper's averaging goes by cell centres; leave out transfer='area', or take "
                "the mean."
            )
        header, rule = self._header, transfer or self.transfer
        lattice = header.lattice_of(cell_m)
        as_stored = (lattice, rule, averaging) == (header.lattice, header.transfer, Averaging.MEAN)
        with reading(self._connection, self.path):
            extent = header.lattice.bounds(self._evidence.data_window())
            view = empty_view(lattice, lattice.window(bounds or extent), self.datum)
            if as_stored and sessions is None and frame_filter is None:
                self._evidence.fill_from_tiles(view)
            else:
                frames = self._evidence.accepted(view.bounds, sessions, frame_filter)
                for frame in frames:
                    check_cell_sizes(lattice.cell_m, frame.spec.cell_m)
                fold(view, frames, averaging, rule)
        return view

    def _blobs(self, row: tuple[Any, ...]) -> Callable[[], tuple[object, object]]:
        with reading(self._connection, self.path):
            blobs = self._evidence.blobs(row)
        return lambda: blobs

    def _require_writable(self) -> None:
        if not self._release.alive:
            raise ConfigError(f"{self.path} is closed; open it again to add a session.")
        if not self._writable:
            raise ConfigError(
                f"{self.path} was opened for reading; open it with datum=... to add a session."
            )
        if self._session is not None:
            raise ConfigError(
                f"Session {self._session.name!r} has not ended; add one session at a time."
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
