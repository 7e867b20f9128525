"""What cells and drives can be read from: a map, or several maps as one."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from fieldgrid.core import ConfigError, runner
from fieldgrid.geometry import Bounds, Datum, Lattice, Trajectory, Window
from fieldgrid.maps.file.arrays import Array
from fieldgrid.maps.file.history import during, in_drive_order
from fieldgrid.maps.file.records import FrameRecord, SessionInfo
from fieldgrid.maps.layers.registry import check_layers
from fieldgrid.maps.transfer import check_cell_sizes
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.blocks import MapBlocks, blocks_of
from fieldgrid.maps.views.deciding import read_views
from fieldgrid.maps.views.provenance import Provenance, trace
from fieldgrid.maps.views.read import Content, Request
from fieldgrid.maps.views.view import MapView

if TYPE_CHECKING:
    from distributed import Client


class Readable(Protocol):
    """Reads cells: what `Costmap` and the exports of cells need of a map, or of several as one."""

    path: Path

    @property
    def datum(self) -> Datum:
        """The origin of the plane."""

    @property
    def cell_m(self) -> float:
        """Side of the own cells in metres."""

    @property
    def bounds(self) -> Bounds:
        """The extent of the observed cells in metres."""

    def sessions(self) -> list[SessionInfo]:
        """The sessions, each of a name of its own."""

    def sessions_at(self, at: str | int) -> list[str]:
        """The names of the active sessions as of a moment, in the order of their drives.

        `at` is a session, a date or time as in ISO 8601 (UTC), or UTC in nanoseconds; `FROM..TO`,
        each a session or date or empty, is the drives of a season alone. ConfigError for none.
        """
        found = [info.name for info in during(at, self.sessions(), self.path)]
        if not found:
            when = f"in {at}" if ".." in str(at) else f"up to {at}"
            raise ConfigError(
                f"{self.path} has no session {when}; `fieldgrid sessions`, or of a folder "
                "`fieldgrid farm`, lists the dates of its drives."
            )
        return found

    def check_sessions(self, names: Collection[str]) -> None:
        """Raise ConfigError unless all these are names of active sessions."""

    def marks(self) -> tuple[Mark, ...]:
        """The marks that are in force."""

    def content(self) -> AbstractContextManager[Content]:
        """What views are made of, in one state of it."""

    def read(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        jobs: int | None = None,
        sessions: Collection[str] | None = None,
        decide: str = "",
    ) -> MapView:
        """The cells within bounds as arrays, of all sessions or some; see `MapFile.read`."""
        asked = Selection(bounds, cell_m, at=at, jobs=jobs, beside=layers, sessions=sessions)
        return asked.view(self, decide=decide)

    def read_blocks(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        jobs: int | None = None,
        scheduler: str | Client | None = None,
        decide: str = "",
    ) -> AbstractContextManager[MapBlocks]:
        """What `read` gives, in views of some million cells, for maps of any size.

        One state of the map for as long as the block lasts: nobody can change it meanwhile; of
        several maps, MapError when one changes. `jobs` threads read a block, all cores when not
        given; with a `scheduler`, the address of one of Dask or a client, the workers of that
        cluster read some blocks at a time. Errors as in `read`, but that ten thousand million cells
        are allowed; ClusterError where no scheduler answers or its workers cannot read the map.
        """
        asked = Selection(bounds, cell_m, at=at, jobs=jobs, scheduler=scheduler, beside=layers)
        return asked.blocks(self, decide=decide)


@dataclass(frozen=True, slots=True)
class Selection:
    """What is asked of a map. `bounds` None for all that was observed; `cell_m` None for the map's
    own cell; `layer` one of the map's layers, and `beside` others that are read with it; `at` a
    session or a date, None for now; `sessions` some of them by name. `jobs` threads read it, one a
    core when not given, or the workers of Dask's `scheduler`, an address or a client.

    ConfigError for an unknown layer.
    """

    bounds: Bounds | None = None
    cell_m: float | None = None
    layer: str = "density"
    at: str | int | None = None
    jobs: int | None = None
    scheduler: str | Client | None = None
    beside: Collection[str] = ()
    sessions: Collection[str] | None = None

    def __post_init__(self) -> None:
        check_layers((self.layer, *self.beside))

    def view(
        self, universal: Readable, layers: Collection[str] = (), *, decide: str = ""
    ) -> MapView:
        """It as arrays, with `layers` beside the one that is asked for, and what its cells count as
        by one of densities.

        Raises ConfigError for a cell that the evidence cannot fill, and for a part that is too
        large for one view, or is to be read by a cluster.
        """
        if self.scheduler is not None:
            raise ConfigError(
                "This format needs its part of the map at once, which one process reads; leave out "
                "--scheduler, or choose a format that goes piece by piece, as geotiff does."
            )
        with universal.content() as content:
            request = self.request(universal, content, layers)._replace(decide=decide)
            (view,) = read_views(content, request)
        return view

    @contextmanager
    def blocks(
        self,
        universal: Readable,
        layers: Collection[str] = (),
        smallest_px: int | None = None,
        *,
        decide: str = "",
    ) -> Iterator[MapBlocks]:
        """It in blocks from the north, of one state of the map, however large; layers and errors as
        in `view`. With `smallest_px` it has overviews, until the longer side of one has at most so
        many cells."""
        with runner(1, self.scheduler) as run, universal.content() as content:
            request = self.request(universal, content, layers)._replace(decide=decide)
            if self.scheduler is not None:  # a cluster has a task for each of its threads
                request = request._replace(jobs=1)
            with blocks_of(content, request, run, smallest_px) as blocks:
                yield blocks

    def request(
        self, universal: Readable, content: Content, layers: Collection[str] = ()
    ) -> Request:
        """What it asks of the content of a map."""
        lattice, window = self.cells(universal)
        sessions = None
        if self.at is not None or self.sessions is not None:
            chosen = self.names(universal)
            if chosen != Selection().names(universal):
                sessions = tuple(chosen)
        wanted = dict.fromkeys((self.layer, *self.beside, *layers))
        return Request(
            lattice,
            window,
            content.header.transfer,
            sessions=sessions,
            layers=tuple(name for name in wanted if name != "density"),
            jobs=self.jobs,
        )

    def names(self, universal: Readable) -> list[str]:
        """The names of the sessions that are in it, in the order of their drives."""
        if self.at is not None:
            names = universal.sessions_at(self.at)
        else:
            names = [info.name for info in in_drive_order(universal.sessions())]
        if self.sessions is None:
            return names
        universal.check_sessions(self.sessions)
        return [name for name in names if name in set(self.sessions)]

    def cells(self, universal: Readable) -> tuple[Lattice, Window]:
        """The lattice of its cells, and which of them it covers."""
        with universal.content() as content:
            lattice = content.header.lattice_of(self.cell_m)
        return lattice, lattice.window(self.bounds or universal.bounds)

    def area(self, universal: Readable) -> Bounds | None:
        """The ground that its cells cover, None for all that there is."""
        if self.bounds is None:
            return None
        lattice, window = self.cells(universal)
        return lattice.bounds(window)


class DrivenMap(Readable, Protocol):
    """What the viewer and figures need of a map, beside its cells: the drives that they are of."""

    def trajectory(self, session: str) -> Trajectory:
        """The trajectory of a session as it is placed; MapError where none was stored."""

    def frames(self, session: str) -> Iterator[FrameRecord]:
        """The frames of a session, in time order."""

    def session_inputs(self, session: str) -> dict[str, Array]:
        """The arrays that were given with a session."""

    def frames_near(self, near: Bounds) -> AbstractContextManager[list[FrameRecord]]:
        """The accepted frames that may reach into bounds, in time order, with their grids."""

    def query(self, east_m: float, north_m: float, cell_m: float | None = None) -> Provenance:
        """Which sessions and frames observed the cell at a point, and what each said of it."""
        if not (math.isfinite(east_m) and math.isfinite(north_m)):
            raise ConfigError(f"A point at {east_m}, {north_m} is nowhere; give metres.")
        with self.content() as content:
            lattice, transfer = content.header.lattice_of(cell_m), content.header.transfer
        half_m = lattice.cell_m
        near = Bounds(east_m - half_m, north_m - half_m, east_m + half_m, north_m + half_m)
        with self.frames_near(near) as frames:
            for frame in frames:
                check_cell_sizes(lattice.cell_m, frame.spec.cell_m)
            return trace(east_m, north_m, lattice, transfer, frames)
