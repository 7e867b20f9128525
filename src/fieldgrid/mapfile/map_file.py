"""A map that is open: what can be read of it, and how it is changed."""

from __future__ import annotations

import logging
import math
import sqlite3
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fieldgrid import notebook
from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds
from fieldgrid.layers import check_layers
from fieldgrid.mapfile import revision
from fieldgrid.mapfile.arrays import Array
from fieldgrid.mapfile.blocks import Blocks, read_blocks
from fieldgrid.mapfile.change import ChangeView
from fieldgrid.mapfile.codec import EncodedChannel
from fieldgrid.mapfile.database import clear_journal, reading, writing
from fieldgrid.mapfile.derived import settle
from fieldgrid.mapfile.evidence import Evidence, loader
from fieldgrid.mapfile.header import Header, read_header
from fieldgrid.mapfile.metadata import SessionMetadata, find, name_is_taken, session_metadata
from fieldgrid.mapfile.overviews import OverviewBlock, read_overviews
from fieldgrid.mapfile.provenance import Provenance, trace
from fieldgrid.mapfile.reading import Request, extent_of, read_change, read_view, sessions_at
from fieldgrid.mapfile.records import FrameRecord, SessionInfo, frame_record, sessions_html
from fieldgrid.mapfile.root import check_root, read_root, seal
from fieldgrid.mapfile.schema import FORMAT_VERSION
from fieldgrid.mapfile.session import Session
from fieldgrid.mapfile.transform import Transform
from fieldgrid.mapfile.upgrade import upgrade
from fieldgrid.mapfile.verification import HealthReport, repair, verify
from fieldgrid.mapfile.view import MapView
from fieldgrid.publish import Draft
from fieldgrid.trajectory import Pose, Trajectory
from fieldgrid.transfer import Averaging, Transfer, check_cell_sizes

_LOG = logging.getLogger(__name__)


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
        self._unsettled = False
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

    def _repr_html_(self) -> str:
        """Where the map lies, its cells and its sessions, for a notebook."""
        if not self._release.alive:
            return notebook.table([("map", self.path.name), ("state", "closed")])
        facts = (
            ("map", self.path.name),
            ("datum", self.datum.described()),
            ("cells", f"{self.cell_m * 100:g} cm"),
        )
        return notebook.table(facts) + sessions_html(self.sessions())

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
        self._settle()
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
        return self.add_session_of(
            session_metadata(name, trajectory, config, source, source_sha256, inputs)
        )

    def add_session_of(self, metadata: SessionMetadata) -> Session:
        """`add_session` of what is known already, as when it comes from another map."""
        self._require_writable()
        if metadata.trajectory is not None:
            self._header.check_datum(self.path, metadata.trajectory.datum)
        self._upgrade()
        with reading(self._connection, self.path):
            is_active = self._evidence.find_name(metadata.name)
        if is_active is not None:
            raise name_is_taken(metadata.name, self.path, removed=not is_active)
        self._session = Session(
            self._connection, self.path, metadata, self._header, on_end=self._session_ended
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

    def rename_session(self, name: str, to: str) -> None:
        """Give a session another name; nothing else changes, its digest included.

        Raises ConfigError when there is none of that name, or the new one is taken.
        """
        with self._changing():
            revision.rename(self._connection, self.path, name, to)

    def transform(self, name: str) -> Transform:
        """The transform that puts a session into its place in the map."""
        with reading(self._connection, self.path):
            return self._evidence.transform(name)

    def set_transform(
        self, name: str, shift_east_m: float, shift_north_m: float, turn_deg: float = 0.0
    ) -> Transform:
        """Put a session elsewhere: shifted by metres east and north, turned by degrees clockwise
        about the middle of its accepted frames. Replaces any transform that it had; 0, 0, 0 is
        where it was driven, bit for bit.

        Raises ConfigError when it cannot be, DatumError when the drive would be too far away.
        """
        with self._changing():
            pivot = revision.middle_m(self._connection, self.path, name)
            to = Transform(shift_east_m, shift_north_m, turn_deg, *pivot)
            revision.transform(self._connection, self.path, self._header, name, to)
        return to

    def repose(
        self,
        name: str,
        poses: Mapping[str, Pose],
        trajectory: Trajectory | None = None,
        config: Mapping[str, Any] | None = None,
    ) -> None:
        """Give the frames of a session other poses and verdicts, without their images.

        `poses` has one for each frame_id, as driven: the session's transform stays. `trajectory`
        and `config` replace those of the session where they are given. The map is then as if the
        session had been added so. Raises ConfigError when a frame is left out, DatumError for a
        trajectory of another datum.
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

    def metadata(self, name: str) -> SessionMetadata:
        """All that is kept of a session beside its frames, for `add_session_of` of another map."""
        with reading(self._connection, self.path):
            return find(self._connection, self.path, self.datum, name).metadata

    def has_datum(self, datum: Datum) -> bool:
        """Whether a datum is that of the map, up to rounding."""
        return self._header.is_datum(datum)

    @property
    def root_sha256(self) -> str:
        """The root digest: of settings, plane and sessions, and so of all evidence."""
        with reading(self._connection, self.path):
            return read_root(self._connection).of_content

    def verify(self, jobs: int | None = None) -> HealthReport:
        """Check the file, the evidence against its hashes, and that all else follows from it.

        `jobs` is the number of threads, all cores when not given.
        """
        with reading(self._connection, self.path):
            return verify(self._connection, self.path, self._header, jobs)

    def repair(self, jobs: int | None = None) -> None:
        """Rebuild the tiles, pictures and layers of features from the stored frames.

        The tiles hold all channel groups that are registered now, and no others. Raises MapError
        when the evidence itself is damaged.
        """
        with self._changing(trusting=False):
            groups = repair(self._connection, self.path, self._header, jobs)
        self._header = self._header._replace(groups=groups)

    def upgrade(self) -> bool:
        """Bring a map of an older format to the present one, at once or not at all; returns whether
        there was anything to do."""
        self._require_writable()
        return self._upgrade()

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
        return (frame_record(row, self._channels(row) if with_grid else _no_grid) for row in rows)

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
    ) -> MapView:
        """The universal grid within `bounds` (all of it when not given) as arrays.

        `layers` adds to the density: any of `fieldgrid.layers.LAYERS`. `at` is a session or a date:
        the map as of then; `sessions` are some of them by name.

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
    def blocks(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
    ) -> Iterator[Blocks]:
        """What `read` gives, in views of some million cells, for maps of any size.

        One state of the map for as long as the block lasts: nobody can change it meanwhile.
        Errors as in `read`, but that ten thousand million cells are allowed.
        """
        names = check_layers(layers)
        with reading(self._connection, self.path):
            request = self._request(bounds, cell_m, None)
            request = request._replace(sessions=self._chosen(at, None), layers=names)
            yield read_blocks(self._evidence, self._header, request)

    @contextmanager
    def overviews(
        self,
        levels: int,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
    ) -> Iterator[Iterator[OverviewBlock]]:
        """What `read` gives, with cells of 2, 4, ... 2^levels times the side, for overviews of a
        raster: counted from the north-west corner. Errors as in `read`."""
        names = check_layers(layers)
        with reading(self._connection, self.path):
            request = self._request(bounds, cell_m, None)
            request = request._replace(sessions=self._chosen(at, None), layers=names)
            yield read_overviews(self._evidence, self._header, request, levels)

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

    def _channels(self, row: tuple[Any, ...]) -> Callable[[], tuple[EncodedChannel, ...]]:
        with reading(self._connection, self.path):
            channels = loader(self._connection, row[0])()
        return lambda: channels

    @contextmanager
    def _changing(self, *, trusting: bool = True) -> Iterator[None]:
        """One transaction in which the map is changed; `trusting` what its root digest covers."""
        self._require_writable()
        self._upgrade()
        with writing(self._connection, self.path):
            if trusting:
                check_root(self._connection, self.path)
            yield
            seal(self._connection)
        self._unsettled = True

    def _settle(self) -> None:
        """Fill in what commits have left for later, unless another program is writing."""
        if not self._unsettled or not self._release.alive:
            return
        self._unsettled = False
        try:
            with reading(self._connection, self.path):
                self._connection.execute("PRAGMA busy_timeout = 0")
            with writing(self._connection, self.path):
                settle(self._connection, self._header, self.path)
        except MapError as error:
            # The map is complete without: readers make it from the tiles below.
            _LOG.info("%s was not settled: %s", self.path, error)

    def _upgrade(self) -> bool:
        if self._header.version == FORMAT_VERSION:
            return False
        with writing(self._connection, self.path):
            upgrade(self._connection, self.path, self._header)
            seal(self._connection)
        with reading(self._connection, self.path):
            self._header = read_header(self._connection, self.path)
        return True

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
        self._unsettled |= committed

    def _abandon_session(self) -> None:
        if self._session is not None:
            self._session.discard()


def _release(connection: sqlite3.Connection, draft: Draft | None) -> None:
    connection.close()
    if draft is not None:
        draft.discard()


def _no_grid() -> tuple[EncodedChannel, ...]:
    raise ConfigError("The frame was read without its grid; ask for frames(with_grid=True).")
