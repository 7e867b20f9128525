"""Layers, changes and provenance against sums over each frame by itself."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Bounds, Lattice, LocalGrid, Pose, Status
from fieldgrid.maps import (
    LAYERS,
    MEANING,
    Averaging,
    Change,
    MapFile,
    Transfer,
    mean_density,
    open_map,
)
from fieldgrid.maps.transfer import MeanFold
from fieldgrid.maps.views import content
from fieldgrid.maps.writing import placing
from tests.maps.file.maps import CELL_M, Frame, drive, grid_of, one_cell, pose_at, write_map

DAY_NS = 86_400_000_000_000


def later(frames: list[Frame], days: int) -> list[Frame]:
    """The same drive, some days after 2026-06-01."""
    start = 1_780_272_000_000_000_000 + days * DAY_NS
    return [
        (
            grid,
            Pose(
                start + pose.time_ns, pose.east_m, pose.north_m, pose.up_m, pose.heading_deg,
                pose.position_sigma_m, pose.heading_sigma_deg, pose.speed_mps,
            ),
        )
        for grid, pose in frames
    ]  # fmt: skip


FIELD = [
    later(drive(6, step_m=0.713), 3),
    later(drive(5, heading_deg=-61.0, start=1), 0),
    later(drive(6, step_m=0.5, start=3), 9),
]
"""Sessions "0", "1", "2", driven in the order 1, 0, 2: on the 4th, the 1st and the 10th."""


@pytest.fixture(scope="module", params=[(), ("all",)], ids=["core", "all"])
def path(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """A map whose tiles hold the core, and one whose tiles hold all layers."""
    return write_map(tmp_path_factory.mktemp("map") / "map.gpkg", FIELD, layers=request.param)


def brute_force(
    universal: MapFile, cell_m: float, transfer: Transfer, names: list[int]
) -> dict[str, np.ndarray]:
    """Every layer, from a fold of each frame by itself."""
    lattice = Lattice(cell_m)
    window = lattice.window(universal.bounds)
    shape = window.shape
    weight, total, squares = (np.zeros(shape) for _ in range(3))
    count, highest, sessions, obstacle = (np.zeros(shape, dtype=np.int64) for _ in range(4))
    for name in names:
        session = np.zeros((2, *shape), dtype=np.uint64)
        for grid, pose in FIELD[name]:
            alone = MeanFold(lattice, window, transfer)
            alone.add(grid, pose)
            session += alone.sums
            count += alone.sums[0] > 0
            # One value at a time: a cell's values cannot be told from their sum.
            for value in np.unique(grid.density[grid.observed]):
                only = MeanFold(lattice, window, transfer)
                seen = grid.observed & (grid.density == value)
                only.add(LocalGrid(grid.spec, grid.density, seen), pose)
                squares += only.sums[0] * float(value) ** 2
                highest = np.where(only.sums[0] > 0, np.maximum(highest, value), highest)
        weight += session[0]
        total += session[1]
        density, observed = mean_density(*session)
        sessions += observed
        obstacle += observed & (density > 100)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / weight
        return {
            "density": np.floor(np.nan_to_num(mean) + 0.5),
            "count": count,
            "variance": squares / weight - mean**2,
            "max": highest,
            "sessions": sessions,
            "persistence": obstacle / sessions,
        }


@pytest.mark.parametrize(
    ("cell_m", "transfer", "names"),
    [
        (CELL_M, Transfer.CENTRE, [0, 1, 2]),
        (CELL_M, Transfer.CENTRE, [1, 2]),
        (0.23, Transfer.AREA, [0, 1, 2]),
    ],
)
def test_every_layer_is_what_the_frames_say(
    path: Path, cell_m: float, transfer: Transfer, names: list[int]
) -> None:
    with open_map(path) as universal:
        view = universal.read(
            cell_m=cell_m, transfer=transfer, layers=LAYERS, sessions=[str(n) for n in names]
        )
        expected = brute_force(universal, cell_m, transfer, names)
    np.testing.assert_array_equal(view.observed, expected["count"] > 0)
    if cell_m != CELL_M:  # the highest of what is in them: tests.maps.file.test_base_cells
        for name in ("count", "max", "sessions"):
            del expected[name]
    for name, array in expected.items():
        layer = view.layer(name)
        assert layer.dtype == LAYERS[name].dtype
        np.testing.assert_allclose(layer, array, rtol=1e-5, atol=1e-2 if name == "variance" else 0)


@pytest.mark.parametrize("names", [[0, 1, 2], [0, 2]])
@pytest.mark.parametrize("times", [2, 3, 4, 6])
def test_larger_cells_follow_from_the_base_cells_by_one_rule(
    path: Path, times: int, names: list[int]
) -> None:
    with open_map(path) as universal:
        sessions = [str(n) for n in names]
        layers = [name for name in LAYERS if name != "height"]
        view = universal.read(cell_m=times * CELL_M, layers=layers, sessions=sessions)
        fine = universal.read(view.bounds, layers=layers, sessions=sessions)

        def blocks(values: np.ndarray) -> np.ndarray:
            rows, columns = view.window.shape
            shaped = values.reshape(rows, times, columns, times)
            return shaped.swapaxes(1, 2).reshape(rows, columns, times * times)

        fine_window = Lattice(CELL_M).window(view.bounds)
        assert fine.window == fine_window
        weight, total = (np.zeros(fine_window.shape) for _ in range(2))
        for n in names:
            fold = MeanFold(Lattice(CELL_M), fine_window)
            for grid, pose in FIELD[n]:
                fold.add(grid, pose)
            weight += fold.sums[0]
            total += fold.sums[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = blocks(total).sum(axis=2) / blocks(weight).sum(axis=2)
        sessions_seen = blocks(fine.layer("sessions")).astype(float)
        in_obstacle = np.nan_to_num(blocks(fine.layer("persistence"))) * sessions_seen
        persistence = in_obstacle.sum(axis=2) / sessions_seen.sum(axis=2)
    seen = blocks(fine.observed)
    np.testing.assert_array_equal(view.observed, seen.any(axis=2))
    np.testing.assert_array_equal(view.density, np.floor(np.nan_to_num(mean) + 0.5))
    for name in ("count", "max", "sessions"):
        np.testing.assert_array_equal(view.layer(name), blocks(fine.layer(name)).max(axis=2))
    np.testing.assert_allclose(view.layer("persistence"), persistence, rtol=1e-6)
    np.testing.assert_array_equal(view.peak, blocks(fine.density).max(axis=2))
    share = np.where(seen.any(axis=2), seen.mean(axis=2), np.nan)
    np.testing.assert_allclose(view.seen_share, share, rtol=1e-6)


def test_a_cell_seen_often_outweighs_one_seen_once_at_every_size(tmp_path: Path) -> None:
    """100 frames of 0 in one cell and one of 200 in the next: a mean of 2, a peak of 200."""
    frames = [one_cell(2.05, 3.05, 0)] * 100 + [one_cell(2.15, 3.05, 200)]
    path = write_map(tmp_path / "map.gpkg", [frames])
    with open_map(path) as universal:
        for cell_m in (0.2, 0.4, 0.5):
            view = universal.read(cell_m=cell_m, layers=["peak", "count", "seen_share"])
            (found,) = np.argwhere(view.observed)
            assert view.density[tuple(found)] == 2
            assert view.peak[tuple(found)] == 200
            assert view.layer("count")[tuple(found)] == 100
            times = round(cell_m / CELL_M)
            assert view.seen_share[tuple(found)] == pytest.approx(2 / times**2)


def test_the_stored_tiles_are_those_of_a_new_fold(path: Path) -> None:
    with open_map(path) as universal:
        for cell_m in (CELL_M, 0.2, 0.3):
            stored = universal.read(cell_m=cell_m, layers=LAYERS)
            anew = universal.read(cell_m=cell_m, layers=LAYERS, frame_filter=lambda frame: True)
            for name in LAYERS:
                np.testing.assert_array_equal(stored.layer(name), anew.layer(name))


def test_a_window_is_a_part_of_the_whole(path: Path) -> None:
    with open_map(path) as universal:
        whole = universal.read(layers=LAYERS)
        part = universal.read(Bounds(-5.0, 4.0, 1.0, 9.0), layers=["max", "persistence"])
    place = whole.window.slices_of(part.window)
    for name in ("density", "observed", "max", "persistence"):
        np.testing.assert_array_equal(part.layer(name), whole.layer(name)[place])
    with pytest.raises(ConfigError, match="has no layer 'count'"):
        part.layer("count")


def test_only_the_tiles_of_a_window_are_touched(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    for module, name in ((placing, "decode_tile"), (content, "decode_png")):
        original = getattr(module, name)

        def spy(
            *arguments: object, name: str = name, original: object = original, **options: object
        ) -> object:
            read.append(name)
            return original(*arguments, **options)  # type: ignore[operator]

        monkeypatch.setattr(module, name, spy)
    corner = Bounds(-5.0, 4.0, -4.0, 5.0)
    with open_map(path) as universal:
        universal.read(corner)
        universal.read(corner, 0.2)
        assert read == ["decode_png"] * 2
        read.clear()
        universal.read(corner, layers=["count"])
        universal.read(corner, 0.4, layers=["count"])
        assert read == ["decode_tile"] * 4  # the density and the count, twice


def test_layers_that_are_none_or_cannot_be_are_refused(path: Path) -> None:
    with open_map(path) as universal:
        with pytest.raises(ConfigError, match="no layer 'depth'; there are density, count"):
            universal.read(layers=["depth"])
        with pytest.raises(ConfigError, match="gives a density only"):
            universal.read(layers=["count"], averaging=Averaging.PAPER)


def test_a_view_places_its_cells(path: Path) -> None:
    with open_map(path) as universal:
        view = universal.read(cell_m=0.25)
    a, b, c, d, e, f = view.transform
    row, column = np.argwhere(view.observed)[17]
    east, north = view.lattice.centres(view.window)
    assert east[column] == pytest.approx(a * (column + 0.5) + b * (row + 0.5) + c)
    assert north[row] == pytest.approx(d * (column + 0.5) + e * (row + 0.5) + f)
    assert "fieldgrid LTP" in view.crs_wkt


def test_a_view_as_xarray(path: Path) -> None:
    pytest.importorskip("xarray")
    with open_map(path) as universal:
        view = universal.read(layers=["count"])
    data = view.to_xarray()
    assert sorted(data) == ["count", "density", "observed"]
    row, column = np.argwhere(view.observed)[17]
    point = data.isel(north_m=row, east_m=column)
    i, j = view.lattice.index(float(point.east_m), float(point.north_m))
    assert (i - view.window.i0, j - view.window.j0) == (column, row)
    assert int(point["count"]) == view.layer("count")[row, column]
    assert data.attrs["datum_height_m"] == view.datum.height_m


# --- as of a date


@pytest.mark.parametrize(
    ("at", "names"),
    [
        ("1", ["1"]),
        ("0", ["1", "0"]),
        ("2", ["1", "0", "2"]),
        ("2026-06-01", ["1"]),
        ("2026-06-03", ["1"]),
        ("2026-06-04", ["1", "0"]),
        ("2026-06-04T00:00:00", ["1"]),
        ("2026-06-04T23:59+05:00", ["1", "0"]),
        ("2030-01-01T00:00:00Z", ["1", "0", "2"]),
        (1_780_272_000_000_000_000 + 4 * DAY_NS, ["1", "0"]),
        ("0..", ["0", "2"]),
        ("..0", ["1", "0"]),
        ("0..0", ["0"]),
        ("..", ["1", "0", "2"]),
        ("2026-06-02..2026-06-04", ["0"]),
        ("2026-06-01..0", ["1", "0"]),
        ("2026-06-04..2030-01-01", ["0", "2"]),
    ],
)
def test_a_map_as_of_a_session_or_a_date(path: Path, at: str | int, names: list[str]) -> None:
    with open_map(path) as universal:
        assert universal.sessions_at(at) == names
        bounds = universal.bounds
        view, expected = universal.read(bounds, at=at), universal.read(bounds, sessions=names)
        only = [frame.session for frame in universal.frames() if frame.session in names]
        anew = universal.read(bounds, frame_filter=lambda frame: frame.session in set(only))
    for other in (expected, anew):
        np.testing.assert_array_equal(view.density, other.density)
        np.testing.assert_array_equal(view.observed, other.observed)


@pytest.mark.parametrize("at", ["june", "2026-13-01", "2026-6-1", "", "june..2", "0..june"])
def test_what_is_neither_a_session_nor_a_date(path: Path, at: str) -> None:
    with open_map(path) as universal, pytest.raises(ConfigError, match="neither a session"):
        universal.read(at=at)


def test_before_the_first_drive_there_is_no_map(path: Path) -> None:
    with open_map(path) as universal, pytest.raises(ConfigError, match="no session up to 2026-05"):
        universal.read(at="2026-05-31")


def test_in_a_season_without_a_drive_there_is_no_map(path: Path) -> None:
    with (
        open_map(path) as universal,
        pytest.raises(ConfigError, match=r"session in 2026-06-02\.\."),
    ):
        universal.read(at="2026-06-02..2026-06-03")


# --- change


def test_each_change_is_told(tmp_path: Path) -> None:
    before, after = {"a": 10, "b": 10, "c": 200, "d": 200, "e": 5}, {
        "a": 90, "b": 250, "c": 101, "d": 100, "f": 9, "g": 222,
    }  # fmt: skip
    places = {name: (2.05 + k, -3.05 + 2 * k) for k, name in enumerate("abcdefgh")}
    path = write_map(
        tmp_path / "map.gpkg",
        [
            later([one_cell(*places[name], density) for name, density in found.items()], days)
            for days, found in enumerate((before, after))
        ],
    )
    expected = {
        "a": Change.FREE,
        "b": Change.APPEARED,
        "c": Change.STAYED,
        "d": Change.VANISHED,
        "e": Change.NOT_SEEN_AGAIN,
        "f": Change.NEW_FREE,
        "g": Change.NEW_OBSTACLE,
        "h": Change.UNKNOWN,
    }
    with open_map(path) as universal:
        for view in (
            universal.diff("0", "1", Bounds(0.0, -5.0, 12.0, 15.0)),
            universal.diff("2026-06-01", "2026-06-02", Bounds(0.0, -5.0, 12.0, 15.0)),
            universal.diff("0", "1", Bounds(0.0, -5.0, 12.0, 15.0), 0.2),
        ):
            for name, place in places.items():
                i, j = view.lattice.index(*place)
                found = view.change[j - view.window.j0, i - view.window.i0]
                assert found == expected[name], name
            assert (view.before, view.after) == (("0",), ("1",))
            assert view.area_m2(Change.STAYED) == pytest.approx(view.lattice.cell_m**2)
        assert set(MEANING) == set(Change)
        with pytest.raises(ConfigError, match="no session after 1 and up to 0"):
            universal.diff("1", "0")
        with pytest.raises(ConfigError, match="no session up to 2020-01-01"):
            universal.diff("2020-01-01", "1")


def test_on_either_side_the_latest_drive_counts(tmp_path: Path) -> None:
    cell = (2.05, 3.05)
    path = write_map(
        tmp_path / "map.gpkg",
        [later([one_cell(*cell, value)], day) for day, value in enumerate((250, 20, 30, 240))],
    )
    with open_map(path) as universal:
        for pair, change in (
            (("0", "1"), Change.VANISHED),
            (("1", "2"), Change.FREE),
            (("0", "3"), Change.STAYED),
            (("1", "3"), Change.APPEARED),
        ):
            assert universal.diff(*pair).area_m2(change) == pytest.approx(CELL_M**2)


# --- provenance


def test_a_cell_names_its_frames(tmp_path: Path) -> None:
    cell = (2.05, 3.05)
    frames = [one_cell(*cell, 40), one_cell(*cell, 200), one_cell(7.0, 3.0, 9)]
    path = tmp_path / "map.gpkg"
    write_map(path, [frames, [one_cell(*cell, 240)]])
    with open_map(path, writable=True) as universal:
        found = universal.query(2.09, 3.01)
        assert [(c.session, c.frame_id, c.density, c.cells) for c in found.contributions] == [
            ("0", "000000", 40.0, 1.0),
            ("0", "000001", 200.0, 1.0),
            ("1", "000000", 240.0, 1.0),
        ]
        assert found.density == 160
        assert found.bounds == pytest.approx((2.0, 3.0, 2.1, 3.1))
        assert found.contributions[0].pose == frames[0][1]
        assert universal.query(2.11, 3.01).contributions == ()
        assert universal.query(2.11, 3.01).density is None
        coarse = universal.query(2.11, 3.01, 0.5)
        assert coarse.density == 160
        universal.remove_session("1")
        assert universal.query(2.09, 3.01).density == 120
        for place in ((math.nan, 0.0), (0.0, math.inf)):
            with pytest.raises(ConfigError, match="is nowhere"):
                universal.query(*place)
        with pytest.raises(ConfigError, match="smaller than the local cells"):
            universal.query(2.0, 3.0, 0.05)


@pytest.mark.parametrize("transfer", Transfer)
def test_the_contributions_make_up_the_density(tmp_path: Path, transfer: Transfer) -> None:
    rejected = pose_at(-7.0, 4.0, 30.0, status=Status.REJECTED, reason="why not")
    path = write_map(
        tmp_path / "map.gpkg", [[*drive(5, step_m=0.6), (grid_of(3), rejected)]], transfer=transfer
    )
    with open_map(path) as universal:
        view = universal.read()
        for row, column in np.argwhere(view.observed)[::997]:
            east_m, north_m = (axis[k] for axis, k in zip(
                view.lattice.centres(view.window), (column, row), strict=True
            ))  # fmt: skip
            found = universal.query(float(east_m), float(north_m))
            assert found.density == view.density[row, column]
            weights = [one.cells for one in found.contributions]
            mean = np.average([one.density for one in found.contributions], weights=weights)
            assert found.density == math.floor(mean + 0.5)
            assert all(one.pose.status is Status.OK for one in found.contributions)
