"""The channels of a group in one tile as a blob, as `docs/map-format.md` defines it."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import UInt64, kernel
from fieldgrid.geometry import TILE_CELLS
from fieldgrid.maps.file.codec import damaged, deflate, inflate
from fieldgrid.maps.layers.declaration import (
    Channel,
    ChannelGroup,
    Combine,
    OverviewChannel,
    has_any,
    is_nothing,
    nothing,
)

# Numbers of a tile as planes of bytes and back: the loops of `tile_codec`.
#
# What is expected of the numbers has no cells where nothing is.


@kernel
def differences(values, expected, signed, row, column, stored):  # type: ignore[no-untyped-def]
    """Fill `stored` [rows, columns] with what the values of a tile from a row and column on are
    more than expected; `signed` ones become small numbers. Returns the bits that any of them has.
    """
    one, bits = np.uint64(1), np.uint64(0)
    width = stored.shape[1]
    for j in range(stored.shape[0]):
        out, own = stored[j], values[row + j, column : column + width]
        if expected.size > 0:
            others = expected[j * width : (j + 1) * width]
            for i in range(width):
                out[i] = own[i] - others[i]
        else:
            for i in range(width):
                out[i] = own[i]
        if signed:
            for i in range(width):
                out[i] = (out[i] << one) ^ np.uint64(np.int64(out[i]) >> 63)
        for i in range(width):
            bits |= out[i]
    return bits


@kernel
def split(stored, shift, planes):  # type: ignore[no-untyped-def]
    """Fill `planes`, uint8 [bytes, cells], with the bytes of `stored`, the low ones first."""
    for byte in range(planes.shape[0]):
        low = np.uint64(shift) + np.uint64(8 * byte)
        for k in range(stored.size):
            planes[byte, k] = np.uint8((stored[k] >> low) & np.uint64(0xFF))


@kernel
def join(planes, shift, expected, signed, row, column, values):  # type: ignore[no-untyped-def]
    """Fill the part of a tile that `planes` [bytes, rows, columns] were made of; it is 0 before."""
    zero, one = np.uint64(0), np.uint64(1)
    for j in range(planes.shape[1]):
        out = values[row + j, column : column + planes.shape[2]]
        for byte in range(planes.shape[0]):
            low = np.uint64(shift) + np.uint64(8 * byte)
            for i in range(planes.shape[2]):
                out[i] |= np.uint64(planes[byte, j, i]) << low
        if signed:
            for i in range(planes.shape[2]):
                out[i] = (out[i] >> one) ^ (zero - (out[i] & one))
        if expected.size > 0:
            first = j * planes.shape[2]
            for i in range(planes.shape[2]):
                out[i] += expected[first + i]


_WORD_BYTES = 8
_DENSITY = ("weight", "sum")
_NOTHING = np.empty(0, dtype=np.uint64)
_NO_PLANES = deflate(b"", zlib.Z_RLE)


class Box(NamedTuple):
    """The rows and columns of a tile outside of which all is 0; both ends are inside."""

    first_row: int
    first_column: int
    last_row: int
    last_column: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.last_row - self.first_row + 1, self.last_column - self.first_column + 1

    @property
    def slices(self) -> tuple[slice, slice]:
        """Where it is in an array of the tile."""
        return (
            slice(self.first_row, self.last_row + 1),
            slice(self.first_column, self.last_column + 1),
        )

    def blocks(self, side: int) -> Box:
        """The blocks of `side` x `side` cells that it touches."""
        return Box(*(value // side for value in self))


def box_of(weight: UInt64) -> Box:
    """The extent of the cells of a tile that have weight; there is at least one."""
    rows, columns = np.flatnonzero(weight.any(axis=1)), np.flatnonzero(weight.any(axis=0))
    return Box(int(rows[0]), int(columns[0]), int(rows[-1]), int(columns[-1]))


def stored_channels(group: ChannelGroup, *, base: bool) -> tuple[tuple[str, bool], ...]:
    """The names of a group's channels that a tile has, and which are signed: above the base level
    those of overviews, too, and none that are absent there."""
    if base:
        return tuple((channel.name, channel.signed) for channel in group.channels)
    above: tuple[Channel | OverviewChannel, ...] = (*group.channels, *group.overview)
    return tuple((one.name, one.signed) for one in above if one.coarser is not Combine.ABSENT)


class Expectation:
    """What is expected of the channels of groups, from the density of the same tile.

    Nothing is above the base level, and before the density is known.
    """

    def __init__(self, density: Mapping[str, UInt64], *, base: bool) -> None:
        self._density = density
        self._base = base
        self._sums: dict[Box, tuple[UInt64, UInt64]] = {}

    def of(self, group: ChannelGroup, box: Box) -> Sequence[UInt64]:
        """The channels of a group in a box, flat; empty arrays where nothing is expected.

        Raises KeyError when the density is not known.
        """
        if not self._base or group.expected is None:
            return (_NOTHING,) * len(stored_channels(group, base=self._base))
        if box not in self._sums:
            weight, total = (self._density[name][box.slices] for name in _DENSITY)
            self._sums[box] = np.ravel(weight), np.ravel(total)
        return tuple(_if_any(row) for row in group.expected(*self._sums[box]))


def _if_any(values: UInt64) -> UInt64:
    """What is expected, flat; nothing where it is all 0."""
    return np.ravel(values) if has_any(values) else _NOTHING


def _guesses(group: ChannelGroup, *, base: bool) -> dict[str, Channel]:
    """The channels that are guessed from others of their group, by name."""
    return {one.name: one for one in group.channels if base and one.guess is not None}


def _guess(channel: Channel, cells: Mapping[str, UInt64], box: Box) -> UInt64:
    """What a channel is expected to be in a box, flat; empty where it is 0."""
    known = [cells[name] for name in channel.guessed_from]
    if channel.guess is None or any(is_nothing(one) for one in known):
        return _NOTHING
    return _if_any(channel.guess(*(one[box.slices] for one in known)))


def encode_tile(
    group: ChannelGroup,
    cells: Mapping[str, UInt64],
    box: Box,
    expectation: Expectation,
    *,
    base: bool,
) -> bytes:
    """The blob of a group's channels, uint64 [256, 256] each.

    Those of a group with blocks have one value for each block, [256 / side, 256 / side] with so
    many cells along its side; `box` counts blocks then.
    """
    names = stored_channels(group, base=base)
    if not any(has_any(cells[name]) for name, _ in names):
        # All outside of the box is 0, so that what was expected in vain is not written down.
        box = Box(box.first_row, box.first_column, box.first_row, box.first_column)
        if group.expected is None or not base:
            return bytes([len(names), *box]) + bytes(2 * len(names)) + _NO_PLANES
    area = box.shape[0] * box.shape[1]
    header, planes = [len(names), *box], np.empty((len(names) * _WORD_BYTES, area), np.uint8)
    stored, used = np.empty(box.shape, dtype=np.uint64), 0
    guesses = _guesses(group, base=base)
    for expected, (name, signed) in zip(expectation.of(group, box), names, strict=True):
        guess = _guess(guesses[name], cells, box) if name in guesses else expected
        values = cells[name]
        if is_nothing(values):
            if not guess.size:
                header += [0, 0]
                continue
            values = np.zeros(values.shape, np.uint64)
        values = np.ascontiguousarray(values)
        bits = int(differences(values, guess, signed, box.first_row, box.first_column, stored))
        shift = (bits & -bits).bit_length() - 1 if bits else 0
        count = -(-(bits >> shift).bit_length() // 8)
        split(stored.reshape(-1), shift, planes[used : used + count])
        header += [shift, count]
        used += count
    return bytes(header) + (deflate(planes[:used].data, zlib.Z_RLE) if used else _NO_PLANES)


def decode_tile(
    group: ChannelGroup,
    blob: object,
    expectation: Expectation,
    what: str,
    *,
    base: bool,
    block: int = 1,
) -> dict[str, UInt64]:
    """The channels of a group, uint64 [256, 256] each; those of a group with blocks have one value
    for each `block` x `block` cells, [256 / block, 256 / block].

    `what` names the tile when it is damaged.
    """
    side = TILE_CELLS // block if group.blocks else TILE_CELLS
    names = stored_channels(group, base=base)
    box, shifts, counts, packed = _head(blob, len(names), side, what)
    try:
        expected = expectation.of(group, box)
    except KeyError as error:
        raise damaged(what, "it has no density beside it") from error
    size = box.shape[0] * box.shape[1] * sum(counts)
    if size == 0 and not any(guess.size for guess in expected) and names[0][0] not in _DENSITY:
        inflate(packed, 0, what)
        return dict.fromkeys((name for name, _ in names), nothing((side, side)))
    planes = np.frombuffer(inflate(packed, size, what), dtype=np.uint8)
    planes = planes.reshape(-1, *box.shape)
    arrays, first = dict[str, UInt64](), 0
    guesses = _guesses(group, base=base)
    for guess, (name, signed), shift, count in zip(expected, names, shifts, counts, strict=True):
        if name in guesses:
            guess = _guess(guesses[name], arrays, box)
        if not (count or guess.size or name in _DENSITY):  # that kernels take
            arrays[name] = nothing((side, side))
            continue
        arrays[name] = np.zeros((side, side), dtype=np.uint64)
        part = planes[first : first + count]
        join(part, shift, guess, signed, box.first_row, box.first_column, arrays[name])
        first += count
    return arrays


def stored_box(group: ChannelGroup, blob: object, what: str) -> Box:
    """The box of a blob of the base level, of which nothing is unpacked: that of a group without
    blocks is the extent of the cells that were observed."""
    return _head(blob, len(stored_channels(group, base=True)), TILE_CELLS, what)[0]


def _head(blob: object, channels: int, side: int, what: str) -> tuple[Box, bytes, bytes, bytes]:
    """The box, shifts and counts of a blob of `channels`, and its planes, which are still packed.
    A tile has `side` values along its side. MapError for another blob."""
    end = 5 + 2 * channels
    if not isinstance(blob, bytes) or len(blob) < end or blob[0] != channels:
        raise damaged(what, "its header does not fit its channels")
    box, shifts, counts = Box(*blob[1:5]), blob[5:end:2], blob[6:end:2]
    if min(box.shape) < 1 or max(box) >= side or max(shifts) > 63 or max(counts) > _WORD_BYTES:
        raise damaged(what, f"its header is {tuple(blob[:end])}")
    return box, shifts, counts, blob[end:]
