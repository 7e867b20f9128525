"""What of a map is exported: a part of it, at a cell size, one layer, as of some moment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Bounds, Lattice, check_inside
from fieldgrid.maps import LAYERS, MapBlocks, MapView, OverviewBlock, Readable, in_drive_order

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True, slots=True)
class Selection:
    """`bounds` None for all that was observed; `cell_m` None for the map's own cell; `layer` one
    of the map's layers; `at` a session or a date, None for now. `jobs` and `scheduler` say who
    reads it, as for `MapFile.read_blocks`."""

    bounds: Bounds | None = None
    cell_m: float | None = None
    layer: str = "density"
    at: str | int | None = None
    jobs: int | None = None
    scheduler: str | Client | None = None

    def __post_init__(self) -> None:
        if self.layer not in ("density", *LAYERS):
            known = ", ".join(dict.fromkeys(("density", *LAYERS)))
            raise ConfigError(f"{self.layer!r} is no layer of a map; known are {known}.")

    def view(self, universal: Readable, layers: Sequence[str] = ()) -> MapView:
        """The part of the map, with the layer asked for and `layers` beside it.

        Raises ConfigError for bounds outside the map, a cell that the evidence cannot fill, and a
        part that is too large for one view, or is to be read by a cluster.
        """
        if self.scheduler is not None:
            raise ConfigError(
                "This format needs its part of the map at once, which one process reads; leave out "
                "--scheduler, or choose a format that goes piece by piece, as geotiff does."
            )
        return universal.read(
            self.checked_bounds(universal),
            self.cell_m,
            layers=tuple(dict.fromkeys((self.layer, *layers))),
            at=self.at,
            jobs=self.jobs,
        )

    def checked_bounds(self, universal: Readable) -> Bounds | None:
        """The bounds; ConfigError for those that hold nothing of the map."""
        if self.bounds is not None:
            check_inside(self.bounds, universal.bounds)
        return self.bounds

    def area(self, universal: Readable) -> Bounds | None:
        """The ground that the cells of the part cover, None for all that there is."""
        if self.bounds is None:
            return None
        lattice = Lattice(universal.cell_m if self.cell_m is None else self.cell_m)
        return lattice.bounds(lattice.window(self.bounds))

    def blocks(
        self, universal: Readable, layers: Sequence[str] = ()
    ) -> AbstractContextManager[MapBlocks]:
        """The part of the map in blocks from the north, of one state of the map, however large;
        layers and errors as in `view`."""
        bounds, wanted = self.checked_bounds(universal), tuple(dict.fromkeys((self.layer, *layers)))
        return universal.read_blocks(
            bounds, self.cell_m, layers=wanted, at=self.at, jobs=self.jobs, scheduler=self.scheduler
        )

    def overviews(
        self, universal: Readable, levels: int
    ) -> AbstractContextManager[Iterator[OverviewBlock]]:
        """The part of the map in blocks with cells of 2, 4, ... 2^levels times the side, from the
        north-west corner."""
        return universal.overviews(
            levels,
            self.bounds,
            self.cell_m,
            layers=(self.layer,),
            at=self.at,
            jobs=self.jobs,
            scheduler=self.scheduler,
        )

    def sessions(self, universal: Readable) -> list[str]:
        """The names of the sessions that are in the part, in the order of their drives."""
        if self.at is not None:
            return universal.sessions_at(self.at)
        return [info.name for info in in_drive_order(universal.sessions())]
