"""A farm that a server shows: the maps of a folder as one, for looking."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import RLock
from typing import Any

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import MAX_CELL_M, TILE_CELLS, Bounds, Datum, TileIndex
from fieldgrid.maps import Farm, Mark, map_files
from fieldgrid.view import drives, layers
from fieldgrid.view.maps import ShownSource, shown_maps, stamp

MOST_MAPS = 16
"""Maps whose frames are drawn at once: in a view of more of them a frame is no more than a dot."""


class ShownFarm(ShownSource):
    """The maps of a folder in the plane of a datum, of the first map where none is given.

    The farm is open between requests, which take turns; one that was written to is opened anew.
    """

    def __init__(self, path: Path, datum: Datum | None = None) -> None:
        super().__init__(path, path.resolve().name or "farm", path)
        self._datum = datum
        self._turn = RLock()
        self._farm: Farm | None = None
        self._opened = ""

    def version(self) -> str:
        """See `ShownSource`: of all its maps, those that cannot be read included.

        No file is opened for it: closing one would let go of the locks of whoever reads it.
        """
        try:
            seen = [f"{file.name} {stamp(file)}" for file in map_files(self.path)]
        except OSError as error:
            raise MapError(
                f"{self.path} is no longer there; put it back, then load the page again."
            ) from error
        return hashlib.sha256("\n".join(seen).encode()).hexdigest()[:16]

    @contextmanager
    def open(self) -> Iterator[Farm]:
        """See `ShownSource`."""
        version = self.version()
        with self._turn:
            if self._farm is None or version != self._opened:
                if self._farm is not None:
                    self._farm.close()
                self._farm, self._opened = Farm(self.path, datum=self._datum), version
            yield self._farm

    @contextmanager
    def open_alone(self) -> Iterator[Farm]:
        """See `ShownSource`."""
        with Farm(self.path, datum=self._datum) as farm:
            yield farm

    def levels(self) -> int:
        """See `ShownSource`: up to where one tile has all of it."""
        with self.open() as farm:
            west, south, east, north = farm.bounds
            cells = max(east - west, north - south) / farm.cell_m
            highest = math.floor(math.log2(MAX_CELL_M / farm.cell_m))
        return min(max(math.ceil(math.log2(max(cells / TILE_CELLS, 1.0))), 0), highest)

    def density(self, level: int, tile: TileIndex) -> bytes | None:
        """See `ShownSource`."""
        with self.open() as farm:
            bounds, cell_m = layers.tile_bounds(farm, level, tile)
            return layers.draw_layer(
                farm.read(bounds, cell_m), "density", layers.scale_of(farm, "density")
            )

    def marks(self) -> tuple[Mark, ...]:
        """See `ShownSource`: those in force."""
        with self.open() as farm:
            return farm.marks()

    def features(self) -> list[dict[str, Any]]:
        """See `ShownSource`: those of its maps are not shown."""
        return []

    def frames(self, bounds: Bounds) -> list[drives.FrameTable]:
        """See `ShownSource`: of the maps that bounds touch, unless these are many."""
        with self.open() as farm:
            near = [name for name, extent in farm.extents().items() if extent.overlaps(bounds)]
            if len(near) > MOST_MAPS:
                return []
            return [self.kept(("frames", name), partial(_frame_table, block=name)) for name in near]


def _frame_table(farm: Farm, block: str) -> drives.FrameTable:
    """The frames of a map of a farm."""
    return drives.frame_table(
        farm, [info.name for info in farm.sessions() if farm.map_of(info.name).name == block]
    )


def shown_at(paths: Sequence[Path], datum: Datum | None = None) -> tuple[ShownSource, ...]:
    """What is shown of these paths, maps and folders of maps, once it is sure that each can be
    read.

    `datum` is the plane of farms. MapError for a path that is no map and a folder of which no map
    can be read, DatumError as `Farm`, ConfigError for no path at all.
    """
    if not paths:
        raise ConfigError("There is no map to show; name one.")
    found: list[ShownSource] = []
    for path in paths:
        if path.is_dir():
            farm = ShownFarm(path, datum)
            farm.levels()  # which needs the extent of all of it
            found.append(farm)
        else:
            found += shown_maps([path])
    return tuple(found)
