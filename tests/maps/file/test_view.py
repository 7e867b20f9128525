"""Reading a map: what the tiles say, and what a new fold of the evidence says."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import Bounds, Lattice, Status
from fieldgrid.maps import Averaging, MapView, Transfer, create_map, open_map
from fieldgrid.maps.transfer import MeanFold, PaperFold
from fieldgrid.maps.views import view as view_module
from tests.maps.file.maps import CELL_M, DATUM, Frame, drive, grid_of, pose_at, track, write_map

# In odd fractions of a cell and of a degree, so that no centre falls on the edge of a cell.
poses = st.builds(
    lambda east, north, heading: pose_at(
        east * 0.1373 + 0.00431, north * 0.1291 - 0.00217, heading * 0.371 + 0.1137
    ),
    st.integers(-150, 150),
    st.integers(-150, 150),
    st.integers(-480, 480),
)
drives = st.lists(st.tuples(st.integers(0, 50).map(grid_of), poses), min_size=1, max_size=6)
rules = st.sampled_from(Transfer)
few = settings(max_examples=15, deadline=None)


def assert_same(a: MapView, b: MapView) -> None:
    assert (a.lattice, a.window, a.datum) == (b.lattice, b.window, b.datum)
    np.testing.assert_array_equal(a.observed, b.observed)
    np.testing.assert_array_equal(a.density, b.density)


def in_a_map(
    frames: list[Frame], transfer: Transfer = Transfer.CENTRE
) -> tuple[tempfile.TemporaryDirectory[str], Path]:
    folder = tempfile.TemporaryDirectory()
    return folder, write_map(Path(folder.name) / "map.gpkg", [frames], transfer=transfer)


@few
@given(frames=drives, transfer=rules)
def test_the_tiles_are_the_fold_of_the_evidence(frames: list[Frame], transfer: Transfer) -> None:
    folder, path = in_a_map(frames, transfer)
    with folder, open_map(path) as universal:
        view = universal.read()
        assert view.observed.any()
        assert_same(view, universal.read(frame_filter=lambda frame: True))
        fold = MeanFold(view.lattice, view.window, transfer)
        for grid, pose in frames:
            fold.add(grid, pose)
        density, observed = fold.density()
        np.testing.assert_array_equal(view.density, density)
        np.testing.assert_array_equal(view.observed, observed)


@few
@given(frames=drives, data=st.data())
def test_the_mean_does_not_depend_on_the_order_of_the_frames(
    frames: list[Frame], data: st.DataObject
) -> None:
    shuffled = data.draw(st.permutations(frames))
    folder, path = in_a_map(frames)
    other_folder, other_path = in_a_map(shuffled)
    with folder, other_folder, open_map(path) as universal, open_map(other_path) as other:
        assert_same(universal.read(), other.read())
        assert_same(universal.read(cell_m=0.25), other.read(cell_m=0.25))


@few
@given(frames=drives, times=st.integers(2, 5))
def test_larger_cells_by_centre_are_the_sum_of_the_cells_in_them(
    frames: list[Frame], times: int
) -> None:
    folder, path = in_a_map(frames)
    with folder, open_map(path) as universal:
        coarse = universal.read(cell_m=times * CELL_M)
        fine = MeanFold(Lattice(CELL_M), Lattice(CELL_M).window(coarse.bounds))
        for grid, pose in frames:
            fine.add(grid, pose)
        rows, columns = coarse.window.shape
        sums = fine.sums.reshape(2, rows, times, columns, times).sum(axis=(2, 4))
        np.testing.assert_array_equal(coarse.observed, sums[0] > 0)
        mean = np.floor(sums[1] / np.maximum(sums[0], 1) + 0.5)
        np.testing.assert_array_equal(coarse.density, mean)


def test_the_extent_is_that_of_the_observed_cells(tmp_path: Path) -> None:
    with open_map(write_map(tmp_path / "map.gpkg", [drive(3), drive(5)])) as universal:
        view = universal.read()
        assert view.bounds == universal.bounds
        for edge in (view.observed[0], view.observed[-1], view.observed.T[0], view.observed.T[-1]):
            assert edge.any()
        wide = universal.read(Bounds(-70.0, -70.0, 70.0, 70.0))
        assert wide.observed.sum() == view.observed.sum()


def test_bounds_cut_a_part_out(tmp_path: Path) -> None:
    with open_map(write_map(tmp_path / "map.gpkg", [drive(12)])) as universal:
        whole = universal.read()
        for west, south, width, height in ((-3.0, 6.0, 5.0, 9.0), (0.0, 20.0, 40.0, 2.0)):
            part = universal.read(Bounds(west, south, west + width, south + height))
            assert part.bounds == pytest.approx((west, south, west + width, south + height))
            shared = whole.window.intersect(part.window)
            assert shared is not None
            place, source = part.window.slices_of(shared), whole.window.slices_of(shared)
            np.testing.assert_array_equal(part.density[place], whole.density[source])
            assert part.observed.sum() == whole.observed[source].sum()
        far = universal.read(Bounds(900.0, 900.0, 901.0, 901.0))
        assert not far.observed.any()
        assert not universal.read(far.bounds, cell_m=0.5).observed.any()


def test_the_paper_averages_in_the_order_of_time(tmp_path: Path) -> None:
    frames = drive(6, step_m=0.613)
    path = write_map(tmp_path / "map.gpkg", [frames[3:], frames[2::-1]])
    with open_map(path) as universal:
        view = universal.read(averaging=Averaging.PAPER)
    fold = PaperFold(view.lattice, view.window)
    for grid, pose in frames:
        fold.add(grid, pose)
    np.testing.assert_array_equal(view.density, fold.density()[0])
    assert (view.density != open_map(path).read().density).any()


def test_a_fold_in_blocks_is_the_fold_in_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_map(write_map(tmp_path / "map.gpkg", [drive(12)])) as universal:
        views = [universal.read(cell_m=0.17, averaging=rule) for rule in Averaging]
        monkeypatch.setattr(view_module, "BLOCK_CELLS", 37)
        for view, rule in zip(views, Averaging, strict=True):
            assert_same(view, universal.read(cell_m=0.17, averaging=rule))


def test_the_area_rule_leaves_no_holes_where_the_centre_rule_does(tmp_path: Path) -> None:
    grid = grid_of(1)
    grid.observed[...] = True
    path = write_map(tmp_path / "map.gpkg", [[(grid, pose_at(0.0123, 0.0271, 45.0))]])
    with open_map(path) as universal:
        inside = Bounds(2.5, 1.7, 4.5, 3.7)
        assert not universal.read(inside).observed.all()
        assert universal.read(inside, transfer=Transfer.AREA).observed.all()
        assert_same(universal.read(inside, transfer=Transfer.CENTRE), universal.read(inside))
        with pytest.raises(ConfigError, match="cell centres"):
            universal.read(averaging=Averaging.PAPER, transfer=Transfer.AREA)


def test_sessions_and_frames_can_be_chosen(tmp_path: Path) -> None:
    sessions = [drive(4), drive(4, heading_deg=-61.0)]
    with open_map(write_map(tmp_path / "map.gpkg", sessions)) as universal:
        whole = universal.read().bounds
        alone = open_map(write_map(tmp_path / "alone.gpkg", sessions[1:])).read(whole)
        assert_same(universal.read(sessions=["1"]), alone)
        assert_same(universal.read(frame_filter=lambda frame: frame.session == "1"), alone)
        assert_same(universal.read(sessions=["0", "1"]), universal.read())
        with pytest.raises(ConfigError, match=r"no session 'x'; it has '0', '1'"):
            universal.read(sessions=["x"])


def test_cells_smaller_than_the_local_ones_are_refused(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)], cell_m=0.4)
    with open_map(path) as universal:
        assert universal.read(cell_m=0.1).lattice.cell_m == 0.1
        with pytest.raises(ConfigError, match="smaller than the local cells"):
            universal.read(cell_m=0.09)


def test_a_view_of_too_many_cells_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    wide = Bounds(-40_000.0, -40_000.0, 40_000.0, 40_000.0)
    universal = open_map(write_map(tmp_path / "map.gpkg", [drive(2)]))
    with universal, pytest.raises(ConfigError, match="smaller bounds or a larger cell"):
        universal.read(wide)


def test_a_map_with_nothing_in_it_says_so(tmp_path: Path) -> None:
    with create_map(tmp_path / "map.gpkg", DATUM, cell_m=CELL_M) as universal:
        with pytest.raises(MapError, match="no frames yet"):
            universal.read()
        with universal.add_session("one") as session:
            session.add(grid_of(1), pose_at(0, 0, 0, status=Status.REJECTED, reason="no fix"))
        for ask in (universal.read, lambda: universal.bounds, lambda: universal.read(cell_m=1.0)):
            with pytest.raises(MapError, match="of its 1 frames 1 were rejected"):
                ask()


def test_a_trajectory_reads_back_bit_for_bit(tmp_path: Path) -> None:
    stored = track(23)
    path = write_map(tmp_path / "map.gpkg", [drive(1)], trajectory=stored)
    with open_map(path) as universal:
        read = universal.trajectory("0")
        assert read.datum == universal.datum == DATUM
        with pytest.raises(ConfigError, match="no session 'x'"):
            universal.trajectory("x")
    for name in (
        "time_ns", "east_m", "north_m", "up_m", "heading_deg", "position_sigma_m",
        "heading_sigma_deg", "speed_mps", "quality",
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(read, name), getattr(stored, name))
        assert getattr(read, name).dtype == getattr(stored, name).dtype
    assert (read.status, read.reason) == (stored.status, stored.reason)
    assert read.heading_source == "constant:80"


def test_a_session_without_a_trajectory_says_so(tmp_path: Path) -> None:
    universal = open_map(write_map(tmp_path / "map.gpkg", [drive(1)]))
    with universal, pytest.raises(MapError, match="no trajectory"):
        universal.trajectory("0")


def test_frames_come_in_the_order_of_time_with_their_grids_when_asked(tmp_path: Path) -> None:
    frames = drive(6)
    path = write_map(tmp_path / "map.gpkg", [frames[3:], frames[:3]])
    with open_map(path) as universal:
        records = list(universal.frames(with_grid=True))
        assert [record.frame_id for record in universal.frames("1")] == [
            "000000", "000001", "000002",
        ]  # fmt: skip
        (bare, *_) = universal.frames()
        with pytest.raises(ConfigError, match="with_grid=True"):
            bare.grid()
        with pytest.raises(ConfigError, match="no session 'x'"):
            universal.frames("x")
    assert [record.pose for record in records] == [pose for _, pose in frames]
    for record, (grid, _) in zip(records, frames, strict=True):  # the map is closed by now
        np.testing.assert_array_equal(record.grid().density, grid.density)
