"""From local grids to the universal grid: where values go and how they meet."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import ConfigError
from fieldgrid.geometry import GridSpec, Lattice, LocalGrid, Pose, Window, yaw_from_heading_rad
from fieldgrid.maps import Transfer, check_cell_sizes, footprint, land, mean_density, to_universal
from fieldgrid.maps.transfer import (
    AREA_SHIFT,
    CELL_WEIGHT,
    MeanFold,
    PaperFold,
    add_values,
    universal_axes,
)

PAPER = GridSpec(6.65, 14.0, 0.05)
SMALL = GridSpec(2.0, 3.0, 0.1)

headings = st.floats(-180.0, 180.0, exclude_min=True)
metres = st.floats(-3000.0, 3000.0)


def pose_at(east_m: float, north_m: float, heading_deg: float) -> Pose:
    return Pose(0, east_m, north_m, 0.0, heading_deg, 0.02, 0.5, 1.5)


poses = st.builds(pose_at, metres, metres, headings)


def filled(spec: GridSpec, value: int) -> LocalGrid:
    return LocalGrid(spec, np.full(spec.shape, value, np.uint8), np.ones(spec.shape, bool))


def random_grid(spec: GridSpec, seed: int, seen: float = 0.7) -> LocalGrid:
    rng = np.random.default_rng(seed)
    return LocalGrid(
        spec, rng.integers(0, 256, spec.shape, dtype=np.uint8), rng.random(spec.shape) < seen
    )


# --- Eq. 3


@given(
    st.sampled_from([0.0, 90.0, 180.0, -90.0]),
    st.floats(0.0, 89.999),
    metres,
    metres,
    st.floats(-20.0, 20.0),
    st.floats(0.0, 20.0),
)
def test_equation_3_moves_along_the_nose_and_to_its_right(
    quadrant: float, within: float, east: float, north: float, x: float, y: float
) -> None:
    pose = pose_at(east, north, (quadrant + within + 180.0) % 360.0 - 180.0)
    # Forward is one metre towards the heading; right is forward turned clockwise.
    nose = np.exp(1j * math.radians(90.0 - pose.heading_deg))
    expected = complex(east, north) + y * nose + x * nose * -1j
    found = to_universal(x, y, pose)
    assert found[0] == pytest.approx(expected.real, abs=1e-8)
    assert found[1] == pytest.approx(expected.imag, abs=1e-8)


@given(poses, st.floats(-20.0, 20.0), st.floats(0.0, 20.0))
def test_equation_3_is_the_rotation_of_ros(pose: Pose, x: float, y: float) -> None:
    yaw = float(yaw_from_heading_rad(pose.heading_deg))
    R_enu_base = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    base_link = np.array([y, -x])  # x forward, y left
    expected = np.array([pose.east_m, pose.north_m]) + R_enu_base @ base_link
    assert np.array(to_universal(x, y, pose)) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("heading", "east", "north"),
    [
        # Right 1.25, forward -3.75 of (100, 50) …, read off a sketch.
        (0.0, 98.75, 53.75),
        (90.0, 103.75, 51.25),
        (180.0, 101.25, 46.25),
        (-90.0, 96.25, 48.75),
        # 3-4-5: forward is (0.6, 0.8), right is (0.8, -0.6).
        (math.degrees(math.atan2(0.6, 0.8)), 101.25, 53.75),
        # Forward is (0.8, -0.6), right is (-0.6, -0.8).
        (math.degrees(math.atan2(0.8, -0.6)), 103.75, 48.75),
        # Forward is (-0.6, -0.8), right is (-0.8, 0.6).
        (math.degrees(math.atan2(-0.6, -0.8)), 98.75, 46.25),
        # Forward is (-0.8, 0.6), right is (0.6, 0.8).
        (math.degrees(math.atan2(-0.8, 0.6)), 96.25, 51.25),
    ],
)
def test_a_single_cell_lands_where_equation_3_says(
    heading: float, east: float, north: float
) -> None:
    spec = GridSpec(4.0, 6.0, 0.5)
    density = np.zeros(spec.shape, np.uint8)
    density[7, 1] = 200  # x = -1.25, left of the middle; y = 3.75
    grid = LocalGrid(spec, density, density > 0)
    pose, lattice = pose_at(100.0, 50.0, heading), Lattice(0.5)
    window = Window(150, 60, 120, 90)
    expected = (math.floor(north / 0.5) - 60, math.floor(east / 0.5) - 150)
    for fold in (MeanFold(lattice, window), PaperFold(lattice, window)):
        fold.add(grid, pose)
        value, observed = fold.density()
        assert [tuple(cell) for cell in np.argwhere(observed)] == [expected]
        assert value[expected] == 200
        assert value.sum() == 200

    area = MeanFold(lattice, window, Transfer.AREA)
    area.add(grid, pose)
    j, i = np.nonzero(area.sums[0])
    weight = area.sums[0, j, i].astype(float)
    assert weight.sum() == CELL_WEIGHT
    # The centre of gravity of its parts, to the half cell that the lattice allows.
    assert abs(((i + 150.5) * 0.5) @ weight / weight.sum() - east) < 0.25
    assert abs(((j + 60.5) * 0.5) @ weight / weight.sum() - north) < 0.25
    assert (area.density()[0][j, i] == 200).all()


# --- the compiled kernel


@settings(deadline=None, max_examples=60)
@given(
    poses,
    st.integers(-30, 30),
    st.integers(-30, 30),
    st.integers(1, 60),
    st.integers(1, 60),
    st.sampled_from([0, AREA_SHIFT]),
    st.sampled_from([0.1, 0.25]),
    st.integers(0, 2**32 - 1),
)
def test_the_kernel_is_the_reference(
    pose: Pose,
    di: int,
    dj: int,
    width: int,
    height: int,
    shift: int,
    cell_m: float,
    seed: int,
) -> None:
    """Each pass against NumPy, cell by cell: where cells land, and what they add there."""
    lattice, grid = Lattice(cell_m), random_grid(SMALL, seed)
    i, j = (int(value) for value in lattice.index(pose.east_m, pose.north_m))
    window = Window(i + di, j + dj, width, height)
    landing = land(grid, pose, lattice, window, Transfer.AREA if shift else Transfer.CENTRE)
    assert (landing.shift, landing.unit) == (shift, CELL_WEIGHT >> 2 * shift)
    column_i, column_j, row_i, row_j = universal_axes(SMALL, pose, lattice, shift)
    u = np.floor(column_i[None, :] + row_i[:, None]) - window.i0
    v = np.floor(column_j[None, :] + row_j[:, None]) - window.j0
    parts = np.ones((1 << shift, 1 << shift))
    observed = np.kron(grid.observed, parts).astype(bool)
    values = np.kron(grid.density, parts).astype(np.uint64)
    inside = observed & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    cell = np.where(inside, v * width + u, -1).astype(np.int32)
    np.testing.assert_array_equal(landing.cell, cell)
    for row, (first, last) in zip(landing.cell, landing.spans, strict=True):
        assert (np.delete(row, slice(first, last)) == -1).all()

    start = np.random.default_rng(seed).integers(0, 99, width * height).astype(np.uint64)
    table = np.arange(256, dtype=np.uint64) * np.uint64(3)
    compiled, reference = start.copy(), start.copy()
    add_values(grid.density, *landing, table, compiled)
    np.add.at(reference, cell[inside], table[values[inside]])
    np.testing.assert_array_equal(compiled, reference)


def test_a_weight_that_outgrows_half_a_word_goes_on_in_a_whole_one() -> None:
    """Large universal cells take up many local ones of many frames: no bit runs over."""
    spec = GridSpec(20.0, 20.0, 0.05)
    grid = filled(spec, 255)
    lattice, window = Lattice(90.0), Window(0, 0, 1, 1)
    fold = MeanFold(lattice, window)
    for _ in range(130):
        fold.add(grid, pose_at(45.0, 30.0, 17.0))
    frames = 130 * grid.density.size
    assert fold.sums[:, 0, 0].tolist() == [CELL_WEIGHT * frames, 255 * CELL_WEIGHT * frames]
    assert frames * CELL_WEIGHT > 1 << 28


@settings(max_examples=50, deadline=None)
@given(poses, st.sampled_from([0, AREA_SHIFT]))
def test_the_axes_are_equation_3(pose: Pose, shift: int) -> None:
    lattice = Lattice(0.25)
    column_i, column_j, row_i, row_j = universal_axes(SMALL, pose, lattice, shift)
    parts = 1 << shift
    assert column_i.shape == (SMALL.n_x * parts,)
    assert row_j.shape == (SMALL.n_y * parts,)
    x = -1.0 + (np.arange(SMALL.n_x * parts) + 0.5) * 0.1 / parts
    y = (np.arange(SMALL.n_y * parts) + 0.5) * 0.1 / parts
    east, north = to_universal(x[None, :], y[:, None], pose)
    assert column_i[None, :] + row_i[:, None] == pytest.approx(east / 0.25, abs=1e-7)
    assert column_j[None, :] + row_j[:, None] == pytest.approx(north / 0.25, abs=1e-7)


@settings(deadline=None, max_examples=60)
@given(poses, st.sampled_from(list(Transfer)), st.sampled_from([0.1, 0.23, 0.5]))
def test_no_weight_is_lost_in_the_footprint(pose: Pose, rule: Transfer, cell_m: float) -> None:
    grid = random_grid(SMALL, 7)
    lattice = Lattice(cell_m)
    fold = MeanFold(lattice, footprint(SMALL, pose, lattice), rule)
    fold.add(grid, pose)
    assert fold.sums[0].sum() == CELL_WEIGHT * grid.observed.sum()
    assert fold.sums[1].sum() == CELL_WEIGHT * grid.density[grid.observed].astype(int).sum()


@settings(deadline=None, max_examples=30)
@given(poses, st.sampled_from(list(Transfer)), st.integers(-25, 25), st.integers(-25, 25))
def test_a_crop_is_a_part_of_the_whole(pose: Pose, rule: Transfer, di: int, dj: int) -> None:
    lattice, grid = Lattice(0.1), random_grid(SMALL, 3)
    whole = footprint(SMALL, pose, lattice)
    part = Window(whole.i0 + di, whole.j0 + dj, 20, 20).intersect(whole)
    if part is None:
        return
    folds = MeanFold(lattice, whole, rule), MeanFold(lattice, part, rule)
    for fold in folds:
        fold.add(grid, pose)
    assert np.array_equal(folds[0].sums[(slice(None), *whole.slices_of(part))], folds[1].sums)


# --- how values meet


@settings(deadline=None, max_examples=25)
@given(
    st.permutations(range(6)),
    st.sampled_from(list(Transfer)),
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1), headings), min_size=6, max_size=6),
)
def test_the_mean_does_not_depend_on_the_order(
    order: list[int], rule: Transfer, places: list[tuple[float, float, float]]
) -> None:
    frames = [(random_grid(SMALL, k), pose_at(*place)) for k, place in enumerate(places)]
    lattice, window = Lattice(0.25), Window(-20, -20, 40, 40)
    results = []
    for indices in (range(6), order):
        fold = MeanFold(lattice, window, rule)
        for k in indices:
            fold.add(*frames[k])
        results.append((fold.sums.tobytes(), *(a.tobytes() for a in fold.density())))
    assert results[0] == results[1]


@given(
    st.lists(
        st.tuples(st.integers(1, 10_000), st.integers(0, 255), st.integers(0, 255)),
        min_size=1,
        max_size=20,
    )
)
def test_the_mean_is_exact_and_rounds_half_up(cells: list[tuple[int, int, int]]) -> None:
    # `n` observations of a and one of b.
    weight = np.array([n + 1 for n, _, _ in cells], dtype=np.uint64)
    total = np.array([n * a + b for n, a, b in cells], dtype=np.uint64)
    value, observed = mean_density(weight, total)
    assert observed.all()
    for found, (n, a, b) in zip(value.tolist(), cells, strict=True):
        assert found == math.floor(Fraction(n * a + b, n + 1) + Fraction(1, 2))


def test_a_cell_without_weight_is_unseen_and_a_zero_is_seen() -> None:
    value, observed = mean_density(np.array([0, 5, 2], np.uint64), np.array([0, 0, 5], np.uint64))
    assert value.tolist() == [0, 0, 3]
    assert observed.tolist() == [False, True, True]


ONE_CELL = GridSpec(1.0, 1.0, 1.0)


def fold_values(fold: MeanFold | PaperFold, values: list[int]) -> int:
    for value in values:
        fold.add(filled(ONE_CELL, value), pose_at(0.5, 0.0, 0.0))
    density, observed = fold.density()
    assert observed.tolist() == [[True]]
    return int(density[0, 0])


@pytest.mark.parametrize(
    ("values", "paper"),
    [([10, 20, 40], 28), ([40, 20, 10], 20), ([20, 40, 10], 20), ([10, 40, 20], 23), ([7], 7)],
)
def test_the_paper_averages_old_and_new_in_order(values: list[int], paper: int) -> None:
    """((10 + 20)/2 + 40)/2 = 27.5, but ((40 + 20)/2 + 10)/2 = 20; the mean is 23.3."""
    lattice, window = Lattice(1.0), Window(0, 0, 1, 1)
    assert fold_values(PaperFold(lattice, window), values) == paper
    mean = fold_values(MeanFold(lattice, window), values)
    assert mean == round(sum(values) / len(values))


def test_all_orders_agree_on_the_mean_alone() -> None:
    lattice, window = Lattice(1.0), Window(0, 0, 1, 1)
    orders = [list(order) for order in itertools.permutations([0, 90, 255, 60])]
    assert len({fold_values(MeanFold(lattice, window), order) for order in orders}) == 1
    assert len({fold_values(PaperFold(lattice, window), order) for order in orders}) > 5


def test_the_paper_rule_meets_the_cells_of_one_grid_row_by_row() -> None:
    spec = GridSpec(2.0, 2.0, 1.0)
    grid = LocalGrid(spec, np.array([[8, 16], [64, 32]], np.uint8), np.ones((2, 2), bool))
    fold = PaperFold(Lattice(2.0), Window(0, 0, 1, 1))
    fold.add(grid, pose_at(1.0, 0.0, 0.0))
    assert fold.value[0, 0] == (((8 + 16) / 2 + 64) / 2 + 32) / 2


def test_unseen_cells_leave_no_trace() -> None:
    grid = LocalGrid(ONE_CELL, np.full((1, 1), 200, np.uint8), np.zeros((1, 1), bool))
    for fold in (MeanFold(Lattice(1.0), Window(0, 0, 1, 1)),
                 PaperFold(Lattice(1.0), Window(0, 0, 1, 1))):  # fmt: skip
        fold.add(grid, pose_at(0.5, 0.0, 0.0))
        value, observed = fold.density()
        assert not observed.any()
        assert not value.any()


def test_ten_observations_keep_what_the_paper_rule_loses() -> None:
    """A mean of ten leaves 20/sqrt(10) = 6.3 of an error of 20; the pairwise average 11.7."""
    rng = np.random.default_rng(5)
    spec, lattice, window = GridSpec(40.0, 40.0, 1.0), Lattice(1.0), Window(0, 0, 40, 40)
    mean, paper = MeanFold(lattice, window), PaperFold(lattice, window)
    for _ in range(10):
        noisy = np.clip(np.rint(rng.normal(128.0, 20.0, spec.shape)), 0, 255).astype(np.uint8)
        for fold in (mean, paper):
            fold.add(LocalGrid(spec, noisy, np.ones(spec.shape, bool)), pose_at(20.0, 0.0, 0.0))
    assert np.std(mean.density()[0]) == pytest.approx(6.3, abs=0.4)
    assert np.std(paper.density()[0]) == pytest.approx(11.7, abs=0.6)


# --- holes


def hole_share(heading_deg: float, universal_m: float, rule: Transfer) -> float:
    """Share of the cells well inside a full local grid that get nothing."""
    spec, lattice = GridSpec(6.0, 8.0, 0.05), Lattice(universal_m)
    pose = pose_at(123.456, -78.9, heading_deg)
    window = footprint(spec, pose, lattice)
    fold = MeanFold(lattice, window, rule)
    fold.add(filled(spec, 50), pose)
    _, observed = fold.density()
    inside = inner_cells(spec, pose, lattice, window)
    assert inside.sum() > 4000
    return 1.0 - float(observed[inside].mean())


def inner_cells(
    spec: GridSpec, pose: Pose, lattice: Lattice, window: Window
) -> npt.NDArray[np.bool_]:
    """The universal cells at least two cells inside the outline of a local grid."""
    east, north = lattice.centres(window)
    offset = (east[None, :] - pose.east_m) + 1j * (north[:, None] - pose.north_m)
    body = offset / np.exp(1j * math.radians(90.0 - pose.heading_deg))  # real: forward, imag: left
    margin = 2.0 * lattice.cell_m
    return (
        (body.real > margin)
        & (body.real < spec.length_m - margin)
        & (np.abs(body.imag) < spec.width_m / 2.0 - margin)
    )


@settings(deadline=None, max_examples=30)
@given(headings)
def test_an_area_transfer_leaves_no_holes(heading: float) -> None:
    assert hole_share(heading, 0.05, Transfer.AREA) == 0.0


@settings(deadline=None, max_examples=30)
@given(headings)
def test_centres_leave_no_holes_in_cells_root_two_larger(heading: float) -> None:
    assert hole_share(heading, 0.05 * math.sqrt(2.0) * 1.0001, Transfer.CENTRE) == 0.0


@pytest.mark.parametrize(
    ("heading", "low", "high"), [(0, 0, 0), (10, 0.015, 0.035), (20, 0.06, 0.10), (45, 0.14, 0.20)]
)
def test_centres_leave_holes_in_cells_of_the_same_size(
    heading: float, low: float, high: float
) -> None:
    assert low <= hole_share(heading, 0.05, Transfer.CENTRE) <= high


# --- sizes


@pytest.mark.parametrize("fold", [MeanFold, PaperFold])
def test_universal_cells_finer_than_the_local_ones_are_refused(
    fold: type[MeanFold] | type[PaperFold],
) -> None:
    with pytest.raises(ConfigError, match=r"0\.05 m are smaller than the local cells of 0\.1 m"):
        fold(Lattice(0.05), Window(0, 0, 9, 9)).add(filled(SMALL, 1), pose_at(0.0, 0.0, 0.0))


def test_equal_cells_are_accepted() -> None:
    check_cell_sizes(0.05, 0.05)
    check_cell_sizes(0.1 + 0.2, 0.3)
    check_cell_sizes(0.3, 0.1 + 0.2)


def corners(spec: GridSpec, pose: Pose) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    half = spec.width_m / 2.0
    return to_universal([-half, half, -half, half], [0.0, 0.0, *[spec.length_m] * 2], pose)


@given(poses, st.sampled_from([0.05, 0.25, 1.0]))
def test_the_footprint_holds_the_corners_and_little_more(pose: Pose, cell_m: float) -> None:
    lattice = Lattice(cell_m)
    bounds = lattice.bounds(footprint(PAPER, pose, lattice))
    east, north = corners(PAPER, pose)
    assert bounds.west_m <= east.min()
    assert bounds.east_m >= east.max()
    assert bounds.south_m <= north.min()
    assert bounds.north_m >= north.max()
    assert bounds.east_m - bounds.west_m <= np.ptp(east) + 4.1 * cell_m
    assert bounds.north_m - bounds.south_m <= np.ptp(north) + 4.1 * cell_m


@settings(deadline=None, max_examples=40)
@given(
    st.integers(-400, 400),
    st.integers(-400, 400),
    st.sampled_from([0.0, 90.0, 180.0, -90.0, 45.0]),
    st.integers(-3, 3),
    st.sampled_from(["mean", "paper"]),
)
def test_a_centre_on_a_cell_s_edge_falls_alike_in_every_window(
    half_east: int, half_north: int, heading_deg: float, shift: int, rule: str
) -> None:
    """Poses on half cells put centres exactly on edges, where rounding alone decides."""
    lattice, grid = Lattice(0.1), random_grid(SMALL, 3)
    pose = Pose(0, half_east * 0.05, half_north * 0.05, 0.0, heading_deg, 0.0, 0.0, 0.0)
    whole = footprint(SMALL, pose, lattice)
    part = Window(whole.i0 + 5 + shift, whole.j0 + 7, whole.width - 11, whole.height - 9)
    views = []
    for window in (whole, part):
        fold = MeanFold(lattice, window) if rule == "mean" else PaperFold(lattice, window)
        fold.add(grid, pose)
        views.append(fold.density())
    inside = whole.slices_of(part)
    assert np.array_equal(views[0][0][inside], views[1][0])
    assert np.array_equal(views[0][1][inside], views[1][1])
