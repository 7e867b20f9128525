from __future__ import annotations

import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldgrid.errors import MapError
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.mapfile.codec import (
    decode_grid,
    decode_moments,
    decode_sums,
    encode_grid,
    encode_moments,
    encode_sums,
    inflate,
)
from fieldgrid.mapfile.planes import (
    empty_stored,
    from_stored,
    from_stored_reference,
    to_stored,
    to_stored_reference,
)


@given(columns=st.integers(1, 40), rows=st.integers(1, 40), seed=st.integers(0, 99))
def test_a_grid_reads_back(columns: int, rows: int, seed: int) -> None:
    spec = GridSpec(columns * 0.25, rows * 0.25, 0.25)
    random = np.random.default_rng(seed)
    observed = random.random(spec.shape) < 0.5
    density = random.integers(0, 256, spec.shape, dtype=np.uint8)
    read = decode_grid(spec, *encode_grid(LocalGrid(spec, density, observed)), "grid")
    np.testing.assert_array_equal(read.observed, observed)
    np.testing.assert_array_equal(read.density, np.where(observed, density, 0))
    assert read.density.dtype == np.uint8
    assert read.observed.dtype == np.bool_


@settings(max_examples=30, deadline=None)
@given(
    weight_bits=st.integers(0, 40),
    sum_bits=st.integers(0, 50),
    unit=st.sampled_from([1, 2, 16, 64]),
    seed=st.integers(0, 99),
)
def test_sums_read_back(weight_bits: int, sum_bits: int, unit: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    sums = np.stack(
        [
            random.integers(0, 1 << bits, (256, 256), dtype=np.uint64, endpoint=True)
            for bits in (weight_bits, sum_bits)
        ],
        axis=-1,
    ) * np.uint64(unit)
    read = decode_sums(encode_sums(sums), "tile")
    assert read.dtype == np.uint64
    np.testing.assert_array_equal(read, sums)


def test_sums_of_whole_cells_take_three_bytes_a_cell_before_compression() -> None:
    sums = np.zeros((256, 256, 2), dtype=np.uint64)
    sums[3, 5] = (16 * 200, 16 * 200 * 255)
    assert tuple(encode_sums(sums)[:3]) == (1, 2, 4)


def test_a_stream_that_unfolds_to_too_much_is_refused_without_unfolding_it() -> None:
    bomb = zlib.compress(bytes(64 << 20), 9)
    tracemalloc.start()
    try:
        with pytest.raises(MapError, match="grid is damaged"):
            inflate(bomb, 60_000, "grid")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "blob",
    [
        b"",
        b"no stream",
        zlib.compress(bytes(99)),
        zlib.compress(bytes(101)),
        zlib.compress(bytes(100))[:-5],
        "text",
        None,
        7,
    ],
)
def test_anything_but_the_expected_bytes_is_damage(blob: object) -> None:
    with pytest.raises(MapError, match="damaged"):
        inflate(blob, 100, "grid")


@pytest.mark.parametrize("header", [b"", b"\1\1", b"\0\1\0", b"\1\x08\0", b"\1\1\x05"])
def test_a_senseless_header_of_sums_is_damage(header: bytes) -> None:
    body = zlib.compress(bytes(2 * 65536))
    assert decode_sums(b"\1\1\0" + body, "tile").sum() == 0
    with pytest.raises(MapError, match="damaged"):
        decode_sums(header + (body if len(header) == 3 else b""), "tile")


@settings(max_examples=40, deadline=None)
@given(
    bits=st.tuples(*(st.integers(0, 63) for _ in range(4))),
    unit=st.sampled_from([1, 2, 16, 64]),
    share=st.sampled_from([0.0, 0.1, 1.0]),
    seed=st.integers(0, 99),
)
def test_moments_read_back_even_where_no_drive_has_them(
    bits: tuple[int, int, int, int], unit: int, share: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    moments = np.zeros((256, 256, 5), dtype=np.uint64)
    for k, size in enumerate(bits):
        values = random.integers(0, 1 << size, (256, 256), dtype=np.uint64, endpoint=True)
        moments[..., k] = values * np.uint64(unit if k < 3 else 1)
    moments[..., 4] = random.integers(0, 256, (256, 256), dtype=np.uint64)
    moments[random.random((256, 256)) >= share] = 0
    cells, shift = moments.reshape(-1, 5), int(unit > 1)
    stored, expected = empty_stored(len(cells)), empty_stored(len(cells))
    to_stored(cells, shift, stored)
    to_stored_reference(cells, shift, expected)
    np.testing.assert_array_equal(stored, expected)
    for back in (from_stored, from_stored_reference):
        again = np.empty_like(cells)
        back(stored, shift, again)
        np.testing.assert_array_equal(again, cells)
    read = decode_moments(encode_moments(moments), "tile")
    np.testing.assert_array_equal(read, moments)
    assert read.dtype == np.uint64
    assert read.flags.c_contiguous


def test_cells_seen_once_cost_no_more_than_their_sums() -> None:
    density = np.random.default_rng(1).integers(0, 256, (256, 256)).astype(np.uint64)
    sixteen = np.full_like(density, 16)
    moments = np.stack(
        [sixteen, 16 * density, 16 * density**2, np.ones_like(density), density], axis=-1
    )
    blob = encode_moments(moments)
    assert tuple(blob[:6]) == (4, 1, 1, 0, 0, 0)
    assert len(blob) < 256 * 256 * 1.02


@pytest.mark.parametrize(
    "header", [b"", b"\1\1", b"\5\1\1\1\1\1", b"\0\x09\0\0\0\0", b"\0\2\0\0\0\0"]
)
def test_a_senseless_header_of_moments_is_damage(header: bytes) -> None:
    body = zlib.compress(bytes(65536))
    assert decode_moments(b"\0\1\0\0\0\0" + body, "tile").sum() == 0
    with pytest.raises(MapError, match="damaged"):
        decode_moments(header + (body if len(header) == 6 else b""), "tile")
