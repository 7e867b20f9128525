"""Blobs of tiles: whatever channels hold reads back, and what is damaged is told of."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import MapError
from fieldgrid.maps import GROUPS, nothing
from fieldgrid.maps.tiles.tile_codec import (
    Expectation,
    box_of,
    decode_tile,
    encode_tile,
    stored_box,
    stored_channels,
)

DENSITY = GROUPS["density"]
SHAPE = (256, 256)


def noise(seed: int, bits: int, unit: int, seen: np.ndarray) -> np.ndarray:
    random = np.random.default_rng(seed)
    values = random.integers(0, 1 << bits, SHAPE, dtype=np.uint64, endpoint=True)
    return np.where(seen, values * np.uint64(unit), np.uint64(0))


@settings(max_examples=40)
@given(
    name=st.sampled_from(sorted(name for name, group in GROUPS.items() if group.channels)),
    bits=st.integers(0, 63),
    unit=st.sampled_from([1, 2, 16, 64]),
    share=st.sampled_from([0.001, 0.1, 1.0]),
    base=st.booleans(),
    seed=st.integers(0, 99),
)
def test_channels_read_back_even_where_no_drive_has_them(
    name: str, bits: int, unit: int, share: float, base: bool, seed: int
) -> None:
    group = GROUPS[name]
    seen = np.random.default_rng(seed).random(SHAPE) < share
    seen[7, 9] = True
    weight = np.where(seen, np.maximum(noise(seed, min(bits, 40), 1, seen), 1), 0)
    cells = {"weight": weight.astype(np.uint64), "sum": noise(seed + 1, bits, unit, seen)}
    for k, (channel, _) in enumerate(stored_channels(group, base=base)):
        cells.setdefault(channel, noise(seed + 2 + k, bits, unit, seen))
    box = box_of(cells["weight"])
    blob = encode_tile(group, cells, box, Expectation(cells, base=base), base=base)
    read = decode_tile(group, blob, Expectation(cells, base=base), "tile", base=base)
    assert set(read) == {channel for channel, _ in stored_channels(group, base=base)}
    for channel, values in read.items():
        assert values.dtype == np.uint64
        np.testing.assert_array_equal(values, cells[channel])


def test_cells_seen_once_cost_no_more_than_their_density() -> None:
    density = np.random.default_rng(1).integers(0, 256, SHAPE).astype(np.uint64)
    sixteen = np.full_like(density, 16)
    cells = {
        "weight": sixteen,
        "sum": 16 * density,
        "squares": 16 * density**2,
        "frames": np.ones_like(density),
        "highest": density,
    }
    box = box_of(sixteen)
    sizes = [
        len(encode_tile(GROUPS[name], cells, box, Expectation(cells, base=True), base=True))
        for name in ("density", "variance", "count", "max")
    ]
    assert sizes[0] < 256 * 256 * 1.02
    assert max(sizes[1:]) < 20


@pytest.mark.parametrize("base", [True, False])
@pytest.mark.parametrize("name", ["vehicle_height", "terrain", "surface", "drop", "occupancy"])
def test_what_a_drive_lacks_costs_nothing_although_it_is_expected(name: str, base: bool) -> None:
    random = np.random.default_rng(2)
    weight = random.integers(0, 99, SHAPE).astype(np.uint64)
    weight[:3, :5] = 0
    weight[3, 5] = 7
    density = {"weight": weight, "sum": weight * np.uint64(40)}
    channels = stored_channels(GROUPS[name], base=base)
    for zero in (nothing(SHAPE), np.zeros(SHAPE, np.uint64)):
        cells = {**density, **{channel: zero for channel, _ in channels}}
        expectation = Expectation(cells, base=base)
        blob = encode_tile(GROUPS[name], cells, box_of(weight), expectation, base=base)
        assert len(blob) < 30 + 2 * len(channels)
        read = decode_tile(GROUPS[name], blob, Expectation(cells, base=base), "tile", base=base)
        assert set(read) == {channel for channel, _ in channels}
        assert not any(values.any() for values in read.values())


@pytest.mark.parametrize("name", ["standing", "surface", "drop"])
def test_channels_that_are_0_everywhere_are_stored_as_zeros_are(name: str) -> None:
    weight = np.zeros(SHAPE, np.uint64)
    weight[30:50, 100:140] = 16
    density = {"weight": weight, "sum": np.zeros_like(weight)}
    group, box = GROUPS[name], box_of(weight)
    names = [channel for channel, _ in stored_channels(group, base=True)]
    blobs = []
    for zero in (nothing(SHAPE), np.zeros(SHAPE, np.uint64)):
        cells = density | dict.fromkeys(names, zero)
        blobs.append(encode_tile(group, cells, box, Expectation(cells, base=True), base=True))
    head = 5 + 2 * len(names)
    assert blobs[0][:head] == blobs[1][:head]
    assert zlib.decompress(blobs[0][head:]) == zlib.decompress(blobs[1][head:])
    read = decode_tile(group, blobs[0], Expectation(density, base=True), "tile", base=True)
    assert not any(values.any() for values in read.values())


def test_only_the_box_that_was_observed_is_stored() -> None:
    weight = np.zeros(SHAPE, np.uint64)
    weight[250:252, 3] = 16
    assert box_of(weight) == (250, 3, 251, 3)
    blob = encode_tile(
        DENSITY,
        {"weight": weight, "sum": weight},
        box_of(weight),
        Expectation({}, base=True),
        base=True,
    )
    assert tuple(blob[:9]) == (2, 250, 3, 251, 3, 4, 1, 4, 1)
    assert zlib.decompress(blob[9:]) == bytes([1, 1, 1, 1])
    assert stored_box(DENSITY, blob, "tile") == (250, 3, 251, 3)


@pytest.mark.parametrize("blob", [None, b"", bytes([2, 1, 0, 0, 1, 0, 1, 0, 1]), bytes([3]) * 9])
def test_a_box_is_read_of_no_blob_that_is_none(blob: object) -> None:
    with pytest.raises(MapError, match="tile is damaged"):
        stored_box(DENSITY, blob, "tile")


NONE = Expectation({}, base=True)
GOOD = bytes([2, 0, 0, 0, 1, 0, 1, 0, 1])


@pytest.mark.parametrize(
    "blob",
    [
        None,
        "text",
        b"",
        GOOD,
        GOOD[:5],
        bytes([3]) + GOOD[1:] + zlib.compress(bytes(4)),
        bytes([2, 1, 0, 0, 1, 0, 1, 0, 1]) + zlib.compress(bytes(4)),
        bytes([2, 0, 0, 0, 1, 64, 1, 0, 1]) + zlib.compress(bytes(4)),
        bytes([2, 0, 0, 0, 1, 0, 9, 0, 1]) + zlib.compress(bytes(20)),
        GOOD + zlib.compress(bytes(3)),
        GOOD + zlib.compress(bytes(5)),
    ],
)
def test_a_blob_that_is_none_is_damage(blob: object) -> None:
    assert decode_tile(DENSITY, GOOD + zlib.compress(bytes(4)), NONE, "tile", base=True)
    with pytest.raises(MapError, match="tile is damaged"):
        decode_tile(DENSITY, blob, NONE, "tile", base=True)
    alone = bytes([1, 0, 0, 0, 1, 0, 1]) + zlib.compress(bytes(2))
    with pytest.raises(MapError, match="no density beside it"):
        decode_tile(GROUPS["max"], alone, NONE, "tile", base=True)


def test_a_group_with_blocks_has_one_value_for_each() -> None:
    random = np.random.default_rng(3)
    weight = np.zeros(SHAPE, np.uint64)
    weight[37:91, 5:250] = 16
    group, box = GROUPS["surface"], box_of(weight)
    inside = np.zeros((64, 64), np.bool_)
    inside[37 // 4 : 90 // 4 + 1, 5 // 4 : 249 // 4 + 1] = True
    cells = {
        name: np.where(inside, random.integers(0, 300, (64, 64)), 0).astype(np.uint64)
        for name, _ in stored_channels(group, base=True)
    }
    assert box.blocks(4) == (9, 1, 22, 62)
    blob = encode_tile(group, cells, box.blocks(4), NONE, base=True)
    read = decode_tile(group, blob, NONE, "tile", base=True, block=4)
    for name, values in read.items():
        np.testing.assert_array_equal(values, cells[name])
    with pytest.raises(MapError, match="tile is damaged"):
        decode_tile(group, blob, NONE, "tile", base=True, block=16)  # 62 is beyond its edge
