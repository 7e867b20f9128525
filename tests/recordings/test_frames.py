"""Frames and images: what is decoded, and what is refused."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from fieldgrid.core import CalibrationError, RecordingError
from fieldgrid.recordings import Image, ImageFile, StereoFrame

RAMP: Image = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8) * 2


@dataclass(frozen=True)
class Given:
    """An image source that holds its image."""

    name: str
    image: Image

    def read(self) -> Image:
        return self.image

    def sha256(self) -> str:
        return ""

    def encoded(self) -> bytes:
        return b""


def write(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def claims(path: Path, width: int, height: int) -> Path:
    """A PNG whose header claims a size that it does not have."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = bytearray(write(path, RAMP).read_bytes())
    data[16:29] = header
    data[29:33] = struct.pack(">I", zlib.crc32(b"IHDR" + header))
    path.write_bytes(data)
    return path


def test_an_orientation_tag_does_not_turn_a_calibrated_image(tmp_path: Path) -> None:
    path = write(tmp_path / "a.jpg", RAMP)
    tag = struct.pack(">HHIHH", 0x0112, 3, 1, 6, 0)  # orientation 6: turn by 90 degrees
    exif = b"Exif\0\0MM\0*" + struct.pack(">IH", 8, 1) + tag + bytes(4)
    data = path.read_bytes()
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
    assert cv2.imread(str(path)).shape[:2] == (64, 48)
    assert ImageFile(path).read().shape == (48, 64)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".pgm"])
def test_a_cut_image_is_damaged(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="truncated or damaged"):
        ImageFile(claims(tmp_path / "lie.png", 64, 4800)).read()
    path = write(tmp_path / f"a{suffix}", RAMP)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(RecordingError, match=rf"a\{suffix} is truncated or damaged"):
        ImageFile(path).read()


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (None, r"a\.png cannot be read: No such file"),
        ("folder", "is not a regular file"),
        ("pipe", "is not a regular file"),
        (b"", r"a\.png is empty"),
        (b"GIF89a" + bytes(100), r"a\.png is no PNG, JPEG"),
        (b"P5 # made by hand\n99999 99999\n255\n", "claims 99999 x 99999 px"),
    ],
)
def test_what_is_no_image_is_named(content: str | bytes | None, match: str, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    if content == "folder":
        path.mkdir()
    elif content == "pipe":
        os.mkfifo(path)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=match):
        ImageFile(path).read()


def test_a_huge_image_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "imdecode", None)  # calling it would be a TypeError
    with pytest.raises(RecordingError, match="claims 30000 x 30000 px, more than 100000000"):
        ImageFile(claims(tmp_path / "a.png", 30_000, 30_000)).read()
    with pytest.raises(RecordingError, match="claims 64 x 48 px, more than 1000"):
        ImageFile(write(tmp_path / "a.jpg", RAMP), max_pixels=1000).read()


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(suffix=st.sampled_from([".png", ".jpg", ".bmp", ".pgm"]), data=st.data())
def test_damage_is_never_more_than_a_recording_error(
    suffix: str, data: st.DataObject, tmp_path: Path
) -> None:
    path = write(tmp_path / f"a{suffix}", RAMP)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, min(len(content) - 1, 200)))] = data.draw(
            st.integers(0, 255)
        )
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        image = ImageFile(path, max_pixels=1_000_000).read()
    except RecordingError:
        return
    assert image.dtype == np.uint8
    assert image.ndim == 2


def frame(left: Image, right: Image, size_px: tuple[int, int] = (64, 48)) -> StereoFrame:
    return StereoFrame("7", 0, Given("left/7.png", left), Given("right/7.png", right), size_px)


def test_a_pair_has_one_size_that_the_calibration_is_for() -> None:
    left, right = frame(RAMP, RAMP[::-1]).images()
    assert (left == RAMP).all()
    assert (right == RAMP[::-1]).all()
    with pytest.raises(RecordingError, match=r"frame 7 .* left/7\.png has 64 x 48 .* 60 x 48 px"):
        frame(RAMP, RAMP[:, :60]).images()
    with pytest.raises(CalibrationError, match="has 64 x 48 px, but the calibration is for 48 x"):
        frame(RAMP, RAMP, (48, 64)).images()
