"""What cells and drives can be read from: a map, or several maps as one."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Protocol

from fieldgrid.geometry import Bounds, Datum, Trajectory
from fieldgrid.maps.file.arrays import Array
from fieldgrid.maps.file.records import FrameRecord, SessionInfo
from fieldgrid.maps.tiles.overviews import OverviewBlock
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.blocks import MapBlocks
from fieldgrid.maps.views.provenance import Provenance
from fieldgrid.maps.views.view import MapView

if TYPE_CHECKING:
    from distributed import Client


class Readable(Protocol):
    """What `Costmap` and the exports of cells need of a map; each as `MapFile` has it."""

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
        """The names of the active sessions as of a moment, in the order of their drives."""

    def marks(self) -> tuple[Mark, ...]:
        """The marks that are in force."""

    def deciding(self, cell_m: float | None) -> tuple[str, ...]:
        """The layers by which cells of this size are free or obstacles."""

    def read(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        jobs: int | None = None,
    ) -> MapView:
        """The cells within bounds as arrays, read by `jobs` threads."""

    def read_blocks(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        jobs: int | None = None,
        scheduler: str | Client | None = None,
    ) -> AbstractContextManager[MapBlocks]:
        """The cells within bounds in views of some million cells."""

    def overviews(
        self,
        levels: int,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        jobs: int | None = None,
        scheduler: str | Client | None = None,
    ) -> AbstractContextManager[Iterator[OverviewBlock]]:
        """The cells within bounds in cells of 2, 4, ... 2^levels times the side."""


class DrivenMap(Readable, Protocol):
    """What the viewer and figures need of a map, beside its cells: the drives that they are of."""

    def read(
        self,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layers: Collection[str] = (),
        at: str | int | None = None,
        jobs: int | None = None,
        sessions: Collection[str] | None = None,
    ) -> MapView:
        """The cells within bounds as arrays, of all sessions or some of them."""

    def trajectory(self, session: str) -> Trajectory:
        """The trajectory of a session as it is placed; MapError where none was stored."""

    def frames(self, session: str) -> Iterator[FrameRecord]:
        """The frames of a session, in time order."""

    def session_inputs(self, session: str) -> dict[str, Array]:
        """The arrays that were given with a session."""

    def query(self, east_m: float, north_m: float, cell_m: float | None = None) -> Provenance:
        """Which frames observed the cell at a point."""
