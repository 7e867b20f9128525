"""Heights of drives, from the ground that they saw."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.field import align_map, undo_alignment
from fieldgrid.field.align import heights
from fieldgrid.field.align.drives import Role, read_drives
from fieldgrid.field.align.heights import level
from fieldgrid.geometry import GROUND_CHANNEL, NO_GROUND_CM, Pose
from fieldgrid.maps import HeightCorrection, Transform, create_map, open_map, to_universal
from tests.field.align.field import DATUM, SPEC, Field

Error = Callable[[float], float]
"""What a receiver adds to heights, by the seconds since the start of the drive."""

LANES = (-1.3, 1.3)


def hill_m(east_m: Float64, north_m: Float64) -> Float64:
    return np.asarray(0.06 * east_m + 0.8 * np.sin(north_m / 17.0))


def rises(constant_m: float, wander_m: float = 0.0) -> Error:
    return lambda time_s: constant_m + wander_m * float(np.sin(time_s / 15.0))


def write(
    path: Path,
    drives: Mapping[str, tuple[float, Error]],
    *,
    ground: bool = True,
    canopy: float = 0.0,
    lanes: Mapping[str, tuple[float, ...]] | None = None,
    worse_from_s: float = math.inf,
) -> Path:
    """A map of drives through one field on a hill: the error that each states, and what its heights
    are off by. The last one takes a `canopy` of 1.2 m for ground in a share of the places, and
    states 0.5 m from a time on."""
    field = Field()
    with create_map(path, DATUM, cell_m=0.25) as universal:
        for number, (name, (sigma_m, error)) in enumerate(drives.items()):
            own = (lanes or {}).get(name, LANES)
            frames = field.drive(own, sigma_m=sigma_m, seed=number, start_s=1000.0 * number)
            random = np.random.default_rng(number)
            with universal.add_session(name) as session:
                for grid, pose in frames:
                    up_m = float(hill_m(np.array(pose.east_m), np.array(pose.north_m)))
                    x, y = np.meshgrid(*SPEC.centres_m())
                    heights = hill_m(*to_universal(x, y, pose)) + random.normal(0.0, 0.03, x.shape)
                    if number == len(drives) - 1:
                        heights += 1.2 * (np.sin(np.floor(y) * 7.7) > 1.0 - 2.0 * canopy)
                    heights_cm = np.rint(100.0 * (heights - up_m)).astype(np.int16)
                    heights_cm[~grid.observed] = NO_GROUND_CM
                    late_s = pose.time_ns / 1e9 - 1000.0 * number
                    is_worse = number == len(drives) - 1 and late_s >= worse_from_s
                    off = Pose(
                        pose.time_ns, pose.east_m, pose.north_m, up_m + error(late_s),
                        pose.heading_deg, 0.5 if is_worse else sigma_m, 0.3, 1.5,
                    )  # fmt: skip
                    channels = {GROUND_CHANNEL: heights_cm} if ground else {}
                    session.add(grid, off, channels=channels)
    return path


def levelled(
    path: Path, roles: Mapping[str, Role] | None = None, doubtful: tuple[int, ...] = ()
) -> dict[str, HeightCorrection | None]:
    with open_map(path) as universal:
        every = {info.name: Role.MOVES for info in universal.sessions()}
        drives = read_drives(universal, every | dict(roles or {}))
        found = level(drives, [drive.transform for drive in drives], doubtful)
        pairs = zip(drives, found.corrections, strict=True)
        return {drive.name: one for drive, one in pairs}


def kept_heights(path: Path, doubtful: tuple[int, ...] = ()) -> dict[str, str]:
    """Why heights of drives were not aligned, by their names."""
    with open_map(path) as universal:
        drives = read_drives(universal, {info.name: Role.MOVES for info in universal.sessions()})
        found = level(drives, [drive.transform for drive in drives], doubtful)
        return {drives[n].name: why for n, why in found.kept.items()}


def left_m(path: Path, name: str, correction: HeightCorrection, error: Error) -> Float64:
    """What is left of the error of each frame."""
    with open_map(path) as universal:
        times = [frame.driven.time_ns for frame in universal.frames(name)]
    first = times[0] - times[0] % 1_000_000_000_000
    return np.array([correction.at(t) + error((t - first) / 1e9) for t in times])


def test_a_poor_receiver_comes_to_the_better_one(tmp_path: Path) -> None:
    poor, good = rises(0.6, 0.2), rises(0.01)
    path = write(tmp_path / "m.gpkg", {"good": (0.02, good), "poor": (0.3, poor)})
    found = levelled(path)
    assert found["good"] is not None
    assert found["poor"] is not None
    assert np.abs(left_m(path, "good", found["good"], good)).max() < 0.04
    left = np.abs(left_m(path, "poor", found["poor"], poor))
    assert left.max() < 0.08
    assert found["poor"].least_sigma_m < 0.7
    assert found["good"].least_sigma_m < 0.05


def test_two_equal_ones_meet_half_way(tmp_path: Path) -> None:
    high, low = rises(0.5), rises(-0.3)
    path = write(tmp_path / "m.gpkg", {"high": (0.3, high), "low": (0.3, low)})
    found = levelled(path)
    assert found["high"] is not None
    assert found["low"] is not None
    of_high, of_low = (
        left_m(path, "high", found["high"], high),
        left_m(path, "low", found["low"], low),
    )
    assert of_high.mean() == pytest.approx(0.1, abs=0.03)
    assert of_low.mean() == pytest.approx(of_high.mean(), abs=0.02)


def test_the_lanes_of_one_drive_straighten_it(tmp_path: Path) -> None:
    """What both lanes saw differs by what the receiver wandered meanwhile."""
    jump: Error = lambda time_s: 0.0 if time_s < 30.0 else 0.4  # noqa: E731
    path = write(tmp_path / "m.gpkg", {"alone": (0.3, jump)})
    correction = levelled(path)["alone"]
    assert correction is not None
    left = left_m(path, "alone", correction, jump)
    assert abs(left[:20].mean() - left[-20:].mean()) < 0.1


def test_a_canopy_taken_for_ground_counts_little(tmp_path: Path) -> None:
    drives = {"good": (0.02, rises(0.0)), "poor": (0.3, rises(0.5))}
    path = write(tmp_path / "m.gpkg", drives, canopy=0.2)
    correction = levelled(path)["poor"]
    assert correction is not None
    assert np.abs(left_m(path, "poor", correction, rises(0.5))).mean() < 0.1


def stated_m(path: Path, name: str, correction: HeightCorrection) -> Float64:
    """What the placed poses of a drive state of their heights."""
    with open_map(path) as universal:
        driven = [frame.driven for frame in universal.frames(name)]
    return np.array([Transform(heights=correction).pose(pose).up_sigma_m for pose in driven])


@pytest.mark.parametrize("off_m", [1.0, 4.0])
def test_two_that_contradict_each_other_are_less_sure_than_they_state(
    tmp_path: Path, off_m: float
) -> None:
    drives = {"good": (0.02, rises(0.0)), "wrong": (0.02, rises(off_m)), "far": (0.02, rises(0.0))}
    # One that saw other ground says nothing of which is right.
    path = write(tmp_path / "m.gpkg", drives, lanes={"far": (60.0, 62.6)})
    found = levelled(path)
    assert found["far"] is not None
    assert found["far"].least_sigma_m == pytest.approx(0.0, abs=0.05)
    for name, error in (("good", rises(0.0)), ("wrong", rises(off_m))):
        correction = found[name]
        assert correction is not None
        left = np.abs(left_m(path, name, correction, error))
        assert (left < 3.0 * stated_m(path, name, correction)).all()


def test_of_three_the_one_that_contradicts_two_moves(tmp_path: Path) -> None:
    errors = {"a": rises(0.0), "wrong": rises(1.0), "c": rises(0.02)}
    path = write(tmp_path / "m.gpkg", {name: (0.02, error) for name, error in errors.items()})
    found = levelled(path)
    for name, error in errors.items():
        correction = found[name]
        assert correction is not None
        assert np.abs(left_m(path, name, correction, error)).max() < 0.06


def test_a_part_of_a_drive_that_states_more_moves_alone(tmp_path: Path) -> None:
    """RTK on the first lane, float and 0.8 m off on the second; the other drive is right."""
    late: Error = lambda time_s: 0.8 if time_s >= 30.0 else 0.0  # noqa: E731
    drives = {"right": (0.02, rises(0.0)), "mixed": (0.02, late)}
    path = write(tmp_path / "m.gpkg", drives, worse_from_s=30.0)
    correction = levelled(path)["mixed"]
    assert correction is not None
    left = np.abs(left_m(path, "mixed", correction, late))
    assert left[:20].max() < 0.08
    assert left[-20:].max() < 0.15


def test_logs_of_another_zero_are_left_alone(tmp_path: Path) -> None:
    drives = {"good": (0.02, rises(0.0)), "none": (0.3, rises(-1100.0)), "poor": (0.3, rises(0.6))}
    path = write(tmp_path / "m.gpkg", drives)
    found = levelled(path)
    assert found["none"] is None
    assert found["poor"] is not None
    assert kept_heights(path) == {"none": "they are over 100 m off: another zero, or none"}
    assert np.abs(left_m(path, "poor", found["poor"], rises(0.6))).max() < 0.06


def test_who_has_nothing_to_be_compared_with_stays(tmp_path: Path) -> None:
    drives = {"good": (0.02, rises(0.0)), "poor": (0.3, rises(0.6))}
    path = write(tmp_path / "m.gpkg", drives)
    held = levelled(path, {"good": Role.HOLDS})
    assert held["good"] is None
    assert held["poor"] is not None
    assert np.abs(left_m(path, "poor", held["poor"], rises(0.6))).max() < 0.06
    assert levelled(path, {"poor": Role.STAYS})["poor"] is None
    in_doubt = levelled(path, doubtful=(1,))
    assert in_doubt["poor"] is None
    assert in_doubt["good"] is not None  # its own lanes
    assert levelled(path, doubtful=(0, 1)) == {"good": None, "poor": None}
    without = write(tmp_path / "no.gpkg", drives, ground=False)
    assert levelled(without) == {"good": None, "poor": None}
    assert kept_heights(without, (0, 1)) == {}
    assert kept_heights(path, (1,)) == {"poor": "it is in doubt where the drive lies"}
    lanes = {"poor": (60.0,), "good": (0.0,)}
    apart = levelled(write(tmp_path / "far.gpkg", drives, lanes=lanes))["poor"]
    assert apart is not None  # with itself
    assert np.abs(apart.up_m).max() < 0.02


def test_more_than_can_be_solved_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "m.gpkg", {"good": (0.02, rises(0.0)), "poor": (0.3, rises(0.6))})
    monkeypatch.setattr(heights, "MOST_SUBMAPS", 4)
    assert levelled(path) == {"good": None, "poor": None}
    (why,) = set(kept_heights(path).values())
    assert re.fullmatch(r"\d+ pieces of 8 m are more than the 4 that are solved", why)
    # Drives in doubt do not count.
    monkeypatch.setattr(heights, "MOST_SUBMAPS", 20)
    assert levelled(path, doubtful=(1,))["good"] is not None


def test_more_pairs_that_share_ground_than_can_be_solved_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One block driven over and over: few pieces, of which each shares ground with all others."""
    path = write(tmp_path / "m.gpkg", {"good": (0.02, rises(0.0)), "poor": (0.3, rises(0.6))})
    with open_map(path) as universal:
        drives = read_drives(universal, {info.name: Role.MOVES for info in universal.sessions()})
    seen = heights._ground(drives, [Transform()] * 2)
    by_submap = [set(seen.place[seen.submap == n]) for n in np.unique(seen.submap)]
    shared = sum(bool(a & b) for a in by_submap for b in by_submap if a is not b)
    monkeypatch.setattr(heights, "MOST_SHARED", shared)
    assert levelled(path)["good"] is not None
    monkeypatch.setattr(heights, "MOST_SHARED", shared - 1)
    monkeypatch.setattr(heights, "_solve", None)
    assert levelled(path) == {"good": None, "poor": None}
    why = f"{shared} times two pieces of 8 m share ground, more than the {shared - 1} that are"
    assert set(kept_heights(path).values()) == {f"{why} solved"}


def test_priors_are_those_of_a_part_that_stays_and_one_that_wanders(tmp_path: Path) -> None:
    path = write(tmp_path / "m.gpkg", {"one": (0.02, rises(0.0)), "other": (0.3, rises(0.6))})
    with open_map(path) as universal:
        drives = read_drives(universal, {info.name: Role.MOVES for info in universal.sessions()})
    counts = [len(drive.submaps) for drive in drives]
    parts = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    stated_m = np.linspace(0.1, 0.5, sum(counts))
    # The covariance of all unknowns has that of the heights in it.
    found = np.linalg.inv(heights._prior(drives, stated_m, parts).toarray())
    assert found.shape == (sum(counts) + 2,) * 2
    for drive, part in zip(drives, parts, strict=True):
        apart_s = np.abs(np.subtract.outer(drive.time_ns, drive.time_ns)) / 1e9
        alike = 1.0 - 0.7**2 + 0.7**2 * np.exp(-apart_s / 300.0)
        expected = alike * np.outer(stated_m[part], stated_m[part])
        np.testing.assert_allclose(found[np.ix_(part, part)], expected, rtol=1e-9)
    np.testing.assert_allclose(found[np.ix_(*parts)], 0.0, atol=1e-15)


def test_drives_that_hold_and_contradict_each_other_hold(tmp_path: Path) -> None:
    off = {"one": (0.02, rises(0.0)), "other": (0.02, rises(0.3)), "poor": (0.3, rises(0.9))}
    path = write(tmp_path / "m.gpkg", off)
    with open_map(path) as universal:
        roles = {"one": Role.HOLDS, "other": Role.HOLDS, "poor": Role.MOVES}
        drives = read_drives(universal, roles)
        seen = heights._ground(drives, [drive.transform for drive in drives])
    counts = [len(drive.submaps) for drive in drives]
    parts = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    stated_m = np.repeat([heights.HELD_M, heights.HELD_M, 0.6], counts)
    up_m, _ = heights._solve(seen, drives, stated_m, parts)
    assert np.abs(up_m[np.concatenate(parts[:2])]).max() < 0.01
    assert np.abs(up_m[parts[2]] + 0.75).max() < 0.2


def test_the_ground_of_an_aligned_map_and_back_bit_for_bit(tmp_path: Path) -> None:
    drives = {"good": (0.02, rises(0.0)), "poor": (0.3, rises(0.6, 0.15))}
    path = write(tmp_path / "m.gpkg", drives)
    with open_map(path, writable=True) as universal:
        before, root = error_m(path), universal.root_sha256
        universal.set_transforms(align_map(universal).transforms)
        assert universal.verify(deep=True).problems == ()
        assert universal.transform("poor").heights is not None
        placed = [frame.pose.up_m - frame.driven.up_m for frame in universal.frames("poor")]
        assert np.mean(placed) == pytest.approx(-0.6, abs=0.15)
        after = error_m(path)
        assert before > 0.2
        assert after < 0.06
        # Another drive comes to what stays, as that is placed now.
        kept = universal.transform("poor")
        again = align_map(universal, ["good"]).transforms
        assert set(again) == {"good"}
        assert again["good"].heights is not None
        assert np.abs(again["good"].heights.up_m).max() < 0.05
        assert universal.transform("poor") == kept
        undo_alignment(universal)
        assert universal.root_sha256 == root


def error_m(path: Path) -> float:
    """The root mean square of the error of the ground that the last drive alone gives."""
    with open_map(path) as universal:
        view = universal.read(cell_m=0.5, layers=["ground"], at="poor..poor")
        found = view.layer("ground").astype(np.float64)
        east, north = np.meshgrid(*view.lattice.centres(view.window))
    off = (found - hill_m(east, north))[np.isfinite(found)]
    return float(np.sqrt(np.mean(off**2)))
