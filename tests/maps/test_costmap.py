from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from fieldgrid import CostCurve, Costmap
from fieldgrid.core import ConfigError
from fieldgrid.geometry import Bounds, Lattice, Window
from fieldgrid.maps import LETHAL, MapFile, MapView, Mark, MarkKind, costmap, open_map
from fieldgrid.maps.costmap import MAX_CELLS
from fieldgrid.maps.views import blocks
from tests.export.asymmetric import (
    COARSE_M,
    DATUM,
    EXTENT,
    F_BOXES,
    geodetic,
    probes,
    truth,
    write_asymmetric_map,
)

CELL_M = 0.25
DENSITIES = st.sampled_from([0, 50, 51, 75, 100, 101, 255])


def view_of(density: npt.ArrayLike, observed: npt.ArrayLike, i0: int = -3, j0: int = 2) -> MapView:
    cells = np.array(density, dtype=np.uint8)
    seen = np.array(observed, dtype=np.bool_)
    window = Window(i0, j0, cells.shape[1], cells.shape[0])
    cells = np.where(seen, cells, 0).astype(np.uint8)
    return MapView(Lattice(CELL_M), window, cells, seen, DATUM, is_base=True)


@st.composite
def views(draw: st.DrawFn) -> MapView:
    shape = draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    density = draw(arrays.arrays(np.uint8, shape, elements=DENSITIES))
    observed = draw(arrays.arrays(np.bool_, shape))
    return view_of(density, observed, draw(st.integers(-12, 4)), draw(st.integers(-12, 4)))


def centres(view: MapView) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    east, north = view.lattice.centres(view.window)
    return east[None, :], north[:, None]


def nearest_m(cells: list[tuple[int, int]], j: int, i: int) -> float:
    """To the nearest of some cells, by looking at each."""
    return min((CELL_M * math.hypot(j - v, i - u) for v, u in cells), default=math.inf)


@given(views())
def test_distances_are_to_the_nearest_cell_of_the_kind(view: MapView) -> None:
    costmap = Costmap.from_view(view)
    rows, columns = view.window.shape
    every = [(j, i) for j in range(-1, rows + 1) for i in range(-1, columns + 1)]
    inside = {(j, i) for j, i in every if 0 <= j < rows and 0 <= i < columns}
    obstacles = [c for c in inside if view.observed[c] and view.density[c] > 100]
    # One ring of cells outside is as near as anything beyond it.
    unknown = [c for c in every if c not in inside or not view.observed[c]]
    clearance = costmap.clearance_m(*centres(view))
    to_unknown = costmap.unknown_m(*centres(view))
    for j, i in inside:
        assert clearance[j, i] == pytest.approx(nearest_m(obstacles, j, i), rel=1e-6)
        assert to_unknown[j, i] == pytest.approx(nearest_m(unknown, j, i), rel=1e-6)


def inflated(cost: int, distance_m: float, radius_m: float, reach_m: float, decay: float) -> int:
    """The rule of Nav2's inflation layer, for a known cell."""
    if cost >= 254 or distance_m > max(reach_m, radius_m) + 1e-6:
        return cost
    if 0 < distance_m <= radius_m + 1e-6:
        return max(cost, 253)
    return max(cost, int(252 * math.exp(-decay * (distance_m - radius_m))))


@given(views(), st.sampled_from([0.0, 0.25, 0.4, 0.75]), st.sampled_from([0.0, 0.5, 1.3]))
def test_costs_are_those_of_the_static_and_the_inflation_layer(
    view: MapView, radius_m: float, inflation_m: float
) -> None:
    plain = Costmap.from_view(view)
    costmap = Costmap.from_view(
        view, robot_radius_m=radius_m, inflation_m=inflation_m, decay_per_m=2.0
    )
    clearance = plain.clearance_m(*centres(view))
    np.testing.assert_array_equal(plain.costs, CostCurve().cost(view.density, view.observed))
    for cell, before in np.ndenumerate(plain.costs):
        if max(radius_m, inflation_m) < CELL_M:
            expected = int(before)
        else:
            expected = inflated(int(before), clearance[cell], radius_m, inflation_m, 2.0)
        assert costmap.costs[cell] == expected
    assert np.array_equal(costmap.costs == 255, ~view.observed)
    # OpenCV's distances differ in their last bit from call to call.
    np.testing.assert_allclose(costmap.clearance_m(*centres(view)), clearance, rtol=1e-6)


@given(views(), st.lists(st.tuples(st.floats(-6, 6), st.floats(-6, 6)), min_size=1))
def test_a_point_has_the_answer_of_the_cell_that_encloses_it(
    view: MapView, points: list[tuple[float, float]]
) -> None:
    costmap = Costmap.from_view(view)
    east, north = np.array(points).T
    answer = costmap.at(east, north)
    for k, (e, n) in enumerate(points):
        i, j = math.floor(e / CELL_M) - view.window.i0, math.floor(n / CELL_M) - view.window.j0
        if not (0 <= i < view.window.width and 0 <= j < view.window.height):
            assert (answer.cost[k], answer.unknown_m[k], answer.known[k]) == (255, 0.0, False)
            assert math.isnan(answer.clearance_m[k])
            continue
        assert answer.cost[k] == costmap.costs[j, i]
        assert answer.known[k] == view.observed[j, i]
        # The promise: the true distance to the nearest obstacle is not far below the answer.
        v, u = np.nonzero(view.observed & (view.density > 100))
        low_e, low_n = (u + view.window.i0) * CELL_M, (v + view.window.j0) * CELL_M
        away_e = np.maximum(np.maximum(low_e - e, e - low_e - CELL_M), 0)
        away_n = np.maximum(np.maximum(low_n - n, n - low_n - CELL_M), 0)
        true_m = np.hypot(away_e, away_n).min(initial=math.inf)
        assert answer.clearance_m[k] - math.sqrt(2) * CELL_M - 1e-5 <= true_m
        assert true_m <= answer.clearance_m[k] + 1e-5


@settings(max_examples=20)
@given(views())
def test_all_answers_at_once_are_those_of_each_question(view: MapView) -> None:
    costmap = Costmap.from_view(view, inflation_m=0.5)
    east, north = np.linspace(-5.0, 5.0, 37)[None, :], np.linspace(-5.0, 5.0, 31)[:, None]
    answer = costmap.at(east, north)
    assert answer.cost.shape == (31, 37)
    assert answer.cost.dtype == np.uint8
    np.testing.assert_array_equal(answer.cost, costmap.cost(east, north))
    np.testing.assert_array_equal(answer.clearance_m, costmap.clearance_m(east, north))
    np.testing.assert_array_equal(answer.unknown_m, costmap.unknown_m(east, north))
    np.testing.assert_array_equal(answer.known, costmap.is_known(east, north))


def test_points_that_are_nowhere_are_unknown() -> None:
    costmap = Costmap.from_view(view_of([[255, 0]], [[True, True]]))
    east = np.array([math.nan, math.inf, -math.inf, 1e300, -0.7])
    north = np.array([0.6, 0.6, 0.6, 0.6, math.nan])
    assert costmap.cost(east, north).tolist() == [255] * 5
    assert np.isnan(costmap.clearance_m(east, north)).all()
    assert costmap.unknown_m(east, north).tolist() == [0.0] * 5


def test_one_point_is_answered_too() -> None:
    costmap = Costmap.from_view(view_of([[255, 0, 0]], [[True, True, True]]))
    assert costmap.cost(-0.7, 0.6) == 254
    assert costmap.clearance_m(-0.1, 0.6) == 0.5
    assert bool(costmap.is_known(-0.1, 0.6))
    assert costmap.clearance_m(0.1, 0.6) != costmap.clearance_m(0.1, 0.6)  # outside: NaN


def test_without_an_obstacle_the_way_to_one_is_endless() -> None:
    costmap = Costmap.from_view(view_of([[0, 75]], [[True, True]]), inflation_m=10.0)
    assert costmap.clearance_m(-0.6, 0.6) == math.inf
    assert costmap.costs.tolist() == [[0, 124]]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@pytest.mark.parametrize("cell_m", [None, COARSE_M])
def test_the_costs_of_a_map_are_where_they_belong(universal: MapFile, cell_m: float | None) -> None:
    costmap = Costmap.from_map(universal, cell_m=cell_m)
    assert tuple(costmap.bounds) == pytest.approx(tuple(EXTENT))
    east, north = probes()
    true = truth(east, north)
    cost = costmap.cost(east, north)
    np.testing.assert_array_equal(cost == 255, ~true.observed)
    np.testing.assert_array_equal(cost == 254, true.density > 100)
    np.testing.assert_array_equal(cost == 0, true.observed & (true.density <= 50))
    lat, lon, _ = geodetic(east, north)
    answer = costmap.at_latlon(lat, lon)
    np.testing.assert_array_equal(answer.cost, cost)
    np.testing.assert_array_equal(answer.clearance_m, costmap.clearance_m(east, north))
    lat, lon, height = geodetic(east, north, 35.0)
    np.testing.assert_array_equal(costmap.at_latlon(lat, lon, height).cost, cost)


def test_clearance_of_the_f_is_its_distance(universal: MapFile) -> None:
    costmap = Costmap.from_map(universal, Bounds(-9.0, -4.0, 4.0, 9.0))
    random = np.random.default_rng(3)
    east, north = random.uniform(-8.9, 3.9, 500), random.uniform(-3.9, 8.9, 500)
    away = [
        np.hypot(
            np.maximum(np.maximum(box.west_m - east, east - box.east_m), 0.0),
            np.maximum(np.maximum(box.south_m - north, north - box.north_m), 0.0),
        )
        for box in F_BOXES
    ]
    true_m = np.min(away, axis=0)
    found_m = costmap.clearance_m(east, north)
    assert np.all(found_m >= true_m - 1e-6)
    assert np.all(found_m <= true_m + math.sqrt(2) * 0.05 + 1e-6)


def test_a_curve_and_a_moment_are_taken(universal: MapFile) -> None:
    # The disputed patch: 40 in spring, 120 in the mean.
    assert Costmap.from_map(universal).cost(9.5, -5.5) == 254
    assert Costmap.from_map(universal, at="spring").cost(9.5, -5.5) == 0
    mild = Costmap.from_map(universal, curve=CostCurve(120, 200))
    assert mild.cost(9.5, -5.5) == 0


def test_a_costmap_that_would_not_fit_is_refused() -> None:
    side = math.isqrt(MAX_CELLS) + 1
    flat = np.broadcast_to(np.uint8(0), (side, side))
    seen = np.broadcast_to(np.True_, (side, side))
    view = MapView(Lattice(CELL_M), Window(0, 0, side, side), flat, seen, DATUM)
    with pytest.raises(ConfigError, match="smaller bounds or a larger cell"):
        Costmap.from_view(view)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot_radius_m": -1.0}, "robot's radius of -1.0 m"),
        ({"inflation_m": math.inf}, "inflation of inf m"),
        ({"decay_per_m": 0.0}, "decay of 0.0"),
    ],
)
def test_settings_that_cannot_be_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Costmap.from_view(view_of([[0]], [[True]]), **options)


def test_a_distance_that_equals_the_radius_is_within_it() -> None:
    cells = np.zeros((1, 60), dtype=np.uint8)
    cells[0, 0] = 255
    seen = np.ones(cells.shape, dtype=np.bool_)
    view = MapView(Lattice(0.01), Window(0, 0, 60, 1), cells, seen, DATUM, is_base=True)
    assert 0.57 / 0.01 < 57.0  # by rounding only
    costs = Costmap.from_view(view, robot_radius_m=0.57).costs[0]
    assert costs[56:].tolist() == [253, 253, 0, 0]


def test_far_from_the_datum_the_height_of_a_point_matters() -> None:
    """20 km away the radii of two heights that are 3 km apart are 9.4 m apart."""
    costmap = Costmap.from_view(view_of([[255, 0]], [[True, True]], i0=80_000, j0=0))
    lat, lon, height = geodetic(20_000.1, 0.1, 3000.0)
    assert costmap.at_latlon(lat, lon, height).cost == 254
    assert costmap.at_latlon(lat, lon).cost == 255


def test_marks_count_and_are_evidence_of_nothing(tmp_path: Path) -> None:
    """A keep-out costs as an obstacle does, and a correction takes its place, at any cell size."""
    path = write_asymmetric_map(tmp_path / "f.gpkg")
    with open_map(path, writable=True) as universal:
        plain = Costmap.from_map(universal)
        cells = np.argwhere(plain.costs == LETHAL)
        j, i = cells[len(cells) // 2]
        east, north = plain.lattice.centres(plain.window)
        half = 2.0 * universal.cell_m
        ring = [(-half, -half), (half, -half), (half, half), (-half, half)]

        def around(kind: MarkKind, e: float, n: float) -> Mark:
            return Mark(kind, tuple((e + a, n + b) for a, b in ring))

        bad = float(east[i]), float(north[j])
        j, i = np.argwhere(plain.costs == 0)[0]
        good = float(east[i]), float(north[j])
        universal.add_marks([around(MarkKind.FREE, *bad), around(MarkKind.KEEPOUT, *good)])
        for cell_m in (None, 3 * universal.cell_m):
            marked = Costmap.from_map(universal, cell_m=cell_m)
            assert marked.cost(*good) == LETHAL
            assert marked.clearance_m(*good) == 0.0
        assert Costmap.from_map(universal).cost(*bad) == 0
        universal.remove_marks([1, 2])
        np.testing.assert_array_equal(Costmap.from_map(universal).costs, plain.costs)


@pytest.mark.parametrize(
    ("times", "layer"),
    [
        (1, "density"),
        (3, "max"),
        pytest.param(1, "max", marks=pytest.mark.long),
        pytest.param(3, "density", marks=pytest.mark.long),
    ],
)
def test_the_costs_are_those_of_the_whole_however_it_is_cut(
    times: int, layer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_asymmetric_map(tmp_path / "f.gpkg")
    with open_map(path, writable=True) as universal:
        east_m, north_m = EXTENT.west_m + 1.3, EXTENT.south_m + 1.1
        ring = [(0.0, 0.0), (3.1, 0.4), (2.2, 2.9)]
        for kind, aside_m in ((MarkKind.FREE, 0.0), (MarkKind.KEEPOUT, 4.0)):
            rings = tuple((east_m + aside_m + a, north_m + b) for a, b in ring)
            universal.add_marks([Mark(kind, rings)])
        cell_m = times * universal.cell_m
        view = universal.read(cell_m=cell_m, decide=layer)
        whole = CostCurve().cost(*view.decision())
        monkeypatch.setattr(blocks, "_ROWS", 24)  # still less than the inflation reaches
        monkeypatch.setattr(blocks, "_COLUMNS", 32)
        monkeypatch.setattr(costmap, "_BLOCK_CELLS", 100)
        cut = Costmap.from_map(universal, cell_m=cell_m, layer=layer)
        np.testing.assert_array_equal(cut.costs, whole)
        assert len(np.unique(cut.costs)) > 2
        near = Costmap.from_map(universal, cell_m=cell_m, inflation_m=2.0, robot_radius_m=0.3)
        monkeypatch.undo()
        other = Costmap.from_map(universal, cell_m=cell_m, inflation_m=2.0, robot_radius_m=0.3)
        np.testing.assert_array_equal(near.costs, other.costs)


def test_distances_of_a_view_are_worked_out_when_they_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    density = np.full((40, 50), 10, np.uint8)
    density[20, 30] = 255
    view = view_of(density, np.ones(density.shape), i0=0, j0=0)
    made: list[npt.NDArray[np.float32]] = []
    cells = costmap._distance_cells

    def making(other: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
        made.append(cells(other))
        return made[-1]

    monkeypatch.setattr(costmap, "_distance_cells", making)
    found = Costmap.from_view(view)
    assert found.cost(30.5 * CELL_M, 20.5 * CELL_M) == LETHAL
    assert not made
    assert found.clearance_m(30.5 * CELL_M, 24.5 * CELL_M) == pytest.approx(4 * CELL_M)
    assert found.unknown_m(0.5 * CELL_M, 20.5 * CELL_M) == pytest.approx(CELL_M)
    found.at(1.0, 1.0)
    assert len(made) == 2
