from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from fieldgrid.core import MapError
from fieldgrid.maps import encode_png
from fieldgrid.maps.tiles.png import decode_png


def test_another_reader_sees_grey_and_alpha_with_the_north_on_top() -> None:
    random = np.random.default_rng(3)
    density = random.integers(0, 256, (256, 256), dtype=np.uint8)
    observed = random.random((256, 256)) < 0.4
    image = Image.open(io.BytesIO(encode_png(density, observed)))
    image.load()  # checks the checksums
    assert (image.mode, image.size) == ("LA", (256, 256))
    pixels = np.asarray(image)
    np.testing.assert_array_equal(pixels[::-1, :, 0], density)
    np.testing.assert_array_equal(pixels[::-1, :, 1], np.where(observed, 255, 0))


def test_a_picture_reads_back_and_anything_else_is_damage() -> None:
    random = np.random.default_rng(3)
    density = random.integers(0, 256, (256, 256), dtype=np.uint8)
    observed = random.random((256, 256)) < 0.5
    png = encode_png(density, observed)
    pixels = decode_png(png, "picture")
    np.testing.assert_array_equal(pixels[::-1, :, 0], density)
    np.testing.assert_array_equal(pixels[::-1, :, 1], observed * 255)
    for other in (b"", png[:90], png[:-3000], b"x" + png, "text", None):
        with pytest.raises(MapError, match="damaged"):
            decode_png(other, "picture")


def test_a_sum_or_an_end_that_is_wrong_is_damage() -> None:
    """A GIS shows nothing of such a picture, although its pixels can be inflated."""
    png = encode_png(np.full((256, 256), 7, np.uint8), np.full((256, 256), True))
    for at in (29, len(png) - 13, len(png) - 1):  # sums of head and pixels, the end
        broken = bytearray(png)
        broken[at] ^= 1
        with pytest.raises(MapError, match="damaged"):
            decode_png(bytes(broken), "picture")
