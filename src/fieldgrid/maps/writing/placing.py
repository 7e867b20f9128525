"""Placing: frames, each with its pose in the map, become tiles.

This is the only way from frames to tiles. The frames may come from anywhere, in any order; the
tiles have the same bits.
"""

from __future__ import annotations

import sqlite3
import threading
from collections import defaultdict
from collections.abc import Callable, Container, Iterator, Sequence
from functools import lru_cache, reduce
from itertools import count
from typing import NamedTuple, TypeVar

from fieldgrid.core import Closing, Threads, UInt64
from fieldgrid.geometry import TILE_CELLS, GridSpec, Lattice, Pose, TileIndex, Window, tile_window
from fieldgrid.maps.layers.blocks import block_side
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup
from fieldgrid.maps.layers.frame import FrameCells
from fieldgrid.maps.layers.window import WindowFold, merge_sessions
from fieldgrid.maps.tiles.tile_codec import Box, Expectation, box_of, decode_tile, encode_tile
from fieldgrid.maps.transfer import Transfer, footprint

_Result = TypeVar("_Result")

BLOCK_TILES, ALONE_TILES = 2, 9
"""Side of the square of tiles that is folded at a time. It takes up to 40 MB with cells of 5 cm,
however many frames there are. Heights of the terrain take up to half a kilobyte of that for each
block, so that it is up to 180 MB where a block is a single cell, which then is 0.13 m or more.
A session that is narrower is folded in longer rectangles of no more tiles: a frame that falls into
two of them is carried over twice. One that has no more than `ALONE_TILES` is folded at once, and
then no other square is under way beside it."""

RECENT_FRAMES, RECENT_TILES = 32, 8
"""What is kept decoded, because the next block or the commit is likely to want it."""


class PlacedFrame(NamedTuple):
    """A frame of a session at its pose in the map; `load` decodes its cells, and any thread may
    call it."""

    pose: Pose
    spec: GridSpec
    load: Callable[[], FrameCells]
    session: int = 0


class TileSquares:
    """The squares of tiles into which the frames of sessions are folded, each by itself.

    They are worked on one by one, so that the memory taken does not depend on how many there are.
    """

    def __init__(
        self,
        frames: Sequence[PlacedFrame],
        lattice: Lattice,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
    ) -> None:
        self._frames = frames
        # A frame is decoded once where the next square wants it again.
        self._cells = lru_cache(RECENT_FRAMES)(lambda k: frames[k].load())
        self._rule = lattice, transfer, groups
        self._footprints = [footprint(frame.spec, frame.pose, lattice) for frame in frames]
        self._whole = _tiles_under(self._footprints)
        self._width, self._height = _square_of(self._whole)
        self._inside: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        # What moved is told by what was seen first, in whatever order frames were added.
        for k in sorted(range(len(frames)), key=lambda k: frames[k].pose.time_ns):
            window = self._footprints[k]
            i0, j0 = window.i0 - self._whole.i0, window.j0 - self._whole.j0
            for y in range(j0 // self._height, (j0 + window.height - 1) // self._height + 1):
                for x in range(i0 // self._width, (i0 + window.width - 1) // self._width + 1):
                    self._inside[y, x].append(k)

    def places(self) -> list[tuple[int, int]]:
        """Where they are, to and fro, so that neighbours follow each other and share frames."""
        return sorted(
            self._inside, key=lambda place: (place[0], place[1] if place[0] % 2 else -place[1])
        )

    def fold(
        self, place: tuple[int, int], work: Callable[[TileIndex, Cells], _Result]
    ) -> list[_Result]:
        """What `work` makes of each tile of a square that the frames observed; from any thread."""
        y, x = place
        square = Window(
            self._whole.i0 + x * self._width,
            self._whole.j0 + y * self._height,
            self._width,
            self._height,
        )
        of_session: defaultdict[int, list[int]] = defaultdict(list)
        for k in self._inside[place]:
            of_session[self._frames[k].session].append(k)
        total: dict[TileIndex, Cells] = {}
        for inside in of_session.values():
            for tile, cells in self._folded(inside, square):
                before = total.get(tile)
                groups = self._rule[2]
                total[tile] = cells if before is None else merge_sessions(groups, before, cells)
        return [work(tile, total[tile]) for tile in sorted(total)]

    def _folded(self, inside: Sequence[int], square: Window) -> Iterator[tuple[TileIndex, Cells]]:
        """The tiles of a square that some frames of one session observed."""
        lattice, transfer, groups = self._rule
        parts = (self._footprints[k].intersect(square) for k in inside)
        window = reduce(Window.union, (part for part in parts if part is not None))
        fold = WindowFold(lattice, window, transfer, groups)
        for k in inside:
            fold.add(self._cells(k), self._frames[k].pose)
        for tile in window.tiles():
            cells = fold.cells(tile_window(tile), whole_blocks=True)
            if cells["weight"].any():
                yield tile, cells


def _tiles_under(windows: Sequence[Window]) -> Window:
    """The whole tiles that windows reach into, as one rectangle; it is empty without any."""
    i0, j0, width, height = reduce(Window.union, windows) if windows else (0, 0, 0, 0)
    west, south, east, north = (
        side // TILE_CELLS * TILE_CELLS
        for side in (i0, j0, i0 + width + TILE_CELLS - 1, j0 + height + TILE_CELLS - 1)
    )
    return Window(west, south, east - west, north - south)


def _square_of(whole: Window) -> tuple[int, int]:
    """Width and height in cells of what is folded at a time, of a session's whole tiles: all of
    few, else as many as a square of `BLOCK_TILES` has, in the shape of the session where that is
    narrower."""
    most = BLOCK_TILES**2
    across, along = whole.width // TILE_CELLS, whole.height // TILE_CELLS
    if 0 < across * along <= ALONE_TILES:
        return whole.width, whole.height
    width = min(max(across, 1), max(BLOCK_TILES, most // max(along, 1)))
    return width * TILE_CELLS, most // width * TILE_CELLS


class FoldedTiles(Closing):
    """Tiles that were folded, beside the map until they are in it.

    The map is locked for the moment of the commit only, readers and other drives meanwhile see it
    as it was, and giving up costs nothing. Few stay as they are. The others lie encoded in an
    unnamed temporary database that SQLite deletes by itself, also when the process is killed, where
    SQLITE_TMPDIR says, or in the system's place for temporary files.
    """

    def __init__(
        self,
        frames: Sequence[PlacedFrame],
        lattice: Lattice,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
        only: Container[TileIndex] | None = None,
    ) -> None:
        """The tiles that accepted frames observed, or `only` some of them."""
        self._groups, self._block = groups, block_side(lattice)
        self._lock = threading.Lock()
        self._recent: dict[TileIndex, Cells] = {}
        self._database = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        self.tiles: set[TileIndex] = set()
        try:
            # Nothing here outlives an error, so nothing needs to be undone or synced.
            self._database.execute("PRAGMA journal_mode = OFF")
            self._database.execute("PRAGMA synchronous = OFF")
            self._database.execute("CREATE TABLE tile (ty, tx, channels, data)")
            self._database.execute("CREATE INDEX place ON tile (ty, tx)")
            self._fold(TileSquares(frames, lattice, transfer, groups), only)
        except BaseException:
            self.close()
            raise

    def _fold(self, squares: TileSquares, only: Container[TileIndex] | None) -> None:
        numbers = count()

        def kept(tile: TileIndex, cells: Cells) -> tuple[TileIndex, Cells | None, dict[str, bytes]]:
            # Decoded, the tiles of the squares under way would take most of the memory of a build.
            if next(numbers) < RECENT_TILES:
                return tile, cells, {}
            return tile, None, encode_groups(self._groups, cells, base=True)

        for results in Threads().in_order(lambda at: squares.fold(at, kept), squares.places()):
            for tile, cells, blobs in results:
                if only is not None and tile not in only:
                    continue
                self.tiles.add(tile)
                if cells is not None:
                    self._recent[tile] = cells
                self._database.executemany(
                    "INSERT INTO tile VALUES (?, ?, ?, ?)",
                    [(*tile, name, blob) for name, blob in blobs.items()],
                )

    def blobs(self, tile: TileIndex) -> dict[str, bytes]:
        """The stored form of a tile, by channel group; empty where it was not needed yet."""
        with self._lock:
            rows = self._database.execute(
                "SELECT channels, data FROM tile WHERE ty = ? AND tx = ?", tile
            ).fetchall()
        return dict(rows)

    def cells(self, tile: TileIndex) -> Cells | None:
        """The channels of a tile; None where the frames observed nothing."""
        if tile in self._recent or tile not in self.tiles:
            return self._recent.get(tile)
        what = f"tile {tuple(tile)}"
        return decode_groups(self._groups, self.blobs(tile), what, base=True, block=self._block)

    def close(self) -> None:
        """Throw them away."""
        self._database.close()


def encode_groups(
    groups: Sequence[ChannelGroup], cells: Cells, *, base: bool, box: Box | None = None
) -> dict[str, bytes]:
    """The blobs of a tile that has been observed, by channel group."""
    inside = box or box_of(cells["weight"])
    expectation = Expectation(cells, base=base)
    blocks = inside.blocks(cells.block)
    return {
        group.name: encode_tile(
            group, cells, blocks if group.blocks else inside, expectation, base=base
        )
        for group in groups
    }


def decode_groups(
    groups: Sequence[ChannelGroup], blobs: dict[str, bytes], what: str, *, base: bool, block: int
) -> Cells:
    """The channels of a tile from its blobs, which has `block` cells along the side of a block;
    MapError when one is damaged or missing."""
    arrays: dict[str, UInt64] = {}
    expectation = Expectation(arrays, base=base)
    for group in groups:
        blob, name = blobs.get(group.name), f"{group.name} of {what}"
        arrays.update(decode_tile(group, blob, expectation, name, base=base, block=block))
    return Cells(arrays, block=block)
