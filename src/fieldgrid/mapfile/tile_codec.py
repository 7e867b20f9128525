"""The channels of a group in one tile as a blob, as `docs/map-format.md` defines it."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import UInt8, UInt64
from fieldgrid.errors import MapError
from fieldgrid.lattice import TILE_CELLS
from fieldgrid.layers import ChannelGroup
from fieldgrid.mapfile.codec import damaged, deflate, inflate

_WORD_BYTES = 8
_SIGN = np.uint64(63)
_ONE = np.uint64(1)


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


def box_of(weight: UInt64) -> Box:
    """The extent of the cells of a tile that have weight; there is at least one."""
    rows, columns = np.flatnonzero(weight.any(axis=1)), np.flatnonzero(weight.any(axis=0))
    return Box(int(rows[0]), int(columns[0]), int(rows[-1]), int(columns[-1]))


def stored_channels(group: ChannelGroup, *, base: bool) -> tuple[tuple[str, bool], ...]:
    """The names of a group's channels that a tile has, and which are signed: above the base level
    those of overviews, too."""
    own = tuple((channel.name, channel.signed) for channel in group.channels)
    return own if base else own + tuple((extra.name, False) for extra in group.overview)


def encode_tile(group: ChannelGroup, cells: Mapping[str, UInt64], box: Box, *, base: bool) -> bytes:
    """The blob of a group's channels, uint64 [256, 256] each."""
    names = stored_channels(group, base=base)
    values = np.empty((len(names), *box.shape), dtype=np.uint64)
    for row, (name, _) in zip(values, names, strict=True):
        row[:] = cells[name][box.slices]
    flat = values.reshape(len(names), -1)
    if base and group.expected is not None:
        flat -= group.expected(*_weight_and_sum(cells, box))
    header, planes = [len(names), *box], list[UInt8]()
    for row, (_, signed) in zip(flat, names, strict=True):
        if signed:
            row[:] = (row << _ONE) ^ (row.view(np.int64) >> 63).view(np.uint64)
        bits = int(np.bitwise_or.reduce(row))
        shift = (bits & -bits).bit_length() - 1 if bits else 0
        row >>= np.uint64(shift)
        count = -(-(bits >> shift).bit_length() // 8)
        header += [shift, count]
        octets = row.view(np.uint8).reshape(-1, _WORD_BYTES)
        planes += [octets[:, k] for k in range(count)]
    body = np.stack(planes).data if planes else b""
    return bytes(header) + deflate(body, zlib.Z_RLE)


def decode_tile(
    group: ChannelGroup,
    blob: object,
    density: Mapping[str, UInt64] | None,
    what: str,
    *,
    base: bool,
) -> dict[str, UInt64]:
    """The channels of a group, uint64 [256, 256] each; `what` names the tile when it is damaged.

    `density` has the channels of the density in the same tile, for groups that expect theirs.
    """
    names = stored_channels(group, base=base)
    head = 5 + 2 * len(names)
    if not isinstance(blob, bytes) or len(blob) < head or blob[0] != len(names):
        raise damaged(what, "its header does not fit its channels")
    box, codes = Box(*blob[1:5]), blob[5:head]
    shifts, counts = codes[::2], codes[1::2]
    if min(box.shape) < 1 or max(shifts) > 63 or max(counts) > _WORD_BYTES:
        raise damaged(what, f"its header is {tuple(blob[:head])}")
    area = box.shape[0] * box.shape[1]
    data = inflate(blob[head:], area * sum(counts), what)
    planes = np.frombuffer(data, dtype=np.uint8).reshape(-1, area)
    flat, first = np.zeros((len(names), area), dtype=np.uint64), 0
    for row, (_, signed), shift, count in zip(flat, names, shifts, counts, strict=True):
        octets = row.view(np.uint8).reshape(-1, _WORD_BYTES)
        octets[:, :count] = planes[first : first + count].T
        first += count
        row <<= np.uint64(shift)
        if signed:
            row[:] = (row >> _ONE) ^ (np.uint64(0) - (row & _ONE))
    if base and group.expected is not None:
        if density is None:
            raise MapError(f"The {what} has no density beside it. Repair the map.")
        flat += group.expected(*_weight_and_sum(density, box))
    whole = np.zeros((len(names), TILE_CELLS, TILE_CELLS), dtype=np.uint64)
    whole[(slice(None), *box.slices)] = flat.reshape(len(names), *box.shape)
    return {name: array for (name, _), array in zip(names, whole, strict=True)}


def _weight_and_sum(cells: Mapping[str, UInt64], box: Box) -> tuple[UInt64, UInt64]:
    return tuple(  # type: ignore[return-value]
        np.ascontiguousarray(cells[name][box.slices]).reshape(-1) for name in ("weight", "sum")
    )
