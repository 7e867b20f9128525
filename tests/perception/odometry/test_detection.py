"""Corners beside OpenCV's measure of them, and a plain search for the strongest."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fieldgrid.perception.odometry.detection import BORDER_PX, find_corners


def textured(height: int, width: int, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (height, width))
    grey = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128.0 + 50.0 * grey / grey.std(), 0, 255).astype(np.uint8)


def plain(image: np.ndarray, cell_px: int, least: float) -> list[tuple[int, int]]:
    """The strongest of each cell, column and row, that no neighbour exceeds."""
    strength = cv2.cornerMinEigenVal(image, 5)
    height, width = image.shape
    found = []
    for top in range(0, height, cell_px):
        for left in range(0, width, cell_px):
            spots = [
                (-strength[y, x], y, x)
                for y in range(max(top, BORDER_PX), min(top + cell_px, height - BORDER_PX))
                for x in range(max(left, BORDER_PX), min(left + cell_px, width - BORDER_PX))
            ]
            if not spots:
                continue
            value, y, x = min(spots)
            around = strength[y - 1 : y + 2, x - 1 : x + 2].max()
            if -value > least and around <= -value:
                found.append((x, y))
    return found


@pytest.mark.parametrize(("height", "width", "cell_px"), [(96, 131, 16), (70, 64, 9), (12, 40, 8)])
def test_corners_are_the_strongest_spots_of_their_cells(
    height: int, width: int, cell_px: int
) -> None:
    image = textured(height, width, seed=height)
    least = float(np.median(cv2.cornerMinEigenVal(image, 5)))
    corners = find_corners(image, cell_px, least)
    assert np.rint(corners).astype(int).tolist() == [list(p) for p in plain(image, cell_px, least)]
    assert len(corners) > 0


def test_a_corner_lies_between_pixels() -> None:
    """A small round spot that is moved by fractions."""
    rows, columns = np.mgrid[0:40, 0:40].astype(np.float64)
    for x, y in ((20.0, 20.0), (20.3, 19.6), (19.75, 20.25)):
        spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2.0 * 1.3**2))
        image = np.rint(60.0 + 180.0 * spot).astype(np.uint8)
        corners = find_corners(image, 40, 1e-4)
        assert corners == pytest.approx(np.array([[x, y]]), abs=0.1)


def test_a_flat_image_and_a_tiny_one_have_no_corners() -> None:
    assert len(find_corners(np.full((60, 60), 90, np.uint8), 16, 2e-5)) == 0
    assert len(find_corners(textured(7, 7, 0), 8, 0.0)) == 0
