"""Exports that are too large for one map or message, as tiles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.cells import tiles
from fieldgrid.export.robots import bag_content, nav2
from fieldgrid.geometry import Bounds
from fieldgrid.maps import Mark, MarkKind, open_map
from tests.export.nav2_loader import load
from tests.maps.file.maps import drive, one_cell, write_map


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive, a cell far away from it, and a keep-out between them where nobody was."""
    found = tmp_path_factory.mktemp("map") / "m.gpkg"
    write_map(found, [drive(9), [one_cell(40.05, -33.35, 200)]])
    with open_map(found, writable=True) as universal:
        universal.add_marks([Mark(MarkKind.KEEPOUT, ((20.0, -9.0), (23.0, -9.0), (21.0, -5.0)))])
    return found


@pytest.fixture
def cut_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "MESSAGE_CELLS", 20_000)
    monkeypatch.setattr(tiles, "_LOOK_CELLS", 50)
    monkeypatch.setattr(nav2, "TILE_CELLS", 64)
    monkeypatch.setattr(bag_content, "TILE_CELLS", 64)
    monkeypatch.setattr(bag_content, "GRID_MAP_CELLS", 10_000)


@pytest.mark.parametrize(
    ("cell_m", "bounds"),
    [(None, None), (0.13, None), (None, Bounds(-6.03, -10.02, 30.0, 21.07)), (0.2, None)],
)
def test_tiles_of_a_nav2_map_are_that_map(
    path: Path,
    tmp_path: Path,
    cut_small: None,
    monkeypatch: pytest.MonkeyPatch,
    cell_m: float | None,
    bounds: Bounds | None,
) -> None:
    selection = Selection(bounds, cell_m)
    with open_map(path) as universal:
        done = export_map(universal, tmp_path / "cut.yaml", selection)
        monkeypatch.setattr(tiles, "MESSAGE_CELLS", 10**9)
        export_map(universal, tmp_path / "whole.yaml", selection)
    assert done.paths == (tmp_path / "cut.tiles",)
    assert dict(done.rows)["index of the tiles"] == "cut.tiles/index.yaml"
    index = yaml.safe_load((tmp_path / "cut.tiles" / "index.yaml").read_text())
    for ending in ("", ".keepout"):
        whole = load(tmp_path / f"whole{ending}.yaml")
        found = np.full_like(whole.data, 0 if ending else -1)
        for tile in index["tiles"]:
            name = tile["keepout" if ending else "yaml"]
            part = load(tmp_path / "cut.tiles" / name)
            assert part.data.shape == (tile["height"], tile["width"])
            assert part.origin[:2] == pytest.approx(
                (tile["bounds_m"]["west"], tile["bounds_m"]["south"])
            )
            column, row = (
                round((part.origin[k] - whole.origin[k]) / whole.resolution) for k in (0, 1)
            )
            place = np.s_[row : row + part.data.shape[0], column : column + part.data.shape[1]]
            assert found[place].shape == part.data.shape
            found[place] = part.data
        np.testing.assert_array_equal(found, whole.data)
    about = json.loads((tmp_path / "whole.georef.json").read_text())
    assert index["bounds_m"] == about["bounds_m"]
    across, up = -(-index["width"] // 64) + 1, -(-index["height"] // 64) + 1
    assert 1 < len(index["tiles"]) < 0.7 * across * up  # where nothing is there is no tile


def test_tiles_of_a_bag_are_the_occupancy_grid_and_the_grid_map(
    path: Path, tmp_path: Path, cut_small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_map(path) as universal:
        done = export_map(universal, tmp_path / "cut.rosbag2")
        with pytest.raises(ConfigError, match="leave --messages foxglove out"):
            export_map(universal, tmp_path / "x.mcap", options={"messages": "foxglove"})
        monkeypatch.setattr(tiles, "MESSAGE_CELLS", 10**9)
        part = export_map(universal, tmp_path / "part.rosbag2")
        monkeypatch.setattr(bag_content, "GRID_MAP_CELLS", 10**9)
        export_map(universal, tmp_path / "whole.rosbag2")
    assert dict(done.rows)["too large for one message"].startswith("/map and /grid_map: ")
    assert dict(part.rows)["too large for one message"].startswith("/grid_map: ")
    between = messages_of(tmp_path / "part.rosbag2")
    assert {"/map", "/grid_map/index"} <= set(between)
    assert not {"/map/index", "/grid_map"} & set(between)
    cut, whole = (messages_of(tmp_path / f"{name}.rosbag2") for name in ("cut", "whole"))
    assert cut["/georeference"].data == whole["/georeference"].data
    index = json.loads(cut["/map/index"].data)
    assert cut["/grid_map/index"].data == cut["/map/index"].data.replace("/map/", "/grid_map/")
    assert {one["topic"] for one in index} == {name for name in cut if name.startswith("/map/tile")}
    info = whole["/map"].info
    expected = whole["/map"].data.reshape(info.height, info.width)
    counts = whole["/grid_map"].data[1].data.reshape(info.height, info.width)[::-1, ::-1]
    found, counted = np.full_like(expected, -1), np.full_like(counts, np.nan)
    for one in index:
        grid, layers = cut[one["topic"]], cut[one["topic"].replace("/map/", "/grid_map/")]
        shape = grid.info.height, grid.info.width
        assert shape == (one["height"], one["width"])
        column, row = (
            round((getattr(grid.info.origin.position, k) - getattr(info.origin.position, k)) / 0.1)
            for k in ("x", "y")
        )
        place = np.s_[row : row + shape[0], column : column + shape[1]]
        found[place] = grid.data.reshape(shape)
        counted[place] = layers.data[1].data.reshape(shape)[::-1, ::-1]
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(counted, counts)


def messages_of(bag: Path) -> dict[str, Any]:
    """The last message of each topic."""
    with AnyReader([bag]) as reader:
        return {
            one.topic: reader.deserialize(data, one.msgtype) for one, _, data in reader.messages()
        }


def test_tiles_are_replaced_as_a_whole_and_only_those_of_ours(
    path: Path, tmp_path: Path, cut_small: None
) -> None:
    with open_map(path) as universal:
        with pytest.raises(ConfigError, match="hold nothing of the map"):
            export_map(universal, tmp_path / "x.yaml", Selection(Bounds(1e3, 1e3, 2e3, 2e3)))
        export_map(universal, tmp_path / "x.yaml")
        before = sorted(file.name for file in (tmp_path / "x.tiles").iterdir())
        with pytest.raises(MapExistsError):
            export_map(universal, tmp_path / "x.yaml")
        (tmp_path / "x.tiles" / "999_999.yaml").write_text("left by another export")
        export_map(universal, tmp_path / "x.yaml", overwrite=True)
        assert sorted(file.name for file in (tmp_path / "x.tiles").iterdir()) == before
        (tmp_path / "y.tiles").mkdir()
        (tmp_path / "y.tiles" / "index.yaml").write_text("of somebody else")
        with pytest.raises(MapExistsError, match="other things"):
            export_map(universal, tmp_path / "y.yaml", overwrite=True)
        (tmp_path / "z.yaml").write_text("a Nav2 map")
        with pytest.raises(MapExistsError, match=r"too large for one Nav2 map.*z\.tiles"):
            export_map(universal, tmp_path / "z.yaml", overwrite=True)
