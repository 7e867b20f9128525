"""Roughness and steps of the ground: differences of heights within frames, by whole sums."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import (
    GROUND_CHANNEL,
    NO_GROUND_CM,
    NO_STEP_KNOWN,
    STEP_CHANNEL,
    GridSpec,
    LocalGrid,
    Pose,
)
from fieldgrid.maps import MapView, Transfer, create_map, open_map
from fieldgrid.maps.layers.built_in.relief import roughness
from tests.maps.file.maps import DATUM

SPEC = GridSpec(width_m=6.0, length_m=8.0, cell_m=0.1)
LAYERS = ("roughness", "step")
Channels = dict[str, npt.NDArray[np.int16] | npt.NDArray[np.uint8]]
Frame = tuple[Pose, Channels]


def seen_from(heading_deg: float = 0.0, east_m: float = 0.0, up_m: float = 3.0) -> Pose:
    return Pose(1_000_000_000, east_m, 2.0, up_m, heading_deg, 0.02, 0.3, 1.0)


def ground(heights_cm: npt.ArrayLike = 0) -> npt.NDArray[np.int16]:
    return np.broadcast_to(np.asarray(heights_cm, np.int16), SPEC.shape).copy()


def steps(cm: npt.ArrayLike = 0) -> npt.NDArray[np.uint8]:
    return np.broadcast_to(np.asarray(cm, np.uint8), SPEC.shape).copy()


def read(
    path: Path, sessions: Sequence[Sequence[Frame]], *, cell_m: float = 0.2, without: str = ""
) -> MapView:
    seen = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, np.bool_))
    with create_map(path, DATUM, cell_m=0.2, transfer=Transfer.AREA) as universal:
        for number, frames in enumerate(sessions):
            with universal.add_session(str(number)) as session:
                for k, (pose, channels) in enumerate(frames):
                    session.add(seen, pose, frame_id=str(k), channels=channels)
        if without:
            universal.remove_session(without)
        assert universal.verify(deep=True).problems == ()
    with open_map(path) as universal:
        return universal.read(cell_m=cell_m, layers=LAYERS)


def test_roughness_is_what_a_plane_through_nine_heights_leaves() -> None:
    random = np.random.default_rng(2)
    heights = random.integers(-30, 30, SPEC.shape).astype(np.int16)
    heights[random.random(SPEC.shape) < 0.02] = NO_GROUND_CM
    found = roughness(heights, SPEC, 2)
    assert found.shape == (40, 30)
    y, x = np.mgrid[-1:2, -1:2].reshape(2, 9)
    design = np.stack([np.ones(9), x, y], axis=1)
    known = 0
    for row, column in np.ndindex(found.shape):
        j, i = 2 * row + 1, 2 * column + 1
        inside = 5 <= j < SPEC.n_y - 5 and 5 <= i < SPEC.n_x - 5
        nine = heights[j + 5 * y, i + 5 * x].astype(float) if inside else np.full(9, NO_GROUND_CM)
        if NO_GROUND_CM in nine:
            assert found[row, column] == -1
            continue
        left = nine - design @ np.linalg.lstsq(design, nine, rcond=None)[0]
        rms_m = np.sqrt((left**2).sum() / 6.0) / 100.0
        assert found[row, column] * 0.002 == pytest.approx(rms_m, abs=0.0011)
        known += 1
    assert known > 500


def test_a_hillside_is_even_and_a_washboard_is_rough(tmp_path: Path) -> None:
    y = np.arange(SPEC.n_y)[:, None]
    even, waves = ground(3 * y), ground(np.where(y // 5 % 2 == 0, 0, 12))
    for heights, expected_m in ((even, 0.0), (waves, 0.0693)):
        path = tmp_path / f"{expected_m}.gpkg"
        found = read(path, [[(seen_from(), {GROUND_CHANNEL: heights})]]).layer("roughness")
        inside = np.isfinite(found)
        assert 0.6 < inside.mean() < 0.9  # half a metre within the grid
        np.testing.assert_allclose(found[inside], expected_m, atol=0.002)


def test_what_poses_are_off_makes_no_relief(tmp_path: Path) -> None:
    """Two drives whose heights differ by half a metre, each of which saw one half twice."""
    left = ground()
    left[:, 30:] = NO_GROUND_CM
    frames = [
        (seen_from(up_m=3.0), {GROUND_CHANNEL: left, STEP_CHANNEL: steps()}),
        (seen_from(up_m=3.5), {GROUND_CHANNEL: ground(), STEP_CHANNEL: steps()}),
    ]
    view = read(tmp_path / "map.gpkg", [frames[:1], frames[1:]])
    for name in LAYERS:
        assert np.nanmax(view.layer(name)) == 0.0


def test_a_step_needs_half_of_the_frames_that_could_tell(tmp_path: Path) -> None:
    cm = np.array([21, 0, NO_STEP_KNOWN, 9, 14])  # of columns of 1.2 m
    said = np.stack([cm, np.array([19, 0, 0, 9, 0]), np.array([0, 30, NO_STEP_KNOWN, 9, 0])])
    frames = [(seen_from(), {STEP_CHANNEL: steps(np.repeat(one, 12)[None])}) for one in said]
    view = read(tmp_path / "map.gpkg", [frames])
    east_m = (view.window.i0 + np.arange(view.window.width) + 0.5) * 0.2
    found = view.layer("step")
    assert np.isnan(view.layer("roughness")).all()
    for number, expected_m in enumerate([0.20, 0.0, 0.0, 0.0, 0.0]):
        middle = np.abs(east_m - (number * 1.2 - 2.4)) < 0.3
        column = found[5:-5, middle]
        np.testing.assert_allclose(column, expected_m, atol=1e-6)
    both = read(tmp_path / "two.gpkg", [frames[:1], frames[1:2]]).layer("step")
    np.testing.assert_allclose(both[5:-5, np.abs(east_m - 2.4) < 0.3], 0.14, atol=1e-6)


def test_what_a_frame_lacks_is_not_a_number(tmp_path: Path) -> None:
    half = steps(20)
    half[:, 30:] = NO_STEP_KNOWN
    view = read(tmp_path / "map.gpkg", [[(seen_from(), {STEP_CHANNEL: half})]])
    east_m = (view.window.i0 + np.arange(view.window.width) + 0.5) * 0.2
    assert np.isnan(view.layer("step")[:, east_m > 0.1]).all()
    assert np.isfinite(view.layer("step")[5:-5, (east_m < -0.1) & (east_m > -2.9)]).all()
    old = read(tmp_path / "old.gpkg", [[(seen_from(), {})]])
    assert all(np.isnan(old.layer(name)).all() for name in LAYERS)


def test_larger_cells_have_the_highest_step_and_the_mean_roughness(tmp_path: Path) -> None:
    kerb = steps()
    kerb[40:42] = 25
    rough = ground(np.random.default_rng(0).integers(-9, 9, (SPEC.n_y, 1)))
    frames = [(seen_from(), {STEP_CHANNEL: kerb, GROUND_CHANNEL: rough})]
    path = tmp_path / "map.gpkg"
    fine, coarse = read(path, [frames]), open_map(path).read(cell_m=0.8, layers=LAYERS)
    north_m = (coarse.window.j0 + np.arange(coarse.window.height) + 0.5) * 0.8
    row = np.abs(north_m - 6.1) < 0.4
    assert np.nanmax(coarse.layer("step")[row]) == pytest.approx(0.25)
    assert np.nanmax(coarse.layer("step")[~row]) == 0.0
    known = np.isfinite(fine.layer("roughness"))
    assert np.nanmean(coarse.layer("roughness")) == pytest.approx(
        fine.layer("roughness")[known].mean(), rel=0.15
    )


def test_sums_are_the_same_in_any_order_and_without_a_session(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    frames = [
        (
            seen_from(10.0 * k, 0.3 * k, 12.0 + 0.1 * k),
            {
                GROUND_CHANNEL: ground(random.integers(-20, 20, SPEC.shape)),
                STEP_CHANNEL: steps(random.integers(0, 60, SPEC.shape)),
            },
        )
        for k in range(6)
    ]
    other = [(seen_from(77.0, 1.0), frames[3][1])]
    view = read(tmp_path / "one.gpkg", [frames])
    shuffled = read(tmp_path / "two.gpkg", [[frames[k] for k in (3, 0, 5, 1, 4, 2)]])
    never = read(tmp_path / "three.gpkg", [frames[:2], frames[2:]])
    undone = read(tmp_path / "four.gpkg", [frames[:2], other, frames[2:]], without="1")
    for name in LAYERS:
        assert np.isfinite(view.layer(name)).any()
        np.testing.assert_array_equal(view.layer(name), shuffled.layer(name))
        np.testing.assert_array_equal(never.layer(name), undone.layer(name))


def test_each_session_has_one_voice(tmp_path: Path) -> None:
    """Five frames that saw a kerb against two drives of one frame that did not."""
    kerb = [(seen_from(), {STEP_CHANNEL: steps(20)})] * 5
    even = [(seen_from(), {STEP_CHANNEL: steps(0)})]
    found = read(tmp_path / "one.gpkg", [kerb, even]).layer("step")
    assert np.nanmin(found) == pytest.approx(0.2)
    assert np.nanmax(read(tmp_path / "two.gpkg", [kerb, even, even]).layer("step")) == 0.0
