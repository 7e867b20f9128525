"""Drives of a made-up field, from the map to their transforms."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, Float64
from fieldgrid.field import align_map, undo_alignment
from fieldgrid.field.align import agreement
from fieldgrid.field.align.drives import Role
from fieldgrid.field.align.submaps import cut
from fieldgrid.maps import Transform, Wander, open_map, placing
from tests.field.align.field import (
    SPACING_M,
    Drive,
    Field,
    along_one_lane,
    left_m,
    mixed,
    write_field,
)

OFF = Transform(0.9, -0.7)
LATER_S = 1e5


@pytest.fixture(scope="module")
def drives() -> dict[str, Drive]:
    """One lane with a good receiver, two with one that is off."""
    field = Field()
    return {
        "june": field.drive([0.0], sigma_m=0.02),
        "july": field.drive([0.0, SPACING_M], by=OFF, seed=7, start_s=LATER_S),
    }


@pytest.fixture(scope="module")
def true(drives: Mapping[str, Drive]) -> dict[str, Drive]:
    field = Field()
    return {"june": drives["june"], "july": field.drive([0.0, SPACING_M], seed=7, start_s=LATER_S)}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, drives: Mapping[str, Drive]) -> Path:
    return write_field(tmp_path_factory.mktemp("field") / "map.gpkg", drives)


@pytest.fixture
def path(tmp_path: Path, written: Path) -> Path:
    """The map of the drives, a copy for each test."""
    return Path(shutil.copy(written, tmp_path))


def test_a_drive_comes_to_the_better_one_and_back_bit_for_bit(
    path: Path, drives: Mapping[str, Drive], true: Mapping[str, Drive]
) -> None:
    told: list[tuple[str, int, int]] = []
    with open_map(path, writable=True) as universal:
        before = universal.root_sha256
        picture = universal.read().density.tobytes()
        found = align_map(universal, progress=lambda *now: told.append(now))
        assert universal.root_sha256 == before, "it changes nothing by itself"
        universal.set_transforms(found.transforms)
        off = left_m(found.transforms, drives, true)
        assert np.hypot(*off[0]) < 0.02
        assert np.hypot(*off[1]) < 0.12
        (pair,) = found.pairs
        assert (pair.a, pair.b, pair.doubt) == ("june", "july", None)
        assert pair.before_m == pytest.approx([0.9, -0.7], abs=0.12)
        assert np.hypot(*off[1]) < 3.0 * pair.sigma_m
        aligned = universal.transform("july").aligned
        assert aligned is not None
        assert aligned.to == ("june",)
        (beside,) = aligned.beside
        assert (beside.name, beside.sigma_m) == ("june", pair.sigma_m)
        held = [frame.driven for frame in universal.frames("june") if frame.accepted]
        assert beside.placing == placing(universal.transform("june"), held)
        assert universal.verify(deep=True).problems == ()
        assert {name: done == count for name, done, count in told}.values()
        again = align_map(universal)
        assert again.transforms["july"].aligned is not None
        universal.set_transforms(again.transforms)
        off = left_m(again.transforms, drives, true)
        assert np.hypot(*off[1]) < 0.12
        assert sorted(undo_alignment(universal)) == ["july", "june"]
        assert universal.root_sha256 == before
        assert universal.read().density.tobytes() == picture
        with pytest.raises(ConfigError, match="there is nothing to undo"):
            undo_alignment(universal)


def test_an_undone_alignment_leaves_the_shift_that_was_set_by_hand(path: Path) -> None:
    with open_map(path, writable=True) as universal:
        by_hand = universal.set_transform("july", -0.5, 0.4)
        universal.set_transforms(align_map(universal).transforms)
        assert undo_alignment(universal, ["july"]) == ["july"]
        assert universal.transform("july") == by_hand
        assert universal.transform("june").aligned is not None
        with pytest.raises(ConfigError, match=r"'july' of .* is not aligned"):
            undo_alignment(universal, ["july"])


def test_other_poses_keep_the_transform_and_not_its_sigma(path: Path) -> None:
    with open_map(path, writable=True) as universal:
        before = universal.root_sha256
        universal.set_transforms(align_map(universal, rounds=0).transforms)
        aligned = universal.transform("july")
        frames = list(universal.frames("july"))
        assert max(frame.pose.position_sigma_m for frame in frames) < 0.2
        universal.repose("july", {frame.frame_id: frame.driven for frame in frames})
        after = universal.transform("july")
        assert (after.shift_east_m, after.wander) == (aligned.shift_east_m, aligned.wander)
        assert after.aligned is not None
        assert after.aligned.sigma_m is None
        assert after.aligned.beside == ()
        assert {frame.pose.position_sigma_m for frame in universal.frames("july")} == {0.35}
        assert universal.verify(deep=True).problems == ()
        # It is what others are compared with as far as its receiver is sure.
        again = align_map(universal, ["june"], rounds=0)
        assert abs(again.transforms["june"].shift_east_m) < 0.05
        undo_alignment(universal)
        assert universal.root_sha256 == before


def test_frames_of_one_moment_are_one_submap(path: Path) -> None:
    """Times are for the wander; a program that has none to give may leave them out."""
    with open_map(path) as universal:
        frames = list(universal.frames("july", with_grid=True))
    still = [replace(f, driven=replace(f.driven, time_ns=0)) for f in frames]
    assert len(list(cut("july", frames))) > 5
    assert len(list(cut("july", still))) == 1


def test_who_holds_is_chosen(path: Path) -> None:
    with open_map(path) as universal:
        for given in (
            align_map(universal, to=["july"], rounds=0),
            align_map(universal, datum_from="july", rounds=0),
        ):
            by_name = {drive.name: drive for drive in given.drives}
            assert list(given.transforms) == ["june"]
            assert by_name["july"].role is Role.HOLDS
            moved = given.transforms["june"]
            assert (moved.shift_east_m, moved.shift_north_m) == pytest.approx((0.9, -0.7), abs=0.2)
        # One that only stays is followed as far as it is sure, and july is not.
        stays = align_map(universal, ["june"], rounds=0)
        assert [drive.role for drive in stays.drives] == [Role.MOVES, Role.STAYS]
        assert abs(stays.transforms["june"].shift_east_m) < 0.02
        for bad, message in (
            ({"sessions": ["may"]}, "has no session 'may'"),
            ({"sessions": ["june"], "to": ["june"]}, "is to move and to hold"),
            (
                {"to": ["june"], "datum_from": "july"},
                r"of 'june', 'july' .*'july', 'june'\. Append",
            ),
            ({"reach_m": 0.0}, "A reach of 0 m cannot be"),
        ):
            with pytest.raises(ConfigError, match=message):
                align_map(universal, **bad)  # type: ignore[arg-type]


def placed_m(path: Path, name: str, true: Drive) -> tuple[Float64, Float64]:
    """By how much the frames of a drive are off as they are placed, and what they state."""
    with open_map(path) as universal:
        poses = [frame.pose for frame in universal.frames(name)]
    pairs = zip(poses, [pose for _, pose in true], strict=True)
    off_m = [np.hypot(p.east_m - q.east_m, p.north_m - q.north_m) for p, q in pairs]
    return np.array(off_m), np.array([pose.position_sigma_m for pose in poses])


def test_a_leap_within_a_drive_is_reported_with_its_place_and_its_size(tmp_path: Path) -> None:
    true = along_one_lane("abc")
    leap = slice(10, 20)
    drives = {**true, "c": mixed(true["c"], Transform(0.6), 0.02, leap)}
    path = write_field(tmp_path / "map.gpkg", drives, 0.5)
    with open_map(path, writable=True) as universal:
        found = align_map(universal)
        universal.set_transforms(found.transforms)
    by_pair = {(pair.a, pair.b): pair for pair in found.pairs}
    assert by_pair["a", "b"].contradictions == ()
    for other in "ab":
        places = by_pair[other, "c"].contradictions
        assert places
        assert [one.sigmas for one in places] == sorted((p.sigmas for p in places), reverse=True)
        norths = [true["c"][k][1].north_m for k in range(10, 20)]
        for one in places:
            assert min(norths) < one.at_m[1] < max(norths) + 8.0
            assert np.abs(one.left_m - (0.6, 0.0)).max() < 0.15
        assert by_pair[other, "c"].sigma_m > 0.15
    for name in "abc":
        off_m, sigma_m = placed_m(path, name, true[name])
        assert (off_m < 3.0 * sigma_m).all()
        assert (sigma_m.max() < 0.05) == (name != "c")


def test_a_leap_in_a_small_part_of_a_long_drive_is_within_three_sigma(tmp_path: Path) -> None:
    field = Field()
    true = {
        name: field.drive([0.0, SPACING_M] * 3, sigma_m=0.02, seed=seed, start_s=1e5 * seed)
        for seed, name in enumerate("abc")
    }
    assert len(true["c"]) == 180
    drives = {**true, "c": mixed(true["c"], Transform(0.6), 0.02, slice(70, 80))}
    path = write_field(tmp_path / "map.gpkg", drives, 0.5)
    with open_map(path, writable=True) as universal:
        found = align_map(universal)
        universal.set_transforms(found.transforms)
    apart_m = {(pair.a, pair.b): pair.sigma_m for pair in found.pairs}
    assert apart_m["a", "b"] < 0.05
    assert min(apart_m["a", "c"], apart_m["b", "c"]) > 0.6 / 3.0
    for name in "abc":
        off_m, sigma_m = placed_m(path, name, true[name])
        assert (off_m < 3.0 * sigma_m).all()
        assert (sigma_m.max() < 0.05) == (name != "c")


def test_of_two_that_contradict_each_other_the_better_receiver_may_be_wrong(
    tmp_path: Path,
) -> None:
    field = Field()
    true = {
        name: field.drive([0.0], sigma_m=sigma_m, seed=seed, start_s=1e5 * seed)
        for seed, (name, sigma_m) in enumerate({"poor": 0.3, "rtk": 0.02}.items())
    }
    drives = {**true, "rtk": mixed(true["rtk"], Transform(1.0), 0.02, slice(10, 20))}
    path = write_field(tmp_path / "map.gpkg", drives, 0.5)
    with open_map(path, writable=True) as universal:
        universal.set_transforms(align_map(universal).transforms)
    for name, frames in true.items():
        off_m, sigma_m = placed_m(path, name, frames)
        assert (off_m < 3.0 * sigma_m).all()


def test_what_a_drive_states_more_of_stays_as_unsure_as_it_is(tmp_path: Path) -> None:
    """RTK until it is lost: one error for the whole drive says nothing of what comes after."""
    true = along_one_lane("ab")
    lost = slice(19, None)
    drives = {**true, "b": mixed(true["b"], Transform(0.4), 0.5, lost)}
    path = write_field(tmp_path / "map.gpkg", drives, 0.5)
    with open_map(path, writable=True) as universal:
        universal.set_transforms(align_map(universal).transforms)
    off_m, sigma_m = placed_m(path, "b", true["b"])
    assert (off_m < 3.0 * sigma_m).all()
    assert sigma_m[:19].max() < 0.2
    assert sigma_m[lost].min() == 0.5


def test_of_two_that_state_too_little_both_are_unsure_afterwards(tmp_path: Path) -> None:
    true = along_one_lane("ab")
    drives = {**true, "b": mixed(true["b"], Transform(0.8, 0.6), 0.02, slice(None))}
    path = write_field(tmp_path / "map.gpkg", drives, 0.5)
    with open_map(path, writable=True) as universal:
        universal.set_transforms(align_map(universal).transforms)
    for name in "ab":
        off_m, sigma_m = placed_m(path, name, true[name])
        assert off_m.mean() == pytest.approx(0.5, abs=0.05)
        assert (off_m < 3.0 * sigma_m).all()


def test_a_ridge_does_not_hide_what_lies_beyond_reach(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drives a row apart: the way from row to row looked like one along which nothing is told."""
    way = np.array([0.9, -0.7]) / math.hypot(0.9, 0.7)
    monkeypatch.setattr(agreement, "along_ridge", lambda *given: way)
    with open_map(path) as universal:
        found = align_map(universal, reach_m=0.5)
    assert "beyond the 0.5 m that --reach allows" in str(found.pairs[0].doubt)
    assert found.pairs[0].matches == 0


def test_what_lies_beyond_reach_is_a_doubt_and_moves_nothing(path: Path) -> None:
    with open_map(path) as universal:
        found = align_map(universal, reach_m=0.4, rounds=0)
        (pair,) = found.pairs
        assert "beyond the 0.4 m that --reach allows" in str(pair.doubt)
        # One that saw itself from another lane may be straightened, and lies where it lay.
        assert set(found.transforms) <= {"july"}
        for transform in found.transforms.values():
            assert np.hypot(transform.shift_east_m, transform.shift_north_m) < 0.02


@pytest.mark.parametrize(
    ("rows", "even"),
    [
        (-1.0, False),
        (1.0, True),
        pytest.param(-1.0, True, marks=pytest.mark.long),
        pytest.param(1.0, False, marks=pytest.mark.long),
    ],
)
def test_a_slip_by_one_row_is_never_believed_in_silence(
    tmp_path: Path, rows: float, even: bool
) -> None:
    """Drives along neighbouring lanes whose receivers put them into the same one, with plants that
    tell rows apart and with walls that do not."""
    field = Field(3, even=even)
    slip = Transform(rows * SPACING_M, 0.0)
    drives = {
        "a": field.drive([0.0]),
        "b": field.drive([-rows * SPACING_M], by=slip, seed=5, start_s=LATER_S),
    }
    true = dict(drives, b=field.drive([-rows * SPACING_M], seed=5, start_s=LATER_S))
    with open_map(write_field(tmp_path / "map.gpkg", drives, 0.5)) as universal:
        found = align_map(universal, reach_m=4.0)
    (pair,) = found.pairs
    if pair.doubt is None and not len(pair.agreement.alike_m):
        off = left_m(found.transforms, drives, true)
        assert np.hypot(*(off[1] - off[0])) < 0.5


@pytest.mark.parametrize("sigma_m", [0.02, pytest.param(0.35, marks=pytest.mark.long)])
def test_a_receiver_that_states_too_little_is_told_by_what_was_seen(
    tmp_path: Path, sigma_m: float
) -> None:
    """Two drives that hold the same are right, though the third states as little as they do."""
    field, off = Field(), Transform(1.3, -0.9)
    drives = {
        name: field.drive(
            [0.0], by=off if name == "c" else None, sigma_m=sigma_m, seed=seed, start_s=seed * 1e5
        )
        for seed, name in enumerate("abc", 1)
    }
    true = dict(drives, c=field.drive([0.0], seed=3, start_s=3e5))
    with open_map(write_field(tmp_path / "map.gpkg", drives, 0.5)) as universal:
        found = align_map(universal)
    left = left_m(found.transforms, drives, true)
    assert np.hypot(*(left[2] - left[0])) < 0.06
    sure = next(pair.sigma_m for pair in found.pairs if (pair.a, pair.b) == ("a", "c"))
    assert np.hypot(*(left[2] - left[0])) < 3.0 * sure
    if sigma_m < 0.1:
        assert np.abs(left[:2]).max() < 0.05


def test_a_receiver_that_wanders_by_more_than_it_states_is_told_by_what_was_seen(
    tmp_path: Path,
) -> None:
    """On the mean it is right, so that only what is left of the parts of the drive tells it."""
    field, times = Field(), tuple(int(2e14 + t * 1e9) for t in range(0, 66, 5))
    swing = tuple(0.2 * math.sin(math.pi * k / 3.0) for k in range(len(times)))
    wander = Transform(wander=Wander(times, swing, swing))
    drives = {
        "right": field.drive([0.0, 2.6], sigma_m=0.02, seed=1),
        "wrong": field.drive([0.0, 2.6], by=wander, sigma_m=0.02, seed=2, start_s=2e5),
    }
    with open_map(write_field(tmp_path / "map.gpkg", drives, 0.5)) as universal:
        found = align_map(universal)
    (pair,) = found.pairs
    assert pair.doubt is None
    assert min(drive.sigma_m for drive in found.drives) > 0.06


def test_far_apart_nothing_is_compared(tmp_path: Path) -> None:
    field = Field()
    drives = {
        "a": field.drive([0.0]),
        "b": field.drive([0.0], by=Transform(500.0, 0.0), start_s=LATER_S),
    }
    with open_map(write_field(tmp_path / "map.gpkg", drives, 0.5)) as universal:
        found = align_map(universal)
        assert found.pairs == ()
        assert found.transforms == {}
        # The one that holds is not even read where nothing is near.
        alone = align_map(universal, ["a"])
        assert [drive.name for drive in alone.drives] == ["a"]
