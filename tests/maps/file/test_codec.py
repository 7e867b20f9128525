from __future__ import annotations

import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import GridSpec, LocalGrid
from fieldgrid.maps import FrameCells, stage
from fieldgrid.maps.file.codec import (
    EncodedChannel,
    as_decoded,
    cells_sha256,
    decode_cells,
    decode_channel,
    encode_channels,
    inflate,
)

SPEC = GridSpec(1.0, 1.0, 0.25)


@given(
    columns=st.integers(1, 40),
    rows=st.integers(1, 40),
    dtype=st.sampled_from(["u1", "i2", "<u4", ">i8", "f4", "f8", "bool"]),
    seed=st.integers(0, 99),
)
def test_the_channels_of_a_frame_read_back(columns: int, rows: int, dtype: str, seed: int) -> None:
    spec = GridSpec(columns * 0.25, rows * 0.25, 0.25)
    random = np.random.default_rng(seed)
    observed = random.random(spec.shape) < 0.5
    density = random.integers(0, 256, spec.shape, dtype=np.uint8)
    extra = random.integers(0, 2, spec.shape).astype(dtype)
    grid = LocalGrid(spec, density, observed)
    stored, sha256 = encode_channels(grid, {"extra": extra})
    assert [channel.name for channel in stored] == ["density", "extra", "observed"]
    read = decode_cells(spec, stored, "grid")
    np.testing.assert_array_equal(read.grid.observed, observed)
    np.testing.assert_array_equal(read.grid.density, np.where(observed, density, 0))
    np.testing.assert_array_equal(read.channels["extra"], extra)
    assert read.channels["extra"].dtype == np.dtype(dtype).newbyteorder("<")
    assert (read.grid.density.dtype, read.grid.observed.dtype) == (np.uint8, np.bool_)
    assert sha256 == cells_sha256(read) == cells_sha256(FrameCells(grid, {"extra": extra}))


def test_the_hash_of_cells_tells_every_change() -> None:
    density, observed = np.full(SPEC.shape, 7, np.uint8), np.ones(SPEC.shape, np.bool_)

    def hashed(**extra: np.ndarray) -> str:
        return cells_sha256(FrameCells(LocalGrid(SPEC, density, observed), extra))

    seen = {hashed(), hashed(a=density), hashed(b=density), hashed(a=density.view(np.int8))}
    density[1, 2] = 8
    seen.add(hashed())
    observed[0, 0] = False
    seen.add(hashed())
    assert len(seen) == 6
    before = hashed()
    density[0, 0] = 99  # not observed, so it means nothing
    assert hashed() == before


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((3, 4)),
        np.array(["a"] * 16).reshape(4, 4),
        np.zeros((4, 4), "c16"),
        np.zeros((4, 4), np.longdouble),
        np.zeros((4, 4), object),
        np.zeros((4, 4), "u1,u1"),
    ],
)
def test_a_channel_that_cannot_be_stored_is_refused(values: np.ndarray) -> None:
    grid = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, np.bool_))
    with pytest.raises(ConfigError, match="channel 'x' of a frame has"):
        encode_channels(grid, {"x": values})


@pytest.mark.parametrize(
    ("density", "observed"), [("u2", "?"), ("i8", "?"), ("f4", "?"), ("u1", "u1"), ("u1", "f8")]
)
def test_a_local_grid_of_other_types_is_refused(density: str, observed: str) -> None:
    """Whoever folds it without decoding it first would go by what cannot be stored."""
    grid = LocalGrid(SPEC, np.full(SPEC.shape, 3, density), np.ones(SPEC.shape, observed))
    with pytest.raises(ConfigError, match="of a local grid has"):
        stage(grid, "0", 0)


@pytest.mark.parametrize("name", ["density", "observed", 5])
def test_a_further_channel_cannot_take_the_place_of_the_grids_own(name: str) -> None:
    grid = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, np.bool_))
    with pytest.raises(ConfigError, match="cannot be named"):
        stage(grid, "0", 0, channels={name: np.ones(SPEC.shape, np.bool_)})


@pytest.mark.parametrize(
    "stored",
    [
        [EncodedChannel("density", "|u1", zlib.compress(bytes(16)))],
        [
            EncodedChannel("density", "|u1", zlib.compress(bytes(15))),
            EncodedChannel("observed", "bits", zlib.compress(bytes(2))),
        ],
        [
            EncodedChannel("density", "<u2", zlib.compress(bytes(32))),
            EncodedChannel("observed", "bits", zlib.compress(bytes(2))),
        ],
        [EncodedChannel("density", "O", zlib.compress(bytes(16)))],
        [EncodedChannel("density", "u1,u1", zlib.compress(bytes(16)))],
        [EncodedChannel("density", "nonsense", b"")],
        [EncodedChannel("density", "<U1000", b"")],
    ],
)
def test_channels_that_are_damaged_are_told_of(stored: list[EncodedChannel]) -> None:
    with pytest.raises(MapError, match="is damaged"):
        decode_cells(SPEC, stored, "grid")


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


@pytest.mark.parametrize("text", [",", "f4,", "f8(", "{'a': 1}", "", "O", "f4\n", "<f4x"])
def test_a_type_that_is_none_is_damage(text: str) -> None:
    """NumPy parses such texts as Python, and raises SyntaxError."""
    with pytest.raises(MapError, match="damaged"):
        decode_channel(GridSpec(width_m=1.0, length_m=1.0, cell_m=0.5), text, b"", "frame")


def test_cells_at_hand_are_those_that_would_be_decoded() -> None:
    random = np.random.default_rng(1)
    observed = random.random(SPEC.shape) < 0.5
    grid = LocalGrid(SPEC, random.integers(1, 255, SPEC.shape, dtype=np.uint8), observed)
    extra = {
        "big": random.integers(-9, 9, SPEC.shape).astype(">i2"),
        "flag": random.random(SPEC.shape) < 0.5,
        "turned": np.asfortranarray(random.random(SPEC.shape)),
    }
    decoded = decode_cells(SPEC, encode_channels(grid, extra)[0], "x")
    at_hand = as_decoded(grid, extra)
    for array in (grid.density, grid.observed, *extra.values()):
        array.flags.writeable = True
        array[:] = 0  # theirs are copies
    np.testing.assert_array_equal(at_hand.grid.density, decoded.grid.density)
    np.testing.assert_array_equal(at_hand.grid.observed, decoded.grid.observed)
    assert at_hand.channels.keys() == decoded.channels.keys()
    for name, values in decoded.channels.items():
        np.testing.assert_array_equal(at_hand.channels[name], values)
        assert at_hand.channels[name].dtype == values.dtype
        assert at_hand.channels[name].flags.c_contiguous
