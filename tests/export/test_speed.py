"""Speed masks, as Nav2's map server and speed filter make limits of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely
import yaml

from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.maps import MapFile, Mark, MarkKind, open_map
from tests.export.asymmetric import COARSE_M, truth, write_asymmetric_map
from tests.export.nav2_loader import load


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def limits(
    universal: MapFile, out: Path, east: npt.NDArray[Any], north: npt.NDArray[Any], **options: Any
) -> npt.NDArray[Any]:
    """Percent of the highest speed at some places, 100 where the filter sets no limit; the rule of
    nav2_costmap_2d's speed filter with the parameters that were written."""
    export_map(universal, out, Selection(cell_m=COARSE_M), options=options)
    params = yaml.safe_load(out.with_suffix(".speed.params.yaml").read_text())
    server = params["speed_filter_mask_server"]["ros__parameters"]
    info = params["speed_costmap_filter_info_server"]["ros__parameters"]
    assert info["type"] == 1  # percent
    assert info["mask_topic"] == server["topic_name"]
    path = out.parent / server["yaml_filename"]
    values = load(path).at(east, north)
    np.testing.assert_array_equal(values, load(path, vectorised=True).at(east, north))
    # A mask without a limit is 0, and so is one that is unknown.
    limit = np.where(values > 0, info["base"] + info["multiplier"] * values, 100.0)
    assert (limit > 0.0).all()  # which the filter would take for no limit
    return limit


def places(universal: MapFile) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Places on the map; beyond it a mask says nothing."""
    random, box = np.random.default_rng(3), universal.bounds
    return (
        random.uniform(box.west_m, box.east_m, 2000), random.uniform(box.south_m, box.north_m, 2000)
    )  # fmt: skip


def barred(east: npt.NDArray[Any], north: npt.NDArray[Any]) -> npt.NDArray[Any]:
    true = truth(east, north)
    found: npt.NDArray[Any] = ~true.observed | (true.density > 100)
    return found


def near(east: npt.NDArray[Any], north: npt.NDArray[Any], away_m: float) -> npt.NDArray[Any]:
    """Whether something that bars the way is so near, looked up on rings of points."""
    found = barred(east, north)
    for r in np.arange(0.05, away_m + 1e-9, 0.05):
        for angle in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
            found |= barred(east + r * np.cos(angle), north + r * np.sin(angle))
    return found


def test_slow_near_obstacles_and_unseen_ground(universal: MapFile, tmp_path: Path) -> None:
    """Everywhere within the distance, and nowhere two cells beyond it."""
    east, north = places(universal)
    limit = limits(universal, tmp_path / "a.yaml", east, north, slow_percent=40, slow_within_m=0.5)
    assert set(np.unique(limit)) == {40.0, 100.0}
    assert (limit[near(east, north, 0.5)] == 40.0).all()
    assert (limit[~near(east, north, 0.5 + 2.5 * COARSE_M)] == 100.0).all()
    assert 0.05 < (limit == 100.0).mean() < 0.95


def test_slow_where_few_frames_saw_the_ground(universal: MapFile, tmp_path: Path) -> None:
    east, north = places(universal)
    count = universal.read(cell_m=COARSE_M, layers=["count"])
    frames = count.layer("count")
    few = int(frames.max())
    limit = limits(
        universal, tmp_path / "a.yaml", east, north,
        slow_percent=30, slow_within_m=0.0, slow_seen_by=few,
    )  # fmt: skip
    i, j = count.lattice.index(east, north)
    i, j = i - count.window.i0, j - count.window.j0
    inside = (i >= 0) & (j >= 0) & (i < count.window.width) & (j < count.window.height)
    seen = np.zeros(len(east), dtype=np.int64)
    seen[inside] = frames[j[inside], i[inside]]
    clear = ~near(east, north, 2.5 * COARSE_M) & inside
    assert (limit[clear & (seen < few)] == 30.0).all()
    assert (limit[clear & (seen >= few)] == 100.0).all()
    assert (clear & (seen < few)).any() or few == 1


def test_slow_at_the_turns_of_a_route(universal: MapFile, tmp_path: Path) -> None:
    east, north = places(universal)
    clear = np.flatnonzero(~near(east, north, 1.5))
    turn, straight = clear[0], clear[-1]
    route = tmp_path / "route.csv"
    route.write_text(
        "east_m,north_m,curvature_1pm\n"
        f"{east[turn]},{north[turn]},-0.5\n{east[straight]},{north[straight]},0.05\n"
    )
    limit = limits(
        universal, tmp_path / "a.yaml", east, north,
        slow_percent=25, slow_within_m=0.4, slow_turns=route,
    )  # fmt: skip
    away = np.hypot(east - east[turn], north - north[turn])
    others = ~near(east, north, 0.4 + 2.5 * COARSE_M)
    assert (limit[away < 0.4] == 25.0).all()
    assert (limit[others & (away > 0.4 + 2.5 * COARSE_M)] == 100.0).all()
    assert limit[straight] == 100.0


def test_slow_near_a_keep_out(tmp_path: Path) -> None:
    path = write_asymmetric_map(tmp_path / "marked.gpkg")
    with open_map(path) as opened:
        east, north = places(opened)
    middle = np.flatnonzero(~near(east, north, 1.2))[0]
    east_m, north_m = float(east[middle]), float(north[middle])
    box = shapely.box(east_m - 0.3, north_m - 0.3, east_m + 0.3, north_m + 0.3)
    with open_map(path, writable=True) as opened:
        opened.add_marks([Mark(MarkKind.KEEPOUT, tuple(box.exterior.coords[:-1]))])
        limit = limits(opened, tmp_path / "a.yaml", east, north, slow_percent=60, slow_within_m=0.5)
    away = shapely.distance(box, shapely.points(east, north))
    assert (limit[away < 0.5] == 60.0).all()


def test_without_a_speed_there_is_no_mask(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "a.yaml", Selection(cell_m=COARSE_M))
    assert not list(tmp_path.glob("*.speed.*"))


def test_without_a_speed_the_mask_of_the_map_that_is_replaced_goes(
    universal: MapFile, tmp_path: Path
) -> None:
    """It would be loaded beside the new map."""
    how = Selection(cell_m=COARSE_M)
    export_map(universal, tmp_path / "a.yaml", how, options={"slow_percent": 40})
    assert len(list(tmp_path.glob("*.speed.*"))) == 3
    done = export_map(universal, tmp_path / "a.yaml", how, overwrite=True)
    assert not list(tmp_path.glob("*.speed.*"))
    removed = "a.speed.pgm, a.speed.yaml, a.speed.params.yaml"
    assert ("removed with the old map", removed) in done.rows


PARAMETERS = "speed_filter_mask_server: {ros__parameters: {yaml_filename: a.speed.yaml}}"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ("a.speed.params.yaml", PARAMETERS),
        ("a.speed.params.yaml", "- {"),
        ("a.speed.params.yaml", "[" * 5000),
        ("a.speed.params.yaml", "# mine" * 5000),
        ("a.speed.params.yaml", None),
        ("a.speed.yaml", "image: other.pgm"),
        ("a.speed.yaml", "just a note"),
        ("a.speed.georef.json", "{}"),
    ],
)
def test_files_with_names_of_a_mask_that_are_not_known_stay(
    universal: MapFile, tmp_path: Path, changed: str, words: str | None
) -> None:
    """They may be the work of a user, or another map."""
    how = Selection(cell_m=COARSE_M)
    export_map(universal, tmp_path / "a.yaml", how, options={"slow_percent": 40})
    if words is None:
        (tmp_path / changed).unlink()
    else:
        (tmp_path / changed).write_text(words)
    before = {path: path.read_bytes() for path in tmp_path.glob("*.speed.*")}
    done = export_map(universal, tmp_path / "a.yaml", how, overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.glob("*.speed.*")} == before
    rows = dict(done.rows)
    assert "a.speed.pgm" in rows["left: not of the old map, or changed"]
    assert "removed with the old map" not in rows


def test_a_map_that_is_named_as_a_mask_stays(universal: MapFile, tmp_path: Path) -> None:
    how = Selection(cell_m=COARSE_M)
    export_map(universal, tmp_path / "a.speed.yaml", how, options={"mode": "raw"})
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    done = export_map(universal, tmp_path / "a.yaml", how)
    assert before.items() <= {path: path.read_bytes() for path in tmp_path.iterdir()}.items()
    left = "a.speed.pgm, a.speed.yaml"
    assert ("left: not of the old map, or changed", left) in done.rows


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"slow_percent": 0}, "slow_percent"),
        ({"slow_percent": 100}, "slow_percent"),
        ({"slow_percent": 50, "slow_turns": "none.csv"}, "none.csv cannot be read"),
        ({"slow_percent": 50, "slow_turns": __file__}, "is no table of poses"),
    ],
)
def test_what_cannot_be(
    universal: MapFile, tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        export_map(universal, tmp_path / "a.yaml", Selection(cell_m=COARSE_M), options=options)
    assert not list(tmp_path.iterdir())
