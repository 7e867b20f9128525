"""The compressed values inside a map: a frame's channels, and the channels of a tile.

All are zlib streams, so that any language can read them. Decoding never makes more bytes than
the value's known size asks for, whatever a file claims.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, ConfigError, MapError, quoted
from fieldgrid.geometry import GridSpec, LocalGrid
from fieldgrid.maps.layers.frame import FrameCells

# Level 1 is 6 to 9 times as fast as level 6 here, for 10 to 15 % more bytes.
_LEVEL = 1

_KINDS = "buif"
_DTYPE = re.compile(r"[<>|=]?[A-Za-z?][0-9]{0,9}(\[[0-9]{0,9}[A-Za-z]{1,2}\])?")
"""Kinds of NumPy values that a frame's channel may hold."""

BITS = "bits"
"""The type of a channel of truth values: eight cells a byte, the first in the high bit."""


_zlib: Any = zlib
# ISA-L is three times as fast, for a few more bytes, which are not the same each time.
with suppress(ImportError):
    _zlib = importlib.import_module("isal.isal_zlib")


def deflate(data: bytes | memoryview, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> bytes:
    """A zlib stream of `data`. Z_RLE suits bytes that repeat or are noise: faster and smaller."""
    if _zlib is not zlib:
        return bytes(_zlib.compress(data, _LEVEL))
    stream = zlib.compressobj(_LEVEL, zlib.DEFLATED, zlib.MAX_WBITS, 8, strategy)
    return stream.compress(data) + stream.flush()


def inflate(blob: object, size: int, what: str) -> bytes:
    """The `size` bytes of a zlib stream, or MapError: neither fewer nor more are accepted."""
    stream = _zlib.decompressobj()
    try:
        if not isinstance(blob, bytes):
            raise TypeError(f"a blob was expected, not {type(blob).__name__}")
        data = bytes(stream.decompress(blob, size + 1))
    except (zlib.error, _zlib.error, TypeError) as error:
        raise damaged(what, str(error)) from error
    if len(data) != size or not stream.eof:
        raise damaged(what, f"it does not hold {size} bytes")
    return data


def damaged(what: str, why: str) -> MapError:
    """The error for a stored value that cannot be read."""
    return MapError(f"The stored {what} is damaged: {why}. Restore the map from a copy.")


class EncodedChannel(NamedTuple):
    """One channel of a frame as it is stored: its name, the type of its cells, and a stream."""

    name: str
    dtype: str
    data: bytes


def encode_channels(
    grid: LocalGrid, extra: Mapping[str, AnyArray]
) -> tuple[tuple[EncodedChannel, ...], str]:
    """The channels of a frame, ordered by name, and their `cells_sha256`; ConfigError for one that
    cannot be stored.

    The density of a cell that was not observed means nothing and is stored as 0.
    """
    own: dict[str, AnyArray] = {"density": grid.density, "observed": grid.observed}
    for (name, array), kind in zip(own.items(), (np.uint8, np.bool_), strict=True):
        if array.dtype != kind:
            raise ConfigError(
                f"The {name} of a local grid has {array.dtype}; give an array of "
                f"{np.dtype(kind)}, for example by astype()."
            )
    for name, array in extra.items():
        if name in own or not isinstance(name, str):
            raise ConfigError(
                f"A further channel of a frame cannot be named {quoted(name)}; give it another "
                "name, a text that is neither 'density' nor 'observed'."
            )
        own[name] = array
    for name, array in own.items():
        if array.shape != grid.spec.shape or not _is_stored(array.dtype):
            raise ConfigError(
                f"The channel {quoted(name)} of a frame has {array.dtype} in shape {array.shape}; "
                f"give numbers of at most 64 bits in shape {grid.spec.shape}, one a cell of the "
                "local grid."
            )
    encoded, hashed = [], hashlib.sha256()
    for name, dtype, raw in _channels(FrameCells(grid, extra)):
        _add(hashed, name, dtype, grid.spec, raw)
        size = 1 if dtype == BITS else np.dtype(dtype).itemsize
        if size > 1:
            raw = np.ascontiguousarray(np.frombuffer(raw, np.uint8).reshape(-1, size).T).data
        strategy = zlib.Z_DEFAULT_STRATEGY if dtype == BITS else zlib.Z_RLE
        encoded.append(EncodedChannel(name, dtype, deflate(raw, strategy)))
    return tuple(encoded), hashed.hexdigest()


def _channels(cells: FrameCells) -> Iterator[tuple[str, str, memoryview]]:
    """The name of each channel of a frame, in the order of these, its type and its bytes, as they
    are stored."""
    observed = cells.grid.observed
    density = np.where(observed, cells.grid.density, np.uint8(0))
    for name, array in sorted({"density": density, "observed": observed, **cells.channels}.items()):
        if array.dtype.kind == "b":
            yield name, BITS, np.packbits(array).data
        else:
            flat = np.ascontiguousarray(array, _little(array)).reshape(-1)
            yield name, flat.dtype.str, flat.view(np.uint8).data


def stored_dtype(text: object) -> np.dtype[Any]:
    """The type of a stored array. TypeError for a text that is none: NumPy would take whole
    sentences for a type, and parse them as Python."""
    if not _DTYPE.fullmatch(str(text)):
        raise TypeError(f"its type is {quoted(str(text))}")
    return np.dtype(str(text))


def _is_stored(kind: np.dtype[Any]) -> bool:
    """Whether a channel may have values of that type: the same when it is written and read."""
    return kind.kind in _KINDS and not kind.fields and kind.itemsize <= 8


def decode_channel(spec: GridSpec, dtype: object, data: object, what: str) -> AnyArray:
    """The values of a stored channel [n_y, n_x]; `what` names it when it is damaged."""
    cells = spec.n_x * spec.n_y
    if dtype == BITS:
        bits = np.frombuffer(inflate(data, -(-cells // 8), what), dtype=np.uint8)
        return np.unpackbits(bits, count=cells).view(np.bool_).reshape(spec.shape)
    try:
        kind = stored_dtype(dtype)
        if not _is_stored(kind):
            raise TypeError(f"its type is {kind}")
    except (TypeError, ValueError) as error:
        raise damaged(what, str(error)) from error
    planes = np.frombuffer(inflate(data, cells * kind.itemsize, what), dtype=np.uint8)
    # Its own, so that it can be written.
    one_byte = kind.itemsize == 1
    values = planes.copy() if one_byte else planes.reshape(kind.itemsize, cells).T.copy()
    return values.reshape(-1).view(kind).reshape(spec.shape)


def decode_cells(spec: GridSpec, stored: Iterable[EncodedChannel], what: str) -> FrameCells:
    """The cells of a frame from its stored channels; `what` names it when they are damaged."""
    arrays = dict[str, AnyArray]()
    for name, dtype, data in stored:
        if not isinstance(name, str):  # of a map that was damaged
            raise damaged(what, f"the name of a channel is {quoted(name)}")
        arrays[name] = decode_channel(spec, dtype, data, f"{name} of {what}")
    density, observed = arrays.pop("density", None), arrays.pop("observed", None)
    if density is None or observed is None or density.dtype != np.uint8 or observed.dtype != bool:
        raise damaged(what, "it has no density, or does not say what was observed")
    return FrameCells(LocalGrid(spec, density, observed), arrays)


def as_decoded(grid: LocalGrid, extra: Mapping[str, AnyArray]) -> FrameCells:
    """The cells of a frame, copied, as they are decoded after `encode_channels`."""
    density = np.where(grid.observed, grid.density, np.uint8(0))
    channels = {
        name: array.astype(bool if array.dtype.kind == "b" else _little(array), order="C")
        for name, array in extra.items()
    }
    return FrameCells(LocalGrid(grid.spec, density, grid.observed.copy()), channels)


def cells_sha256(cells: FrameCells) -> str:
    """The SHA-256 of a frame's channels, uncompressed, whatever compressor stored them."""
    hashed = hashlib.sha256()
    for name, dtype, raw in _channels(cells):
        _add(hashed, name, dtype, cells.grid.spec, raw)
    return hashed.hexdigest()


def _add(hashed: Any, name: str, dtype: str, spec: GridSpec, raw: memoryview) -> None:
    """Hash a channel."""
    head = json.dumps([name, dtype, list(spec.shape)], separators=(",", ":"))
    hashed.update(head.encode() + b"\n")
    hashed.update(raw)


def _little(array: AnyArray) -> np.dtype[np.generic]:
    dtype: np.dtype[np.generic] = array.dtype.newbyteorder("<")
    return dtype
