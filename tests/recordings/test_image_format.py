"""Image files of 16 bits, of Bayer mosaics, and TIFFs, in a plain folder."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import RecordingError
from fieldgrid.recordings import Shot
from fieldgrid.recordings.frames.image_format import image_format
from fieldgrid.recordings.frames.image_header import read_header
from fieldgrid.recordings.frames.images import ImageFormat, decode_image
from fieldgrid.recordings.readers.settings_file import RecordingSettings

RNG = np.random.default_rng(3)
GREY = RNG.integers(0, 256, (20, 24), dtype=np.uint8)
DEEP = RNG.integers(0, 4096, (20, 24), dtype=np.uint16)
DEEP[0, 0] = 4095


def encoded(ending: str, image: npt.NDArray[np.uint8 | np.uint16]) -> bytes:
    done, data = cv2.imencode(ending, image)
    assert done
    return bytes(data)


@pytest.mark.parametrize("ending", [".png", ".pgm", ".tif"])
def test_16_bits_are_cut_the_same_in_every_format(ending: str) -> None:
    data = encoded(ending, DEEP)
    assert (decode_image(data, "a") == DEEP >> 8).all()
    assert (decode_image(data, "a", image_format=ImageFormat(bits=12)) == DEEP >> 4).all()
    assert decode_image(data, "a", image_format=ImageFormat(bits=10)).max() == 255


@pytest.mark.parametrize("ending", [".png", ".ppm", ".tif"])
def test_deep_colour_is_read_too(ending: str) -> None:
    bgr = RNG.integers(0, 65536, (20, 24, 3), dtype=np.uint16)
    luma = bgr @ np.array([0.114, 0.587, 0.299])
    assert (np.abs(decode_image(encoded(ending, bgr), "a") - luma / 256 + 0.5) < 0.51).all()


@pytest.mark.parametrize(
    ("ending", "colour"),
    [
        *((ending, False) for ending in (".png", ".jpg", ".bmp", ".pgm", ".tif")),
        *((ending, True) for ending in (".png", ".jpg", ".bmp", ".ppm", ".tif")),
    ],
)
def test_8_bits_are_read_as_by_opencv(ending: str, colour: bool) -> None:
    image = np.dstack([GREY, GREY[::-1], GREY[:, ::-1]]) if colour else GREY
    data = encoded(ending, image)
    expected = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    assert (decode_image(data, "a") == expected).all()
    # What 16 bits would mean changes nothing.
    assert (decode_image(data, "a", image_format=ImageFormat(bits=10)) == expected).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_mosaic_in_a_grey_file(dtype: type) -> None:
    mosaic = np.full((20, 24), 100, dtype=dtype)
    mosaic[::2, ::2], mosaic[1::2, 1::2] = 200, 40
    for pattern, red, blue in (("rggb", 200, 40), ("bggr", 40, 200)):
        grey = decode_image(encoded(".png", mosaic), "a", image_format=ImageFormat(pattern, 8))
        assert np.abs(grey - (0.299 * red + 0.587 * 100 + 0.114 * blue)).max() <= 1.0
    data = encoded(".png", np.dstack([GREY] * 3))
    with pytest.raises(RecordingError, match=r"^a is a colour image, and .* leave bayer out"):
        decode_image(data, "a", image_format=ImageFormat("rggb"))


@pytest.mark.parametrize(
    ("images", "said", "found", "told"),
    [
        ([DEEP >> 4, DEEP, DEEP >> 4], RecordingSettings(), ImageFormat(None, 12), "the lower 12"),
        ([None, DEEP], RecordingSettings(), ImageFormat(None, 12), "the lower 12"),
        ([DEEP], RecordingSettings(bits=14, bayer="gbrg"), ImageFormat("gbrg", 14), ""),
        ([GREY] * 7, RecordingSettings(), ImageFormat(), ""),
    ],
)
def test_the_bits_are_found_once_for_all_images(
    images: list[npt.NDArray[np.uint8 | np.uint16] | None],
    said: RecordingSettings,
    found: ImageFormat,
    told: str,
    tmp_path: Path,
) -> None:
    """A broken image does not hide the others, what is said is believed, and of 8 bits there is
    nothing to find out."""
    for number, image in enumerate(images):
        data = b"nothing" if image is None else encoded(".png", image)
        (tmp_path / f"{number}.png").write_bytes(data)
    shots = [Shot(k, str(k), (f"{k}.png", f"{k}.png")) for k in range(len(images))]
    stated, notes = image_format(tmp_path, shots, said)
    assert stated == found
    assert bool(notes) == bool(told)
    assert told in "".join(notes)


def tiff(**changes: int) -> bytes:
    """A TIFF by libtiff with one tag of its directory set to another value."""
    data = bytearray(encoded(".tif", GREY))
    at = int.from_bytes(data[4:8], "little")
    for k in range(int.from_bytes(data[at : at + 2], "little")):
        entry = at + 2 + 12 * k
        tag = int.from_bytes(data[entry : entry + 2], "little")
        if f"tag_{tag}" in changes:
            data[entry + 8 : entry + 12] = changes[f"tag_{tag}"].to_bytes(4, "little")
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (tiff(tag_256=0xFFFF, tag_257=0xFFFF), "claims 65535 x 65535 px, more than"),
        (tiff(tag_258=1), "plain TIFF"),
        (tiff(tag_259=7), "plain TIFF"),
        (tiff(tag_273=0x7FFFFFFF), "is truncated or damaged"),
        (encoded(".tif", GREY)[:-40], "plain TIFF|truncated"),
        (encoded(".tif", GREY)[:20], "plain TIFF|truncated"),
        (b"II*\0", "plain TIFF"),
        (b"MM\0*\0\0\0\x08\xff\xff", "plain TIFF"),
    ],
)
def test_a_tiff_that_is_broken_or_odd(data: bytes, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        decode_image(data, "a.tif")


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300), st.sampled_from([b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08", b""]))
def test_headers_of_anything_are_no_harm(data: bytes, start: bytes) -> None:
    header = read_header(start + data)
    assert header is None or isinstance(header.width_px, int)
