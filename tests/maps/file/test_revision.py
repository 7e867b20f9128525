"""Sessions that leave, come back and move: the map is always that of its present sessions."""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import ConfigError, DatumError, MapError
from fieldgrid.geometry import Datum, Status
from fieldgrid.maps import LAYERS, Transfer, create_map, open_map
from tests.maps.file.content import ANONYMOUS, content
from tests.maps.file.maps import (
    CELL_M,
    DATUM,
    Frame,
    drive,
    grid_of,
    pose_at,
    track,
    write_map,
    write_session,
)

few = settings(max_examples=6, deadline=None)

poses = st.builds(
    lambda east, north, heading, status: pose_at(
        east * 3.1373 + 0.00431,
        north * 2.9291 - 0.00217,
        heading * 0.371 + 0.1137,
        status=status,
        reason="" if status is Status.OK else "why not",
    ),
    # Within four tiles either way: farther apart, hardly any two frames see the same cells.
    st.integers(-16, 16),
    st.integers(-16, 16),
    st.integers(-480, 480),
    st.sampled_from([Status.OK, Status.OK, Status.OK, Status.REJECTED, Status.HELD]),
)
drives = st.lists(st.tuples(st.integers(0, 20).map(grid_of), poses), min_size=1, max_size=3)
fields = st.lists(drives, min_size=2, max_size=3)


def assert_sound(path: Path) -> None:
    with open_map(path) as universal:
        verdict = universal.verify(deep=True)
    assert verdict.problems == ()


@few
@given(field=fields, transfer=st.sampled_from(Transfer), data=st.data())
def test_a_session_that_is_removed_was_never_there_and_one_that_is_restored_never_gone(
    field: list[list[Frame]], transfer: Transfer, data: st.DataObject
) -> None:
    names = [str(k) for k in range(len(field))]
    gone = data.draw(st.sets(st.sampled_from(names), min_size=1))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = write_map(folder / "all.gpkg", field, transfer=transfer, trajectory=track(6))
        whole = content(path)
        with open_map(path, writable=True) as universal:
            for session in data.draw(st.permutations(sorted(gone))):
                universal.remove_session(session)
        never = folder / "never.gpkg"
        with create_map(never, DATUM, cell_m=CELL_M, transfer=transfer) as universal:
            for session, frames in zip(names, field, strict=True):
                if session not in gone:
                    write_session(universal, session, frames, track(6))
            if len(gone) == len(names):
                with universal.add_session("nothing"):  # a map needs one to come to be
                    pass
        left, expected = content(path), content(never)
        if len(gone) == len(names):
            expected["digests"] = []
        assert left == expected
        assert_sound(path)
        with open_map(path, writable=True) as universal:
            for session in data.draw(st.permutations(sorted(gone))):
                universal.restore_session(session)
        assert content(path) == whole
        assert_sound(path)


@pytest.mark.parametrize("orders_tried", [6, pytest.param(20, marks=pytest.mark.long)])
def test_any_order_of_frames_and_sessions_gives_the_same_bits(
    orders_tried: int, tmp_path: Path
) -> None:
    field = [drive(5), drive(4, heading_deg=-61.0), drive(3, heading_deg=170.0, start=2)]
    orders = np.random.default_rng(7)
    seen = set()
    expected = None
    for number in range(orders_tried):
        path = tmp_path / f"{number}.gpkg"
        with create_map(path, DATUM, cell_m=CELL_M) as universal:
            for k in orders.permutation(3):
                with universal.add_session(f"s{k}", trajectory=track(6)) as session:
                    for n in orders.permutation(len(field[k])):
                        grid, pose = field[k][n]
                        session.add(grid, pose, frame_id=f"{n:03d}")
        found = content(path)
        expected = expected or found
        assert found == expected
        with open_map(path) as universal:
            view = universal.read(cell_m=0.37, layers=LAYERS)
            seen.add(b"".join(view.layer(name).tobytes() for name in LAYERS))
        path.unlink()
    assert len(seen) == 1


@few
@given(frames=drives, data=st.data())
def test_appended_in_pieces_is_appended_at_once(frames: list[Frame], data: st.DataObject) -> None:
    cuts = sorted(data.draw(st.sets(st.integers(0, len(frames)), max_size=3)))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        once = write_map(folder / "once.gpkg", [frames])
        pieces = folder / "pieces.gpkg"
        for k, (start, stop) in enumerate(itertools.pairwise([0, *cuts, len(frames)])):
            with open_map(pieces, datum=DATUM, cell_m=CELL_M) as universal:
                write_session(universal, f"p{k}", frames[start:stop])
        ours, theirs = (
            content(path, *(kind for kind in ANONYMOUS if kind != "extents"))
            for path in (pieces, once)
        )
        assert ours == theirs


@few
@given(frames=drives, others=drives, data=st.data())
def test_a_session_with_new_poses_is_the_session_built_with_them(
    frames: list[Frame], others: list[Frame], data: st.DataObject
) -> None:
    moved = [(grid, data.draw(poses)) for grid, _ in frames]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = write_map(folder / "map.gpkg", [frames, others], trajectory=track(6))
        built = write_map(folder / "built.gpkg", [moved, others], trajectory=track(6))
        with open_map(path, writable=True) as universal:
            universal.repose("0", {f"{k:06d}": pose for k, (_, pose) in enumerate(moved)})
        assert content(path) == content(built)
        assert_sound(path)


def test_new_poses_bring_their_trajectory_and_config(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(3)], trajectory=track(6))
    with open_map(path, writable=True) as universal:
        frames = {f"{k:06d}": pose for k, (_, pose) in enumerate(drive(3, heading_deg=9.0))}
        universal.repose("0", frames, track(11), {"heading": "smooth"})
        (info,) = universal.sessions()
        assert dict(info.config) == {"heading": "smooth"}
        assert len(universal.trajectory("0")) == 11
        assert [f.pose for f in universal.frames()] == [pose for _, pose in drive(3, heading_deg=9)]
    assert_sound(path)


def test_new_poses_for_a_removed_session_wait_for_its_return(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(3), drive(2, heading_deg=80.0)])
    built = write_map(tmp_path / "b.gpkg", [drive(3), drive(2, heading_deg=-20.0)])
    frames = {f"{k:06d}": pose for k, (_, pose) in enumerate(drive(2, heading_deg=-20.0))}
    with open_map(path, writable=True) as universal:
        universal.remove_session("1")
        before = content(path)
        universal.repose("1", frames)
        assert content(path) == before
        universal.restore_session("1")
    assert content(path) == content(built)


def test_poses_that_do_not_fit_change_nothing(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(3)], trajectory=track(6))
    before = path.read_bytes()
    good = {f"{k:06d}": pose for k, (_, pose) in enumerate(drive(3, heading_deg=9.0))}
    with open_map(path, writable=True) as universal:
        with pytest.raises(ConfigError, match=r"missing for 1 of the 3 frames .*'000002'"):
            universal.repose("0", dict(itertools.islice(good.items(), 2)))
        with pytest.raises(ConfigError, match="has no frame 'x'"):
            universal.repose("0", {**good, "x": good["000000"]})
        with pytest.raises(DatumError, match="50 km"):
            universal.repose("0", {**good, "000002": pose_at(60_000.0, 0.0, 0.0)})
        with pytest.raises(DatumError, match="--datum-from"):
            universal.repose("0", good, track(datum=Datum(10.0, 10.0, 10.0)))
        with pytest.raises(ConfigError, match="has no session 'x'; it has '0'"):
            universal.repose("x", good)
    assert path.read_bytes() == before


def test_what_cannot_be_removed_or_restored_is_said(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2), drive(2, heading_deg=80.0)])
    with open_map(path) as universal, pytest.raises(ConfigError, match="opened for reading"):
        universal.remove_session("0")
    with open_map(path, writable=True) as universal:
        with pytest.raises(ConfigError, match=r"'1' of .* is not removed"):
            universal.restore_session("1")
        universal.remove_session("1")
        with pytest.raises(ConfigError, match=r"'1' of .* is removed already"):
            universal.remove_session("1")
        with pytest.raises(ConfigError, match="no session '2'; it has '0', '1'"):
            universal.remove_session("2")
        with pytest.raises(ConfigError, match="was removed; put it back with --restore"):
            universal.add_session("1")
        with pytest.raises(ConfigError, match="is removed; put it back with --restore"):
            universal.read(sessions=["1"])
        with universal.add_session("3"), pytest.raises(ConfigError, match="has not ended"):
            universal.remove_session("0")
        universal.remove_session("0")
        with pytest.raises(MapError, match="all its sessions are removed"):
            universal.read()
    with pytest.raises(ConfigError, match="is closed"):
        universal.remove_session("1")


def test_a_name_of_bytes_that_are_no_text_is_that_of_no_session(tmp_path: Path) -> None:
    """As a command line gives them to Python."""
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    with open_map(path, writable=True) as universal:
        for change in (
            universal.remove_session,
            universal.restore_session,
            universal.metadata,
            lambda name: universal.rename_session(name, "more"),
            lambda name: universal.set_transform(name, 1.0, 1.0),
        ):
            with pytest.raises(ConfigError, match=r"has no session '0\\udcff'; it has '0'"):
                change("0\udcff")


def test_the_evidence_of_a_removed_session_stays(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2), drive(3, heading_deg=80.0)])
    with open_map(path, writable=True) as universal:
        universal.remove_session("1")
        assert [(info.name, info.active) for info in universal.sessions()] == [
            ("0", True), ("1", False),
        ]  # fmt: skip
        assert universal.sessions()[1].removed is not None
        assert len(list(universal.frames("1", with_grid=True))) == 3
        assert {frame.session for frame in universal.frames()} == {"0"}
