"""Obstacles as points: LAS by its specification with nothing but struct, LAZ by laspy, PLY by
trimesh."""

from __future__ import annotations

import builtins
import struct
import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import numpy.typing as npt
import pyproj
import pytest
import trimesh

from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.geometry import (
    FOOT_CHANNEL,
    GROUND_CHANNEL,
    NO_GROUND_CM,
    TOP_CHANNEL,
    GridSpec,
    LocalGrid,
    Pose,
)
from fieldgrid.maps import MapFile, create_map, open_map
from tests.export.asymmetric import DATUM, F_BOXES, cells, enu, write_asymmetric_map

_Floats = npt.NDArray[np.float64]
NAMES = ["f.las", "f.laz", "f.ply"]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def las_by_struct(path: Path) -> tuple[_Floats, dict[str, npt.NDArray[Any]], str]:
    """x, y, z [n, 3], the other values, and the system, of a LAS 1.4 with points of format 6."""
    data = path.read_bytes()
    assert data[:4] == b"LASF"
    encoding = struct.unpack_from("<H", data, 6)[0]
    assert encoding & 16  # the system is WKT
    assert data[24:26] == bytes([1, 4])
    header, offset, records, kind, size = struct.unpack_from("<HIIBH", data, 94)
    assert (kind, size) == (6, 40)
    scale = np.array(struct.unpack_from("<3d", data, 131))
    origin = np.array(struct.unpack_from("<3d", data, 155))
    high_low = struct.unpack_from("<6d", data, 179)
    (count,) = struct.unpack_from("<Q", data, 247)
    wkt, at = "", header
    for _ in range(records):
        user, number, length = struct.unpack_from("<16sHH", data, at + 2)
        body = data[at + 54 : at + 54 + length]
        if user.rstrip(b"\0") == b"LASF_Projection" and number == 2112:
            wkt = body.rstrip(b"\0").decode()
        at += 54 + length
    point = np.dtype(
        [("xyz", "<i4", 3), ("intensity", "<u2"), ("flags", "u1", 4), ("angle", "<i2"),
         ("source", "<u2"), ("time", "<f8"), ("density", "u1"), ("frames", "<u4"),
         ("ground_known", "u1"), ("height_m", "<f4")]
    )  # fmt: skip
    assert point.itemsize == size
    points = np.frombuffer(data, point, count, offset)
    assert offset + count * size == len(data)
    xyz = points["xyz"] * scale + origin
    if count:
        np.testing.assert_allclose(high_low[::2], xyz.max(axis=0), atol=1e-6)
        np.testing.assert_allclose(high_low[1::2], xyz.min(axis=0), atol=1e-6)
    return xyz, {name: points[name] for name in ("intensity", *point.names[6:])}, wkt


def read(path: Path) -> tuple[_Floats, dict[str, npt.NDArray[Any]]]:
    """Points in the map's plane, z above the datum, and their values."""
    if path.suffix == ".ply":
        cloud = trimesh.load(path)
        raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
        values = {name: raw[name] for name in ("density", "frames", "ground_known", "height_m")}
        return np.asarray(cloud.vertices, dtype=np.float64), values
    if path.suffix == ".las":
        xyz, values, wkt = las_by_struct(path)
    else:
        packed = laspy.read(path)
        xyz = np.asarray(packed.xyz)
        values = {
            name: np.asarray(packed[name])
            for name in ("intensity", "density", "frames", "ground_known", "height_m")
        }
        wkt = packed.header.vlrs.get("WktCoordinateSystemVlr")[0].string.rstrip("\0")
    assert np.array_equal(values["intensity"], values["density"])
    to_earth = pyproj.Transformer.from_crs(wkt, "EPSG:4326", always_xy=True)
    lon, lat = to_earth.transform(xyz[:, 0], xyz[:, 1])
    return np.stack(enu(lat, lon, xyz[:, 2]), axis=1), values


@pytest.mark.parametrize("name", NAMES)
def test_each_obstacle_cell_is_a_point(name: str, universal: MapFile, tmp_path: Path) -> None:
    done = export_map(universal, tmp_path / name)
    points, values = read(tmp_path / name)
    east, north, true = cells()
    j, i = np.nonzero(true.density > 100)
    wanted = np.stack([east[i], north[j]], axis=1)
    order = np.lexsort(np.round(points[:, :2], 3).T)
    expected = np.lexsort(np.round(wanted, 3).T)
    np.testing.assert_allclose(points[order, :2], wanted[expected], atol=0.002)
    assert np.array_equal(values["density"][order], true.density[j, i][expected])
    assert np.array_equal(values["frames"][order], true.sessions[j, i][expected])
    assert done.about["points"] == len(points) > 18 / 0.05**2 - 1
    # The vehicles' height: nothing tells how they leaned.
    np.testing.assert_allclose(points[:, 2], 0.3, atol=0.002)
    assert not values["ground_known"].any()
    assert np.isnan(values["height_m"]).all()
    in_stem = np.zeros(len(points), dtype=bool)
    for box in F_BOXES:
        in_stem |= (
            (points[:, 0] > box.west_m) & (points[:, 0] < box.east_m)
            & (points[:, 1] > box.south_m) & (points[:, 1] < box.north_m)
        )  # fmt: skip
    assert in_stem.sum() == round(18 / 0.05**2)


@pytest.mark.parametrize("name", NAMES)
def test_points_stand_on_the_ground_where_it_is_known(name: str, tmp_path: Path) -> None:
    """A slope of a fifth to the north, seen on the western half."""
    spec = GridSpec(width_m=4.0, length_m=4.0, cell_m=0.1)
    x, y = np.meshgrid(*spec.centres_m())
    centimetres = np.where(x < 0.0, np.rint(20.0 * y), NO_GROUND_CM).astype(np.int16)
    grid = LocalGrid(spec, np.full(spec.shape, 200, np.uint8), np.ones(spec.shape, np.bool_))
    path = tmp_path / "m.gpkg"
    pose = Pose(1_780_000_000_000_000_000, 50.0, 20.0, 3.0, 0.0, 0.02, 0.3, 1.0)
    with create_map(path, DATUM, cell_m=0.1) as made:
        with made.add_session("a") as session:
            tops_dm = np.full(spec.shape, 14, np.uint8)
            channels = {
                GROUND_CHANNEL: centimetres,
                TOP_CHANNEL: tops_dm,
                FOOT_CHANNEL: np.zeros_like(tops_dm),
            }
            session.add(grid, pose, channels=channels)
        done = export_map(made, tmp_path / name)
    points, values = read(tmp_path / name)
    known = values["ground_known"] == 1
    assert known.sum() == done.about["on_seen_ground"] == pytest.approx(len(points) / 2, rel=0.1)
    assert np.array_equal(known, points[:, 0] < 50.0)
    np.testing.assert_allclose(values["height_m"], 1.4, atol=0.05)
    slope_m = 3.0 + 0.2 * (points[:, 1] - 20.0)
    np.testing.assert_allclose(points[known, 2], slope_m[known], atol=0.03)
    np.testing.assert_allclose(points[~known, 2], 3.0, atol=0.003)


@pytest.mark.parametrize("name", NAMES)
def test_the_threshold_and_larger_cells(name: str, universal: MapFile, tmp_path: Path) -> None:
    part = Selection(cell_m=0.25)
    done = export_map(universal, tmp_path / name, part, options={"obstacle_above": 254})
    points, values = read(tmp_path / name)
    assert set(values["density"]) == {255}
    assert done.about["points"] == len(points) == 5 * 1 / 0.25**2  # the top arm


def test_no_obstacle_is_no_point(universal: MapFile, tmp_path: Path) -> None:
    from fieldgrid.geometry import Bounds

    free = Selection(Bounds(-9.0, 0.0, -6.0, 3.0))
    for name in NAMES:
        assert export_map(universal, tmp_path / name, free).about["points"] == 0
    assert len(las_by_struct(tmp_path / "f.las")[0]) == 0
    assert b"element vertex 0\n" in (tmp_path / "f.ply").read_bytes()


def test_a_las_without_laspy(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    imported = builtins.__import__

    def without(name: str, *more: Any, **rest: Any) -> Any:
        if name.startswith("laspy"):
            raise ImportError(name)
        return imported(name, *more, **rest)

    monkeypatch.setattr(builtins, "__import__", without)
    for loaded in [name for name in sys.modules if name.startswith("laspy")]:
        monkeypatch.delitem(sys.modules, loaded)
    with pytest.raises(ConfigError, match=r"f.las needs laspy.*fieldgrid\[clouds\]"):
        export_map(universal, tmp_path / "f.las")
    export_map(universal, tmp_path / "f.ply")
