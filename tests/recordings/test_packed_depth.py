"""Depths as ROS's transports pack them: what is read is what was packed; damage is told."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from itertools import groupby

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import RecordingError, UInt16
from fieldgrid.recordings.bag.sensors.images import PackedDepthImage, unpack_rvl
from tests.recordings.test_bag_messages import UTC, Make, read

__all__ = ["read"]

DEPTHS = np.array([[0, 1500, 1501], [65_535, 0, 250]], dtype=np.uint16)


def png(pixels: UInt16) -> bytes:
    """A PNG."""
    return cv2.imencode(".png", pixels)[1].tobytes()


def config(a: float = 0.0, b: float = 0.0) -> bytes:
    """What the transport writes first."""
    return struct.pack("<iff", 0, a, b)


def rvl(pixels: UInt16) -> bytes:
    """Pixels as RVL, by its paper: runs without depth, runs with one, zigzag differences."""
    numbers: list[int] = []
    runs = [(has, [*run]) for has, run in groupby(pixels.ravel().astype(int).tolist(), bool)]
    before = 0
    if runs[0][0]:
        numbers.append(0)
    for has_depth, run in runs:
        numbers.append(len(run))
        for value in run if has_depth else ():
            step = value - before
            numbers.append(2 * step if step >= 0 else -2 * step - 1)
            before = value
    if not runs[-1][0]:
        numbers.append(0)
    return struct.pack("<II", *pixels.shape[::-1]) + packed(numbers)


def packed(numbers: Iterable[int]) -> bytes:
    """Numbers in groups of three bits, eight groups a word, the first one uppermost."""
    groups: list[int] = []
    for number in numbers:
        while number > 7:
            groups.append(number & 7 | 8)
            number >>= 3
        groups.append(number)
    groups += [0] * (-len(groups) % 8)
    words = [
        sum(group << (28 - 4 * k) for k, group in enumerate(groups[start : start + 8]))
        for start in range(0, len(groups), 8)
    ]
    return struct.pack(f"<{len(words)}I", *words)


PACKERS = {"png": png, "rvl": rvl}


@pytest.mark.parametrize(
    ("said", "data"),
    [
        ("16UC1; compressedDepth", config() + png(DEPTHS)),
        ("16UC1; compressedDepth png", config() + png(DEPTHS)),
        ("16UC1; compressedDepth rvl", config() + rvl(DEPTHS)),
        ("16UC1; png compressed ", png(DEPTHS)),
        ("png", png(DEPTHS)),
    ],
)
def test_millimetres_are_those_that_were_packed(said: str, data: bytes, read: Make) -> None:
    depth_m = read(PackedDepthImage, lambda m: m.compressed(UTC, data, said))
    expected = np.where(DEPTHS == 0, np.nan, DEPTHS / 1000.0)
    np.testing.assert_allclose(depth_m, expected, rtol=1e-6)
    assert depth_m.dtype == np.float32


@pytest.mark.parametrize("kind", ["png", "rvl"])
def test_metres_come_back_to_the_transport_s_resolution(kind: str, read: Make) -> None:
    depth_m = np.array([[0.5, 3.0, np.nan], [9.9, 1.0, 7.25]])
    a = 100.0 * 101.0  # as the transport has it: a quantization of 100, depths to 10 m
    b = 1.0 - a / 10.0
    whole = np.nan_to_num(np.round(a / depth_m + b)).astype(np.uint16)
    data, said = config(a, b) + PACKERS[kind](whole), f"32FC1; compressedDepth {kind}"
    found = read(PackedDepthImage, lambda m: m.compressed(UTC, data, said))
    assert np.array_equal(np.isnan(found), np.isnan(depth_m))
    assert np.nanmax(np.abs(found - depth_m) / (depth_m**2 / a)) <= 0.51


@pytest.mark.parametrize(
    ("said", "data", "match"),
    [
        ("16UC1; compressedDepth", b"short", "truncated"),
        ("16UC1; compressedDepth", config() + png(DEPTHS)[:-20], "truncated or damaged"),
        ("16UC1; compressedDepth rvl", config() + b"1234", "truncated"),
        ("16UC1; compressedDepth rvl", config() + rvl(DEPTHS)[:-4], "truncated or damaged"),
        ("16UC1; compressedDepth rvl", config() + struct.pack("<II", 1 << 16, 1 << 16), "claims"),
        ("16UC1; compressedDepth rvl", config() + struct.pack("<II", 4000, 4000), "claims"),
        ("16UC1; compressedDepth rvl", config() + struct.pack("<II", 0, 9), "claims"),
        ("mono8; compressedDepth", config() + png(DEPTHS), "'mono8; compressedDepth'.*not read"),
        ("16UC1; compressedDepth", config() + png(DEPTHS.astype(np.uint8)), "not read"),
        ("mono8; jpeg compressed", b"\xff\xd8\xff\xe0 no depths", "no PNG"),
    ],
)
def test_what_cannot_be_read_is_told(said: str, data: bytes, match: str, read: Make) -> None:
    with pytest.raises(RecordingError, match=match):
        read(PackedDepthImage, lambda m: m.compressed(UTC, data, said))


@given(st.lists(st.one_of(st.just(0), st.integers(0, 65_535)), min_size=1, max_size=60))
def test_rvl_gives_back_what_was_packed(values: list[int]) -> None:
    pixels = np.array([values], dtype=np.uint16)
    words = np.frombuffer(rvl(pixels)[8:], dtype="<u4").astype(np.uint32)
    found = np.zeros(pixels.size, dtype=np.uint16)
    assert unpack_rvl(words, found) == pixels.size
    assert np.array_equal(found, pixels[0])


@given(st.lists(st.integers(0, (1 << 32) - 1), max_size=12), st.integers(1, 40))
def test_any_words_end(words: list[int], size: int) -> None:
    pixels = np.zeros(size + 8, dtype=np.uint16)
    unpack_rvl(np.array(words, dtype=np.uint32), pixels[:size])
    assert not pixels[size:].any()
