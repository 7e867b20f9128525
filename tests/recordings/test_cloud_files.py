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
from fieldgrid.recordings.frames.las import las_time_ns

Points = npt.NDArray[np.float32]

POINTS = np.random.default_rng(0).uniform(-30.0, 30.0, (200, 3)).astype(np.float32)
OPTICAL = CloudKind("rdf")
GPS_S, GPS_UTC_NS = 250_000_000.25, 1_565_964_800_250_000_000 - 18_000_000_000
"""Adjusted standard GPS time: 1.25e9 s after 1980-01-06 is 2019-08-16 14:13:20, 18 leap seconds
ahead of UTC."""
STAMP_NS = 1_780_000_000_000_000_000
AFTER_S = np.linspace(0.0, 0.0995, len(POINTS))

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
        trimesh.PointCloud(points).export(path, encoding=path.stem)
    elif path.suffix == ".pcd":
        Pcd.from_xyz_points(points).save(path, encoding=Encoding(path.stem))
    else:
        las(points, path.stem == "layered").write(path)
    return path


def las(points: Points, layered: bool = True, standard: bool = True) -> laspy.LasData:
    header = laspy.LasHeader(point_format=6 if layered else 1, version="1.4" if layered else "1.2")
    header.scales = np.full(3, 1e-4)
    if standard:
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T.astype(float)
    data.gps_time = GPS_S + AFTER_S[: len(points)]
    return data


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_its_points(name: str, tmp_path: Path) -> None:
    found = CloudFile(write(tmp_path / name), OPTICAL).read()
    assert found.dtype == np.float32
    assert found == pytest.approx(POINTS, abs=1e-4)
    if not name.endswith((".ply", ".bin")):  # trimesh writes none, and none of KITTI is no file
        assert CloudFile(write(tmp_path / name, POINTS[:0])).read().shape == (0, 3)


def test_axes(tmp_path: Path) -> None:
    """Of a point 3 m ahead, 2 m to the left and 1 m up; and what else an array may hold."""
    told = {"flu": [3, 2, 1], "rdf": [-2, -1, 3], "rfu": [-2, 3, 1], "frd": [3, -2, -1],
            "bru": [-3, -2, 1], "luf": [2, 1, 3]}  # fmt: skip
    for axes, point in told.items():
        np.save(tmp_path / "a.npy", np.array([[*point, 9.0, 9.0]], np.float64))
        for kind in (CloudKind(axes), *([CloudKind()] if axes == "flu" else [])):
            assert CloudFile(tmp_path / "a.npy", kind).read().tolist() == [[-2.0, -1.0, 3.0]], axes


def test_a_ply_with_other_properties_and_faces(tmp_path: Path) -> None:
    header = (
        b"ply\r\nformat binary_big_endian 1.0\r\ncomment by hand\r\nelement vertex 2\r\n"
        b"property uchar red\r\nproperty double z\r\nproperty float x\r\nproperty short y\r\n"
        b"element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
    )
    body = struct.pack(">Bdfh", 9, 3.5, 1.5, 2) + struct.pack(">Bdfh", 9, 6.5, 4.5, 5)
    (tmp_path / "a.ply").write_bytes(header + body + b"\x03" + b"\0" * 12)
    found = CloudFile(tmp_path / "a.ply", OPTICAL).read()
    assert found.tolist() == [[1.5, 2.0, 3.5], [4.5, 5.0, 6.5]]


# --- times


def timed(path: Path) -> int:
    """A file of `POINTS` with a time of each, the seventh of which is no place but in a LAS, whose
    numbers are whole. Returns the stamp of the frame."""
    places = POINTS.copy()
    if path.suffix == ".las":
        las(POINTS).write(path)
        return GPS_UTC_NS
    places[7, 1] = np.nan
    if path.suffix == ".pcd":
        columns = [*places.T, STAMP_NS / 1e9 + AFTER_S]
        kinds = (*[np.float32] * 3, np.float64)
        made = Pcd.from_points(columns, ("x", "y", "z", "timestamp"), kinds)
        made.save(path, encoding=Encoding(path.stem))
        return STAMP_NS
    vertices = np.zeros(len(POINTS), [("t", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    vertices["t"] = np.rint(AFTER_S * 1e9)
    for axis, column in zip("xyz", places.T, strict=True):
        vertices[axis] = column
    header = f"ply\nformat {path.stem} 1.0\nelement vertex {len(POINTS)}\nproperty uint t\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    text = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in vertices.tolist())
    body = text.encode() if path.stem == "ascii" else vertices.tobytes()
    path.write_bytes(header.encode() + body)
    return STAMP_NS


@pytest.mark.parametrize(
    "name",
    [
        *("ascii.ply", "binary_little_endian.ply", "ascii.pcd", "binary.pcd"),
        *("binary_compressed.pcd", "a.las"),
    ],
)
def test_a_file_may_say_when_points_were_taken(name: str, tmp_path: Path) -> None:
    stamp_ns = timed(tmp_path / name)
    kept = np.arange(len(POINTS)) != (-1 if name == "a.las" else 7)
    points, after_s = CloudFile(tmp_path / name, OPTICAL, stamp_ns).sweep()
    assert points == pytest.approx(POINTS[kept], abs=1e-4)
    assert after_s == pytest.approx(AFTER_S[kept], abs=1e-6)
    assert CloudFile(tmp_path / name, CloudKind(corrected=True), stamp_ns).sweep().after_s is None


@pytest.mark.parametrize("name", ["pointwise.las", "pointwise.laz", "layered.las", "layered.laz"])
def test_the_time_of_a_las_is_utc(name: str, tmp_path: Path) -> None:
    assert las_time_ns(write(tmp_path / name)) == GPS_UTC_NS


def test_a_las_that_does_not_say_its_time(tmp_path: Path) -> None:
    las(POINTS, standard=False).write(tmp_path / "week.las")
    las(POINTS[:0]).write(tmp_path / "empty.las")
    laspy.LasData(laspy.LasHeader(point_format=0, version="1.2")).write(tmp_path / "none.las")
    for name in ("week.las", "empty.las", "none.las"):
        with pytest.raises(RecordingError, match=r"has no points with GPS time .* add frames\.csv"):
            las_time_ns(tmp_path / name)
        assert CloudFile(tmp_path / name).sweep().after_s is None
    wrong = las(POINTS)
    for seconds in (-2e9, 1e300, np.nan):
        wrong.gps_time = np.full(len(POINTS), seconds)
        wrong.write(tmp_path / "wrong.las")
        with pytest.raises(RecordingError, match="which no receiver can have seen"):
            las_time_ns(tmp_path / "wrong.las")
        assert CloudFile(tmp_path / "wrong.las").sweep().after_s is None


# --- what may not be


def test_what_is_not_finite_is_left_out(tmp_path: Path) -> None:
    bad = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 1e30]], np.float32)
    for name in ("a.npy", "binary.ply"):
        path = write(tmp_path / name, np.vstack([bad, POINTS]))
        data = path.read_bytes()
        assert b"\x00\x00\xc0\x7f" in data
        path.write_bytes(data.replace(b"\x00\x00\xc0\x7f", b"\x01\x00\x80\x7f", 1))  # signals
        assert np.array_equal(CloudFile(path, OPTICAL).read(), POINTS)


def test_points_of_a_map_are_no_sensor_s(tmp_path: Path) -> None:
    far = las(POINTS)
    far.header.offsets = np.array([500_000.0, 4_400_000.0, 0.0])
    far.x, far.y = POINTS[:, 0] + 500_000.0, POINTS[:, 1] + 4_400_000.0
    far.write(tmp_path / "a.las")
    with pytest.raises(RecordingError, match="10 km from their origin"):
        CloudFile(tmp_path / "a.las").read()


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
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "ascii", n=10**12), "claims 10{12} points"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "binary", n=10**12), "claims 10{12} points"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "binary_compressed", n=10**8), "claims 10{8}"),
        ("a.pcd", PCD.format("4 4 4", "1 1 999999999", "binary", n=0), "a point has|damaged PCD"),
        ("a.pcd", PCD.format("4 4 4", "1 1", "binary", n=0), "a point has|damaged PCD"),
        ("a.pcd", PCD.format("", "", "binary", n=1), "damaged PCD"),
        ("a.pcd", PCD.format("4 4 4", "1 1 1", "binary", n="-5"), "damaged PCD"),
        ("a.pcd", PCD.format("4 4 3", "1 1 1", "binary", n=1) + "x" * 12, "damaged PCD"),
        ("a.pcd", "VERSION 0.7\n", "no header of a PCD"),
        ("a.bin", "", "is empty"),
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


@pytest.mark.parametrize("shape", [(9,), (9, 2), (9, 3, 1)])
def test_an_array_that_is_no_cloud_is_refused(shape: tuple[int, ...], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones(shape))
    with pytest.raises(RecordingError, match="a cloud is a row of x, y, z"):
        CloudFile(tmp_path / "a.npy").read()


def test_a_header_is_read_once(tmp_path: Path) -> None:
    """The library alone would take the first ten lines, and the rest for points."""
    start, _, end = PCD.format("4 4 4", "1 1 1", "binary", n=1).partition("POINTS 1\n")
    text = f"{start}POINTS {10**9}\nHEIGHT 1\nPOINTS 1\n{end}"
    (tmp_path / "a.pcd").write_bytes(text.encode() + POINTS[:1].tobytes())
    assert np.array_equal(CloudFile(tmp_path / "a.pcd", OPTICAL).read(), POINTS[:1])


@pytest.mark.parametrize("name", ["layered.las", "layered.laz"])
@pytest.mark.parametrize(
    ("at", "value", "match"),
    [
        (247, struct.pack("<Q", 10**12), "damaged"),  # points
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


def test_a_laz_whose_chunks_claim_too_much(tmp_path: Path) -> None:
    """The library would make room for what a layer claims, or for whatever stands where a chunk
    would be."""
    whole = write(tmp_path / "layered.laz").read_bytes()
    (offset,) = struct.unpack_from("<I", whole, 96)
    (table,) = struct.unpack_from("<q", whole, offset)
    layer, none, many = bytearray(whole), bytearray(whole), bytearray(whole)
    struct.pack_into("<I", layer, offset + 8 + 30 + 4, 0xFFFFFFFF)
    struct.pack_into("<I", none, table + 4, 0)
    none[offset + 8 : table] = b"\xff" * (table - offset - 8)
    struct.pack_into("<I", many, table + 4, 0x7FFFFFFF)
    for data, match in (
        (layer, "layers of 4294"),
        (none, "0 chunks hold fewer than its points"),
        (many, "200 points in 2147483647 chunks"),
    ):
        (tmp_path / "a.laz").write_bytes(data)
        with pytest.raises(RecordingError, match=match):
            CloudFile(tmp_path / "a.laz").read()


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


@pytest.mark.parametrize(("name", "library"), [("binary.pcd", "pypcd4"), ("layered.laz", "laspy")])
def test_a_missing_library_is_named(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / name)
    real = builtins.__import__

    def without(wanted: str, *args: Any, **kwargs: Any) -> Any:
        if wanted.partition(".")[0] == library:
            raise ImportError(wanted)
        return real(wanted, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=rf"takes {library}; .*fieldgrid\[clouds\]"):
        CloudFile(tmp_path / name).read()


def test_an_array_that_python_2_wrote_is_read_in_little_memory(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", POINTS[:3])
    path.write_bytes(path.read_bytes().replace(b"(3, 3), ", b"(3L, 3),"))
    tracemalloc.start()
    try:
        assert CloudFile(path, OPTICAL).read() == pytest.approx(POINTS[:3])
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
