"""A session's transform: exact to undo, apart from the poses, and in all that is shown."""

from __future__ import annotations

import json
import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import ConfigError, DatumError, MapError
from fieldgrid.geometry import Bounds
from fieldgrid.maps import (
    LAYERS,
    AlignmentRecord,
    HeightCorrection,
    RelativeError,
    Transform,
    Wander,
    merge_maps,
    open_map,
    transform_of,
)
from fieldgrid.maps.file import evidence
from fieldgrid.maps.file.records import frame_record
from tests.maps.file.content import content
from tests.maps.file.maps import drive, pose_at, track, write_map

metres = st.floats(-900.0, 900.0)


@given(metres, metres, st.floats(-180.0, 180.0), metres, metres, metres, metres)
def test_it_is_a_clockwise_turn_about_the_pivot_then_a_shift(
    de: float, dn: float, turn: float, pe: float, pn: float, east: float, north: float
) -> None:
    placed = Transform(de, dn, turn, pe, pn).pose(pose_at(east, north, 10.0))
    offset = complex(east - pe, north - pn) * np.exp(-1j * math.radians(turn))
    assert placed.east_m == pytest.approx(pe + offset.real + de, abs=1e-7)
    assert placed.north_m == pytest.approx(pn + offset.imag + dn, abs=1e-7)
    away = math.radians(placed.heading_deg - 10.0 - turn)
    assert math.sin(away) == pytest.approx(0.0, abs=1e-9)
    assert math.cos(away) > 0


@given(
    st.tuples(metres, metres, st.floats(-180.0, 180.0), metres, metres),
    st.lists(st.tuples(metres, metres), max_size=3),
    st.tuples(metres, metres, st.floats(0.0, 300.0), st.floats(0.0, 300.0)),
    st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(-5, 25)),
)
def test_what_is_placed_in_a_rectangle_was_driven_in_the_one_that_it_tells(
    rigid: tuple[float, ...],
    wander: list[tuple[float, float]],
    rectangle: tuple[float, float, float, float],
    place: tuple[float, float, int],
) -> None:
    knots = None
    if wander:
        east, north = zip(*wander, strict=True)
        knots = Wander(tuple(range(0, 10 * len(wander), 10)), east, north)
    transform = Transform(*rigid, wander=knots)
    west, south, width, height = rectangle
    east_m, north_m = west + place[0] * width, south + place[1] * height
    # Where it was driven: the turn is undone by its opposite.
    de, dn = (0.0, 0.0) if knots is None else map(float, knots.at(place[2]))
    x, y = (east_m - de - rigid[0] - rigid[3], north_m - dn - rigid[1] - rigid[4])
    driven = complex(rigid[3], rigid[4]) + complex(x, y) * np.exp(1j * math.radians(rigid[2]))
    again = transform.points(driven.real, driven.imag, place[2])
    assert tuple(map(float, again)) == pytest.approx((east_m, north_m), abs=1e-7)
    found = transform.driven(Bounds(west, south, west + width, south + height))
    assert found.west_m <= driven.real + 1e-8
    assert driven.real - 1e-8 <= found.east_m
    assert found.south_m <= driven.imag + 1e-8
    assert driven.imag - 1e-8 <= found.north_m


def test_a_window_of_shifted_sessions_reads_the_frames_near_it_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_map(tmp_path / "m.gpkg", [drive(4), drive(4, start=4), drive(30, step_m=40.0)])
    read: list[str] = []

    def counted(row: tuple[Any, ...], load: Any) -> Any:
        read.append(row[1])
        return frame_record(row, load)

    with open_map(path, writable=True) as universal:
        universal.set_transform("0", 300.0, 0.0, -90.0)
        first = next(universal.frames("0"))
        monkeypatch.setattr(evidence, "frame_record", counted)
        found = universal.query(first.pose.east_m + 0.05, first.pose.north_m - 1.0)
        assert {one.session for one in found.contributions} <= {"0"}
        assert set(read) <= {"0", "2"}
        assert read.count("2") <= 2
        read.clear()
        moved = universal.read(sessions=["0"], cell_m=0.13)
        assert read.count("0") == 4
        assert moved.observed.any()


def test_places_of_maps_that_were_aligned_before_have_the_error_that_was_stored() -> None:
    """Trajectories are stored as placed: `verify --deep` computes them again."""
    old = transform_of(Transform(0.1, aligned=AlignmentRecord(0.4, 0.1, ("june",))).to_text())
    driven_m, placed_m = [0.02, 0.33, 0.5, math.nan], [0.02, 0.33, 0.4, 0.4]
    poses = [replace(pose_at(1.0, 2.0, 3.0), position_sigma_m=sigma_m) for sigma_m in driven_m]
    assert [old.pose(pose).position_sigma_m for pose in poses] == placed_m
    driven = replace(track(4), position_sigma_m=np.array(driven_m))
    assert old.trajectory(driven).position_sigma_m.tolist() == placed_m


def test_a_turn_of_a_right_angle_to_the_right() -> None:
    placed = Transform(turn_deg=90.0, pivot_east_m=10.0, pivot_north_m=20.0).pose(
        pose_at(10.0, 25.0, 0.0)
    )
    assert (placed.east_m, placed.north_m) == pytest.approx((15.0, 20.0))
    assert placed.heading_deg == pytest.approx(90.0)


def test_it_reads_back_and_what_is_unknown_is_refused() -> None:
    transform = Transform(0.1, -0.2, 0.3, 1 / 3, 2e9 / 7)
    assert transform_of(transform.to_text()) == transform
    assert Transform(pivot_east_m=5.0).to_text() is None
    with pytest.raises(
        MapError, match="has knots, and this fieldgrid knows rigid, wander, heights"
    ):
        transform_of(json.dumps({"rigid": {}, "knots": []}))
    with pytest.raises(MapError, match="has no rigid part"):
        transform_of("{}")
    for text in ("{", "[]", '{"rigid": {"turn_deg": "x"}}', '{"rigid": 7}', "7"):
        with pytest.raises(MapError):
            transform_of(text)
    for bad in ((math.nan, 0.0), (0.0, 1001.0), (0.0, 0.0, 181.0)):
        with pytest.raises(ConfigError, match="cannot be"):
            Transform(*bad)


def test_a_wander_is_linear_between_its_times_and_stays_beyond_them() -> None:
    start = 1_600_000_000_000_000_000
    second = 1_000_000_000
    wander = Wander((start, start + 10 * second), (0.0, 0.5), (-0.2, 0.2))
    transform = Transform(1.0, 2.0, wander=wander)
    for after_s, east, north in ((-9, 0.0, -0.2), (0, 0.0, -0.2), (5, 0.25, 0.0), (99, 0.5, 0.2)):
        placed = transform.pose(pose_at(10.0, 20.0, 30.0, time_ns=start + after_s * second))
        assert (placed.east_m, placed.north_m) == pytest.approx((11.0 + east, 22.0 + north))
        assert placed.heading_deg == 30.0
    assert not Transform(wander=wander).is_identity
    driven = track(4)
    placed_track = transform.trajectory(driven)
    by_pose = [transform.pose(driven.at(int(t))) for t in driven.time_ns[driven.accepted]]
    assert placed_track.east_m[driven.accepted] == pytest.approx([p.east_m for p in by_pose])


@pytest.mark.parametrize(
    "bad",
    [
        ((), (), ()),
        ((1, 2), (0.0,), (0.0, 0.0)),
        ((2, 1), (0.0, 0.0), (0.0, 0.0)),
        ((1,), (math.nan,), (0.0,)),
        ((1,), (2000.0,), (0.0,)),
    ],
)
def test_a_wander_that_cannot_be(bad: Any) -> None:
    with pytest.raises(ConfigError):
        Wander(*bad)


def test_heights_are_moved_by_what_holds_at_their_time() -> None:
    transform = Transform(heights=HeightCorrection((100, 300), (0.5, -0.5), 0.04))
    assert not transform.is_identity
    times = (0, 100, 150, 200, 300, 900)
    for time_ns, up_m in zip(times, (0.5, 0.5, 0.25, 0.0, -0.5, -0.5), strict=True):
        driven = replace(pose_at(1.0, 2.0, 3.0), time_ns=time_ns, up_m=7.0)
        placed = transform.pose(driven)
        assert placed.up_m == pytest.approx(7.0 + up_m)
        assert replace(placed, up_m=7.0, up_sigma_m=driven.up_sigma_m) == driven
    driven_track = replace(track(4), time_ns=100 * np.arange(4))
    placed_track = transform.trajectory(driven_track)
    assert placed_track.up_m - driven_track.up_m == pytest.approx([0.5, 0.5, 0.0, -0.5])
    assert (placed_track.east_m == driven_track.east_m).all()


def test_what_alignment_found_reads_back_and_damage_is_told() -> None:
    transform = Transform(
        0.1, -0.2, 0.3, 4.0, 5.0, Wander((5, 7), (0.1, 0.2), (0.0, -0.1)),
        AlignmentRecord(
            0.02, 0.1, ("june", "july"), Transform(1.0, 2.0).to_text(),
            (RelativeError("june", 0.01, "12ab"), RelativeError("july", 0.03, "34cd")), 0.2,
        ),
        HeightCorrection((5, 9), (0.5, -0.3), 0.04),
    )  # fmt: skip
    text = transform.to_text()
    assert text is not None
    assert transform_of(text) == transform
    # Maps that were aligned before it was kept do not say how sure that is beside others.
    old = json.loads(text)
    del old["aligned"]["beside"], old["aligned"]["stated_m"]
    assert replace(transform_of(json.dumps(old)), aligned=transform.aligned) == transform
    # A place that was aligned is as sure as that, but for those that state more than usual.
    for driven_m, placed_m in ((0.3, 0.02), (0.01, 0.02), (math.nan, 0.02), (0.41, 0.41)):
        driven = replace(pose_at(1.0, 2.0, 3.0), position_sigma_m=driven_m, up_sigma_m=math.nan)
        driven_up_m = math.inf if math.isnan(driven_m) else 2.0 * driven_m
        assert driven.up_sigma_m == driven_up_m
        assert transform.pose(driven).position_sigma_m == placed_m
        assert transform.pose(driven).up_sigma_m == max(0.04, driven_up_m)
        for heights in (None, HeightCorrection((5,), (0.0,))):
            places_alone = replace(transform, heights=heights).pose(driven)
            assert places_alone.up_sigma_m == driven_up_m
        by_hand = replace(transform, aligned=None)
        assert by_hand.pose(driven).position_sigma_m == pytest.approx(driven_m, nan_ok=True)
    for change in (
        {"wander": {"time_ns": [5], "east_m": [0.1]}},
        {"wander": {"time_ns": [5.5], "east_m": [0.1], "north_m": [0.0]}},
        {"wander": {"time_ns": [7, 5], "east_m": [0.1, 0.1], "north_m": [0.0, 0.0]}},
        {"heights": {"time_ns": [5.5], "up_m": [0.0], "least_sigma_m": 0.1}},
        {"heights": {"time_ns": [5, 5], "up_m": [0.0, 0.0], "least_sigma_m": 0.1}},
        {"heights": {"time_ns": [5], "up_m": [0.0, 0.0], "least_sigma_m": 0.1}},
        {"heights": {"time_ns": [5], "up_m": [1e9], "least_sigma_m": 0.1}},
        {"heights": {"time_ns": [5], "up_m": [0.0], "least_sigma_m": -0.1}},
        {"heights": {"time_ns": [5], "up_m": [0.0], "least_sigma_m": "x"}},
        {"heights": {"time_ns": [2**70], "up_m": [0.0], "least_sigma_m": 0.0}},
        {"wander": {"time_ns": [2**70], "east_m": [0.1], "north_m": [0.0]}},
        {"heights": {"time_ns": [5], "up_m": [0.0]}},
        {"aligned": {"sigma_m": "x", "turn_sigma_deg": 0.0, "to": [], "before": None}},
        {"aligned": {"sigma_m": -1.0, "turn_sigma_deg": 0.0, "to": [], "before": None}},
        {"aligned": {"sigma_m": 1.0, "turn_sigma_deg": 0.0, "to": [], "before": 7}},
        {"aligned": {}},
        {"aligned": {"sigma_m": True, "turn_sigma_deg": 0.0, "to": [], "before": None}},
    ):
        with pytest.raises(MapError, match="is damaged"):
            transform_of(json.dumps({**json.loads(text), **change}))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    sessions = [drive(6), drive(5, heading_deg=-60.0)]
    return write_map(tmp_path / "map.gpkg", sessions, trajectory=track(6))


def test_a_map_is_as_if_it_had_been_driven_there_and_back_bit_for_bit(
    path: Path, tmp_path: Path
) -> None:
    before = content(path)
    with open_map(path, writable=True) as universal:
        root = universal.root_sha256
        transform = universal.set_transform("1", 1.5, -2.25, 11.0)
        universal.set_transform("1", 0.31, 0.12, -3.0)  # in place of the one before
        transform = universal.transform("1")
        assert (transform.shift_east_m, transform.turn_deg) == (0.31, -3.0)
        assert universal.sessions()[1].transform == transform
        assert universal.verify(deep=True).problems == ()
        moved = [(grid, transform.pose(pose)) for grid, pose in drive(5, heading_deg=-60.0)]
        assert [f.pose for f in universal.frames("1")] == [pose for _, pose in moved]
        assert [f.driven for f in universal.frames("1")] == [
            pose for _, pose in drive(5, heading_deg=-60.0)
        ]
        view = universal.read(layers=LAYERS)
        anew = universal.read(layers=LAYERS, frame_filter=lambda frame: True)
        assert universal.trajectory("1", as_driven=True).east_m.tolist() == track(6).east_m.tolist()
        assert universal.trajectory("1").east_m.tolist() == (
            transform.trajectory(track(6)).east_m.tolist()
        )
    other = write_map(tmp_path / "other.gpkg", [drive(6), moved], trajectory=track(6))
    for name in LAYERS:
        np.testing.assert_array_equal(view.layer(name), anew.layer(name))
    kinds = ("tiles", "session tiles", "pictures", "window", "frames", "footprints")
    assert content(path, *kinds) == content(other, *kinds)
    with open_map(path, writable=True) as universal:
        universal.set_transform("1", 0.0, 0.0)
        assert universal.root_sha256 == root
    assert content(path) == before


def test_it_survives_new_poses_leaving_and_coming_back_and_merging(
    path: Path, tmp_path: Path
) -> None:
    with open_map(path, writable=True) as universal:
        transform = universal.set_transform("1", 1.0, 2.0, 5.0)
        poses = {f"{k:06d}": pose for k, (_, pose) in enumerate(drive(5, heading_deg=20.0))}
        universal.repose("1", poses)
        assert universal.transform("1") == transform
        assert next(universal.frames("1")).pose == transform.pose(poses["000000"])
        universal.remove_session("1")
        universal.set_transform("1", 3.0, 0.0)
        universal.restore_session("1")
        assert universal.transform("1").shift_east_m == 3.0
        assert universal.verify(deep=True).problems == ()
    merge_maps([path], tmp_path / "copy.gpkg")
    assert content(tmp_path / "copy.gpkg", "tiles", "fixes") == content(path, "tiles", "fixes")
    with open_map(tmp_path / "copy.gpkg") as copy:
        assert copy.transform("1").shift_east_m == 3.0


def test_what_cannot_be_changes_nothing(path: Path, tmp_path: Path) -> None:
    before = path.read_bytes()
    with open_map(path, writable=True) as universal:
        with pytest.raises(ConfigError, match="no session 'x'"):
            universal.set_transform("x", 1.0, 0.0)
        with pytest.raises(ConfigError, match="cannot be"):
            universal.set_transform("1", 2000.0, 0.0)
    assert path.read_bytes() == before
    far = write_map(
        tmp_path / "far.gpkg", [[(g, pose_at(49_500.0, 0.0, 9.0)) for g, _ in drive(1)]]
    )
    with (
        open_map(far, writable=True) as universal,
        pytest.raises(DatumError, match="over 50 km"),
    ):
        universal.set_transform("0", 900.0, 0.0)


def test_a_transform_of_a_newer_program_is_said_so(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE fieldgrid_session SET transform = '{\"knots\": []}'")
    with open_map(path) as universal, pytest.raises(MapError, match="update fieldgrid"):
        universal.sessions()
