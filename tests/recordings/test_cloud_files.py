"""Files of point clouds: what they mean, and what they may not do."""

from __future__ import annotations

import builtins
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from pypcd4 import Encoding, PointCloud as Pcd

from fieldgrid.core import ConfigError, RecordingError
from fieldgrid.recordings import CloudFile, CloudKind
from fieldgrid.recordings.frames.cloud_files import to_optical
from fieldgrid.recordings.frames.las import las_time_ns

Points = npt.NDArray[np.float32]

POINTS = np.random.default_rng(0).uniform(-30.0, 30.0, (200, 3)).astype(np.float32)
GPS_S = 250_000_000.25
"""Adjusted standard GPS time of the first point of the LAS files."""

FORMATS = [
    *("a.npy", "a.bin", "binary.ply", "ascii.ply", "binary.pcd", "ascii.pcd"),
    *("binary_compressed.pcd", "pointwise.las", "pointwise.laz", "layered.las", "layered.laz"),
]


def write(path: Path, points: Points = POINTS) -> Path:
    if path.suffix == ".npy":
        np.save(path, points)
    elif path.suffix == ".bin":
        np.column_stack([points, np.ones(len(points))]).astype("<f4").tofile(path)
    elif path.suffix == ".ply":
        encoding = "ascii" if path.stem == "ascii" else "binary"
        trimesh.PointCloud(points).export(path, encoding=encoding)
    elif path.suffix == ".pcd":
        Pcd.from_xyz_points(points).save(path, encoding=Encoding(path.stem))
    else:
        layered = path.stem == "layered"
        las(points, layered).write(path)
    return path


def las(points: Points, layered: bool = True, standard: bool = True) -> laspy.LasData:
    header = laspy.LasHeader(point_format=6 if layered else 1, version="1.4" if layered else "1.2")
    header.scales = np.full(3, 1e-4)
    if standard:
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T.astype(float)
    data.gps_time = GPS_S + 0.001 * np.arange(len(points))
    return data


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_its_points(name: str, tmp_path: Path) -> None:
    found = CloudFile(write(tmp_path / name), CloudKind("rdf")).read()
    assert found.dtype == np.float32
    assert found == pytest.approx(POINTS, abs=1e-4)


@pytest.mark.parametrize("name", FORMATS)
def test_a_cloud_without_points(name: str, tmp_path: Path) -> None:
    if name.endswith((".ply", ".bin")):
        header = b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
        data = header + b"property float z\nend_header\n" if name.endswith("ply") else b""
        (tmp_path / name).write_bytes(data)
    else:
        write(tmp_path / name, POINTS[:0])
    if name == "a.bin":
        with pytest.raises(RecordingError, match="is empty"):
            CloudFile(tmp_path / name).read()
    else:
        assert CloudFile(tmp_path / name).read().shape == (0, 3)


def test_axes() -> None:
    """Of a point 3 m ahead, 2 m to the left and 1 m up."""
    optical = [-2.0, -1.0, 3.0]
    told = {"flu": [3, 2, 1], "rdf": optical, "rfu": [-2, 3, 1], "frd": [3, -2, -1],
            "bru": [-3, -2, 1], "luf": [2, 1, 3]}  # fmt: skip
    for axes, point in told.items():
        found = to_optical(np.array([point], np.float32), axes)
        assert found.tolist() == [optical], axes


def test_clouds_are_flu_when_nothing_is_said(tmp_path: Path) -> None:
    found = CloudFile(write(tmp_path / "a.npy")).read()
    assert np.array_equal(found, np.stack([-POINTS[:, 1], -POINTS[:, 2], POINTS[:, 0]], axis=1))


def test_more_columns_and_other_numbers(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.column_stack([POINTS, POINTS]).astype(np.float64))
    assert np.array_equal(CloudFile(tmp_path / "a.npy", CloudKind("rdf")).read(), POINTS)


def test_a_ply_with_other_properties_and_faces(tmp_path: Path) -> None:
    header = (
        b"ply\r\nformat binary_big_endian 1.0\r\ncomment by hand\r\nelement vertex 2\r\n"
        b"property uchar red\r\nproperty double z\r\nproperty float x\r\nproperty short y\r\n"
        b"element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
    )
    body = struct.pack(">Bdfh", 9, 3.5, 1.5, 2) + struct.pack(">Bdfh", 9, 6.5, 4.5, 5)
    (tmp_path / "a.ply").write_bytes(header + body + b"\x03" + b"\0" * 12)
    found = CloudFile(tmp_path / "a.ply", CloudKind("rdf")).read()
    assert found.tolist() == [[1.5, 2.0, 3.5], [4.5, 5.0, 6.5]]


STAMP_NS = 1_780_000_000_000_000_000
AFTER_S = np.linspace(0.0, 0.0995, len(POINTS))


def timed_ply(path: Path, kind: str) -> Path:
    """A PLY of `POINTS` with a time of each, in front of them."""
    vertices = np.zeros(len(POINTS), [("t", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    vertices["t"] = np.rint(AFTER_S * 1e9)
    for axis, column in zip("xyz", POINTS.T, strict=True):
        vertices[axis] = column
    header = f"ply\nformat {kind} 1.0\nelement vertex {len(POINTS)}\nproperty uint t\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    rows = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in vertices.tolist())
    path.write_bytes(header.encode() + (rows.encode() if kind == "ascii" else vertices.tobytes()))
    return path


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_ply_may_say_when_points_were_taken(kind: str, tmp_path: Path) -> None:
    path = timed_ply(tmp_path / "a.ply", kind)
    points, after_s = CloudFile(path, CloudKind("rdf"), STAMP_NS).sweep()
    assert points == pytest.approx(POINTS, abs=1e-4)
    assert after_s == pytest.approx(AFTER_S, abs=1e-6)
    assert CloudFile(path, CloudKind("rdf", corrected=True), STAMP_NS).sweep().after_s is None


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_a_pcd_may_say_when_points_were_taken(encoding: str, tmp_path: Path) -> None:
    """By the clock of the stamps: the point that is none is left out with its time."""
    absolute = STAMP_NS / 1e9 - 0.04 + AFTER_S
    places = POINTS.copy()
    places[7, 1] = np.nan
    cloud = Pcd.from_points(
        [*places.T, absolute], ("x", "y", "z", "timestamp"), (*[np.float32] * 3, np.float64)
    )
    cloud.save(tmp_path / "a.pcd", encoding=Encoding(encoding))
    points, after_s = CloudFile(tmp_path / "a.pcd", CloudKind("rdf"), STAMP_NS).sweep()
    assert points == pytest.approx(np.delete(POINTS, 7, axis=0), abs=1e-4)
    assert after_s == pytest.approx(np.delete(AFTER_S, 7) - 0.04, abs=1e-6)


def test_the_times_of_a_las_are_utc(tmp_path: Path) -> None:
    data = las(POINTS)
    data.gps_time = GPS_S + AFTER_S
    data.write(tmp_path / "a.las")
    stamp_ns = las_time_ns(tmp_path / "a.las")
    after_s = CloudFile(tmp_path / "a.las", CloudKind("rdf"), stamp_ns + 50_000_000).sweep().after_s
    assert after_s == pytest.approx(AFTER_S - 0.05, abs=1e-6)
    data = las(POINTS, standard=False)
    data.write(tmp_path / "b.las")
    assert CloudFile(tmp_path / "b.las", CloudKind("rdf"), stamp_ns).sweep().after_s is None


def test_what_is_not_finite_is_left_out(tmp_path: Path) -> None:
    bad = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 1e30]], np.float32)
    np.save(tmp_path / "a.npy", np.vstack([bad, POINTS]))
    assert np.array_equal(CloudFile(tmp_path / "a.npy", CloudKind("rdf")).read(), POINTS)


def test_points_of_a_map_are_no_sensor_s(tmp_path: Path) -> None:
    far = las(POINTS)
    far.header.offsets = np.array([500_000.0, 4_400_000.0, 0.0])
    far.x, far.y = POINTS[:, 0] + 500_000.0, POINTS[:, 1] + 4_400_000.0
    far.write(tmp_path / "a.las")
    with pytest.raises(RecordingError, match="10 km from their origin"):
        CloudFile(tmp_path / "a.las").read()


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    a = CloudFile(write(tmp_path / "a.npy"))
    assert a.sha256() != CloudFile(write(tmp_path / "b.npy", POINTS + 1)).sha256()
    assert a.name == str(tmp_path / "a.npy")


# --- times


@pytest.mark.parametrize("name", ["pointwise.las", "layered.las", "layered.laz"])
def test_the_time_of_a_las_is_utc(name: str, tmp_path: Path) -> None:
    # 1.25e9 s after 1980-01-06 is 2019-08-16 14:13:20 GPS time, 18 leap seconds ahead of UTC.
    expected = 1_565_964_800_250_000_000 - 18_000_000_000
    assert las_time_ns(write(tmp_path / name)) == expected


def test_a_las_that_does_not_say_its_time(tmp_path: Path) -> None:
    las(POINTS, standard=False).write(tmp_path / "week.las")
    las(POINTS[:0]).write(tmp_path / "empty.las")
    laspy.LasData(laspy.LasHeader(point_format=0, version="1.2")).write(tmp_path / "none.las")
    for name in ("week", "empty", "none"):
        with pytest.raises(RecordingError, match=r"has no points with GPS time .* add frames\.csv"):
            las_time_ns(tmp_path / f"{name}.las")
    wrong = las(POINTS)
    for seconds in (-2e9, 1e300, np.nan):
        wrong.gps_time = np.full(len(POINTS), seconds)
        wrong.write(tmp_path / "wrong.las")
        with pytest.raises(RecordingError, match="which no receiver can have seen"):
            las_time_ns(tmp_path / "wrong.las")


# --- what may not be

PLY = "ply\nformat {} 1.0\nelement vertex {}\n{}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = "VERSION 0.7\nFIELDS x y z\nSIZE {}\nTYPE F F F\nCOUNT {}\nWIDTH {n}\nHEIGHT 1\n"
PCD += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {}\n"


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("a.ply", PLY.format("ascii", 10**12, XYZ) + "1 2 3\n", "claims 10{12} points and has 6"),
        ("a.ply", PLY.format("binary_little_endian", 10**12, XYZ), "claims 10{12} points"),
        ("a.ply", PLY.format("ascii", 10**30, XYZ), "no header of a PLY"),
        ("a.ply", PLY.format("ascii", "x", XYZ), "no header of a PLY"),
        ("a.ply", PLY.format("ascii", 1, XYZ[:17]), "no header of a PLY"),
        ("a.ply", PLY.format("ascii", 1, XYZ.replace("z", "x")), "one x, y and z"),
        ("a.ply", PLY.format("ascii", 1, XYZ) + "1 2 x\n", "is damaged"),
        ("a.ply", PLY.format("ascii", 1, XYZ) + "1 2\n   ", "claims 1 points"),
        ("a.ply", PLY.format("ascii", 1, XYZ + "property list uchar int a\n"), "no header"),
        ("a.ply", "ply\n" + "comment x\n" * 9999, "no header of a PLY"),
        ("a.ply", "solid", "no header of a PLY"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "ascii", n=10**12), "claims 10{12} points"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "binary", n=10**12), "claims 10{12} points"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "binary_compressed", n=10**8), "claims 10{8}"),
        ("a.pcd", PCD.format("4 4 4", "1 1 999999999", "binary", n=0), "a point has|damaged PCD"),
        ("a.pcd", PCD.format("4 4 4", "1 1", "binary", n=0), "a point has|damaged PCD"),
        ("a.pcd", PCD.format("", "", "binary", n=1), "damaged PCD"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "binary", n="-5"), "damaged PCD"),
        ("a.pcd", PCD.format("4 4 3", "1 1 1", "binary", n=1) + "x" * 12, "damaged PCD"),
        ("a.pcd", "VERSION 0.7\n", "no header of a PCD"),
        ("a.bin", "x" * 17, "no multiple of the 16"),
        ("a.npy", "x" * 17, "is no array of NumPy"),
        ("a.las", "x" * 500, "truncated or damaged LAS"),
        ("a.laz", "", "truncated or damaged LAS"),
    ],
)
def test_a_file_that_is_no_cloud_is_refused(
    name: str, text: str, match: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=match):
        CloudFile(tmp_path / name).read()


def test_a_header_is_read_once(tmp_path: Path) -> None:
    """The library alone would take the first ten lines, and the rest for points."""
    start, _, end = PCD.format("4 4 4", "1 1 1", "binary", n=1).partition("POINTS 1\n")
    text = f"{start}POINTS {10**9}\nHEIGHT 1\nPOINTS 1\n{end}"
    (tmp_path / "a.pcd").write_bytes(text.encode() + POINTS[:1].tobytes())
    assert np.array_equal(CloudFile(tmp_path / "a.pcd", CloudKind("rdf")).read(), POINTS[:1])


@pytest.mark.parametrize("shape", [(9,), (9, 2), (9, 3, 1)])
def test_an_array_that_is_no_cloud_is_refused(shape: tuple[int, ...], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones(shape))
    with pytest.raises(RecordingError, match="a cloud is a row of x, y, z"):
        CloudFile(tmp_path / "a.npy").read()


@pytest.mark.parametrize("name", ["layered.las", "layered.laz"])
@pytest.mark.parametrize(
    ("at", "value", "match"),
    [
        (247, struct.pack("<Q", 10**12), "damaged|more than 20000000"),
        (100, struct.pack("<I", 1 << 31), "damaged"),  # records before the points
        (96, struct.pack("<I", 1 << 31), "damaged"),  # where the points begin
        (105, struct.pack("<H", 0), "damaged"),  # bytes of a point
    ],
)
def test_a_las_that_claims_too_much(
    name: str, at: int, value: bytes, match: str, tmp_path: Path
) -> None:
    path = write(tmp_path / name)
    data = bytearray(path.read_bytes())
    data[at : at + len(value)] = value
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=match):
        CloudFile(path).read()


def test_layers_of_a_laz_that_claim_too_much(tmp_path: Path) -> None:
    path = write(tmp_path / "layered.laz")
    data = bytearray(path.read_bytes())
    (offset,) = struct.unpack("<I", data[96:100])
    first = offset + 8 + 30 + 4
    data[first : first + 4] = b"\xff\xff\xff\xff"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="layers of 4294"):
        CloudFile(path).read()


@settings(deadline=None, max_examples=200)
@given(
    st.sampled_from(FORMATS),
    st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=4),
    st.floats(0.2, 1.0),
)
def test_a_damaged_file_is_an_error_or_points(
    tmp_path_factory: pytest.TempPathFactory,
    name: str,
    changes: list[tuple[float, int]],
    kept: float,
) -> None:
    path = write(tmp_path_factory.mktemp("damaged") / name, POINTS[:20])
    data = bytearray(path.read_bytes())
    for at, byte in changes:
        data[int(at * (len(data) - 1))] = byte
    path.write_bytes(bytes(data[: int(kept * len(data)) or 1]))
    try:
        found = CloudFile(path).read()
    except RecordingError:
        return
    assert found.shape[1] == 3
    assert np.isfinite(found).all()


@pytest.mark.parametrize(("name", "library"), [("a.pcd", "pypcd4"), ("a.laz", "laspy")])
def test_a_missing_library_is_named(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = "binary" if name == "a.pcd" else "layered"
    write(tmp_path / f"{source}{Path(name).suffix}").rename(tmp_path / name)
    real = builtins.__import__

    def without(wanted: str, *args: Any, **kwargs: Any) -> Any:
        if wanted.partition(".")[0] == library:
            raise ImportError(wanted)
        return real(wanted, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=rf"takes {library}; .*fieldgrid\[clouds\]"):
        CloudFile(tmp_path / name).read()


def test_packed_points_without_a_chunk_are_refused(tmp_path: Path) -> None:
    """The library would make room for whatever stands where a chunk would be."""
    path = write(tmp_path / "layered.laz")
    data = bytearray(path.read_bytes())
    (offset,) = struct.unpack_from("<I", data, 96)
    (table,) = struct.unpack_from("<q", data, offset)
    struct.pack_into("<I", data, table + 4, 0)
    data[offset + 8 : table] = b"\xff" * (table - offset - 8)
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="0 chunks hold fewer than its points"):
        CloudFile(path).read()


def test_a_number_that_signals_is_no_place(tmp_path: Path) -> None:
    path = write(tmp_path / "binary.ply", POINTS[:3])
    start = path.read_bytes().index(b"end_header\n") + len(b"end_header\n")
    data = bytearray(path.read_bytes())
    data[start : start + 4] = b"\x01\x00\x80\x7f"
    path.write_bytes(data)
    assert len(CloudFile(path).read()) == 2


def test_an_array_that_python_2_wrote_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", POINTS[:3])
    path.write_bytes(path.read_bytes().replace(b"(3, 3), ", b"(3L, 3),"))
    assert CloudFile(path, CloudKind("rdf")).read() == pytest.approx(POINTS[:3])


def test_a_small_file_takes_little_memory(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", POINTS[:3])
    tracemalloc.start()
    try:
        CloudFile(path).read()
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
