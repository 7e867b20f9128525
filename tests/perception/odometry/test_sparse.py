"""Disparities of single points beside normalised correlation in NumPy."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from fieldgrid.perception.odometry.sparse import (
    COARSE_PX,
    FINE_PX,
    FINE_SEARCH_PX,
    MIN_CORRELATION,
    MIN_LEAD,
    row_disparities,
)


def correlations(
    left: np.ndarray, right: np.ndarray, x: int, y: int, least: int, most: int, reach: int
) -> dict[int, float]:
    """By disparity, of those whose window is inside both images."""
    height, width = left.shape
    inside = reach <= y < height - reach
    found = {}
    for d in range(least, most + 1):
        if inside and reach <= x < width - reach and reach <= x - d < width - reach:
            rows = slice(y - reach, y + reach + 1)
            one = left[rows, x - reach : x + reach + 1].astype(float)
            other = right[rows, x - d - reach : x - d + reach + 1].astype(float)
            one, other = one - one.mean(), other - other.mean()
            norm = math.sqrt((one**2).sum() * (other**2).sum())
            found[d] = float((one * other).sum() / norm) if norm > 0 else -1.0
    return found


def reference(
    left: np.ndarray, right: np.ndarray, x: float, y: float, least_px: float, most_px: float
) -> float:
    half, right_half = cv2.pyrDown(left), cv2.pyrDown(right)
    where = int(x / 2.0 + 0.5), int(y / 2.0 + 0.5)
    least, most = math.floor(least_px / 2.0), math.ceil(most_px / 2.0)
    coarse = correlations(half, right_half, *where, least, most, COARSE_PX)
    if not coarse:
        return math.nan
    best = max(coarse, key=lambda d: coarse[d])
    rivals = [score for d, score in coarse.items() if abs(d - best) > 2]
    if coarse[best] < MIN_CORRELATION or max(rivals, default=-1) > coarse[best] - MIN_LEAD:
        return math.nan
    first, last = 2 * best - FINE_SEARCH_PX, 2 * best + FINE_SEARCH_PX
    fine = correlations(left, right, int(x + 0.5), int(y + 0.5), first, last, FINE_PX)
    if not fine:
        return math.nan
    best = max(fine, key=lambda d: fine[d])
    if fine[best] < MIN_CORRELATION or not {best - 1, best + 1} <= fine.keys():
        return math.nan
    before, at, after = (fine[best + k] for k in (-1, 0, 1))
    return best + 0.5 * (before - after) / (before - 2.0 * at + after)


def shifted(disparity_px: float, gain: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A textured pair; the right one is moved, of another exposure, and has noise of its own."""
    rng = np.random.default_rng(seed)
    wide = cv2.GaussianBlur(rng.normal(0.0, 1.0, (90, 260)), (0, 0), 1.5)
    wide = 120.0 + 40.0 * wide / wide.std()
    moved = np.float64([[1.0, 0.0, -disparity_px], [0.0, 1.0, 0.0]])
    right = gain * cv2.warpAffine(wide, moved, (260, 90), flags=cv2.INTER_CUBIC) + 5.0
    pair = (wide, right + rng.normal(0.0, 3.0, right.shape))
    left_image, right_image = (
        np.clip(np.rint(image), 0, 255).astype(np.uint8)[:, 40:200].copy() for image in pair
    )
    return left_image, right_image


@pytest.mark.parametrize(
    ("disparity_px", "gain", "least_px", "most_px"),
    [
        (12.3, 1.0, 0.0, 40.0),
        (0.6, 0.7, 0.0, 40.0),
        (-9.5, 1.2, -20.0, 8.0),
        (30.0, 1.0, 0.0, 33.0),
    ],
)
def test_disparities_are_those_of_the_reference(
    disparity_px: float, gain: float, least_px: float, most_px: float
) -> None:
    left, right = shifted(disparity_px, gain)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0.0, 159.4, 150), rng.uniform(0.0, 89.4, 150)])
    found = row_disparities(
        left, right, cv2.pyrDown(left), cv2.pyrDown(right), points, least_px, most_px
    )
    expected = [reference(left, right, *point, least_px, most_px) for point in points.tolist()]
    assert found == pytest.approx(np.array(expected), abs=1e-9, nan_ok=True)
    assert np.isfinite(found).sum() > 20
    assert np.nanmedian(found) == pytest.approx(disparity_px, abs=0.1)


def test_what_repeats_has_no_disparity() -> None:
    stripes = np.tile(np.rint(128 + 80 * np.sin(np.arange(160) / 1.5)).astype(np.uint8), (60, 1))
    noise = np.random.default_rng(0).integers(0, 12, stripes.shape).astype(np.uint8)
    image = stripes + noise
    half = cv2.pyrDown(image)
    found = row_disparities(image, image, half, half, np.array([[100.0, 30.0]]), 0.0, 60.0)
    assert np.isnan(found).all()
