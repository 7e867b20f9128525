"""Files of depths and disparities: what they mean, and what they may not do."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings, strategies as st

from fieldgrid.core import RecordingError
from fieldgrid.recordings import DepthFile
from fieldgrid.recordings.frames.depth_files import DepthFormat

DEPTH = DepthFormat("depth")
DISPARITY = DepthFormat("disparity", focal_baseline_px_m=163.0)
VALUES = np.array([[0.0, 1.5, 2.25], [4.125, 8.0, 16.5]], np.float32)
KNOWN = VALUES > 0


def write(path: Path, values: npt.NDArray[np.generic]) -> Path:
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        assert cv2.imwrite(str(path), values)
    return path


def depths(path: Path, meaning: DepthFormat = DEPTH) -> npt.NDArray[np.float32]:
    found = DepthFile(path, meaning).read()
    assert found.dtype == np.float32
    return found


def shows(path: Path, expected: npt.NDArray[np.float32], meaning: DepthFormat = DEPTH) -> None:
    found = depths(path, meaning)
    assert found.shape == expected.shape
    assert np.isnan(found[~KNOWN]).all()
    assert found[KNOWN] == pytest.approx(expected[KNOWN], rel=1e-6)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.TIFF", "a.npy"])
def test_whole_numbers_are_millimetres(name: str, tmp_path: Path) -> None:
    shows(write(tmp_path / name, (VALUES * 1000).astype(np.uint16)), VALUES)


@pytest.mark.parametrize("name", ["a.tif", "a.npy", "a.pfm"])
def test_floats_are_metres(name: str, tmp_path: Path) -> None:
    shows(write(tmp_path / name, VALUES), VALUES)


@pytest.mark.parametrize("dtype", ["float16", "float64", ">f4", "uint32", "int16"])
def test_arrays_of_any_numbers(dtype: str, tmp_path: Path) -> None:
    unit = 1 if np.dtype(dtype).kind == "f" else 1000
    shows(write(tmp_path / "a.npy", (VALUES * unit).astype(dtype)), VALUES)
    shows(write(tmp_path / "a.npy", np.asfortranarray((VALUES * unit).astype(dtype))), VALUES)


def test_a_unit_can_be_told(tmp_path: Path) -> None:
    tenths = write(tmp_path / "a.png", (VALUES * 2000).astype(np.uint16))
    shows(tenths, VALUES, DepthFormat("depth", 0.0005))
    centimetres = write(tmp_path / "a.tif", VALUES * 100)
    shows(centimetres, VALUES, DepthFormat("depth", 0.01))
    coarse = write(tmp_path / "b.png", (VALUES * 8).astype(np.uint8))
    shows(coarse, VALUES, DepthFormat("depth", 0.125))


@pytest.mark.parametrize(
    ("meaning", "said"),
    [(DEPTH, r"\[depth\] scale_m"), (DISPARITY, r"\[disparity\] scale_px")],
)
def test_of_8_bits_the_unit_must_be_told(meaning: DepthFormat, said: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=f"8 bit, .* {said}"):
        depths(write(tmp_path / "a.png", (VALUES * 8).astype(np.uint8)), meaning)


def test_disparities_become_depths(tmp_path: Path) -> None:
    expected = np.where(KNOWN, 163.0 / np.where(KNOWN, VALUES, 1.0), 0.0).astype(np.float32)
    kitti = write(tmp_path / "a.png", (VALUES * 256).astype(np.uint16))
    shows(kitti, expected, DISPARITY)
    shows(write(tmp_path / "a.pfm", VALUES), expected, DISPARITY)
    sixteenths = write(tmp_path / "b.png", (VALUES * 16).astype(np.uint16))
    told = DepthFormat("disparity", 1.0 / 16.0, 163.0)
    shows(sixteenths, expected, told)


def test_disparities_mind_the_one_at_infinity(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", np.array([[2.0, 4.0, 6.0, 8.0]], np.float32))
    found = depths(path, DepthFormat("disparity", None, 163.0, 4.0))
    assert np.isnan(found[0, :2]).all()
    assert found[0, 2:] == pytest.approx([163.0 / 2.0, 163.0 / 4.0])


@pytest.mark.parametrize("meaning", [DEPTH, DISPARITY])
def test_what_is_no_depth(meaning: DepthFormat, tmp_path: Path) -> None:
    values = np.array([[np.nan, np.inf, -np.inf, -2.0, 0.0, 1e38, 1e-42]], np.float32)
    found = depths(write(tmp_path / "a.npy", values), meaning)
    assert np.isnan(found).all()


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_pfm_is_written_from_below(order: str, tmp_path: Path) -> None:
    path = tmp_path / "a.pfm"
    scale = -1.0 if order == "<" else 1.0
    path.write_bytes(b"Pf\n3 2\n%f\n" % scale + VALUES[::-1].astype(f"{order}f4").tobytes())
    shows(path, VALUES)


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    a, b = write(tmp_path / "a.npy", VALUES), write(tmp_path / "b.npy", VALUES + 1)
    assert DepthFile(a, DEPTH).sha256() != DepthFile(b, DEPTH).sha256()
    assert len(DepthFile(a, DEPTH).sha256()) == 64
    assert DepthFile(a, DEPTH).name == str(a)


# --- what may not be


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + b"\0\0\0\0"


PNG = b"\x89PNG\r\n\x1a\n"
HUGE_PNG = PNG + chunk(b"IHDR", struct.pack(">IIBBBBB", 9000, 9000, 16, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("name", "data", "match"),
    [
        ("a.png", b"", "is empty"),
        ("a.png", b"GIF89a", "is no PNG, JPEG, BMP, PGM, PPM or plain TIFF"),
        ("a.png", PNG + b"\0" * 8, "is no PNG|truncated"),
        ("a.png", HUGE_PNG + chunk(b"IDAT", b"x") + chunk(b"IEND", b""), "truncated or damaged"),
        ("a.png", HUGE_PNG + b"\xff\xff\xff\xf0IDAT", "truncated or damaged"),
        ("a.png", HUGE_PNG.replace(b"\0\0#(", b"\x7f\xff\xff\xff"), "claims 2147483647 x "),
        ("a.pfm", b"Pf\n3 2\n-1.0\n" + b"\0" * 23, r"3 x 2 px and has 23 bytes"),
        ("a.pfm", b"Pf\n999999999 999999999\n-1.0\n1234", "999999999 x 999999999 px and has 4"),
        ("a.pfm", b"Pf\n3 x\n", "no header of a grey PFM"),
        ("a.npy", b"\x93NUMPY\x01\x00", "is no array of NumPy"),
        ("a.npy", b"\x93NUMPY\x01\x00\x06\x00{'a':(", "is no array of NumPy"),
    ],
)
def test_a_file_that_is_no_depth_is_refused(
    name: str, data: bytes, match: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError, match=match):
        depths(tmp_path / name)


def npy(shape: str, descr: str = "'<f4'", data: bytes = b"") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (npy("(1000000000000, 3)", data=b"1234"), r"4 bytes for an array of shape \(10+, 3\)"),
        (npy("(-1, -1)", data=b"1234"), "4 bytes for an array|is no array"),
        (npy("(2, 1)", data=b"1234"), "truncated or damaged"),
        (npy("(1,)", "'|O'", b"12345678"), "holds object, not numbers"),
        (npy("(1,)", "'<c8'", b"12345678"), "holds complex64, not numbers"),
        (npy("(4,)", data=b"1234" * 4), "depths have one channel"),
        (npy("(1, 1, 1)", data=b"1234"), "depths have one channel"),
        (npy("(0, 4)"), "depths have one channel"),
    ],
)
def test_an_array_that_is_no_depth_is_refused(data: bytes, match: str, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(RecordingError, match=match):
        depths(tmp_path / "a.npy")


def test_a_colour_image_is_no_depth(tmp_path: Path) -> None:
    for name in ("a.png", "a.tif"):
        path = write(tmp_path / name, np.ones((4, 5, 3), np.uint16))
        with pytest.raises(RecordingError, match=r"is a colour image|depths have one channel"):
            depths(path)


@settings(deadline=None, max_examples=150)
@given(
    st.sampled_from(["a.png", "a.tif", "f.tif", "a.npy", "a.pfm"]),
    st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=4),
    st.floats(0.2, 1.0),
)
@example("a.png", [], 0.234375)  # cut right before the byte that tells grey from colour
def test_a_damaged_file_is_an_error_or_depths(
    tmp_path_factory: pytest.TempPathFactory,
    name: str,
    changes: list[tuple[float, int]],
    kept: float,
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    whole = name in ("a.png", "a.tif")
    values = np.arange(1, 61, dtype=np.float32).reshape(6, 10)
    path = write(folder / name, values.astype(np.uint16) if whole else values)
    data = bytearray(path.read_bytes())
    for at, byte in changes:
        data[int(at * (len(data) - 1))] = byte
    path.write_bytes(bytes(data[: int(kept * len(data)) or 1]))
    try:
        found = depths(path)
    except RecordingError:
        return
    assert found.ndim == 2
    assert not (found <= 0.0).any()
