"""What of a map is exported: a part of it, at a cell size, one layer, as of some moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fieldgrid.errors import ConfigError
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import LAYERS, MapFile, MapView


@dataclass(frozen=True, slots=True)
class Selection:
    """`bounds` None for all that was observed; `cell_m` None for the map's own cell; `layer` one
    of the map's layers; `at` a session or a date, None for now."""

    bounds: Bounds | None = None
    cell_m: float | None = None
    layer: str = "density"
    at: str | int | None = None

    def __post_init__(self) -> None:
        if self.layer not in ("density", *LAYERS):
            known = ", ".join(dict.fromkeys(("density", *LAYERS)))
            raise ConfigError(f"{self.layer!r} is no layer of a map; known are {known}.")

    def view(self, universal: MapFile, layers: Sequence[str] = ()) -> MapView:
        """The part of the map, with the layer asked for and `layers` beside it.

        Raises ConfigError for bounds outside the map, a cell that the evidence cannot fill, and a
        part that is too large for one view.
        """
        if self.bounds is not None:
            check_inside(self.bounds, universal.bounds)
        wanted = tuple(dict.fromkeys((self.layer, *layers)))
        return universal.read(self.bounds, self.cell_m, layers=wanted, at=self.at)


def check_inside(crop: Bounds, extent: Bounds) -> None:
    """Raise ConfigError for a crop that shares nothing with the map."""
    if (
        crop.west_m >= extent.east_m
        or crop.east_m <= extent.west_m
        or crop.south_m >= extent.north_m
        or crop.north_m <= extent.south_m
    ):
        raise ConfigError(
            f"The bounds {crop.west_m:g} {crop.south_m:g} {crop.east_m:g} {crop.north_m:g} hold "
            f"nothing of the map, which lies between {extent.west_m:g} {extent.south_m:g} "
            f"{extent.east_m:g} {extent.north_m:g} (west south east north, metres)."
        )
