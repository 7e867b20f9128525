"""Drops of a map: votes of frames within a drive, of drives, and what a planner is told."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import (
    BEYOND_DROP,
    DROP_CHANNEL,
    NO_DROP_TOLD,
    NO_STEP_KNOWN,
    STEP_CHANNEL,
    GridSpec,
    LocalGrid,
    Pose,
)
from fieldgrid.maps import (
    LETHAL,
    UNKNOWN_COST,
    CostCurve,
    Costmap,
    Farm,
    MapView,
    Mark,
    MarkKind,
    Transfer,
    create_map,
    open_map,
)
from tests.maps.file.maps import DATUM

SPEC = GridSpec(width_m=4.0, length_m=4.0, cell_m=0.1)
LAYERS = ("drop", "sure_share")
Said = tuple[int, int]
"""What a frame says of all of its cells: `drop_cm` and `step_cm`."""
CLEAR, FALLS, RISE, BEYOND, FAR = (
    (0, 0),
    (40, 40),
    (0, 40),
    (BEYOND_DROP, 0),
    (NO_DROP_TOLD, NO_STEP_KNOWN),
)
OLD = (-1, 0)
"""A frame of before, which keeps steps and nothing of drops."""


def channels(said: Said) -> dict[str, npt.NDArray[np.uint8]]:
    drop, step = said
    kept = {STEP_CHANNEL: np.full(SPEC.shape, step, np.uint8)}
    return kept if drop < 0 else kept | {DROP_CHANNEL: np.full(SPEC.shape, drop, np.uint8)}


def write(
    path: Path, drives: Sequence[Sequence[Said]], density: int = 0, without: Sequence[int] = ()
) -> Path:
    seen = LocalGrid(SPEC, np.full(SPEC.shape, density, np.uint8), np.ones(SPEC.shape, np.bool_))
    with create_map(path, DATUM, cell_m=0.1, transfer=Transfer.AREA) as universal:
        for number, frames in enumerate(drives):
            with universal.add_session(str(number)) as session:
                for k, said in enumerate(frames):
                    pose = Pose(1_000_000_000, 0.05, 2.05, 3.0, 0.0, 0.02, 0.3, 1.0)
                    session.add(seen, pose, frame_id=str(k), channels=channels(said))
        for number in without:
            universal.remove_session(str(number))
        assert universal.verify(deep=True).problems == ()
    return path


def read(path: Path, **options: object) -> MapView:
    with open_map(path) as universal:
        return universal.read(layers=LAYERS, decide="density", **options)  # type: ignore[arg-type]


def inner(values: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """What there is away from the edges, and from the vehicle, under which the ground is free."""
    return np.unique(values[9:-5, 5:-5])


@pytest.mark.parametrize(
    ("drives", "drop_m", "sure"),
    [
        ([[CLEAR]], 0.0, 1),
        ([[FALLS]], 0.4, 1),
        ([[FALLS, CLEAR]], 0.4, 1),
        ([[FALLS, CLEAR, CLEAR]], 0.0, 1),
        ([[FALLS, FAR, FAR, RISE, RISE]], 0.4, 1),  # who cannot tell has no vote
        ([[FAR]], np.nan, 1),
        ([[FALLS, (20, 20)]], 0.3, 1),
        ([[FALLS] * 40, [CLEAR] * 40], 0.4, 1),
        ([[FALLS] * 40, [CLEAR] * 40, [CLEAR] * 40, [CLEAR] * 40], 0.0, 1),
        ([[FALLS] * 2, [RISE] * 40], 0.4, 1),
        ([[BEYOND]], np.nan, 0),
        ([[BEYOND, BEYOND, BEYOND, CLEAR]], 0.0, 0),
        ([[BEYOND, BEYOND, CLEAR]], 0.0, 1),
        ([[BEYOND, FAR, FAR]], np.nan, 0),
        ([[BEYOND] * 40, [CLEAR]], 0.0, 1),  # another drive looks from its own level
    ],
)
def test_frames_and_drives_vote(
    tmp_path: Path, drives: list[list[Said]], drop_m: float, sure: int
) -> None:
    for order in list(permutations(drives))[:3]:
        path = tmp_path / "map.gpkg"
        view = read(write(path, [list(reversed(frames)) for frames in order]))
        np.testing.assert_allclose(inner(view.layer("drop")), [drop_m], atol=1e-6)
        assert inner(view.layer("sure_share")).tolist() == [sure]
        assert inner(view.density).tolist() == [0]
        path.unlink()


@pytest.mark.parametrize(
    ("frames", "density", "log_odds"),
    [
        ([CLEAR] * 2, 0, -0.8),
        ([BEYOND] * 9, 0, 0.0),  # nothing is known of the ground there
        ([BEYOND, BEYOND, CLEAR], 0, -0.4),
        ([BEYOND], 255, 0.85),  # what stands up from there is an obstacle all the same
        ([FALLS], 0, 0.85),
        ([FALLS, CLEAR, CLEAR, CLEAR], 0, -0.35),
        ([RISE, FAR, OLD], 0, -1.2),
    ],
)
def test_occupancy_takes_an_edge_for_an_obstacle_and_nothing_beyond_for_free(
    tmp_path: Path, frames: list[Said], density: int, log_odds: float
) -> None:
    with open_map(write(tmp_path / "map.gpkg", [frames], density)) as universal:
        found = inner(universal.read(layers=["occupancy"]).layer("occupancy"))
    np.testing.assert_allclose(found, 1.0 / (1.0 + np.exp(-log_odds)), rtol=1e-6)


def test_a_drive_that_leaves_takes_its_drops_along(tmp_path: Path) -> None:
    left = read(write(tmp_path / "left.gpkg", [[CLEAR] * 3, [FALLS, BEYOND]], without=[1]))
    never = read(write(tmp_path / "never.gpkg", [[CLEAR] * 3]))
    for name in LAYERS:
        np.testing.assert_array_equal(left.layer(name), never.layer(name))


def test_a_planner_is_kept_from_edges_and_from_what_lies_beyond(tmp_path: Path) -> None:
    for said, cost, occupancy in (
        (FALLS, LETHAL, 100),
        (BEYOND, UNKNOWN_COST, -1),
        (CLEAR, 0, 0),
        (FAR, 0, 0),
    ):
        path = write(tmp_path / f"{said[0]}.gpkg", [[said] * 3])
        for cell_m in (None, 0.2, 0.25):
            with open_map(path) as universal:
                costs = Costmap.from_map(universal, cell_m=cell_m)
            assert inner(costs.costs).tolist() == [cost]
            found = CostCurve().occupancy(*read(path, cell_m=cell_m).decision())
            assert inner(found).tolist() == [occupancy]
        with Farm(tmp_path) as farm:
            assert inner(Costmap.from_map(farm).costs).tolist() == [cost]
        path.unlink()


def test_how_deep_a_drop_must_be_is_settable(tmp_path: Path) -> None:
    path = write(tmp_path / "map.gpkg", [[FALLS]])
    for least_drop_m, cost in ((0.4, LETHAL), (0.45, 0), (float("inf"), 0)):
        curve = CostCurve(least_drop_m=least_drop_m)
        with open_map(path) as universal:
            assert inner(Costmap.from_map(universal, curve=curve).costs).tolist() == [cost]
    with pytest.raises(ValueError, match="A least drop of 0 m"):
        CostCurve(least_drop_m=0)


@pytest.mark.parametrize("cell_m", [0.1, 0.2, 0.3])
def test_marks_say_more_than_drops(tmp_path: Path, cell_m: float) -> None:
    path = write(tmp_path / "map.gpkg", [[FALLS]])
    with open_map(path, writable=True) as universal:
        corners = ((-1.0, 3.0), (0.15, 3.0), (0.15, 5.0), (-1.0, 5.0))
        universal.add_marks([Mark(MarkKind.FREE, corners)])
    view = read(path, cell_m=cell_m)
    worst, seen, _ = view.decision()
    east_m, north_m = view.lattice.centres(view.window)
    within = (np.abs(north_m[:, None] - 4.0) < 0.8) & (np.abs(east_m + 0.5) < 0.3)
    assert (worst[within] == 0).all()
    assert (seen[within] == 1.0).all()
    partly = (np.abs(north_m[:, None] - 4.0) < 0.8) & (np.abs(east_m - 0.15) < 0.5 * cell_m - 0.01)
    assert partly.any()
    assert (worst[partly] == 255).all()


def test_an_old_map_reads_as_ever(tmp_path: Path) -> None:
    path = write(tmp_path / "old.gpkg", [[OLD] * 3], density=30)
    view = read(path)
    assert np.isnan(view.layer("drop")[view.observed]).all()
    with open_map(path) as universal:
        plain = universal.read(decide="density")
    worst, seen, _ = view.decision()
    np.testing.assert_array_equal(worst, plain.decision().worst)
    np.testing.assert_array_equal(seen, plain.decision().seen)


def test_a_live_grid_is_guarded() -> None:
    drops = np.zeros(SPEC.shape, np.uint8)
    drops[3, 4], drops[5:], drops[4, 4] = 25, BEYOND_DROP, NO_DROP_TOLD
    observed = np.ones(SPEC.shape, np.bool_)
    observed[3, 5], drops[3, 5] = False, 25
    grid = LocalGrid(SPEC, np.full(SPEC.shape, 7, np.uint8), observed)
    guarded = grid.guarded(drops)
    assert np.argwhere(guarded.density != 7).tolist() == [[3, 4]]
    assert guarded.density[3, 4] == 255
    assert not guarded.observed[5:].any()
    assert guarded.observed[:5].sum() == observed[:5].sum()
    assert grid.guarded(None) is grid
