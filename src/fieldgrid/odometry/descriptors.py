"""How the neighbourhood of a corner looks, in 256 bits that can be compared fast."""

from __future__ import annotations

import random
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from fieldgrid.array_types import Float32, Float64, UInt8, UInt64
from fieldgrid.kernel import kernel

PATTERN_PX = 15
"""Half the side of the described patch at scale 1."""

LARGEST_SCALE = 5.0
"""The pyramid of three levels has none for larger patches."""


def describe(levels: Sequence[UInt8], places_px: Float64, scale: Float64) -> UInt64:
    """Descriptors [n, 4], uint64: which spot of each of 256 pairs is the darker one.

    `levels` are an image and two more, each half the size of the one before, whose pixel (i, j)
    lies on pixel (2 i, 2 j) of that. `places_px` [n, 2 or more] are column and row in the first;
    the pattern is enlarged by `scale` [n] and read from the level that fits.
    """
    smooth = [cv2.GaussianBlur(image, (7, 7), 2.0) for image in levels]
    descriptors = np.zeros((len(scale), 4), dtype=np.uint64)
    _describe(*smooth, places_px, scale, *_pattern(), descriptors)
    return descriptors


@lru_cache(maxsize=1)
def _pattern() -> tuple[Float32, Float32]:
    """x and y of the compared spots, [512] each: of one of each pair, then of the other.

    They crowd in the middle, as BRIEF (Calonder et al., 2010) recommends. Python's own
    generator gives the same numbers in every version.
    """
    draw = random.Random(256).random
    middle = [[sum(draw() for _ in range(3)) / 1.5 - 1.0 for _ in range(4)] for _ in range(256)]
    spots = np.array(middle, dtype=np.float32) * np.float32(PATTERN_PX)
    return spots[:, 0::2].T.ravel(), spots[:, 1::2].T.ravel()


@kernel
def _describe(full, half, quarter, places_px, scale, pattern_x, pattern_y, descriptors):  # type: ignore[no-untyped-def]
    """Fill in `descriptors` [n, 4]."""
    columns, rows = np.empty(512, dtype=np.int32), np.empty(512, dtype=np.int32)
    for k in range(len(scale)):
        level = 2 if scale[k] >= 2.8 else (1 if scale[k] >= 1.4 else 0)
        image = quarter if level == 2 else (half if level == 1 else full)
        per_px = np.float32(0.5**level)
        # Half a pixel is added, so that cutting off the fraction rounds.
        x = np.float32(places_px[k, 0]) * per_px + np.float32(0.5)
        y = np.float32(places_px[k, 1]) * per_px + np.float32(0.5)
        grow = np.float32(scale[k]) * per_px
        bottom, right = np.int32(image.shape[0] - 1), np.int32(image.shape[1] - 1)
        # Patches at the border are cut there: their inner half still tells them apart.
        for i in range(512):
            columns[i] = min(max(np.int32(x + grow * pattern_x[i]), np.int32(0)), right)
            rows[i] = min(max(np.int32(y + grow * pattern_y[i]), np.int32(0)), bottom)
        for word in range(4):
            bits = np.uint64(0)
            for bit in range(64):
                i = 64 * word + bit
                darker = image[rows[i], columns[i]] < image[rows[i + 256], columns[i + 256]]
                bits |= np.uint64(darker) << np.uint64(bit)
            descriptors[k, word] = bits
