"""What cells say beyond their density: layers over all sessions, and what changed between two.

Both look at each session's moments in a cell, tile by tile, from the stored tiles or from a new
fold of the frames; a tally per tile takes them up in the order of the drives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from fieldgrid.array_types import AnyArray
from fieldgrid.errors import ConfigError
from fieldgrid.grids import OBSTACLE_ABOVE
from fieldgrid.lattice import TILE_CELLS, Lattice, TileIndex, Window, tile_window
from fieldgrid.mapfile.records import FrameRecord
from fieldgrid.mapfile.view import MapView
from fieldgrid.moments import (
    FRAMES,
    HIGHEST,
    PLANES,
    SQUARES,
    SUM,
    WEIGHT,
    Moments,
    add_to_tiles,
    finished,
)
from fieldgrid.transfer import Transfer, footprint, mean_density

_SHAPE = (TILE_CELLS, TILE_CELLS)
_SQUARE_TILES = 4
"""Side of the square of tiles that is folded at a time; its moments take 42 MB."""


class Layer(NamedTuple):
    """A layer that can be read: the type of its cells, and what one says."""

    dtype: str
    says: str


LAYERS: Mapping[str, Layer] = {
    "density": Layer("uint8", "mean 3D density, 0..255"),
    "count": Layer("uint32", "frames that observed the cell"),
    "variance": Layer("float32", "variance of the density over them, NaN where unobserved"),
    "max": Layer("uint8", "highest density that any of them gave it"),
    "sessions": Layer("uint16", "sessions that observed the cell"),
    "persistence": Layer(
        "float32", "share of those sessions in which it was an obstacle, NaN where unobserved"
    ),
    "height": Layer(
        "float32",
        "ground height of the vehicle when it saw the cell, metres above the datum's plane: the "
        "mean over the frames that observed it, NaN where unobserved",
    ),
}


class Tally(Protocol):
    """What takes up the sessions of one tile, in the order of their drives."""

    def add(self, session: str, moments: Moments) -> None:
        """Take up what a session has in the tile, uint64 [256, 256, 5]."""

    def write(self, tile: TileIndex) -> None:
        """Put the result where it belongs; no session follows."""


def check_layers(names: Iterable[str]) -> tuple[str, ...]:
    """The names, once it is sure that there are such layers."""
    wanted = tuple(names)
    for name in wanted:
        if name not in LAYERS:
            raise ConfigError(f"There is no layer {name!r}; there are {', '.join(LAYERS)}.")
    return wanted


def with_layers(view: MapView, names: Iterable[str]) -> MapView:
    """The view with empty arrays for layers beyond the density."""
    arrays = {name: np.zeros(view.window.shape, LAYERS[name].dtype) for name in names}
    for array in arrays.values():
        if array.dtype.kind == "f":
            array.fill(np.nan)
    return MapView(view.lattice, view.window, view.density, view.observed, view.datum, arrays)


class LayerTally:
    """Sums over sessions, written into a view's layers."""

    def __init__(self, view: MapView) -> None:
        self._view = view
        self._sums = np.zeros((*_SHAPE, PLANES), dtype=np.uint64)
        self._sessions = np.zeros(_SHAPE, dtype=np.uint16)
        self._obstacle = np.zeros(_SHAPE, dtype=np.uint16)

    def add(self, session: str, moments: Moments) -> None:
        """Take up a session."""
        self._sums[..., :HIGHEST] += moments[..., :HIGHEST]
        highest = self._sums[..., HIGHEST]
        np.maximum(highest, moments[..., HIGHEST], out=highest)
        density, observed = mean_density(moments[..., WEIGHT:SQUARES])
        self._sessions += observed
        self._obstacle += observed & (density > OBSTACLE_ABOVE)

    def write(self, tile: TileIndex) -> None:
        """Fill the tile's part of the view."""
        cells = tile_window(tile)
        part = cells.intersect(self._view.window)
        if part is None:
            return
        inside, place = cells.slices_of(part), self._view.window.slices_of(part)
        density, observed = mean_density(self._sums[inside][..., WEIGHT:SQUARES])
        self._view.density[place], self._view.observed[place] = density, observed
        for name, array in self._view.layers.items():
            array[place] = self._layer(name, inside, density, observed)

    def _layer(self, name: str, inside: Any, density: AnyArray, observed: AnyArray) -> AnyArray:
        sums = self._sums[inside]
        with np.errstate(divide="ignore", invalid="ignore"):
            if name == "variance":
                weight, total, squares = (
                    sums[..., k].astype(np.float64) for k in (WEIGHT, SUM, SQUARES)
                )
                # Of whole numbers, so that a constant has a variance of exactly 0.
                variance: AnyArray = (weight * squares - total * total) / (weight * weight)
                return variance
            if name == "persistence":
                share: AnyArray = self._obstacle[inside] / self._sessions[inside]
                return share
        plain: dict[str, AnyArray] = {
            "density": density,
            "count": sums[..., FRAMES],
            "max": sums[..., HIGHEST],
            "sessions": self._sessions[inside],
        }
        return plain[name]


def tally_stored(
    stored: Iterator[tuple[TileIndex, str, Moments]], tally: Callable[[], Tally]
) -> None:
    """Tally the stored moments, which come tile by tile."""
    here: TileIndex | None = None
    current: Tally | None = None
    for tile, session, moments in stored:
        if tile != here:
            if current is not None and here is not None:
                current.write(here)
            here, current = tile, tally()
        assert current is not None
        current.add(session, moments)
    if current is not None and here is not None:
        current.write(here)


def tally_folded(
    window: Window,
    lattice: Lattice,
    transfer: Transfer,
    sessions: Sequence[tuple[str, Sequence[FrameRecord]]],
    tally: Callable[[], Tally],
) -> None:
    """Tally moments that are folded anew: on any lattice, by any rule, from any frames."""
    pool = np.zeros((_SQUARE_TILES**2, *_SHAPE, PLANES), dtype=np.uint64)
    slots = np.arange(_SQUARE_TILES**2, dtype=np.int32).reshape(_SQUARE_TILES, _SQUARE_TILES)
    for corner in _squares(window):
        square = Window(
            corner.tx * TILE_CELLS,
            corner.ty * TILE_CELLS,
            _SQUARE_TILES * TILE_CELLS,
            _SQUARE_TILES * TILE_CELLS,
        )
        tallies: dict[TileIndex, Tally] = {}
        for session, frames in sessions:
            inside = [
                frame
                for frame in frames
                if footprint(frame.spec, frame.pose, lattice).intersect(square) is not None
            ]
            if not inside:
                continue
            pool[:] = 0
            for number, frame in enumerate(inside, 1):
                grid = frame.grid()
                add_to_tiles(pool, slots, square, grid, frame.pose, lattice, transfer, number)
            for tile in square.tiles():
                moments = pool[slots[tile.ty - corner.ty, tile.tx - corner.tx]]
                if not moments[..., WEIGHT].any():
                    continue
                if tile not in tallies:
                    tallies[tile] = tally()
                tallies[tile].add(session, finished(moments))
        for tile, done in tallies.items():
            done.write(tile)


def _squares(window: Window) -> Iterator[TileIndex]:
    """The south-west tile of each square of tiles over a window."""
    tiles = list(window.tiles())
    (south, west), (north, east) = tiles[0], tiles[-1]
    for ty in range(south, north + 1, _SQUARE_TILES):
        for tx in range(west, east + 1, _SQUARE_TILES):
            yield TileIndex(ty, tx)
