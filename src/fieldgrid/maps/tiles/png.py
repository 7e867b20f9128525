"""Grey and alpha tiles as PNG.

Written here rather than by an imaging library because a tile is encoded for every place that
a drive touches, and this takes half the time: no filters are tried, runs are enough.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from fieldgrid.core import Bool, MapError, UInt8
from fieldgrid.geometry import TILE_CELLS
from fieldgrid.maps.file.codec import deflate, inflate

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY_ALPHA = 4
_BIT_DEPTH = 8


def encode_png(density: UInt8, observed: Bool) -> bytes:
    """A PNG of a density and its mask, both [rows north, columns east], row 0 in the south.

    Grey is the 3D density, alpha 255 where a cell was observed and 0 where not. A PNG starts
    with its upper row, so the rows are turned over.
    """
    height, width = density.shape
    rows = np.zeros((height, 1 + 2 * width), dtype=np.uint8)  # a row starts with filter 0: none
    rows[:, 1::2] = density[::-1]
    np.multiply(observed[::-1], np.uint8(255), out=rows[:, 2::2])
    header = struct.pack(">IIBBBBB", width, height, _BIT_DEPTH, _GREY_ALPHA, 0, 0, 0)
    return b"".join(
        (
            _SIGNATURE,
            _chunk(b"IHDR", header),
            _chunk(b"IDAT", deflate(rows.data, zlib.Z_RLE)),
            _chunk(b"IEND", b""),
        )
    )


def decode_png(blob: object, what: str) -> UInt8:
    """Grey and alpha [rows, columns, 2] of a PNG as written here, its upper row first.

    `what` names it in the MapError for anything else.
    """
    damaged = MapError(f"The stored {what} is damaged. Repair the map.")
    start = len(_SIGNATURE) + 8
    if not isinstance(blob, bytes) or len(blob) < start + 33 or not blob.startswith(_SIGNATURE):
        raise damaged
    width, height, *kind = struct.unpack(">IIBBBBB", blob[start : start + 13])
    (size,) = struct.unpack(">I", blob[start + 17 : start + 21])
    data = blob[start + 25 : start + 25 + size]
    if (width, height) != (TILE_CELLS, TILE_CELLS) or kind != [_BIT_DEPTH, _GREY_ALPHA, 0, 0, 0]:
        raise damaged
    # Sums and end, too: a GIS shows nothing of a picture in which one of them is wrong.
    if blob[len(_SIGNATURE) :] != b"".join(
        (_chunk(b"IHDR", blob[start : start + 13]), _chunk(b"IDAT", data), _chunk(b"IEND", b""))
    ):
        raise damaged
    rows = np.frombuffer(inflate(data, height * (1 + 2 * width), what), dtype=np.uint8)
    rows = rows.reshape(height, 1 + 2 * width)
    if rows[:, 0].any():
        raise damaged
    return rows[:, 1:].reshape(height, width, 2)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
