"""The quadtree as polygons: read back without GDAL, each square lies where its cells are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely

from fieldgrid import Quadtree
from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.shapes import features as squares
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import probes, truth, write_asymmetric_map
from tests.export.test_vector import READERS, Feature, exported


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def of_squares(universal: MapFile, folder: Path, kind: str, **options: Any) -> list[Feature]:
    wanted = "quadtree,obstacle,trajectory,pose,footprint"
    return exported(universal, folder, kind, features=wanted, **options)["quadtree"]


def check(features: Sequence[Feature], loss: float) -> None:
    """Each point that was seen lies in one square, whose density is that of the point."""
    east, north = probes()
    known = truth(east, north)
    tree = shapely.STRtree([feature.shape for feature in features])
    point, square = tree.query(shapely.points(east, north), predicate="within")
    np.testing.assert_array_equal(np.sort(point), np.flatnonzero(known.observed))
    for k, density in zip(square, known.density[point], strict=True):
        said = {key[:8]: value for key, value in features[k].properties.items()}
        assert abs(said["mean_den"] - density) <= loss
        assert said["min_dens"] <= density <= said["max_dens"]
        state = "obstacle" if density > 100 else "free" if density <= 50 else "doubt"
        assert said["state"] == state
        assert said["seen_sha"] == 1.0
        assert features[k].shape.area == pytest.approx(said["side_m"] ** 2, rel=0.02)


@pytest.mark.parametrize("kind", READERS)
def test_squares_come_back(universal: MapFile, tmp_path: Path, kind: str) -> None:
    features = of_squares(universal, tmp_path, kind)
    assert len(features) == len(Quadtree.from_map(universal))
    check(features, 16.0)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda places: places[:, ::-1],
        lambda places: places * (-1, 1),
        lambda places: places * (1, -1),
        lambda places: places + np.array([0.03, 0.0]),
    ],
)
def test_wrong_squares_are_found(
    universal: MapFile, tmp_path: Path, wrong: Callable[[Any], npt.NDArray[np.float64]]
) -> None:
    features = of_squares(universal, tmp_path, "gpkg")
    moved = [Feature(shapely.transform(f.shape, wrong), f.properties) for f in features]
    with pytest.raises(AssertionError):
        check(moved, 16.0)


def test_the_options_reach_the_squares(universal: MapFile, tmp_path: Path) -> None:
    cell_m = universal.cell_m
    options = {
        "quadtree_loss": 40.0,
        "quadtree_sides": f"{cell_m},{4 * cell_m}",
        "quadtree_seen": 0.5,
        "obstacle_above": 20,
    }
    features = of_squares(universal, tmp_path, "gpkg", **options)
    sides = sorted({feature.properties["side_m"] for feature in features})
    assert sides == pytest.approx([cell_m, 4 * cell_m])
    assert any(feature.properties["seen_share"] < 1.0 for feature in features)
    low = {f.properties["state"] for f in features if f.properties["max_density"] > 20}
    assert low == {"obstacle"}


def test_squares_at_the_bounds_stay_whole_and_are_left_out_where_nobody_asks(
    universal: MapFile, tmp_path: Path
) -> None:
    west_m, south_m, east_m, north_m = universal.bounds
    bounds = Bounds(west_m + 0.7, south_m + 0.7, east_m - 0.7, north_m - 0.7)
    selection = Selection(bounds)
    done = export_map(universal, tmp_path / "q.gpkg", selection, options={"features": "quadtree"})
    assert done.about["features"]["quadtree"] > 10
    found = READERS["gpkg"][1](tmp_path / "q.gpkg")["quadtree"]
    area = selection.area(universal)
    assert area is not None
    tree, box = Quadtree.from_map(universal), shapely.box(*area)
    every = shapely.box(
        tree.west_m, tree.south_m, tree.west_m + tree.side_m, tree.south_m + tree.side_m
    )
    centres = [feature.shape.centroid for feature in found]
    written = tree.at([place.x for place in centres], [place.y for place in centres])
    reaching = np.flatnonzero(shapely.area(shapely.intersection(every, box)) > 1e-6)
    np.testing.assert_array_equal(np.sort(written), reaching)
    assert not shapely.covers(box.buffer(1e-6), every[reaching]).all()
    for feature, k in zip(found, written, strict=True):
        assert feature.shape.area == pytest.approx(tree.side_m[k] ** 2, rel=1e-3)
        assert feature.properties["side_m"] == tree.side_m[k]
        assert feature.properties["mean_density"] == tree.squares.mean[k]
    usual = export_map(universal, tmp_path / "usual.gpkg")
    assert "quadtree" not in usual.about["features"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"quadtree_sides": "fine,coarse"}, "'fine,coarse' are no sides of squares; give metres"),
        ({"quadtree_sides": "0.3,7"}, "the nearest is"),
        ({"quadtree_loss": 256.0}, "quadtree_loss = 256.0"),
        ({"quadtree_seen": 0.0}, "quadtree_seen = 0.0"),
    ],
)
def test_options_that_cannot_be(
    universal: MapFile, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        export_map(universal, tmp_path / "q.gpkg", options={"features": "quadtree", **options})
    assert not list(tmp_path.iterdir())


def test_more_squares_than_a_file_takes(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(squares, "MAX_SQUARES", 5)
    with pytest.raises(ConfigError, match="larger --quadtree-loss"):
        export_map(universal, tmp_path / "q.gpkg", options={"features": "quadtree"})
