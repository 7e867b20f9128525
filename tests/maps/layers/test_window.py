"""What frames leave in cells: each channel against a plain sum over the frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.geometry import GROUND_CHANNEL, STEP_CHANNEL, GridSpec, Lattice, LocalGrid, Window
from fieldgrid.maps import (
    GROUPS,
    Cells,
    Combine,
    FrameCells,
    Transfer,
    WindowFold,
    has_any,
    is_nothing,
    nothing,
)
from fieldgrid.maps.layers.window import coarser, merge_sessions, with_overviews
from fieldgrid.maps.transfer import CELL_WEIGHT
from tests.maps.file.maps import CELL_M, Frame, drive, grid_of, one_cell, pose_at

ALL = tuple(GROUPS.values())
WINDOW = Window(-256, -256, 512, 512)


GROUND = ("terrain", "surface", "drop", "standing")


def folded(
    frames: list[Frame], transfer: Transfer = Transfer.CENTRE, cell_m: float = CELL_M
) -> Cells:
    fold = WindowFold(Lattice(cell_m), WINDOW, transfer, ALL)
    for grid, pose in frames:
        fold.add(FrameCells(grid, {}), pose)
    return fold.cells()


def test_a_cell_says_how_often_how_much_and_how_high() -> None:
    frames = [one_cell(1.05, -2.05, density) for density in (10, 200, 7)]
    frames[1] = frames[1][0], replace(frames[1][1], up_m=-1.25)
    frames[2] = frames[2][0], replace(frames[2][1], up_m=math.nan)
    cells = folded(frames)
    (place,) = (tuple(p) for p in np.argwhere(cells.observed))
    assert {name: int(values[place].view(np.int64)) for name, values in cells.items()} == {
        "weight": 3 * CELL_WEIGHT,
        "sum": 217 * CELL_WEIGHT,
        "squares": (100 + 40000 + 49) * CELL_WEIGHT,
        "frames": 3,
        "highest": 200,
        "seen_sessions": 1,
        "obstacle_sessions": 0,
        "height_cm": -27,  # of 70 and -125, rounded half up
        "height_sessions": 1,
        "log_odds": 17 - 2 * 8,
        "moved_drives": 0,
        # No frame says anything of the ground itself.
        **{c.name: 0 for group in GROUND for c in GROUPS[group].channels},
    }


@pytest.mark.parametrize("transfer", Transfer)
def test_a_frame_counts_once_in_a_cell_that_several_of_its_cells_fall_into(
    transfer: Transfer,
) -> None:
    frames = [(grid_of(1), pose_at(0.01, 0.02, 30.0)), (grid_of(2), pose_at(0.2, 0.1, -70.0))]
    both, alone = folded(frames, transfer, 0.5), [folded([f], transfer, 0.5) for f in frames]
    assert alone[0]["weight"].max() > 9 * CELL_WEIGHT
    counts = sum(one.observed.astype(int) for one in alone)
    np.testing.assert_array_equal(both["frames"], counts)
    np.testing.assert_array_equal(both["highest"], np.maximum(*(a["highest"] for a in alone)))


@pytest.mark.parametrize("transfer", Transfer)
def test_a_part_of_a_window_is_a_part_of_the_whole(transfer: Transfer) -> None:
    frames = drive(5, step_m=0.7)
    whole, part = folded(frames, transfer), Window(-40, 30, 90, 70)
    fold = WindowFold(Lattice(CELL_M), part, transfer, ALL)
    for grid, pose in frames:
        fold.add(FrameCells(grid, {}), pose)
    inside = WINDOW.slices_of(part)
    corner = Window(-30, 40, 11, 12)
    for name, values in fold.cells().items():
        np.testing.assert_array_equal(values, whole[name][inside])
    for name, values in fold.cells(corner).items():
        np.testing.assert_array_equal(values, whole[name][WINDOW.slices_of(corner)])


def test_sessions_meet_by_sums_and_maxima() -> None:
    frames = drive(6, step_m=0.7)
    whole, parts = folded(frames), [folded(frames[::2]), folded(frames[1::2])]
    merged = merge_sessions(ALL, *parts)
    for name in set(whole) - {
        *("seen_sessions", "obstacle_sessions", "log_odds", "height_cm", "height_sessions")
    }:
        np.testing.assert_array_equal(merged[name], whole[name])
    np.testing.assert_array_equal(
        merged["seen_sessions"], sum(part.observed.astype(int) for part in parts)
    )


def test_coarser_twice_is_coarser_by_four() -> None:
    cells = with_overviews(ALL, folded(drive(5, step_m=0.7)))
    twice, once = coarser(ALL, coarser(ALL, cells, 2), 2), coarser(ALL, cells, 4)
    assert once.base_cells == twice.base_cells == 16
    absent = {c.name for group in ALL for c in group.channels if c.coarser is Combine.ABSENT}
    assert set(once) == set(cells) - absent
    for name in once:
        np.testing.assert_array_equal(twice[name], once[name])
    assert once["weight"].sum() == cells["weight"].sum()
    assert once["seen"].sum() == cells.observed.sum()
    assert once["frames"].max() == cells["frames"].max()


def test_channels_that_are_0_everywhere_take_no_memory() -> None:
    cells = folded([one_cell(1.05, -2.05, 0)])
    there = {name for name, values in cells.items() if not is_nothing(values)}
    # The density is what kernels are compiled for; a frame counts, and says that it is free here.
    assert there == {"weight", "sum", "frames", "seen_sessions", "height_cm", "height_sessions"} | {
        "log_odds"
    }
    assert not cells["drop_odds"].flags.writeable


def test_channels_that_are_0_everywhere_merge_and_grow_coarser_like_others() -> None:
    group, shape = GROUPS["standing"], (4, 6)
    names = [channel.name for channel in group.channels]
    values = {name: np.arange(24, dtype=np.uint64).reshape(shape) for name in names}
    without, zeros = (
        dict.fromkeys(names, zero) for zero in (nothing(shape), np.zeros_like(values["top_dm"]))
    )
    for a, b in ((values, without), (without, values), (without, without)):
        plain = [Cells(zeros if one is without else one) for one in (a, b)]
        merged, expected = (
            merge_sessions([group], Cells(a), Cells(b)),
            merge_sessions([group], *plain),
        )
        larger, expected_larger = coarser([group], merged, 2), coarser([group], expected, 2)
        for name in names:
            np.testing.assert_array_equal(merged[name], expected[name])
            np.testing.assert_array_equal(larger[name], expected_larger[name])


def test_blocks_of_which_nothing_was_observed_have_nothing() -> None:
    """A frame knows heights of the ground a little farther than cells that it observed; a tile
    stores no more than the blocks of these."""
    spec = GridSpec(width_m=4.0, length_m=4.0, cell_m=0.1)
    observed = np.zeros(spec.shape, np.bool_)
    observed[7:15, 3:22] = True
    grid = LocalGrid(spec, np.zeros(spec.shape, np.uint8), observed)
    pose = pose_at(0.0, 0.0, 33.0)
    channels = {
        GROUND_CHANNEL: np.zeros(spec.shape, np.int16),
        STEP_CHANNEL: np.full(spec.shape, 20, np.uint8),
    }
    for window in (Window(-256, -256, 512, 512), Window(-3, 1, 11, 9)):
        fold = WindowFold(Lattice(0.1), window, Transfer.CENTRE, ALL)
        fold.add(FrameCells(grid, channels), pose)
        cells = fold.cells()
        for name in ("ground_sessions", "step_known", "height_sessions"):
            assert (cells[name][cells.observed] > 0).all()
        if window.width == 512:
            seen = cells.observed.reshape(256, 2, 256, 2).any(axis=(1, 3))
            seen = np.repeat(np.repeat(seen, 2, axis=0), 2, axis=1)
            assert seen.sum() > cells.observed.sum() > 100
            whole = cells
            for name in ("ground_sessions", "step_known", "height_sessions"):
                np.testing.assert_array_equal(cells[name] > 0, seen)
        else:
            part = WINDOW.slices_of(window)
            for name in cells:
                np.testing.assert_array_equal(cells[name], whole[name][part])


@pytest.mark.parametrize("value", [1, 2, 256, 1 << 63])
def test_a_channel_has_any_value_or_none(value: int) -> None:
    values = np.zeros((40, 50), np.uint64)
    assert not has_any(values)
    assert not has_any(nothing((40, 50)))
    values[39, 49] = value
    assert has_any(values)
    assert has_any(values[30:, 40:])
    assert not has_any(values[:30, 40:])
    assert has_any(values.T)  # which is no row of bytes
    assert has_any(values[39, 49:])


@pytest.mark.parametrize("whole_blocks", [False, True])
def test_cells_beyond_the_window_are_nothing(whole_blocks: bool) -> None:
    ground = {GROUND_CHANNEL: np.full(grid_of(0).spec.shape, 30, np.int16)}
    small, large = (
        WindowFold(Lattice(CELL_M), window, Transfer.CENTRE, ALL)
        for window in (Window(-40, -30, 256, 210), WINDOW)
    )
    for grid, pose in drive(3):
        for fold in (small, large):
            fold.add(FrameCells(grid, ground), pose)
    part = Window(-256, 0, 512, 256)
    beyond = small.cells(part, whole_blocks=whole_blocks)
    whole = large.cells(part, whole_blocks=whole_blocks)
    assert beyond["weight"].any()
    assert {name: value.shape for name, value in beyond.items()} == {
        name: value.shape for name, value in whole.items()
    }
    seen = np.zeros(part.shape, np.bool_)
    seen[:180, 216:472] = True  # from the corner of the small window on
    for name, values in whole.items():
        side = part.height // len(values)
        np.testing.assert_array_equal(beyond[name], np.where(seen[::side, ::side], values, 0))
