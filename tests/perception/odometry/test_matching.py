"""Matches beside a plain search, and the descriptors that they compare."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fieldgrid.geometry import Mount
from fieldgrid.perception import Features, RigidMotion
from fieldgrid.perception.odometry.corners import _pattern, describe
from fieldgrid.perception.odometry.matching import (
    HEAVE_M,
    LEAN,
    MAX_BITS,
    MAX_RATIO,
    NEAR_DISPARITY_PX,
    RANGE_SHARE,
    match_anywhere,
    match_near,
)
from fieldgrid.perception.odometry.rigid import Lens, predicted

LENS = Lens(780.0, 320.0, 240.0, 156.0)


def two_frames(seed: int, count: int = 120) -> tuple[Features, Features]:
    """Points that moved a little, some of them new, with descriptors of few free bits: many tie."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-4.0, -1.0, 3.0], [4.0, 2.0, 18.0], (count, 3))
    looks = rng.integers(0, 2**64, (count, 4), dtype=np.uint64) & np.uint64(0x0F0F00FF00000FFF)
    frames = []
    for moved in (0.0, 0.05):
        where = points + rng.normal(0.0, 1.0, points.shape) * [moved, moved, 2 * moved]
        flips = np.uint64(1) << rng.integers(0, 64, looks.shape, dtype=np.uint64)
        pixels = predicted(where, RigidMotion(np.eye(3), np.zeros(3)), LENS)
        order = rng.permutation(count)
        frames.append(Features(*(a[order] for a in (pixels, where, np.ones(count), looks ^ flips))))
    return frames[0], frames[1]


def mutual(bits: np.ndarray, possible: np.ndarray) -> list[tuple[int, int, int, int]]:
    """Row, column, bits and those of the next best, of mutual best matches without ties."""
    bits = np.where(possible, bits, 257)
    found = []
    for i, row in enumerate(bits):
        j = int(row.argmin())
        if row[j] < 257 and bits[:, j].argmin() == i:
            found.append((i, j, int(row[j]), int(np.delete(row, j).min())))
    return found


def differing(start: Features, stop: Features) -> np.ndarray:
    apart = start.descriptors[:, None] ^ stop.descriptors
    return np.unpackbits(apart.view(np.uint8), axis=2).sum(axis=2, dtype=np.int64)


def agree(found: object, expected: list[tuple[int, int]], bits: np.ndarray) -> None:
    """The same pairs, but for ties, of which either may be taken."""
    pairs = set(zip(*(side.tolist() for side in found), strict=True))  # type: ignore[call-overload]
    for i, j in pairs ^ set(expected):
        tied = (bits[i] == bits[i, j]).sum() > 1 or (bits[:, j] == bits[i, j]).sum() > 1
        assert tied, (i, j)
    assert len(expected) > 20
    assert len(pairs ^ set(expected)) < 0.2 * len(expected)


@pytest.mark.parametrize("seed", range(4))
def test_matches_anywhere(seed: int) -> None:
    start, stop = two_frames(seed)
    R, step_m = Mount(2.0, 10.0, 2.0, 1.0).rotation(), 1.0
    at_start, at_stop = start.points_m @ R.T, stop.points_m @ R.T
    range_m = at_start[:, 1][:, None]
    off = np.abs(at_start[:, None] - at_stop)
    possible = (off[..., 1] <= step_m + RANGE_SHARE * range_m) & (
        off[..., 2] <= HEAVE_M + LEAN * range_m
    )
    bits = differing(start, stop)
    expected = [(i, j) for i, j, one, other in mutual(bits, possible) if one <= MAX_RATIO * other]
    agree(match_anywhere(start, stop, R, step_m), expected, np.where(possible, bits, 257))


@pytest.mark.parametrize("seed", range(4))
def test_matches_near_a_prediction(seed: int) -> None:
    start, stop = two_frames(seed)
    motion, radius_px = RigidMotion(np.eye(3), np.array([0.02, 0.0, -0.1])), 25.0
    off = np.abs(predicted(start.points_m, motion, LENS)[:, None] - stop.measured_px)
    possible = (off <= [radius_px, radius_px, NEAR_DISPARITY_PX]).all(axis=2)
    bits = differing(start, stop)
    expected = [(i, j) for i, j, one, _ in mutual(bits, possible) if one <= MAX_BITS]
    found = match_near(start, stop, motion, LENS, radius_px)
    agree(found, expected, np.where(possible, bits, 257))


def test_points_behind_the_camera_match_nothing() -> None:
    start, stop = two_frames(0)
    motion = RigidMotion(np.eye(3), np.array([0.0, 0.0, -40.0]))
    assert len(match_near(start, stop, motion, LENS, 1e4).start) == 0


@pytest.mark.parametrize("scale", [1.0, 1.39, 1.5, 2.9, 5.0])
def test_a_descriptor_compares_the_spots_of_its_pattern(scale: float) -> None:
    rng = np.random.default_rng(3)
    grey = cv2.GaussianBlur(rng.normal(0.0, 1.0, (240, 320)), (0, 0), 4.0)
    image = np.clip(128 + 50 * grey / grey.std(), 0, 255).astype(np.uint8)
    half = cv2.pyrDown(image)
    levels = (image, half, cv2.pyrDown(half))
    places = np.array([[160.0, 120.0, 9.0], [3.2, 236.7, 5.0]])
    level = 2 if scale >= 2.8 else (1 if scale >= 1.4 else 0)
    smooth = cv2.GaussianBlur(levels[level], (7, 7), 2.0)
    x, y = _pattern()
    for place, found in zip(places, describe(levels, places, np.full(2, scale)), strict=True):
        # Toward zero, as the kernel does: outside the image all is cut anyway.
        u, v = (
            (np.float32(place[k]) * np.float32(0.5**level) + np.float32(0.5))
            + np.float32(scale) * np.float32(0.5**level) * spots
            for k, spots in enumerate((x, y))
        )
        column = np.clip(u.astype(np.int32), 0, smooth.shape[1] - 1)
        row = np.clip(v.astype(np.int32), 0, smooth.shape[0] - 1)
        values = smooth[row, column]
        bits = np.unpackbits(found.view(np.uint8), bitorder="little")
        assert np.array_equal(bits.astype(bool), values[:256] < values[256:])
