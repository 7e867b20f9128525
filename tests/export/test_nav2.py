from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from PIL import Image

from fieldgrid.core import ConfigError, MapExistsError, MapWriteError, publish
from fieldgrid.export import Exported, Selection, export_map, together
from fieldgrid.export.robots.nav2 import MODES, greys
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import (
    CELL_M,
    COARSE_M,
    DATUM,
    EXTENT,
    enu,
    geodetic,
    probes,
    truth,
    write_asymmetric_map,
)
from tests.export.nav2_loader import load


def export_nav2(
    universal: MapFile,
    path: Path,
    selection: Selection | None = None,
    *,
    overwrite: bool = False,
    **options: Any,
) -> Exported:
    return export_map(
        universal, path, selection, format="nav2", overwrite=overwrite, options=options
    )


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def expected(mode: str, east: npt.NDArray[Any], north: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The occupancy that is meant: 50 is free, 101 an obstacle, a straight line between."""
    true = truth(east, north)
    density = true.density.astype(float)
    doubt = np.clip(np.rint(100.0 * (density - 50.0) / 51.0), 1, 99) if mode != "trinary" else -1
    value = np.where(density <= 50, 0, np.where(density > 100, 100, doubt))
    return np.where(true.observed, value, -1).astype(int)


def check(path: Path, mode: str) -> None:
    """All that a consumer needs: values, place, orientation, unknown, and where on Earth."""
    east, north = probes()
    wanted = expected(mode, east, north)
    assert set(np.unique(wanted)) >= (
        {-1, 0, 100} if mode == "trinary" else {-1, 0, 2, 49, 98, 100}
    )
    for vectorised in (False, True):
        grid = load(path, vectorised=vectorised)
        np.testing.assert_array_equal(grid.at(east, north), wanted)
    about = json.loads(path.with_name(path.stem + ".georef.json").read_text(encoding="utf-8"))
    assert about["datum"]["height_m"] == DATUM.height_m
    for name, (lat, lon) in about["corners_deg"].items():
        row, column = name.split("_")
        place = enu(lat, lon)[:2]
        corner = (about["bounds_m"][column], about["bounds_m"][row])
        assert place == pytest.approx(corner, abs=0.01)
    assert grid.origin[:2] == pytest.approx((about["bounds_m"]["west"], about["bounds_m"]["south"]))


@pytest.mark.parametrize("cell_m", [None, COARSE_M])
@pytest.mark.parametrize(("mode", "image"), [(m, i) for m, kinds in MODES.items() for i in kinds])
def test_it_comes_back_through_the_rules_of_the_map_server(
    universal: MapFile, tmp_path: Path, mode: str, image: str, cell_m: float | None
) -> None:
    path = tmp_path / "field.nav2.yaml"
    done = export_nav2(universal, path, Selection(cell_m=cell_m), mode=mode, image=image)
    assert done.paths[0] == path
    assert sorted(done.paths) == sorted(tmp_path.iterdir())
    check(path, mode)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("vectorised", [False, True])
def test_every_occupancy_has_a_grey_that_is_read_back(
    tmp_path: Path, mode: str, vectorised: bool
) -> None:
    about = {"image": "a.png", "mode": mode, "resolution": 1.0, "origin": [0.0, 0.0, 0.0]}
    about |= {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(about))
    grey = greys(mode)[None, :]
    if mode == "scale":
        grey = np.stack([grey, np.where(np.arange(102) == 101, 0, 255)[None, :]], -1)
    Image.fromarray(grey.astype(np.uint8)).save(tmp_path / "a.png")
    found = load(tmp_path / "a.yaml", vectorised=vectorised).data[0].tolist()
    if mode == "trinary":
        assert found == [0, *[-1] * 99, 100, -1]
    else:
        assert found == [*range(101), -1]


def rewrite(path: Path, change: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> None:
    with Image.open(path) as picture:
        pixels, kind = np.array(picture), picture.format
    Image.fromarray(np.ascontiguousarray(change(pixels))).save(path, format=kind)


def edit(path: Path, **changes: Any) -> None:
    about = yaml.safe_load(path.read_text(encoding="utf-8"))
    path.write_text(yaml.safe_dump({**about, **changes}), encoding="utf-8")


def forget_datum(folder: Path) -> None:
    georef = folder / "field.georef.json"
    about = json.loads(georef.read_text(encoding="utf-8"))
    del about["datum"], about["corners_deg"]
    georef.write_text(json.dumps(about), encoding="utf-8")


def move_datum(folder: Path) -> None:
    """A millionth of a degree, 11 cm, to the north."""
    georef = folder / "field.georef.json"
    about = json.loads(georef.read_text(encoding="utf-8"))
    about["corners_deg"] = {
        name: [lat + 1e-6, lon] for name, (lat, lon) in about["corners_deg"].items()
    }
    georef.write_text(json.dumps(about), encoding="utf-8")


HALF = CELL_M / 2
MISTAKES: dict[str, Callable[[Path], None]] = {
    "transposed": lambda f: rewrite(f / "field.pgm", lambda a: a.T),
    "transposed in place": lambda f: rewrite(f / "field.pgm", lambda a: np.resize(a.T, a.shape)),
    "south first": lambda f: rewrite(f / "field.pgm", lambda a: a[::-1]),
    "east first": lambda f: rewrite(f / "field.pgm", lambda a: a[:, ::-1]),
    "half a cell east": lambda f: edit(f / "field.yaml", origin=[EXTENT.west_m + HALF, -7.0, 0.0]),
    "half a cell south": lambda f: edit(
        f / "field.yaml", origin=[-10.0, EXTENT.south_m - HALF, 0.0]
    ),
    "origin of the upper corner": lambda f: edit(f / "field.yaml", origin=[-10.0, 9.0, 0.0]),
    "an origin of nothing": lambda f: edit(f / "field.yaml", origin=[0.0, 0.0, 0.0]),
    "unknown is free": lambda f: edit(f / "field.yaml", free_thresh=0.25),
    "negated": lambda f: edit(f / "field.yaml", negate=1),
    "another mode": lambda f: edit(f / "field.yaml", mode="raw"),
    "no datum": forget_datum,
    "another datum": move_datum,
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_check_finds_a_mistake(universal: MapFile, tmp_path: Path, mistake: str) -> None:
    export_nav2(universal, tmp_path / "field.yaml")
    check(tmp_path / "field.yaml", "trinary")
    MISTAKES[mistake](tmp_path)
    with pytest.raises((AssertionError, KeyError)):
        check(tmp_path / "field.yaml", "trinary")


def test_the_file_says_what_the_server_asks_for(universal: MapFile, tmp_path: Path) -> None:
    export_nav2(universal, tmp_path / "field.yaml", mode="scale")
    about = yaml.safe_load((tmp_path / "field.yaml").read_text(encoding="utf-8"))
    assert about == {
        "image": "field.png",
        "mode": "scale",
        "resolution": 0.05,
        "origin": [-10.0, -7.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def test_the_georeference_places_the_picture(universal: MapFile, tmp_path: Path) -> None:
    part = Selection(bounds=Bounds(-4.0, -5.0, 3.5, 6.5))
    export_nav2(universal, tmp_path / "f.yaml", part, obstacle_above=120, cost_shape=2.0)
    about = json.loads((tmp_path / "f.georef.json").read_text(encoding="utf-8"))
    assert (about["width"], about["height"]) == (150, 230)
    a, b, c, d, e, f = about["pixel_to_map"]
    assert (c, f) == (-4.0, 6.5)
    assert (a * 150 + b * 230 + c, d * 150 + e * 230 + f) == pytest.approx((3.5, -5.0))
    lat, lon, _ = geodetic(-4.0, 6.5)
    assert about["corners_deg"]["north_west"] == pytest.approx([float(lat), float(lon)], abs=2e-10)
    curve = {"free_up_to": 50, "obstacle_above": 120, "shape": 2.0, "least_seen": 0.5}
    assert about["cost_curve"] == curve | {"least_drop_m": 0.1}
    assert about["crs_wkt"].startswith("PROJCRS[")


def test_the_curve_decides_what_is_free(universal: MapFile, tmp_path: Path) -> None:
    export_nav2(universal, tmp_path / "f.yaml", free_up_to=10, obstacle_above=219, mode="raw")
    grid = load(tmp_path / "f.yaml")
    east, north = np.array([0.5, -6.0, -2.5, 2.5]), np.array([-0.5, 0.0, 0.0, 5.5])
    # Ground of 12 is in doubt, 0 is free, 220 and 255 are obstacles.
    assert grid.at(east, north).tolist() == [1, 0, 100, 100]


def test_a_part_outside_of_what_was_seen_is_unknown(universal: MapFile, tmp_path: Path) -> None:
    part = Selection(bounds=Bounds(12.0, 6.0, 20.0, 12.0))
    export_nav2(universal, tmp_path / "f.yaml", part)
    grid = load(tmp_path / "f.yaml")
    assert grid.origin == (12.0, 6.0, 0.0)
    assert grid.data.shape == (120, 160)
    assert np.all(grid.data == -1)


@pytest.mark.parametrize(
    ("name", "selection", "options", "message"),
    [
        ("f.pgm", {}, {}, "does not end in .yaml"),
        ("f.png", {}, {}, "name of a file of format png, not nav2"),
        ("f.yaml", {"layer": "count"}, {}, "cannot hold the layer 'count'"),
        (
            "f.yaml",
            {},
            {"mode": "ternary"},
            "mode = 'ternary' of the format nav2 is not possible",
        ),
        ("f.yaml", {}, {"mode": "scale", "image": "pgm"}, "give png"),
        ("f.yaml", {}, {"image": "jpg"}, "input should be 'pgm' or 'png'"),
        ("f.yaml", {}, {"free_up_to": 120}, "no curve"),
        ("f.yaml", {"bounds": Bounds(50.0, 50.0, 60.0, 60.0)}, {}, "hold nothing of the map"),
        ("f.yaml", {"cell_m": 0.01}, {}, "smaller than the local cells"),
    ],
)
def test_what_cannot_be_asked_is_one_sentence(
    universal: MapFile,
    tmp_path: Path,
    name: str,
    selection: dict[str, Any],
    options: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        export_nav2(universal, tmp_path / name, Selection(**selection), **options)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_replaced_only_when_asked(universal: MapFile, tmp_path: Path) -> None:
    (tmp_path / "f.georef.json").write_text("mine")
    with pytest.raises(MapExistsError, match=r"f\.georef\.json exists already"):
        export_nav2(universal, tmp_path / "f.yaml")
    assert [file.name for file in tmp_path.iterdir()] == ["f.georef.json"]
    for mode in ("trinary", "raw"):
        export_nav2(universal, tmp_path / "f.yaml", overwrite=True, mode=mode)
        written = {"f.georef.json", "f.pgm", "f.yaml", "f.keepout.pgm", "f.keepout.yaml"}
        assert {file.name for file in tmp_path.iterdir()} == written
        assert yaml.safe_load((tmp_path / "f.yaml").read_text())["mode"] == mode


@pytest.mark.parametrize("fails_at", [1, 2, 3, 4, 5])
def test_an_export_that_fails_leaves_nothing(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails_at: int
) -> None:
    original, calls = publish.os.fsync, [0]

    def full(descriptor: int) -> None:
        calls[0] += 1
        if calls[0] == fails_at:
            raise OSError(errno.ENOSPC, "No space left on device")
        original(descriptor)

    monkeypatch.setattr(publish.os, "fsync", full)
    with pytest.raises(MapWriteError, match="disk is full"):
        export_nav2(universal, tmp_path / "f.yaml")
    assert list(tmp_path.iterdir()) == []


def test_a_picture_that_cannot_be_written_leaves_the_old_map(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_nav2(universal, tmp_path / "f.yaml")
    shutil.copytree(tmp_path, tmp_path / "before")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(MapWriteError, match="No space left"):
        export_nav2(universal, tmp_path / "f.yaml", overwrite=True, mode="raw")
    for file in (tmp_path / "before").iterdir():
        assert (tmp_path / file.name).read_bytes() == file.read_bytes()


def test_a_map_that_cannot_be_named_whole_is_gone(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rather none than the old YAML file with the new picture, where there are no links."""
    export_nav2(universal, tmp_path / "f.yaml")
    monkeypatch.setattr(together, "show", lambda *_: False)
    original = publish.Draft.publish

    def fail_at_the_second(draft: publish.Draft, **how: bool) -> None:
        if draft.target.name == "f.georef.json":
            raise MapWriteError("the disk has gone")
        original(draft, **how)

    monkeypatch.setattr(publish.Draft, "publish", fail_at_the_second)
    with pytest.raises(MapWriteError, match="has gone"):
        export_nav2(universal, tmp_path / "f.yaml", overwrite=True, mode="raw")
    assert [file.name for file in tmp_path.iterdir()] == ["f.georef.json"]


def test_a_file_that_another_program_makes_meanwhile_is_left_alone(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = publish.Draft.publish

    def late(draft: publish.Draft, **how: bool) -> None:
        if draft.target.name == "f.yaml":
            draft.target.write_text("theirs")
        original(draft, **how)

    monkeypatch.setattr(publish.Draft, "publish", late)
    with pytest.raises(MapExistsError, match="exists already"):
        export_nav2(universal, tmp_path / "f.yaml")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["theirs"]


def test_it_is_a_format_by_its_ending(universal: MapFile, tmp_path: Path) -> None:
    done = export_map(universal, tmp_path / "f.nav2.yaml", options={"mode": "raw", "free_up_to": 5})
    assert [path.name for path in done.paths] == [
        "f.nav2.yaml",
        "f.nav2.pgm",
        "f.nav2.keepout.pgm",
        "f.nav2.keepout.yaml",
        "f.nav2.georef.json",
    ]
    assert load(done.paths[0]).at(np.array([0.5]), np.array([-0.5])).tolist() == [7]
