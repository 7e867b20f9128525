"""The comparison of maps that other tests rest on: cells, not the bytes of a compressor."""

from __future__ import annotations

import zlib

import pytest

from tests.maps.file.content import unpacked

CELLS = bytes(range(256)) * 40


@pytest.mark.parametrize("header", [b"", bytes([2]) + bytes(8)], ids=["frame", "tile"])
def test_streams_of_the_same_cells_are_alike_and_of_others_not(header: bytes) -> None:
    fast, small = (header + zlib.compress(CELLS, level) for level in (1, 9))
    assert fast != small
    assert unpacked(fast) == unpacked(small)
    assert unpacked(fast) != unpacked(header + zlib.compress(CELLS[:-1] + b"\0", 1))


def test_other_values_stay_as_they_are() -> None:
    for value in (None, 3, "text", b"", b"\x00GP", b"x^ no stream"):
        assert unpacked(value) == value
