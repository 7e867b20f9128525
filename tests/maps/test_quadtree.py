"""A map in squares: no cell is lost, none differs by more than was allowed, and none is better than
what the drives saw."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays

import fieldgrid as fg
from fieldgrid import Near, Quadtree
from fieldgrid.core import ConfigError
from fieldgrid.geometry import Bounds, Lattice, Window
from fieldgrid.maps import LETHAL, UNKNOWN_COST, MapView, Mark, MarkKind, State, open_map
from fieldgrid.maps.quadtree import split, tree
from fieldgrid.maps.views import blocks
from tests.export.asymmetric import COARSE_M, DATUM, write_asymmetric_map

CELL_M = 0.25
SIDES_M = tuple(CELL_M * 2.0**level for level in range(9))


def view_of(density: npt.ArrayLike, observed: npt.ArrayLike, i0: int = 0, j0: int = 0) -> MapView:
    seen = np.array(observed, dtype=np.bool_)
    cells = np.where(seen, density, 0).astype(np.uint8)
    window = Window(i0, j0, cells.shape[1], cells.shape[0])
    return MapView(Lattice(CELL_M), window, cells, seen, DATUM, is_base=True)


NOISE = (0.4, 0.5, 0.02, 0.0, 0.0, 0.08)

LOSSES = st.sampled_from([0.0, 1.0, 2.0, 3.0]) | st.floats(0.0, 4.0) | st.floats(0.0, 255.0)


@st.composite
def views(draw: st.DrawFn) -> MapView:
    """Patches of 4 x 4 cells that are much alike, with some odd cells and some unseen ones."""
    patches = draw(st.tuples(st.integers(1, 4), st.integers(1, 4)))
    shape = patches[0] * 4, patches[1] * 4
    base = draw(arrays.arrays(np.int64, patches, elements=st.sampled_from([0, 48, 60, 99, 200])))
    seen = draw(arrays.arrays(np.bool_, patches))
    noise = np.random.default_rng(draw(st.integers(0, 99))).choice(6, shape, p=NOISE)
    odd = draw(arrays.arrays(np.int64, shape, fill=st.just(0), elements=st.integers(0, 250)))
    holes = draw(arrays.arrays(np.bool_, shape, fill=st.just(False)))
    if draw(st.booleans()):
        odd, holes = np.zeros_like(odd), np.zeros_like(holes)
    density = np.clip(np.kron(base, np.ones((4, 4), np.int64)) + noise + odd, 0, 255)
    observed = np.kron(seen, np.ones((4, 4), np.bool_)) & ~holes
    height, width = draw(st.integers(1, shape[0])), draw(st.integers(1, shape[1]))
    i0, j0 = draw(st.integers(-9, 4)), draw(st.integers(-9, 4))
    return view_of(density[:height, :width], observed[:height, :width], i0, j0)


METRES = st.floats(-3.0, 4.0).map(lambda value: round(value, 3))

SIDES = st.sets(st.integers(1, 4)).map(lambda more: (0, *sorted(more)))


def states(view: MapView) -> npt.NDArray[np.int64]:
    """What each cell counts as, by the numbers of the documents."""
    known = np.where(view.density <= 50, State.FREE, State.DOUBT)
    known = np.where(view.density > 100, State.OBSTACLE, known)
    return np.where(view.observed, known, State.UNSEEN)


def cells_in(found: Quadtree, k: int, view: MapView) -> tuple[slice, slice]:
    """The slices of the cells of a square in the arrays of a view."""
    part = found.squares
    side = 1 << int(part.level[k])
    place = Window(int(part.column[k]), int(part.row[k]), side, side).intersect(view.window)
    assert place is not None
    return view.window.slices_of(place)


@given(views(), LOSSES, SIDES, st.sampled_from([1.0, 0.7]))
def test_squares_cover_every_known_cell_once_and_lose_no_more_than_allowed(
    view: MapView, loss: float, levels: tuple[int, ...], least_seen: float
) -> None:
    sides_m = [SIDES_M[level] for level in levels]
    found = Quadtree.from_view(view, loss=loss, sides_m=sides_m, least_seen=least_seen)
    covered, state = np.zeros(view.window.shape, int), states(view)
    for k in range(len(found)):
        place, side = cells_in(found, k, view), 1 << int(found.squares.level[k])
        covered[place] += 1
        seen, density = view.observed[place], view.density[place].astype(np.float64)
        mean = float(found.squares.mean[k])
        assert np.abs(density - mean)[seen].max() <= loss or side == 1
        assert mean == np.float32(density[seen].mean())
        assert found.squares.lowest[k] == density[seen].min()
        assert found.squares.highest[k] == density[seen].max()
        assert set(state[place][seen].tolist()) == {int(found.squares.state[k])}
        share = seen.sum() / side**2
        assert found.squares.seen_share[k] == np.float32(share)
        assert share >= least_seen or side == 1
    assert (covered[view.observed] == 1).all()
    assert covered.max(initial=0) <= 1
    if least_seen == 1.0:
        assert not covered[~view.observed].any()
    assert found.worst_loss <= loss
    assert {int(level) for level in found.squares.level} <= set(levels)


@given(views(), LOSSES, SIDES)
def test_a_square_is_as_large_as_it_may_be(
    view: MapView, loss: float, levels: tuple[int, ...]
) -> None:
    found = Quadtree.from_view(view, loss=loss, sides_m=[SIDES_M[level] for level in levels])
    state = states(view)
    part = found.squares
    for k in range(len(found)):
        for larger in [level for level in levels if level > part.level[k]]:
            side = 1 << larger
            whole = Window(
                int(part.column[k]) // side * side, int(part.row[k]) // side * side, side, side
            )
            inside = whole.intersect(view.window)
            assert inside is not None
            place = view.window.slices_of(inside)
            density = view.density[place]
            mean = np.float32(density.sum() / side**2)
            may_be = (
                inside == whole
                and view.observed[place].all()
                and len(set(state[place].ravel().tolist())) == 1
                and np.abs(density.astype(np.float64) - float(mean)).max() <= loss
            )
            assert not may_be


@given(views(), SIDES)
def test_points_find_the_square_that_encloses_them(view: MapView, levels: tuple[int, ...]) -> None:
    found = Quadtree.from_view(view, sides_m=[SIDES_M[level] for level in levels])
    east, north = view.lattice.centres(view.window.grown(3))
    at = found.at(east[None, :], north[:, None])
    np.testing.assert_array_equal(at[3:-3, 3:-3] >= 0, view.observed)
    at[3:-3, 3:-3] = -1
    assert (at == -1).all()
    at = found.at(east[None, :], north[:, None])
    if not len(found):
        return
    for edge, low, way in ((found.west_m, east[None, :], at), (found.south_m, north[:, None], at)):
        away = (low - edge[way])[way >= 0]
        assert ((away > 0.0) & (away < found.side_m[way][way >= 0])).all()
    np.testing.assert_array_equal(found.at([np.nan, 0.0, np.inf], [0.0, np.nan, 0.0]), [-1, -1, -1])
    order = list(zip(*(found.squares[:3]), strict=True))
    assert order == sorted(order)


def test_a_square_of_free_ground_is_one_and_an_obstacle_splits_it() -> None:
    density = np.full((256, 256), 10)
    alone = Quadtree.from_view(view_of(density, np.ones((256, 256)), -256, 256))
    assert (len(alone), alone.side_m[0]) == (1, 64.0)
    assert (alone.west_m[0], alone.south_m[0]) == (-64.0, 64.0)
    density[3, 7] = 130
    split_up = Quadtree.from_view(view_of(density, np.ones((256, 256)), -256, 256), loss=255.0)
    # Three squares are left of each side from 128 down to 1, and the cell.
    assert len(split_up) == 3 * 8 + 1
    (obstacle,) = np.flatnonzero(split_up.squares.state == State.OBSTACLE)
    assert split_up.side_m[obstacle] == CELL_M
    assert split_up.west_m[obstacle] == -64.0 + 7 * CELL_M
    assert split_up.south_m[obstacle] == 64.0 + 3 * CELL_M
    two = Quadtree.from_view(
        view_of(density, np.ones((256, 256)), -256, 256), loss=255.0, sides_m=(0.25, 8.0)
    )
    assert np.bincount(two.squares.level).tolist() == [32 * 32, 0, 0, 0, 0, 63]
    assert two.sides_m == (0.25, 8.0)


@pytest.mark.parametrize("odd", [10, 14])
def test_the_bound_holds_on_both_sides_of_the_mean_and_to_the_last_bit(odd: int) -> None:
    density = np.full((4, 4), 12)
    density[1, 2] = odd
    view = view_of(density, np.ones((4, 4)))
    mean = np.float32(density.mean())
    away = abs(odd - float(mean))
    assert len(Quadtree.from_view(view, loss=away)) == 1
    found = Quadtree.from_view(view, loss=np.nextafter(away, 0.0))
    assert len(found) > 1
    assert Quadtree.from_view(view, loss=away).worst_loss == away


def test_what_is_in_doubt_is_neither_free_nor_an_obstacle() -> None:
    density = np.array([[50, 51], [100, 101]])
    found = Quadtree.from_view(view_of(density, np.ones((2, 2))), loss=255.0)
    assert found.squares.state.tolist() == [1, 2, 2, 3]
    easy = fg.CostCurve(free_up_to=100, obstacle_above=200)
    found = Quadtree.from_view(view_of(density, np.ones((2, 2))), loss=255.0, curve=easy)
    assert found.squares.state.tolist() == [1, 1, 1, 2]


@given(views(), st.floats(0.0, 3.0), st.lists(st.tuples(METRES, METRES), min_size=1))
def test_squares_near_a_line_are_cells(
    view: MapView, within_m: float, line: list[tuple[float, float]]
) -> None:
    import shapely

    near = Near(line if len(line) > 1 else line[0], within_m)
    found = Quadtree.from_view(view, near=near, loss=255.0)
    shape = shapely.LineString(line) if len(line) > 1 else shapely.Point(line[0])
    east, north = (one.ravel() for one in np.meshgrid(*view.lattice.centres(view.window)))
    distance_m = shapely.distance(shape, shapely.points(east, north))
    at = found.at(east, north)
    close = (distance_m < within_m - 1e-9) & (at >= 0)
    assert (found.squares.level[at[close]] == 0).all()
    # A square that is larger than it would be away from the line holds no cell near it.
    plain = Quadtree.from_view(view, loss=255.0)
    whole = plain.at(east, north)
    for k in np.unique(whole[whole >= 0]):
        if (distance_m[whole == k] > within_m + 1e-9).all():
            assert len(np.unique(at[whole == k])) == 1


def test_segments_far_from_a_window_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, window = [], Lattice.window

    def counted(lattice: Lattice, bounds: Bounds) -> Window:
        asked.append(bounds)
        return window(lattice, bounds)

    monkeypatch.setattr(Lattice, "window", counted)
    line = np.c_[np.arange(-50.0, 50.0), np.full(100, 0.5)]
    view = view_of(np.zeros((8, 8)), np.ones((8, 8)))
    found = Quadtree.from_view(view, near=Near(line, 0.3))
    assert len(asked) == 4  # from -1 to 3 m: two over the window, and one that ends at each side
    assert (found.squares.level[found.at([0.1, 1.9], [0.6, 0.6])] == 0).all()


def test_larger_cells_of_which_too_little_was_seen_count_as_not_seen() -> None:
    layers = {
        "peak": np.zeros((2, 2), dtype=np.uint8),
        "seen_share": np.array([[1.0, 1.0], [1.0, 0.4]], dtype=np.float32),
    }
    view = view_of(np.zeros((2, 2)), np.ones((2, 2)))
    view = dataclasses.replace(view, layers=layers, is_base=False)
    found = Quadtree.from_view(view)
    assert found.squares.state.tolist() == [1, 1, 1, 0]
    assert found.squares.seen_share.tolist() == [1.0, 1.0, 1.0, 0.0]
    assert len(Quadtree.from_view(view, least_seen=0.8)) == 4
    whole = Quadtree.from_view(view, least_seen=0.75)
    assert whole.squares.seen_share.tolist() == [0.75]


def test_ground_that_falls_away_is_an_obstacle_and_beyond_it_nothing_is_known() -> None:
    layers = {
        "drop": np.array([[0.0, 0.2], [0.0, 0.0]], dtype=np.float32),
        "sure_share": np.array([[1.0, 1.0], [0.0, 1.0]], dtype=np.float32),
    }
    view = dataclasses.replace(view_of(np.zeros((2, 2)), np.ones((2, 2))), layers=layers)
    found = Quadtree.from_view(view)
    assert found.squares.state.tolist() == [1, 3, 0, 1]
    assert found.squares.seen_share.tolist() == [1.0, 1.0, 0.0, 1.0]
    assert found.squares.mean.tolist() == [0.0] * 4
    deep = Quadtree.from_view(view, curve=fg.CostCurve(least_drop_m=0.3), least_seen=0.75)
    assert (deep.squares.level.tolist(), deep.squares.state.tolist()) == ([1], [1])


@pytest.mark.parametrize("kind", [MarkKind.KEEPOUT, MarkKind.OBSTACLE, MarkKind.FREE])
def test_what_people_said_is_known_wherever_it_is(kind: MarkKind) -> None:
    outline = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    seen = np.zeros((4, 8))
    seen[:, 4:] = 1
    view = dataclasses.replace(view_of(np.zeros((4, 8)), seen), marks=(Mark(kind, outline),))
    found = Quadtree.from_view(view)
    assert found.squares.level.tolist() == [2, 2]
    wanted = State.FREE if kind is MarkKind.FREE else State.OBSTACLE
    assert found.squares.state.tolist() == [wanted, State.FREE]
    assert np.isnan(found.squares.mean[0])
    assert found.squares.seen_share.tolist() == [1.0, 1.0]
    assert found.worst_loss == 0.0


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> fg.Farm | Any:
    path = tmp_path_factory.mktemp("map") / "m.gpkg"
    write_asymmetric_map(path)
    return open_map(path)


@pytest.mark.parametrize("cell_m", [None, COARSE_M])
def test_a_map_block_by_block_gives_the_squares_of_a_view_of_it(
    universal: Any, cell_m: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Quadtree.from_map(universal, cell_m=cell_m, loss=40.0)
    monkeypatch.setattr(blocks, "_ROWS", 256)
    monkeypatch.setattr(blocks, "_COLUMNS", 256)
    monkeypatch.setattr(split, "_CHUNK_CELLS", 256)
    cut = Quadtree.from_map(universal, cell_m=cell_m, loss=40.0)
    view = universal.read(cell_m=cell_m, decide="density")
    from_view = Quadtree.from_view(view, loss=40.0)
    for one, other, third in zip(whole.squares, cut.squares, from_view.squares, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(one, third)
    assert len(whole) > 10
    assert (whole.squares.level > 0).any()


@pytest.mark.parametrize("cell_m", [None, COARSE_M])
@pytest.mark.parametrize("least_seen", [1.0, 0.5])
def test_no_square_is_better_than_its_cells(
    universal: Any, cell_m: float | None, least_seen: float
) -> None:
    found = Quadtree.from_map(universal, cell_m=cell_m, loss=255.0, least_seen=least_seen)
    view = universal.read(cell_m=cell_m, decide="density")
    cost = fg.CostCurve(least_seen=1.0).cost(*view.decision())
    east, north = view.lattice.centres(view.window)
    at = found.at(east[None, :], north[:, None])
    state = np.where(at >= 0, found.squares.state[at], State.UNSEEN)
    np.testing.assert_array_equal(state[cost == LETHAL], State.OBSTACLE)
    assert (state[(cost > 0) & (cost < LETHAL)] == State.DOUBT).all()
    if cell_m is None and least_seen == 1.0:
        assert (state[cost == UNKNOWN_COST] == State.UNSEEN).all()


def test_squares_cover_the_bounds_and_no_square_more(universal: Any) -> None:
    west_m, south_m, east_m, north_m = universal.bounds
    bounds = Bounds(west_m + 0.3, south_m + 0.3, east_m - 0.3, north_m - 0.3)
    found = Quadtree.from_map(universal, bounds, sides_m=(universal.cell_m, universal.cell_m * 4))
    assert found.window.i0 % 4 == found.window.j0 % 4 == 0
    assert found.window.width % 4 == found.window.height % 4 == 0
    asked = found.lattice.window(bounds)
    assert found.window.intersect(asked) == asked
    assert found.window.width < asked.width + 8
    whole = Quadtree.from_map(universal, sides_m=found.sides_m)
    inside = np.isin(whole.at(found.west_m + 1e-6, found.south_m + 1e-6), np.arange(len(whole)))
    assert inside.all()


def test_a_map_of_a_moment_and_of_another_layer(universal: Any) -> None:
    first = universal.sessions()[0].name
    early = Quadtree.from_map(universal, at=first)
    view = universal.read(at=first)
    east, north = view.lattice.centres(view.window)
    assert (early.at(east[None, :], north[:, None]) >= 0)[view.observed].all()
    highest = Quadtree.from_map(universal, layer="max")
    assert highest.squares.highest.max() == universal.read(layers=("max",)).layer("max").max()


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        ({"loss": -1.0}, r"A loss of -1.0 is outside 0..255"),
        ({"loss": float("nan")}, "A loss of nan"),
        ({"least_seen": 0.0}, "A least share seen of 0.0 is not above 0"),
        ({"least_seen": 1.1}, "A least share seen of 1.1"),
        ({"sides_m": (0.25, 0.6)}, r"A side of 0.6 m is not 1, 2, 4, ... 256 cells of 0.25 m; "
                                   "the nearest is 0.5"),
        ({"sides_m": (0.25, -1.0)}, "the nearest is 0.25"),
        ({"sides_m": (0.25, 128.0)}, "the nearest is 64"),
        ({"sides_m": (0.5, 1.0)}, "do not rise from that of the cells; begin with 0.25"),
        ({"sides_m": (0.25, 1.0, 0.5)}, "do not rise"),
        ({"sides_m": ()}, "begin with 0.25"),
        ({"near": Near([], 1.0)}, "give finite points"),
        ({"near": Near([0.0, np.nan], 1.0)}, "give finite points"),
        ({"near": Near([0.0, 0.0], -1.0)}, "Squares cannot be small within -1.0 m"),
        ({"near": Near([0.0, 0.0], 1e308)}, r"within 1e\+308 m; give 0 to 50000"),
        ({"near": Near([0.0, -1e308], 1.0)}, r"goes 1e\+308 m from the datum"),
    ],
)  # fmt: skip
def test_what_cannot_be_asked(given_: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Quadtree.from_view(view_of(np.zeros((2, 2)), np.ones((2, 2))), **given_)


def test_layers_without_a_density_and_too_many_squares(
    universal: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match="'count' holds no density, so it makes no squares"):
        Quadtree.from_map(universal, layer="count")
    monkeypatch.setattr(tree, "MAX_SQUARES", 10)
    with pytest.raises(ConfigError, match="give smaller bounds, a larger cell or a larger loss"):
        Quadtree.from_map(universal)


def test_a_view_of_nothing_has_no_squares(tmp_path: Path) -> None:
    found = Quadtree.from_view(view_of(np.zeros((3, 3)), np.zeros((3, 3))))
    assert len(found) == 0
    assert found.worst_loss == 0.0
    assert found.at(0.1, 0.1) == -1
