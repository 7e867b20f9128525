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
FAR = np.where(KNOWN, 163.0 / np.where(KNOWN, VALUES, 1.0), 0.0).astype(np.float32)
"""The depths of disparities of `VALUES`."""


def write(path: Path, values: npt.NDArray[np.generic]) -> Path:
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        assert cv2.imwrite(str(path), values)
    return path


@pytest.mark.parametrize(
    ("names", "times", "dtype", "stated", "expected"),
    [
        (("a.png", "a.tif", "a.TIFF", "a.npy"), 1000, "uint16", DEPTH, VALUES),
        (("a.tif", "a.npy", "a.pfm"), 1, "float32", DEPTH, VALUES),
        *((("a.npy",), 1, dtype, DEPTH, VALUES) for dtype in ("float16", "float64", ">f4")),
        *((("a.npy",), 1000, dtype, DEPTH, VALUES) for dtype in ("uint32", "int16")),
        (("a.png",), 2000, "uint16", DepthFormat("depth", 0.0005), VALUES),
        (("a.tif",), 100, "float32", DepthFormat("depth", 0.01), VALUES),
        (("a.png",), 8, "uint8", DepthFormat("depth", 0.125), VALUES),
        (("a.png",), 256, "uint16", DISPARITY, FAR),
        (("a.pfm",), 1, "float32", DISPARITY, FAR),
        (("a.png",), 16, "uint16", DepthFormat("disparity", 1.0 / 16.0, 163.0), FAR),
    ],
)
def test_numbers_become_depths(
    names: tuple[str, ...],
    times: float,
    dtype: str,
    stated: DepthFormat,
    expected: npt.NDArray[np.float32],
    tmp_path: Path,
) -> None:
    for name in names:
        path = write(tmp_path / name, np.asfortranarray((VALUES * times).astype(dtype)))
        found = DepthFile(path, stated).read()
        assert found.dtype == np.float32
        assert found.shape == expected.shape
        assert np.isnan(found[~KNOWN]).all()
        assert found[KNOWN] == pytest.approx(expected[KNOWN], rel=1e-6)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_pfm_is_written_from_below(order: str, tmp_path: Path) -> None:
    scale = -1.0 if order == "<" else 1.0
    data = b"Pf\n3 2\n%f\n" % scale + VALUES[::-1].astype(f"{order}f4").tobytes()
    (tmp_path / "a.pfm").write_bytes(data)
    found = DepthFile(tmp_path / "a.pfm", DEPTH).read()
    assert np.array_equal(found, np.where(KNOWN, VALUES, np.nan), equal_nan=True)


def test_disparities_mind_the_one_at_infinity(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", np.array([[2.0, 4.0, 6.0, 8.0]], np.float32))
    found = DepthFile(path, DepthFormat("disparity", None, 163.0, 4.0)).read()
    assert np.isnan(found[0, :2]).all()
    assert found[0, 2:] == pytest.approx([163.0 / 2.0, 163.0 / 4.0])


@pytest.mark.parametrize(
    ("stated", "setting"), [(DEPTH, r"\[depth\] scale_m"), (DISPARITY, r"\[disparity\] scale_px")]
)
def test_what_is_no_depth(stated: DepthFormat, setting: str, tmp_path: Path) -> None:
    values = np.array([[np.nan, np.inf, -np.inf, -2.0, 0.0, 1e38, 1e-42]], np.float32)
    assert np.isnan(DepthFile(write(tmp_path / "a.npy", values), stated).read()).all()
    path = write(tmp_path / "a.png", (VALUES * 8).astype(np.uint8))
    with pytest.raises(RecordingError, match=f"8 bit, .* {setting}"):
        DepthFile(path, stated).read()


# --- what may not be


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + b"\0\0\0\0"


def npy(shape: str, descr: str = "'<f4'", data: bytes = b"") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


PNG = b"\x89PNG\r\n\x1a\n"
HUGE_PNG = PNG + chunk(b"IHDR", struct.pack(">IIBBBBB", 9000, 9000, 16, 0, 0, 0, 0))
COLOUR = cv2.imencode(".png", np.ones((4, 5, 3), np.uint16))[1].tobytes()


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"", "is empty"),
        (b"GIF89a", "is no PNG, JPEG, BMP, PGM, PPM or plain TIFF"),
        (PNG + b"\0" * 8, "is no PNG|truncated"),
        (HUGE_PNG + chunk(b"IDAT", b"x") + chunk(b"IEND", b""), "truncated or damaged"),
        (HUGE_PNG + b"\xff\xff\xff\xf0IDAT", "truncated or damaged"),
        (HUGE_PNG.replace(b"\0\0#(", b"\x7f\xff\xff\xff"), "claims 2147483647 x "),
        (COLOUR, r"shape \(4, 5, 3\); depths have one channel"),
        (b"Pf\n3 2\n-1.0\n" + b"\0" * 23, r"3 x 2 px and has 23 bytes"),
        (b"Pf\n999999999 999999999\n-1.0\n1234", "999999999 x 999999999 px and has 4"),
        (b"Pf\n3 x\n", "no header of a grey PFM"),
        (b"\x93NUMPY\x01\x00", "is no array of NumPy"),
        (b"\x93NUMPY\x01\x00\x06\x00{'a':(", "is no array of NumPy"),
        (npy("(1000000000000, 3)", data=b"1234"), r"4 bytes for an array of shape \(10+, 3\)"),
        (npy("(-1, -1)", data=b"1234"), "4 bytes for an array|is no array"),
        (npy("(2, 1)", data=b"1234"), "truncated or damaged"),
        (npy("(1,)", "'|O'", b"12345678"), "no array of NumPy that holds numbers"),
        (npy("(1,)", "'<c8'", b"12345678"), "no array of NumPy that holds numbers"),
        (npy("(4,)", data=b"1234" * 4), "depths have one channel"),
        (npy("(1, 1, 1)", data=b"1234"), "depths have one channel"),
        (npy("(0, 4)"), "depths have one channel"),
        (npy("(0, 999999999999999999, 999999999999999999)"), "truncated or damaged"),
    ],
)
def test_a_file_that_is_no_depth_is_refused(data: bytes, match: str, tmp_path: Path) -> None:
    """Whatever it is called: the beginning of a file tells its kind."""
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(RecordingError, match=match):
        DepthFile(tmp_path / "a.png", DEPTH).read()


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
    values = np.arange(1, 61, dtype=np.float32).reshape(6, 10)
    values = values.astype(np.uint16) if name in ("a.png", "a.tif") else values
    path = write(tmp_path_factory.mktemp("damaged") / name, values)
    data = bytearray(path.read_bytes())
    for at, byte in changes:
        data[int(at * (len(data) - 1))] = byte
    path.write_bytes(bytes(data[: int(kept * len(data)) or 1]))
    try:
        found = DepthFile(path, DEPTH).read()
    except RecordingError:
        return
    assert found.ndim == 2
    assert not (found <= 0.0).any()
