"""The terrain that frames see: heights and slopes of the ground, by whole sums."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.grids import GROUND_CHANNEL, NO_GROUND_CM, GridSpec, LocalGrid
from fieldgrid.layers.ground import WIDEST_SIGMA_M, weights
from fieldgrid.mapfile import MapView, create_map, open_map
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import Transfer
from tests.mapfile.maps import DATUM

SPEC = GridSpec(width_m=6.0, length_m=8.0, cell_m=0.1)
LAYERS = ("ground", "ground_sigma", "slope")
_Heights = npt.NDArray[np.int16]
Frame = tuple[Pose, _Heights | None]


def seen_from(
    heading_deg: float, east_m: float = 0.0, up_m: float = 12.34, sigma_m: float = 0.02
) -> Pose:
    return Pose(1_000_000_000, east_m, 2.0, up_m, heading_deg, sigma_m, 0.3, 1.0)


def hillside(pose: Pose, rise_east: float, rise_north: float) -> _Heights:
    """Heights that a frame sees of a plane through the datum, above the ground of its pose."""
    x, y = SPEC.centres_m()
    phi = math.radians(pose.heading_deg)
    east = pose.east_m + x * math.cos(phi) + y[:, None] * math.sin(phi)
    north = pose.north_m - x * math.sin(phi) + y[:, None] * math.cos(phi)
    above = rise_east * east + rise_north * north - pose.up_m
    return np.rint(100.0 * above).astype(np.int16)


def grid() -> LocalGrid:
    return LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, np.bool_))


def read(
    path: Path, sessions: Sequence[Sequence[Frame]], *, cell_m: float = 0.2, without: str = ""
) -> MapView:
    with create_map(path, DATUM, cell_m=0.2, transfer=Transfer.AREA) as universal:
        for number, frames in enumerate(sessions):
            with universal.add_session(str(number)) as session:
                for k, (pose, heights) in enumerate(frames):
                    channels = {} if heights is None else {GROUND_CHANNEL: heights}
                    session.add(grid(), pose, frame_id=str(k), channels=channels)
        if without:
            universal.remove_session(without)
    with open_map(path) as universal:
        return universal.read(cell_m=cell_m, layers=LAYERS)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, -143.0])
def test_a_hillside_has_its_height_and_slope(tmp_path: Path, heading_deg: float) -> None:
    pose = seen_from(heading_deg)
    rise = 0.12, -0.09  # 15 percent: 8.5°
    view = read(tmp_path / "map.gpkg", [[(pose, hillside(pose, *rise))]])
    ground, slope = view.layer("ground"), view.layer("slope")
    rows, columns = (np.arange(n) + 0.5 for n in view.window.shape)
    east, north = (view.window.i0 + columns) * 0.2, (view.window.j0 + rows) * 0.2
    expected = rise[0] * east + rise[1] * north[:, None]
    inside = np.isfinite(ground)
    assert inside.sum() > 0.9 * SPEC.width_m * SPEC.length_m / 0.04
    np.testing.assert_allclose(ground[inside], expected[inside], atol=0.025)
    known = np.isfinite(slope)
    assert known.sum() > 0.6 * inside.sum()
    np.testing.assert_allclose(slope[known], math.degrees(math.atan(0.15)), atol=0.8)


def test_a_surer_frame_counts_for_more(tmp_path: Path) -> None:
    sure, unsure = seen_from(0.0, sigma_m=0.02), seen_from(0.0, sigma_m=1.0)
    flat = np.zeros(SPEC.shape, np.int16)
    view = read(tmp_path / "map.gpkg", [[(sure, flat), (unsure, flat + 100)]])
    ground, sigma = view.layer("ground"), view.layer("ground_sigma")
    assert np.nanmax(np.abs(ground - 12.34)) < 0.01
    # Each frame's own sigma, of which the surer one has the greater share.
    assert np.nanmax(sigma) < 0.1
    alone = read(tmp_path / "alone.gpkg", [[(unsure, flat)]]).layer("ground_sigma")
    assert np.nanmin(alone) == pytest.approx(2.0, rel=0.2)


def test_heights_are_the_same_in_any_order_and_without_a_session(tmp_path: Path) -> None:
    poses = [seen_from(10.0 * k, 0.3 * k, 12.0 + 0.1 * k, 0.02 * (k + 1)) for k in range(6)]
    frames = [(pose, hillside(pose, 0.05, 0.1)) for pose in poses]
    other = [(seen_from(77.0, 1.0, 3.0), hillside(seen_from(77.0, 1.0, 3.0), -0.2, 0.3))]
    view = read(tmp_path / "one.gpkg", [frames])
    shuffled = read(tmp_path / "two.gpkg", [[frames[k] for k in (3, 0, 5, 1, 4, 2)]])
    undone = read(tmp_path / "three.gpkg", [frames[:2], other, frames[2:]], without="1")
    for name in LAYERS:
        np.testing.assert_array_equal(view.layer(name), shuffled.layer(name))
        # In two sessions the same sums.
        np.testing.assert_array_equal(view.layer(name), undone.layer(name))


def test_what_a_frame_lacks_is_not_a_number(tmp_path: Path) -> None:
    pose = seen_from(0.0)
    holed = np.zeros(SPEC.shape, np.int16)
    holed[:40] = NO_GROUND_CM
    view = read(tmp_path / "holed.gpkg", [[(pose, holed)]])
    rows = (view.window.j0 + np.arange(view.window.shape[0]) + 0.5) * 0.2
    ground = view.layer("ground")
    assert np.isnan(ground[rows < 5.9]).all()
    assert np.isfinite(ground[(rows > 6.1) & (rows < 9.9)]).any(axis=1).all()
    old = read(tmp_path / "old.gpkg", [[(pose, None)]])
    assert all(np.isnan(old.layer(name)).all() for name in LAYERS)
    nowhere = read(tmp_path / "nowhere.gpkg", [[(seen_from(0.0, up_m=math.nan), holed * 0)]])
    assert np.isnan(nowhere.layer("ground")).all()


def test_larger_cells_are_the_mean_of_their_base_cells(tmp_path: Path) -> None:
    pose = seen_from(0.0)
    view = read(tmp_path / "map.gpkg", [[(pose, hillside(pose, 0.0, 0.1))]], cell_m=0.8)
    north = (view.window.j0 + np.arange(view.window.shape[0]) + 0.5) * 0.8
    ground = view.layer("ground")
    whole = np.isfinite(ground).sum(axis=1) > 4
    middle = np.nanmedian(ground, axis=1)
    np.testing.assert_allclose(middle[whole][1:-1], 0.1 * north[whole][1:-1], atol=0.02)


@pytest.mark.parametrize("sigma_m", [0.01, 0.02, 0.3, 1.0, 7.0, math.inf])
def test_weights_say_how_sure_a_height_is(sigma_m: float) -> None:
    found = WIDEST_SIGMA_M / np.sqrt(weights(SPEC, sigma_m))
    y = SPEC.centres_m()[1]
    true = np.sqrt((2.0 * sigma_m) ** 2 + 0.02**2 + (0.004 * y) ** 2)
    np.testing.assert_array_less(np.abs(np.log2(found / np.clip(true, 0.032, 4.0))), 0.51)
    assert np.all(np.diff(found) >= 0.0)
