"""Pixels by ROS's encodings to grey, against formulas written out."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import RecordingError
from fieldgrid.recordings.frames.pixels import BAYER_PATTERNS, significant_bits, to_grey

RNG = np.random.default_rng(7)
COLOUR = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)  # r, g, b
DEEP = RNG.integers(0, 65536, (6, 8, 3), dtype=np.uint16)


def luma(rgb: npt.NDArray[np.uint8 | np.uint16]) -> npt.NDArray[np.float64]:
    """ITU-R BT.601."""
    return np.asarray(rgb @ np.array([0.299, 0.587, 0.114]), dtype=np.float64)


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", (0, 1, 2)), ("bgr8", (2, 1, 0)), ("8UC3", (2, 1, 0)), ("rgba8", (0, 1, 2, 3)),
     ("bgra8", (2, 1, 0, 3)), ("8UC4", (2, 1, 0, 3)), ("rgb16", (0, 1, 2)), ("bgr16", (2, 1, 0))],
)  # fmt: skip
def test_colour_becomes_luma(encoding: str, order: tuple[int, ...]) -> None:
    """Of 16 bits the upper 8; transparency does not matter, nor how an array lies in memory."""
    deep = encoding.endswith("16")
    colour = DEEP if deep else COLOUR
    for alpha in (0, 255):
        stored = np.dstack([colour, np.full((6, 8), alpha, colour.dtype)])[..., list(order)]
        for pixels in (stored, np.ascontiguousarray(stored), np.asfortranarray(stored)):
            grey = to_grey(pixels, encoding)
            assert grey.dtype == np.uint8
            expected = luma(colour) / 256 - 0.5 if deep else luma(colour)
            assert np.abs(grey - expected).max() <= 0.51


@given(st.integers(8, 16), st.integers(0, 65535))
def test_of_16_bits_the_upper_8_of_the_filled_ones(bits: int, value: int) -> None:
    pixels = np.full((1, 1), value, dtype=np.uint16)
    expected = min(value // 2 ** (bits - 8), 255)
    for encoding in ("mono16", "16UC1"):
        assert to_grey(pixels, encoding, bits)[0, 0] == expected
    for encoding in ("mono8", "8UC1"):
        assert to_grey((pixels % 256).astype(np.uint8), encoding, bits)[0, 0] == value % 256


@pytest.mark.parametrize("pattern", BAYER_PATTERNS)
@pytest.mark.parametrize("depth", [8, 16])
def test_a_mosaic_of_one_colour_is_its_luma(pattern: str, depth: int) -> None:
    colours = {"r": 200, "g": 90, "b": 20}
    mosaic = np.empty((10, 12), dtype=np.uint8)
    for place, name in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = colours[name]
    pixels = mosaic if depth == 8 else mosaic.astype(np.uint16) * 16  # 12 bits
    grey = to_grey(pixels, f"bayer_{pattern}{depth}", bits=12)
    expected = 0.299 * 200 + 0.587 * 90 + 0.114 * 20
    assert np.abs(grey.astype(float) - expected).max() <= 1.0


@pytest.mark.parametrize(
    ("encoding", "place"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)]
)
def test_the_luma_of_yuv_is_taken_as_it_is(encoding: str, place: int) -> None:
    pixels = RNG.integers(0, 256, (4, 6, 2), dtype=np.uint8)
    assert (to_grey(pixels, encoding) == pixels[..., place]).all()
    code = cv2.COLOR_YUV2GRAY_UYVY if place else cv2.COLOR_YUV2GRAY_YUY2
    assert (to_grey(pixels, encoding) == cv2.cvtColor(pixels, code)).all()


@pytest.mark.parametrize("encoding", ["", "32FC1", "mono12", "bayer_rgbg8", "x" * 1000])
def test_an_unknown_encoding_is_named(encoding: str) -> None:
    with pytest.raises(RecordingError, match=r"^Images are encoded as '.{0,63}', which is not"):
        to_grey(COLOUR, encoding)


@pytest.mark.parametrize(
    ("pixels", "encoding"),
    [
        (COLOUR, "mono8"),
        (COLOUR[..., 0], "bgr8"),
        (COLOUR, "bgra8"),
        (COLOUR[..., 0], "mono16"),
        (DEEP[..., 0], "mono8"),
        (COLOUR[:0, :, 0], "mono8"),
        (COLOUR[0, :, 0], "mono8"),
        (np.zeros((4, 4), dtype=np.float32), "mono8"),
    ],
)
def test_pixels_that_are_laid_out_otherwise(pixels: npt.NDArray[np.uint8], encoding: str) -> None:
    with pytest.raises(RecordingError, match="A Bayer mosaic of 2 x 6 px is no image"):
        to_grey(COLOUR[:, :2, 0], "bayer_rggb8")
    with pytest.raises(RecordingError, match=rf"^An image encoded as {encoding} has pixels"):
        to_grey(pixels, encoding)


@pytest.mark.parametrize(
    ("brightest", "bits"),
    [
        *((0, 16), (3, 8), (255, 8), (256, 10), (1023, 10), (1024, 12), (4095, 12)),
        *((4096, 14), (16383, 14), (16384, 16), (65535, 16)),
    ],
)
def test_significant_bits_are_even_and_hold_the_brightest(brightest: int, bits: int) -> None:
    samples = [np.array([[1 if brightest else 0]], dtype=np.uint16)]
    samples.append(np.array([[brightest, 0]], dtype=np.uint16))
    assert significant_bits(iter(samples)) == bits
    assert significant_bits(samples[::-1]) == bits
    for nothing in ([], [np.zeros((0, 0), dtype=np.uint16)]):
        assert significant_bits(nothing) == 16
