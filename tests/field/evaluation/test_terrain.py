"""The ground of a map against the true ground, from a truth folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import TruthError
from fieldgrid.field import read_truth
from fieldgrid.field.evaluation.terrain import TrueGround, score_terrain
from fieldgrid.geometry import GROUND_CHANNEL, GridSpec, LocalGrid, Pose
from fieldgrid.maps import create_map, open_map
from tests.maps.file.maps import DATUM

TRUTH = Path(__file__).parents[3] / "examples" / "two_lanes" / "truth"
SPEC = GridSpec(width_m=6.0, length_m=8.0, cell_m=0.1)


def write(path: Path, *, with_ground: bool = True) -> Path:
    """One frame that looks north from the datum over ground that rises by 10 % to the east."""
    x, _ = SPEC.centres_m()
    heights = np.broadcast_to(np.rint(10.0 * x), SPEC.shape).astype(np.int16)
    seen = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, np.bool_))
    pose = Pose(1, 0.0, 0.0, 5.0, 0.0, 0.02, 0.3, 1.0)
    with create_map(path, DATUM, cell_m=0.1) as universal, universal.add_session("a") as session:
        session.add(seen, pose, channels={GROUND_CHANNEL: heights} if with_ground else {})
    return path


def true(off_m: float = 0.0) -> TrueGround:
    """The same hillside to the east of -1 m and north of 2 m, lower by `off_m`."""
    east = -1.0 + 0.5 * (np.arange(20) + 0.5)
    up_m = np.broadcast_to(5.0 + 0.1 * east - off_m, (30, 20)).copy()
    return TrueGround(up_m, -1.0, 2.0, 0.5)


def test_errors_are_those_of_the_ground_that_both_know(tmp_path: Path) -> None:
    with open_map(write(tmp_path / "map.gpkg")) as universal:
        found, high = score_terrain(universal, true()), score_terrain(universal, true(0.3))
        holed = true()
        holed.up_m[:, :10] = np.nan  # all that the map saw
        assert score_terrain(universal, holed) is None
    assert found is not None
    assert high is not None
    # From the middle of the first cell of the truth to the ends of the frame: 3.75 x 5.75 m.
    assert found.cells == high.cells == pytest.approx(3.75 * 5.75 / 0.0625, rel=0.1)
    assert found.rmse_m < 0.02
    assert abs(found.bias_m) < 0.01
    assert found.within_3_sigma == 1.0
    for value in (high.bias_m, high.rmse_m, high.median_m, high.p95_m, high.max_m):
        assert value == pytest.approx(0.3, abs=0.03)
    assert high.within_3_sigma == 0.0
    with open_map(write(tmp_path / "bare.gpkg", with_ground=False)) as universal:
        assert score_terrain(universal, true()) is None


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree(TRUTH, tmp_path / "truth"))


def test_a_truth_folder_may_have_the_ground(folder: Path) -> None:
    ground = read_truth(folder).ground
    assert ground is not None
    assert ground.cell_m == 0.25
    assert np.isfinite(ground.up_m).any()
    (folder / "ground_dtm_25cm.npz").unlink()
    assert read_truth(folder).ground is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ground_U": np.zeros(7)}, "shape"),
        ({"cell": np.float64(0.0)}, "cells of 0.0 m"),
        ({"east0": np.float64(np.nan)}, "nan"),
        ({"cell": np.array(["wide"])}, "heights of the ground"),
    ],
)
def test_damaged_ground_is_reported(
    folder: Path, change: dict[str, npt.NDArray[Any]], said: str
) -> None:
    path = folder / "ground_dtm_25cm.npz"
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in ("ground_U", "east0", "north0", "cell")}
    np.savez(path, **(arrays | change))
    with pytest.raises(TruthError, match=said):
        read_truth(folder)
    path.write_bytes(b"no archive")
    with pytest.raises(TruthError, match="ground_dtm_25cm"):
        read_truth(folder)
