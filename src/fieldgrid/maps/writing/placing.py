"""Placing a session: its frames, each with its pose in the map, become the tiles of the session.

This is the only way from frames to tiles. The frames may come from anywhere, in any order; the
tiles have the same bits.
"""

from __future__ import annotations

import sqlite3
import threading
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from itertools import count
from typing import NamedTuple, TypeVar

from fieldgrid.core import Closing, UInt64, in_order
from fieldgrid.geometry import TILE_CELLS, GridSpec, Lattice, Pose, TileIndex, Window, tile_window
from fieldgrid.maps.layers.blocks import block_side
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup
from fieldgrid.maps.layers.frame import FrameCells
from fieldgrid.maps.layers.window import WindowFold
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
    """A frame at its pose in the map; `load` decodes its cells, and any thread may call it."""

    pose: Pose
    spec: GridSpec
    load: Callable[[], FrameCells]


def fold_tiles(
    frames: Sequence[PlacedFrame],
    lattice: Lattice,
    transfer: Transfer,
    groups: Sequence[ChannelGroup],
    work: Callable[[TileIndex, Cells], _Result],
    jobs: int | None = None,
) -> Iterator[_Result]:
    """What `work`, in any thread, makes of each tile that the frames of a session observed.

    The tiles come square by square, so that the memory taken does not depend on the session.
    """
    squares = TileSquares(frames, lattice, transfer, groups)
    for results in in_order(lambda place: squares.fold(place, work), squares.places(), jobs):
        yield from results


class TileSquares:
    """The squares of tiles into which the frames of a session are folded, each by itself."""

    def __init__(
        self,
        frames: Sequence[PlacedFrame],
        lattice: Lattice,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
    ) -> None:
        self._frames, self._recent = frames, _FrameCache(frames)
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
        inside = self._inside[place]
        lattice, transfer, groups = self._rule
        square = Window(
            self._whole.i0 + x * self._width,
            self._whole.j0 + y * self._height,
            self._width,
            self._height,
        )
        parts = (self._footprints[k].intersect(square) for k in inside)
        window = reduce(Window.union, (part for part in parts if part is not None))
        fold = WindowFold(lattice, window, transfer, groups)
        for k in inside:
            fold.add(self._recent.cells(k), self._frames[k].pose)
        found = (
            (tile, fold.cells(tile_window(tile), whole_blocks=True)) for tile in window.tiles()
        )
        return [work(tile, cells) for tile, cells in found if cells["weight"].any()]


def _tiles_under(windows: Sequence[Window]) -> Window:
    """The whole tiles that windows reach into, as one rectangle; it is empty without any."""
    if not windows:
        return Window(0, 0, 0, 0)
    i0, j0, width, height = reduce(Window.union, windows)
    i1, j1 = -(-(i0 + width) // TILE_CELLS), -(-(j0 + height) // TILE_CELLS)
    i0, j0 = i0 // TILE_CELLS, j0 // TILE_CELLS
    return Window(*(TILE_CELLS * value for value in (i0, j0, i1 - i0, j1 - j0)))


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


class _FrameCache:
    """Frames decoded once where the next square wants them again."""

    def __init__(self, frames: Sequence[PlacedFrame]) -> None:
        self._frames = frames
        self._lock = threading.Lock()
        self._cells: OrderedDict[int, FrameCells] = OrderedDict()

    def cells(self, k: int) -> FrameCells:
        with self._lock:
            found = self._cells.get(k)
        if found is None:
            found = self._frames[k].load()
            with self._lock:
                self._cells[k] = found
                while len(self._cells) > RECENT_FRAMES:
                    self._cells.popitem(last=False)
        return found


class SessionTiles(Closing):
    """The tiles of a session, encoded, beside the map until they are in it.

    The map is locked for the moment of the commit only, readers and other drives meanwhile see it
    as it was, and giving up costs nothing. They lie in an unnamed temporary database that SQLite
    deletes by itself, also when the process is killed, where SQLITE_TMPDIR says, or in the
    system's place for temporary files.
    """

    def __init__(self, groups: Sequence[ChannelGroup], lattice: Lattice) -> None:
        self._groups, self._block = groups, block_side(lattice)
        self._lock = threading.Lock()
        self._recent: dict[TileIndex, Cells] = {}
        self._database = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        # Nothing here outlives an error, so nothing needs to be undone or synced.
        self._database.execute("PRAGMA journal_mode = OFF")
        self._database.execute("PRAGMA synchronous = OFF")
        self._database.execute("CREATE TABLE tile (ty, tx, channels, data)")
        self._database.execute("CREATE INDEX place ON tile (ty, tx)")
        self.tiles: set[TileIndex] = set()

    @classmethod
    def folded(
        cls,
        frames: Sequence[PlacedFrame],
        lattice: Lattice,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
        jobs: int | None = None,
    ) -> SessionTiles:
        """Place the accepted frames of a session."""
        made, numbers = cls(groups, lattice), count()

        def encode(
            tile: TileIndex, cells: Cells
        ) -> tuple[TileIndex, Cells | None, dict[str, bytes]]:
            # Decoded, the tiles of the squares under way would take most of the memory of a build.
            kept = cells if next(numbers) < RECENT_TILES else None
            return tile, kept, encoded_of_session(groups, cells)

        try:
            for tile, cells, blobs in fold_tiles(frames, lattice, transfer, groups, encode, jobs):
                made.put(tile, blobs, cells)
        except BaseException:
            made.close()
            raise
        return made

    def put(self, tile: TileIndex, blobs: dict[str, bytes], cells: Cells | None = None) -> None:
        """Add a tile in its stored form; its cells, where they are known, save decoding it."""
        self._database.executemany(
            "INSERT INTO tile VALUES (?, ?, ?, ?)",
            [(*tile, name, blob) for name, blob in blobs.items()],
        )
        self.tiles.add(tile)
        if cells is not None:
            self._recent[tile] = cells

    def blobs(self, tile: TileIndex) -> dict[str, bytes]:
        """The stored form of a tile, by channel group."""
        with self._lock:
            rows = self._database.execute(
                "SELECT channels, data FROM tile WHERE ty = ? AND tx = ?", tile
            ).fetchall()
        return dict(rows)

    def cells(self, tile: TileIndex) -> Cells:
        """The channels of a tile."""
        found = self._recent.get(tile)
        if found is None:
            what = f"tile {tuple(tile)}"
            found = session_cells(self._groups, self.blobs(tile), what, self._block)
        return found

    def close(self) -> None:
        """Throw them away."""
        self._database.close()


def stored_of_session(groups: Sequence[ChannelGroup]) -> list[ChannelGroup]:
    """The groups that session tiles hold: others follow from those of the session."""
    return [group for group in groups if group.fold is not None]


def encoded_of_session(groups: Sequence[ChannelGroup], cells: Cells) -> dict[str, bytes]:
    """The blobs of a tile of a session, by channel group."""
    return encode_groups(stored_of_session(groups), cells, base=True)


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
        if not (base and group.derived)
    }


def session_cells(
    groups: Sequence[ChannelGroup], blobs: dict[str, bytes], what: str, block: int
) -> Cells:
    """What a session has in a tile, from the blobs of its session tiles; see `decode_groups`."""
    arrays = dict(decode_groups(stored_of_session(groups), blobs, what, base=True, block=block))
    for group in groups:
        if group.of_session is not None:
            made = group.of_session(Cells(arrays))
            arrays.update(zip((channel.name for channel in group.channels), made, strict=True))
    return Cells(arrays, block=block)


def decode_groups(
    groups: Sequence[ChannelGroup], blobs: dict[str, bytes], what: str, *, base: bool, block: int
) -> Cells:
    """The channels of a tile from its blobs, which has `block` cells along the side of a block;
    MapError when one is damaged or missing."""
    arrays: dict[str, UInt64] = {}
    expectation = Expectation(arrays, base=base)
    for group in groups:
        if base and group.derived:
            continue
        blob, name = blobs.get(group.name), f"{group.name} of {what}"
        arrays.update(decode_tile(group, blob, expectation, name, base=base, block=block))
    return Cells(arrays, block=block)
