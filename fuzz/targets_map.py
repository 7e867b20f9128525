"""What lies in a map and beside it: each blob is decoded, or refused in a sentence."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from fieldgrid.core import FieldgridError
from fieldgrid.geometry import Datum, GridSpec, LocalGrid, Pose, Status
from fieldgrid.live.kept.points import unpacked
from fieldgrid.maps import GROUPS, create_map, encode_png, open_map, transform_of
from fieldgrid.maps.file.codec import BITS, decode_channel
from fieldgrid.maps.file.geometry import decode_rings, encode_point, encode_polygon
from fieldgrid.maps.tiles.png import decode_png
from fieldgrid.maps.tiles.tile_codec import Expectation, decode_tile, stored_channels
from fieldgrid.perception import Sweep
from fieldgrid.pipeline import Journal, read_journal
from fuzz.target import Target, check_sentence, written

_DATUM = Datum(41.65, -4.72, 787.4)
_SPEC = GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1)
_GROUP = GROUPS["density"]


def _refused(decode: Callable[[], Any]) -> Any:
    try:
        return decode()
    except FieldgridError as error:
        check_sentence(str(error))
        return None


def _tile(data: bytes) -> None:
    expectation = Expectation({}, base=False)
    head = 5 + 2 * len(stored_channels(_GROUP, base=False))
    for blob in (data, data[:head] + zlib.compress(data[head:])):
        found = _refused(
            lambda blob=blob: decode_tile(_GROUP, blob, expectation, "tile", base=False)
        )
        assert found is None or all(values.shape == (256, 256) for values in found.values())


def _tile_seeds() -> list[bytes]:
    names = stored_channels(_GROUP, base=False)
    head = bytes([len(names), 3, 3, 8, 9, *([0, 1] * len(names))])
    cells = bytes(range(42)) * len(names)
    return [head + zlib.compress(cells), head + cells]


def _channel(data: bytes) -> None:
    kind, _, rest = data.partition(b"#")
    dtype = kind.decode("latin-1")
    for blob in (rest, zlib.compress(rest)):
        found = _refused(lambda blob=blob: decode_channel(_SPEC, dtype, blob, "frame"))
        assert found is None or found.shape == _SPEC.shape


def _channel_seeds() -> list[bytes]:
    cells = _SPEC.n_x * _SPEC.n_y
    return [
        kind + b"#" + bytes(size)
        for kind, size in (
            (BITS.encode(), -(-cells // 8)),
            (b"|u1", cells),
            (b"<f4", 4 * cells),
            (b"<i2", 2 * cells),
        )
    ]


def _rings(data: bytes) -> None:
    try:
        rings = decode_rings(data)
    except ValueError:
        return
    assert rings
    assert all(len(corner) == 2 for ring in rings for corner in ring)


def _ring_seeds() -> list[bytes]:
    square = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
    hole = ((1.0, 1.0), (2.0, 1.0), (2.0, 2.0))
    made = (encode_point(1.0, 2.0), encode_polygon(square), encode_polygon(square, [hole]))
    return [blob for blob in made if blob]


def _transform(data: bytes) -> None:
    with suppress(UnicodeDecodeError):
        found = _refused(lambda: transform_of(data.decode()))
        assert found is None or np.isfinite((found.shift_east_m, found.turn_deg)).all()


def _transform_seeds() -> list[bytes]:
    rigid = dict.fromkeys(
        ("shift_east_m", "shift_north_m", "turn_deg", "pivot_east_m", "pivot_north_m"), 1.5
    )
    return [json.dumps({"rigid": rigid}).encode()]


def _png(data: bytes) -> None:
    found = _refused(lambda: decode_png(data, "picture"))
    assert found is None or found.shape == (256, 256, 2)


def _png_seeds() -> list[bytes]:
    seen = np.zeros((256, 256), dtype=np.bool_)
    seen[40:60, 50:90] = True
    return [encode_png(np.where(seen, np.uint8(77), np.uint8(0)), seen)]


def _journal(data: bytes) -> None:
    _refused(lambda: list(read_journal(written(data, "journal"))))


def _journal_seeds() -> list[bytes]:
    path = written(b"", "journal")
    path.unlink()
    with Journal(path) as journal:
        for k in range(4):
            journal.append("fix", [k, 1.5, None, "x"], *([b"blob"] * (k % 2)))
    return [path.read_bytes()]


def _map(data: bytes) -> None:
    """A map of which some bytes are others: refused, or read as it was."""
    path = written(_map_with(data), "map.gpkg")
    try:
        with open_map(path) as universal:
            for read in (universal.sessions, universal.read, lambda: list(universal.frames())):
                _refused(read)
    except FieldgridError as error:
        check_sentence(str(error))


_WHOLE: list[bytes] = []


def _map_with(data: bytes) -> bytes:
    """The map with the bytes of a mutant in the place of its own, by page and offset."""
    if not _WHOLE:
        _WHOLE.append(_small_map())
    whole = bytearray(_WHOLE[0])
    for at in range(0, len(data) - 3, 4):
        whole[int.from_bytes(data[at : at + 3], "little") % len(whole)] = data[at + 3]
    return bytes(whole)


def _small_map() -> bytes:
    path = written(b"", "whole.gpkg")
    random = np.random.default_rng(1)
    seen = random.random(_SPEC.shape) < 0.7
    grid = LocalGrid(_SPEC, np.where(seen, np.uint8(90), np.uint8(0)), seen)
    with (
        create_map(path, _DATUM, cell_m=0.1, overwrite=True) as universal,
        universal.add_session("a") as session,
    ):
        session.add(grid, Pose(5, 2.0, 3.0, 0.7, 37.0, 0.02, 0.5, 1.5, Status.OK, ""))
    return path.read_bytes()


def _points(data: bytes) -> None:
    """A record of points whose sum fits, whatever is in it."""
    header, _, body = data.partition(b"#")
    for packed_body in (body, zlib.compress(body)):
        record = len(header).to_bytes(4, "little") + header + packed_body
        found = unpacked(record, None)  # type: ignore[arg-type] - a sweep asks for none
        assert found is None or isinstance(found, Sweep)


def _points_seeds() -> list[bytes]:
    return [
        b'[false, 0, [["float32", [2, 3], false]]]#' + bytes(24),
        b'[false, 0, [["int16", [2, 3], false], ["float64", [2], true]]]#' + bytes(28),
    ]


TARGETS = [
    Target("tile", _tile, _tile_seeds),
    Target("channel", _channel, _channel_seeds),
    Target("geometry", _rings, _ring_seeds),
    Target("transform", _transform, _transform_seeds),
    Target("picture", _png, _png_seeds),
    Target("live journal", _journal, _journal_seeds),
    Target("points", _points, _points_seeds),
    Target("map", _map, lambda: [bytes(range(4)), bytes(range(40)), bytes([0, 16, 0, 9] * 3)]),
]
