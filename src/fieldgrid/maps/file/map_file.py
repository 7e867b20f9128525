"""A map that is open: what can be read of it, and how it is changed."""

from __future__ import annotations

import logging
import sqlite3
import weakref
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from fieldgrid.core import ConfigError, Draft, MapError, notebook, quoted, runner
from fieldgrid.geometry import Feature, Pose, Trajectory
from fieldgrid.maps.file.arrays import Array
from fieldgrid.maps.file.database import (
    USUAL_PATIENCE,
    Patience,
    clear_journal,
    copied,
    is_ours,
    reading,
    writing,
)
from fieldgrid.maps.file.header import MapHeader, read_settings
from fieldgrid.maps.file.metadata import SessionMetadata, name_is_taken, session_metadata
from fieldgrid.maps.file.records import sessions_html
from fieldgrid.maps.file.root import check_root, seal
from fieldgrid.maps.file.upgrade import (
    as_it_is_now,
    drop_what_is_folded,
    upgrade,
    upgraded,
)
from fieldgrid.maps.health.repairing import repair
from fieldgrid.maps.health.row_sums import RowCounter
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.vector.marks import Mark, insert_marks, set_removed
from fieldgrid.maps.vector.stored_features import keep_features
from fieldgrid.maps.views.map_reader import MapReader
from fieldgrid.maps.writing import revision
from fieldgrid.maps.writing.derived import tables_of
from fieldgrid.maps.writing.session import Session
from fieldgrid.maps.writing.transform import Transform

if TYPE_CHECKING:
    from distributed import Client

_LOG = logging.getLogger(__name__)


class MapFile(MapReader):
    """A map that is open: read it, and add sessions to it when it was opened with a datum.

    Use it with `with`, or close it. Made by `open_map` and `create_map`. It may be used by one
    thread at a time.
    """

    def __init__(
        self,
        path: Path,
        connection: sqlite3.Connection,
        header: MapHeader,
        *,
        writable: bool,
        draft: Draft | None = None,
        patience: Patience = USUAL_PATIENCE,
    ) -> None:
        super().__init__(path, connection, header)
        self._patience = patience
        self._draft = draft
        self._writable = writable
        self._session: Session | None = None
        self._has_new_session = False
        self._counter = RowCounter(connection)
        # Also a map that is forgotten gives up its file, and its draft.
        self._release = weakref.finalize(self, _release, connection, draft)

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

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def close(self) -> None:
        """Close the map. A new one gets its name now, if it has a session."""
        if not is_ours(self._connection):  # a copy by fork(): the map is the other process's
            return
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
        with reading(self._connection, self.path):
            same_name = self._connection.execute(
                "SELECT removed FROM fieldgrid_session WHERE name = ?", (metadata.name,)
            ).fetchone()
        if same_name is not None:
            raise name_is_taken(metadata.name, self.path, removed=same_name[0] is not None)
        self._session = Session(
            self._connection,
            self.path,
            metadata,
            upgraded(self._header),
            committing=self._transaction,
            on_end=self._session_ended,
        )
        return self._session

    def remove_session(self, name: str) -> None:
        """Take a session out: the map is as if it had never had it. The evidence is kept.

        Raises ConfigError when there is none of that name, or it is removed already.
        """
        with self._changing(without=name):
            revision.remove(self._connection, self.path, self._header, name)

    def restore_session(self, name: str) -> None:
        """Put back a session that was removed: the map is as if it had never been."""
        with self._changing():
            revision.restore(self._connection, self.path, self._header, name)

    def add_marks(self, marks: Iterable[Mark]) -> tuple[int, ...]:
        """Add what somebody says of places, all of it or nothing; returns their numbers.

        A mark without a time gets that of now; numbers that the marks had elsewhere are not kept.
        Raises ConfigError for one that cannot be.
        """
        with self._changing():
            return insert_marks(self._connection, list(marks))

    def remove_marks(self, numbers: Iterable[int]) -> None:
        """Take marks out, all or none: the map is as if it had never had them. Their rows are kept.

        Raises ConfigError when there is none of that number, or it is removed already.
        """
        with self._changing():
            set_removed(self._connection, self.path, numbers, removed=True)

    def restore_marks(self, numbers: Iterable[int]) -> None:
        """Put back marks that were removed: the map is as if they had never been."""
        with self._changing():
            set_removed(self._connection, self.path, numbers, removed=False)

    def keep_features(self, features: Sequence[Feature], root_sha256: str) -> None:
        """Keep what was found in the map as layers of it, in place of what it keeps already.

        `root_sha256` is what the map had when they were found; ConfigError when it has another now.
        """
        if self.root_sha256 != root_sha256:
            raise ConfigError(
                f"{self.path} has changed since these features were found; find them again."
            )
        with self._changing():
            keep_features(self._connection, features, root_sha256)

    def rename_session(self, name: str, to: str) -> None:
        """Give a session another name; nothing else changes, its digest included.

        Raises ConfigError when there is none of that name, or the new one is taken.
        """
        with self._changing():
            revision.rename(self._connection, self.path, name, to)

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

    def set_transforms(self, transforms: Mapping[str, Transform]) -> None:
        """Put sessions elsewhere, each by its own transform in place of any that it had; all of
        them at once, or none."""
        with self._changing():
            for name, to in transforms.items():
                revision.transform(self._connection, self.path, self._header, name, to)

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

    def repair(
        self,
        jobs: int | None = None,
        *,
        layers: Collection[str] | None = None,
        keep: Path | None = None,
        scheduler: str | Client | None = None,
    ) -> tuple[str, ...]:
        """Rebuild the tiles, pictures and layers of features from the stored frames, and verify
        them before they count.

        The tiles hold the core and `layers` then (see `create_map`), or what they held, but for
        channel groups that are not known here. `keep` is where the map as it was is copied to
        before. `jobs` is the number of threads, all cores when not given; with a `scheduler`, the
        address of one of Dask or a client, the workers of that cluster check and fold the frames of
        that copy. Returns what is still wrong with the evidence of sessions that were taken out.
        Raises MapError, and changes nothing, when other evidence is damaged, or when the map would
        still not be sound; ConfigError for a scheduler without `keep`, ClusterError where none
        answers or its workers cannot read the copy.
        """
        if scheduler is not None and keep is None:
            raise ConfigError(
                "The workers of a cluster read the copy that is kept of the map; leave out "
                "--in-place, or the --scheduler."
            )
        with runner(jobs, scheduler) as run, self._changing(trusting=False, keep=keep):
            header = upgraded(self._header).keeping(layers)
            copy = None if scheduler is None else keep
            problems = repair(self._connection, self.path, header, run, copy)
        self._header = header
        return problems

    def upgrade(self) -> bool:
        """Bring a map of an older format up to date, at once or not at all; returns whether there
        was anything to do.

        Raises MapError when the frames of a session cannot be read.
        """
        self._require_writable()
        with reading(self._connection, self.path):
            is_old = read_settings(self._connection, self.path).is_old
        if is_old:
            with self._changing():
                pass
        return is_old

    @contextmanager
    def _changing(self, **how: Any) -> Iterator[None]:
        """A change of what the map has already; see `_transaction`."""
        self._require_writable()
        with self._transaction(**how):
            yield

    @contextmanager
    def _transaction(
        self,
        *,
        trusting: bool = True,
        keep: Path | None = None,
        without: str | None = None,
    ) -> Iterator[MapHeader]:
        """One transaction in which the map is changed, with its settings as they are in it;
        `trusting` what its root digest covers. `keep` is where it is copied to before.

        An older map is brought up to date in it: where the change is refused, it stays old.
        The frames of a session that it will be `without` need not be readable.
        """
        before = self._header
        try:
            # The copy is never removed once the commit has begun: that may have been done.
            with (
                writing(self._connection, self.path, self._patience),
                nullcontext() if keep is None else copied(self.path, keep),
            ):
                self._header = as_it_is_now(self._connection, self.path, before)
                if self._header.has_other_tables:
                    upgrade(self._connection, self.path, self._header, without)
                    seal(self._connection)
                    self._header = upgraded(self._header)
                if trusting:
                    check_root(self._connection, self.path)
                with self._counter.counting() if trusting else nullcontext():
                    if trusting and self._header.is_old:
                        self._header = drop_what_is_folded(self._connection, self._header)
                    yield self._header
                    seal(self._connection)
        except BaseException:
            self._header = before
            raise

    def _settle(self) -> None:
        """Fill in what commits have left for later, also those of a writer that was killed before
        it closed the map, unless another program is writing."""
        if not self._writable or not self._release.alive:
            return
        try:
            with reading(self._connection, self.path):
                header = read_settings(self._connection, self.path)
                if header.is_old or tables_of(self._connection, header, self.path).is_settled:
                    return
            with (
                writing(self._connection, self.path, Patience(0.0)),
                self._counter.counting(),
            ):
                self._header = as_it_is_now(self._connection, self.path, self._header)
                tables = tables_of(self._connection, self._header, self.path)
                Pyramid(tables).settle()
        except (MapError, ConfigError) as error:
            # The map is complete without: readers make larger cells from its own.
            _LOG.info("%s was not settled: %s", self.path, error)

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
                f"Session {quoted(self._session.name)} has not ended; make one change at a time."
            )

    def _session_ended(self, committed: bool) -> None:
        self._session = None
        self._has_new_session |= committed

    def _abandon_session(self) -> None:
        if self._session is not None:
            self._session.discard()


def _release(connection: sqlite3.Connection, draft: Draft | None) -> None:
    if not is_ours(connection):
        return
    connection.close()
    if draft is not None:
        draft.discard()
