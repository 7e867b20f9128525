"""What can be read of a map that is open."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from fieldgrid.core import ConfigError, MapError, runner
from fieldgrid.geometry import Bounds, Datum, Trajectory
from fieldgrid.maps.file.arrays import Array
from fieldgrid.maps.file.codec import EncodedChannel
from fieldgrid.maps.file.database import reading
from fieldgrid.maps.file.evidence import EvidenceTables, loader, reaches
from fieldgrid.maps.file.header import MapHeader, check_plane
from fieldgrid.maps.file.metadata import SessionMetadata, find
from fieldgrid.maps.file.records import FrameRecord, SessionInfo, frame_record
from fieldgrid.maps.file.root import read_root
from fieldgrid.maps.health.verification import HealthReport, verify
from fieldgrid.maps.transfer import Averaging, Transfer
from fieldgrid.maps.vector.marks import Mark, read_marks
from fieldgrid.maps.vector.stored_features import StoredFeatures, read_stored_features
from fieldgrid.maps.views.change import ChangeView, read_change
from fieldgrid.maps.views.content import MapContent
from fieldgrid.maps.views.deciding import read_views
from fieldgrid.maps.views.readable import DrivenMap, Selection
from fieldgrid.maps.views.view import MapView
from fieldgrid.maps.writing.transform import Transform

if TYPE_CHECKING:
    from distributed import Client


class MapReader(DrivenMap):
    """The part of `MapFile` that reads."""

    def __init__(self, path: Path, connection: sqlite3.Connection, header: MapHeader) -> None:
        self.path = path
        self._connection = connection
        self._header = header
        self._evidence = EvidenceTables(connection, path)

    def __getstate__(self) -> NoReturn:
        raise TypeError(
            f"{self.path} is open and cannot be sent to another process; send its path, and open "
            "it there."
        )

    @contextmanager
    def content(self) -> Iterator[MapContent]:
        """What views are made of, in one state of the map, for whoever joins several maps."""
        with reading(self._connection, self.path):
            yield MapContent(self._evidence, self._header)

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

    def transform(self, name: str) -> Transform:
        """The transform that puts a session into its place in the map."""
        with reading(self._connection, self.path):
            return self._evidence.transform(name)

    def sessions(self) -> list[SessionInfo]:
        """The sessions, in the order in which they were added, removed ones included."""
        with reading(self._connection, self.path):
            return self._evidence.sessions()

    def marks(self, *, within: Bounds | None = None, removed: bool = False) -> tuple[Mark, ...]:
        """What people said of places, in the order in which it was added: what is in force, and
        with `removed` what was taken out, too; of those `within` bounds with any part of them."""
        with reading(self._connection, self.path):
            marks = read_marks(self._connection, removed=removed)
        return tuple(mark for mark in marks if within is None or mark.lies_in(within))

    def kept_features(self) -> StoredFeatures | None:
        """What was found in the map and is kept in it as layers; None where that is nothing."""
        with reading(self._connection, self.path):
            return read_stored_features(self._connection)

    def metadata(self, name: str) -> SessionMetadata:
        """All that is kept of a session beside its frames, for `add_session_of` of another map."""
        with reading(self._connection, self.path):
            return find(self._connection, self.path, self.datum, name).metadata

    def has_datum(self, datum: Datum) -> bool:
        """Whether a datum is that of the map, up to rounding."""
        return self._header.is_datum(datum)

    @property
    def root_sha256(self) -> str:
        """The root digest: of settings, plane, sessions and marks, and so of all evidence."""
        with reading(self._connection, self.path):
            return read_root(self._connection).of_content

    def check_quickly(self) -> None:
        """Raise MapError unless the settings, the plane, the list of sessions and the marks are as
        they were written. No frame and no tile is read: `verify` does that."""
        with reading(self._connection, self.path):
            check_plane(self._connection, self.path, self.datum)
            if not read_root(self._connection).trusted:
                raise MapError(
                    f"The settings, the list of sessions or the marks of {self.path} have changed "
                    "since they were written; see `fieldgrid verify`, or restore a copy."
                )

    def verify(
        self,
        jobs: int | None = None,
        *,
        deep: bool = False,
        scheduler: str | Client | None = None,
    ) -> HealthReport:
        """Check that the map is what was written, by the sums that it keeps of its rows.

        With `deep`, or where they do not fit, the evidence is checked against its hashes, and all
        else made again from it and compared. `jobs` is the number of threads, all cores when not
        given; with a `scheduler`, the address of one of Dask or a client, the workers of that
        cluster do what is `deep`. ConfigError for a scheduler without `deep`, ClusterError where
        none answers or its workers cannot read the map.
        """
        if scheduler is not None and not deep:
            raise ConfigError(
                "The workers of a cluster verify a map only as a whole; add --deep, or leave out "
                "--scheduler."
            )
        with runner(jobs, scheduler) as run, reading(self._connection, self.path):
            return verify(self._connection, self.path, self._header, run, deep=deep)

    def check_sessions(self, names: Collection[str]) -> None:
        """Raise ConfigError unless all these are names of active sessions."""
        with reading(self._connection, self.path):
            self._evidence.check_sessions(names, active=True)

    def session_inputs(self, name: str) -> dict[str, Array]:
        """The arrays that `add_session` was given as `inputs`, bit for bit."""
        with reading(self._connection, self.path):
            return self._evidence.inputs(name)

    def frames(
        self,
        session: str | None = None,
        *,
        with_grid: bool = False,
        near: Bounds | None = None,
    ) -> Iterator[FrameRecord]:
        """The frames of one or of all active sessions, rejected ones included, in time order.

        With `with_grid` each carries its compressed local grid, for `FrameRecord.grid`. With `near`
        only those of which a cell may lie in these bounds; the grids of others are not read.
        """
        with reading(self._connection, self.path):
            rows = self._evidence.frame_rows(None if session is None else [session])
        records = ((row, frame_record(row, _no_grid)) for row in rows)
        # The map is not locked between two frames, however long the caller takes.
        return (
            replace(record, load=self._channels(row)) if with_grid else record
            for row, record in records
            if near is None or reaches(record, near)
        )

    def trajectory(self, session: str, *, as_driven: bool = False) -> Trajectory:
        """The trajectory of a session as it is placed in the map, or `as_driven`: as it was stored,
        bit for bit."""
        with reading(self._connection, self.path):
            track = self._evidence.trajectory(session, self.datum)
            return track if as_driven else self._evidence.transform(session).trajectory(track)

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
        jobs: int | None = None,
        decide: str = "",
    ) -> MapView:
        """The universal grid within `bounds` (all of it when not given) as arrays.

        `layers` adds to the density: any of `layers.registry.LAYERS`. `at` is a session or a date:
        the map as of then, or `FROM..TO`: of the drives of a season (`sessions_at`); `sessions` are
        some of them by name. `jobs` threads read it, all cores when not given. `decide` is the
        layer of densities by which `MapView.decision` says what the cells count as, `density` for
        most.

        With the map's own cell or a whole multiple of it, and its own rule, it comes from the
        stored tiles, of which only those within `bounds` are touched. Anything else is folded
        anew from the accepted frames: another `cell_m` (not below the local grids':
        ConfigError), another `transfer`, the `averaging` of the paper (in time order, by cell
        centres), only frames for which `frame_filter` is true, layers whose channels the map does
        not hold. Raises MapError when the map has no observed cell, ConfigError when the view
        would exceed 400 million cells.
        """
        if averaging is Averaging.PAPER and transfer is Transfer.AREA:
            raise ConfigError(
                "The paper's averaging goes by cell centres; leave out transfer='area', or take "
                "the mean."
            )
        asked = Selection(bounds, cell_m, at=at, jobs=jobs, beside=layers, sessions=sessions)
        with self.content() as content:
            request = asked.request(self, content)._replace(
                averaging=averaging,
                frame_filter=frame_filter,
                decide=decide,
            )
            if transfer is not None:
                request = request._replace(transfer=transfer)
            (view,) = read_views(content, request)
        return view

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
        with self.content() as content:
            request = Selection(bounds, cell_m).request(self, content)
            return read_change(content, request, (from_, to), self.path)

    @contextmanager
    def frames_near(self, near: Bounds) -> Iterator[list[FrameRecord]]:
        """The accepted frames that may reach into bounds, in time order, with their grids."""
        with reading(self._connection, self.path):
            yield self._evidence.accepted(near, None, None)

    def _channels(self, row: tuple[Any, ...]) -> Callable[[], tuple[EncodedChannel, ...]]:
        with reading(self._connection, self.path):
            channels = loader(self._connection, row[0])()
        return lambda: channels


def _no_grid() -> tuple[EncodedChannel, ...]:
    raise ConfigError("The frame was read without its grid; ask for frames(with_grid=True).")
