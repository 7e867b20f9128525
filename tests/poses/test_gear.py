"""Forward or reverse, on simulated tracks of which it is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.poses.gears.habits import Habits
from fieldgrid.poses.gears.holes import back_m, carried_on_nats, edge_mps, tight_nats
from fieldgrid.poses.gears.legs import GearEvidence, Gears, first_beyond, gears, turn_between
from tests.simulated import K_TURN, Command, Drive, simulate

_Float64 = npt.NDArray[np.float64]

SURE = 0.02
ROW = Command(20.0, 1.5)


def sampled(drive: Drive, step_m: float = 0.15) -> Drive:
    """The drive at stations: each `step_m` of path from the one before."""
    along = np.concatenate(
        [[0.0], np.cumsum(np.hypot(np.diff(drive.east_m), np.diff(drive.north_m)))]
    )
    at = np.searchsorted(along, np.arange(0.0, along[-1], step_m))
    return drive.at(drive.time_s[at])


def track(
    drive: Drive,
    noise_m: float = 0.01,
    *,
    seed: int = 0,
    gyro: bool = False,
    nats: float = 0.0,
) -> GearEvidence:
    """A track without holes; wheels or camera say `nats` of the gear on each way."""
    n = len(drive.time_s)
    gap_s = np.zeros(n)
    gap_s[0] = np.inf
    points = np.stack([drive.east_m, drive.north_m], axis=1)
    return GearEvidence(
        points + np.random.default_rng(seed).normal(0.0, noise_m, (n, 2)),
        drive.time_s,
        gap_s,
        np.full(n, max(noise_m, 0.002)),
        np.concatenate([[np.nan], np.degrees(np.diff(drive.heading_rad))])
        if gyro
        else np.full(n, np.nan),
        nats * drive.gear(),
    )


def plain(points: _Float64, gap_s: _Float64, sigma_m: float) -> GearEvidence:
    """Ten positions a second, of which nothing else tells."""
    n = len(points)
    return GearEvidence(
        points, 0.1 * np.arange(n), gap_s, np.full(n, sigma_m), np.full(n, np.nan), np.zeros(n)
    )


def wrong_m(found: Gears, drive: Drive) -> float:
    """Metres driven in another gear than the one found."""
    way = np.hypot(np.diff(drive.east_m), np.diff(drive.north_m))
    off = (found.gear != drive.gear()) & (drive.gear() != 0)
    return float(way[off[1:] & off[:-1]].sum())


# --- manoeuvres


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize(("noise_m", "step_m"), [(0.005, 0.08), (0.02, 0.15), (0.05, 0.25)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_k_turn_backs_up_once(side: int, noise_m: float, step_m: float, gyro: bool) -> None:
    turn = [c._replace(curvature_per_m=side * c.curvature_per_m) for c in K_TURN]
    drive = sampled(simulate(turn, 35.0), step_m)
    for seed in range(10):
        found = gears(track(drive, noise_m, seed=seed, gyro=gyro))
        assert wrong_m(found, drive) < 1.0
        assert set(found.gear.tolist()) == {1, -1}
        assert found.doubt.max() < 0.2
        if gyro:
            assert found.doubt.max() < SURE
        assert found.driven[[0, -1]].all()


def test_a_cusp_is_one_cut() -> None:
    """Around a cusp every point is as sharp as the tip: two tips would hide it between them."""
    drive = sampled(simulate(K_TURN, 35.0), 0.05)
    for seed in range(20):
        found = gears(track(drive, 0.01, seed=seed))
        assert len(set(found.leg.tolist())) == 3
        tips = np.flatnonzero(np.diff(found.leg)) + 1
        true = np.flatnonzero(np.diff(np.sign(drive.speed_mps)) != 0)
        where = np.stack([drive.east_m, drive.north_m], axis=1)
        for tip in tips:
            assert np.hypot(*(where[true] - where[tip]).T).min() < 0.3


@pytest.mark.parametrize("middle_m", [0.7, 1.0, 1.5])
@pytest.mark.parametrize("noise_m", [0.005, 0.02])
def test_a_three_point_turn_with_a_short_middle(middle_m: float, noise_m: float) -> None:
    """Right about the middle, or in doubt of it; sure and right about the rest."""
    drive = sampled(
        simulate(
            [
                ROW,
                Command(4.0, 1.2, 0.25),
                Command(middle_m / 0.5 + 2.3, -0.5, -0.25),
                Command(4.5, 1.2, 0.25),
                ROW,
            ]
        ),
        0.1,
    )
    rows = (drive.time_s < 15.0) | (drive.time_s > drive.time_s[-1] - 15.0)
    for seed in range(10):
        found = gears(track(drive, noise_m, seed=seed))
        assert (found.gear[rows] == 1).all()
        wrong = (found.gear != drive.gear()) & (drive.gear() != 0) & (found.doubt < SURE)
        assert np.count_nonzero(wrong) <= 4  # 0.4 m beside the cusps


@pytest.mark.parametrize("radius_m", [2.0, 3.0, 6.0])
@pytest.mark.parametrize("step_m", [0.2, 1.5])
def test_a_u_turn_is_no_reverse(radius_m: float, step_m: float) -> None:
    """Also from a receiver of 1 Hz, which sees it in a few points."""
    seconds = np.pi * radius_m / 1.5 + 0.5
    drive = simulate([ROW, Command(seconds, 1.5, 1.0 / radius_m), ROW], 10.0, speed_mps=1.5)
    for seed in range(10):
        found = gears(track(sampled(drive, step_m), 0.02, seed=seed))
        assert (found.gear == 1).all()
        assert found.doubt.max() < SURE


def test_out_of_a_dead_end_in_reverse() -> None:
    into = [Command(20.0, 1.5), Command(22.0, -1.4), Command(5.0, 1.2, 0.25), ROW]
    drive = sampled(simulate(into, -100.0), 0.15)
    found = gears(track(drive, 0.02))
    assert wrong_m(found, drive) < 1.0
    assert found.doubt.max() < 0.1


@pytest.mark.parametrize("dwell", [0.03, 0.15])
def test_a_stop_is_no_manoeuvre(dwell: float) -> None:
    """A standing receiver's positions wander; their path is skipped."""
    drive = sampled(simulate([ROW, Command(3.0, 0.0), ROW]), 0.15)
    middle = len(drive.time_s) // 2
    for seed in range(10):
        random = np.random.default_rng(seed)
        whole = track(drive, 0.01, seed=seed)
        wander = whole.points_m[middle] + np.cumsum(random.normal(0.0, dwell, (12, 2)), axis=0)
        wander -= np.linspace(0.0, 1.0, 12)[:, None] * (wander[-1] - wander[0])
        points = np.insert(whole.points_m, middle, wander, axis=0)
        n = len(points)
        gap_s = np.zeros(n)
        gap_s[0] = np.inf
        found = gears(plain(points, gap_s, 0.01))
        driven = np.r_[0 : middle - 8, middle + 20 : n]
        assert (found.gear[driven] == 1).all()
        assert found.doubt[driven].max() < 0.1


# --- what else tells


def test_a_camera_sees_a_drive_that_is_all_reverse() -> None:
    drive = sampled(simulate([Command(20.0, -1.2, 0.03)], 40.0), 0.3)
    blind, seen = gears(track(drive)), gears(track(drive, nats=4.0))
    assert (blind.gear == 1).all()  # by habit
    assert (seen.gear == -1).all()
    assert seen.doubt.max() < 1e-6


def test_weak_words_against_the_habit_leave_doubt() -> None:
    drive = sampled(simulate([Command(10.0, -1.0)], 40.0), 0.3)
    own = track(drive)
    ways = len(drive.time_s) - 1
    length_m = np.hypot(*np.diff(own.points_m, axis=0).T).sum()
    usual = Habits.usual()
    forward, reverse = np.logaddexp.reduce(usual.share[:, None] + usual.leg(length_m, 15.0)).T
    even = -(forward - reverse + 2.0) / ways  # as much as habit and beginning say
    found = gears(own._replace(forward_nats=np.r_[0.0, np.full(ways, even)]))
    assert found.doubt == pytest.approx(0.5, abs=0.01)
    more = gears(own._replace(forward_nats=np.r_[0.0, np.full(ways, even - 2.0 / ways)]))
    assert (more.gear == -1).all()
    assert more.doubt == pytest.approx(1.0 / (1.0 + np.exp(2.0)), abs=0.01)


def _turn_about(on_the_spot: bool) -> Drive:
    """Thirty metres out and back on the same line: backed up, or turned about in the end."""
    out = simulate([Command(15.0, 1.5)], 20.0, speed_mps=1.5)
    back = out.at(out.time_s[::-1])
    heading = back.heading_rad + (np.pi if on_the_spot else 0.0)
    speed = back.speed_mps * (1.0 if on_the_spot else -1.0)
    both = (np.concatenate([a, b[1:]]) for a, b in zip(out, back, strict=True))
    drive = Drive(*both)
    n = len(out.time_s)
    return drive._replace(
        time_s=np.arange(len(drive.time_s)) * 0.01,
        heading_rad=np.concatenate([out.heading_rad, heading[1:]]),
        speed_mps=np.concatenate([out.speed_mps, speed[1:]])[: 2 * n - 1],
    )


@pytest.mark.parametrize("on_the_spot", [True, False])
def test_a_gyro_settles_what_positions_cannot(on_the_spot: bool) -> None:
    drive = sampled(_turn_about(on_the_spot), 0.3)
    whole, told = track(drive, 0.005), track(drive, 0.005, gyro=True)
    found = gears(told)
    assert wrong_m(found, drive) < 0.7
    # Which of the two ways was backed up, no gyro tells; only that a drive begins forward.
    assert found.doubt.max() < (SURE if on_the_spot else 0.2)
    # Positions alone are the same in both cases.
    assert set(gears(whole).gear.tolist()) == {1, -1}
    holed = told.turned_deg.copy()
    holed[1] = np.nan  # far from where the drive turns back
    assert np.array_equal(gears(told._replace(turned_deg=holed)).gear, found.gear)


def test_doubt_is_high_where_the_track_says_nothing() -> None:
    """Two ways from a point, at right angles: a turn on the spot, or a change of gear."""
    along = np.arange(0.0, 6.0, 0.15)
    points = np.concatenate(
        [
            np.stack([np.zeros_like(along), along], axis=1),
            np.stack([along[1:], np.full(along.size - 1, along[-1])], axis=1),
        ]
    )
    n = len(points)
    gap_s = np.zeros(n)
    gap_s[0] = np.inf
    found = gears(plain(points, gap_s, 0.005))
    assert found.doubt.max() > SURE
    straight = np.stack([np.zeros(n), np.arange(n) * 0.15], axis=1)
    sure = gears(
        GearEvidence(
            straight, 0.1 * np.arange(n), gap_s, np.full(n, 0.005), np.full(n, np.nan), np.zeros(n)
        )
    )
    assert len(set(sure.leg.tolist())) == 1
    assert sure.doubt.max() < found.doubt.max()


def test_a_leg_that_may_have_been_driven_is_in_doubt() -> None:
    """0.7 m back and forth at a waiting place: wander or not, one cannot tell."""
    ahead, back = np.arange(0.0, 20.0, 0.1), np.arange(19.9, 19.2, -0.1)
    north = np.concatenate([ahead, back, np.arange(19.3, 40.0, 0.1)])
    points = np.stack([np.zeros_like(north), north], axis=1)
    n = len(points)
    gap_s = np.zeros(n)
    gap_s[0] = np.inf
    found = gears(plain(points, gap_s, 0.005))
    middle = slice(ahead.size + 1, ahead.size + back.size - 1)
    assert (found.doubt[middle] > SURE).all() or (found.gear[middle] == -1).all()
    assert (found.gear[: ahead.size - 4] == 1).all()
    assert (found.gear[-180:] == 1).all()
    assert found.doubt[[0, -1]].max() < SURE


# --- holes


def test_a_hole_begins_a_leg_and_knows_nothing_of_before() -> None:
    drive = sampled(simulate([Command(60.0, 1.5)], speed_mps=1.5), 0.15)
    whole = track(drive)
    middle = len(drive.time_s) // 2
    gap_s = whole.gap_s.copy()
    gap_s[middle] = 30.0
    found = gears(whole._replace(gap_s=gap_s))
    assert np.flatnonzero(np.diff(found.leg)).tolist() == [middle - 1]
    assert (found.gear == 1).all()
    # After it a short leg may be either gear.
    tail = 12
    short = GearEvidence(*(column[: middle + tail] for column in whole._replace(gap_s=gap_s)))
    unsure = gears(short)
    assert unsure.doubt[middle:].min() > 5.0 * unsure.doubt[0]


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_the_shortest_tracks(n: int) -> None:
    gap_s = np.zeros(n)
    gap_s[:1] = np.inf
    points = np.stack([np.zeros(n), np.arange(n) * 1.0], axis=1)
    found = gears(plain(points, gap_s, 0.02))
    assert [len(column) for column in found] == [n] * 4
    assert (found.gear == 1).all()
    if n:
        assert 0.02 < found.doubt[0] < 0.2  # a drive begins forward, says habit alone


# --- symmetries


@settings(deadline=None, max_examples=25)
@given(
    st.floats(-180.0, 180.0),
    st.floats(-5000.0, 5000.0),
    st.floats(-5000.0, 5000.0),
    st.integers(0, 50),
)
def test_where_and_whither_does_not_matter(
    turn_deg: float, east_m: float, north_m: float, seed: int
) -> None:
    own = track(sampled(simulate(K_TURN), 0.15), 0.02, seed=seed)
    angle = np.radians(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    a, b = gears(own), gears(own._replace(points_m=own.points_m @ turn + [east_m, north_m]))
    assert np.array_equal(a.leg, b.leg)
    assert np.array_equal(a.gear, b.gear)
    assert b.doubt == pytest.approx(a.doubt, rel=1e-3, abs=1e-9)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 100))
def test_a_mirrored_track_has_the_same_gears(seed: int) -> None:
    own = track(sampled(simulate(K_TURN), 0.15), 0.02, seed=seed, gyro=True)
    mirrored = own._replace(points_m=own.points_m * [-1.0, 1.0], turned_deg=-own.turned_deg)
    a, b = gears(own), gears(mirrored)
    assert np.array_equal(a.gear, b.gear)
    assert b.doubt == pytest.approx(a.doubt, rel=1e-6, abs=1e-12)


def test_backwards_in_time_only_the_habit_differs() -> None:
    """The same path the other way round: what was driven forward is backed up, but for the
    habit, which says that the longer ways are forward in both."""
    drive = sampled(simulate(K_TURN), 0.15)
    ahead = gears(track(drive, 0.0))
    back = drive.at(drive.time_s[::-1])
    backward = gears(track(back, 0.0))
    assert abs(np.count_nonzero(backward.gear[::-1] != ahead.gear)) <= 6
    changes = [np.flatnonzero(np.diff(g)) for g in (ahead.gear, backward.gear[::-1])]
    assert len(changes[0]) == len(changes[1]) == 2
    # Told the true gears, it swaps them.
    reversed_drive = back._replace(speed_mps=-back.speed_mps)
    told = gears(track(reversed_drive, 0.0, nats=3.0))
    assert np.count_nonzero(told.gear[::-1] != -ahead.gear) <= 6


@settings(deadline=None, max_examples=25)
@given(st.floats(1.0, 30.0), st.sampled_from([1, -1]), st.floats(0.05, 0.3))
def test_turning_in_an_arc_is_that_of_its_chords(radius_m: float, side: int, step_m: float) -> None:
    angle = side * np.arange(0.0, 3.0, step_m / radius_m)
    points = radius_m * np.stack([1.0 - np.cos(angle), np.sin(np.abs(angle))], axis=1)
    points[:, 0] *= side
    reach_m = 0.5
    part = np.zeros(len(points), dtype=np.int64)
    ends = (first_beyond(points, reach_m, step, part) for step in (-1, 1))
    found = turn_between(points, *ends)
    chord = 2.0 * np.arcsin(reach_m / (2.0 * radius_m))
    known = found != 0.0
    assert known[len(points) // 2]
    assert not known[0]
    assert not known[-1]
    # A chord's end lies up to one step beyond reach.
    assert (side * found[known] >= np.degrees(chord) - 1e-6).all()
    assert (side * found[known] <= np.degrees(chord + step_m / radius_m) + 1e-6).all()


ORDER: Sequence[int] = (0, 1)


def test_the_same_track_has_the_same_bits() -> None:
    own = track(sampled(simulate(K_TURN), 0.15), 0.03)
    a, b = (gears(own) for _ in ORDER)
    for one, other in zip(a, b, strict=True):
        assert np.array_equal(one, other)


def with_holes(
    whole: GearEvidence, hole_s: float, phase_s: float
) -> tuple[GearEvidence, npt.NDArray[np.bool_]]:
    """A track of which nothing is seen for so long in every 10 s, and what of it is seen."""
    seen = (whole.time_s + phase_s) % 10.0 < 10.0 - hole_s
    time_s = whole.time_s[seen]
    apart_s = np.diff(time_s, prepend=-np.inf)
    part = GearEvidence(*(column[seen] for column in whole))
    return part._replace(gap_s=np.where(apart_s > 2.0, apart_s, 0.0)), seen


@pytest.mark.parametrize(
    ("commands", "accepted"),
    [(K_TURN, 0.5), ([ROW, Command(8.0, 1.2, 0.3), ROW], 0.7)],
)
def test_a_cusp_in_a_hole_leaves_doubt(commands: list[Command], accepted: float) -> None:
    """K-turns whose cusps nobody saw, or saw begin at the edge of a hole: what is sure is right.
    The radius that was seen, and speeds, tell them from a turn forward, which stays as sure."""
    drive = sampled(simulate(commands, 35.0, speed_mps=1.5))
    sure, right = [], []
    for phase in range(10):
        seen, at = with_holes(track(drive, seed=phase), 5.0, float(phase))
        found = gears(seen)
        moving = np.abs(drive.speed_mps[at]) > 0.3
        sure.append((found.doubt <= SURE)[moving])
        right.append((found.gear == drive.gear()[at])[moving])
    is_sure = np.concatenate(sure)
    assert is_sure.mean() > accepted
    assert np.concatenate(right)[is_sure].mean() > 0.985


def _between_holes(backs_up: Sequence[bool], seen: Sequence[bool]) -> tuple[GearEvidence, slice]:
    """Rows north with a hole of 8 s in each, in which some back up by 4 m and some of these are
    seen to do so; and what is driven after the last hole, which nobody can tell."""
    points, gaps, north = [], [], 0.0
    for backs, is_seen in zip(backs_up, seen, strict=True):
        ahead = north + np.arange(0.0, 15.0, 0.15)
        back = ahead[-1] - np.arange(0.15, 4.0, 0.15) if backs and is_seen else np.zeros(0)
        on = (back[-1] if back.size else ahead[-1]) + np.arange(0.15, 12.0, 0.15)
        points += [*ahead, *back, *on]
        gaps += [8.0, *np.zeros(len(ahead) + len(back) + len(on) - 1)]
        north = on[-1] + 11.5
    last = points[-1] + 5.0 + np.arange(0.0, 3.0, 0.15)
    after = slice(len(points), len(points) + len(last))
    points, gaps = [*points, *last], [*gaps, 8.0, *np.zeros(len(last) - 1)]
    gap_s = np.array(gaps)
    gap_s[0] = np.inf
    track = plain(np.stack([np.zeros(len(points)), points], axis=1), gap_s, 0.01)
    step_s = np.where(gap_s > 0.0, gap_s, 0.1)
    step_s[0] = 0.0
    return track._replace(time_s=np.cumsum(step_s)), after


def test_who_is_seen_to_back_up_may_do_so_in_a_hole() -> None:
    """The same hole leaves more doubt in a drive that turns back in each row than in one that
    never does, and less the longer it never does."""
    doubts = []
    for backs_up in ([False] * 60, [False] * 3, [True] * 12):
        evidence, after = _between_holes(backs_up, backs_up)
        found = gears(evidence)
        assert (found.gear[after] == 1).all()
        doubts.append(float(found.doubt[after].max()))
    assert doubts[0] < 0.75 * doubts[1]
    assert 2.0 * doubts[1] < doubts[2]


def test_a_long_way_is_forward_however_long() -> None:
    points = np.stack([np.zeros(4000), np.arange(4000) * 5.0], axis=1)
    gap_s = np.zeros(4000)
    gap_s[0] = np.inf
    found = gears(plain(points, gap_s, 0.02))
    assert (found.gear == 1).all()
    assert found.doubt.max() < 1e-4


def test_who_shunts_where_every_way_back_begins_in_a_hole_is_not_taken_for_sure() -> None:
    """Back and forth by the same, one of each pair of cusps seen and the other not: which is which
    tells neither habit nor where the holes lie, but a little the beginning."""
    pieces, gaps, at_m = [], [], 0.0
    for stroke in range(24):
        way = 1.0 if stroke % 2 == 0 else -1.0
        ways = at_m + way * np.arange(0.15, 9.0, 0.15)
        hidden = stroke % 2 == 1
        pieces += [*(ways[10:] if hidden else ways)]
        gaps += [3.2 if hidden else 0.0, *np.zeros(len(ways) - 1 - 10 * hidden)]
        at_m = ways[-1]
    gap_s = np.array(gaps)
    gap_s[0] = np.inf
    track = plain(np.stack([np.zeros(len(pieces)), pieces], axis=1), gap_s, 0.01)
    step_s = np.where(gap_s > 0.0, gap_s, 0.1)
    step_s[0] = 0.0
    mirrored = track._replace(
        points_m=track.points_m[::-1],
        gap_s=np.concatenate([[np.inf], track.gap_s[:0:-1]]),
        time_s=np.cumsum(np.concatenate([[0.0], step_s[:0:-1]])),
    )
    for one in (track._replace(time_s=np.cumsum(step_s)), mirrored):
        found = gears(one)
        assert found.gear[0] == 1
        assert found.doubt.min() > SURE


def test_a_change_of_gear_weighs_the_same_both_ways() -> None:
    usual = Habits.usual()
    stay, change = usual.hole(12.0, 0.0)
    assert change.shape == usual.cusp().shape == usual.share.shape
    # Of nothing that is known of the hole both gears are as likely as the drive has them.
    backward, forward = 1.0 / usual.back_per_m, 1.0 / usual.forth_per_m
    share = np.stack([backward, forward], axis=1)
    share /= share.sum(axis=1, keepdims=True)
    far = np.exp(np.stack(usual.hole(1e5, 0.0)[0].T, axis=1))
    assert far == pytest.approx(share, rel=1e-3)
    assert np.exp(usual.hole(1e5, 0.0)[1]) == pytest.approx(np.sqrt(share.prod(axis=1)), rel=1e-3)
    assert (np.exp(change) < 1.0).all()
    assert (np.exp(stay[:, 0]) > 0.3).all()
    # Rare and frequent changes, as often back: of what is seen, the root of how often.
    cusps, legs = usual.cusp(), usual.leg(300.0, 15.0)
    rare, often = (
        int(np.argmax(backward)),
        int(np.argmax(np.where(forward == 5.0, -backward, -1e9))),
    )
    assert cusps[often] - cusps[rare] == pytest.approx(np.log(backward[rare] / backward[often]) / 2)
    assert legs[rare, 0] - legs[often, 0] == pytest.approx(300.0 / backward[often] - 0.3)
    # Little way hides no change.
    assert np.exp(usual.hole(0.01, 0.0)[1]).max() < 0.01


def test_who_turns_back_in_a_hole_loses_the_time_to_stop() -> None:
    """At full speed at both edges he comes far less far than his speed makes; at rest at one of
    them he may have turned back right there, and the distance tells nothing."""
    full = back_m((1.5, 1.5), (1.5, 1.5), 8.0)
    resting = back_m((1.5, 1.5), (1.5, 0.0), 8.0)
    assert full == pytest.approx(1.5 * (8.0 - 2.0))
    assert resting == pytest.approx(1.5 * (8.0 - 1.0) + 0.75)
    assert carried_on_nats(12.0, 12.0, full, 0.02) > 2.0
    assert carried_on_nats(12.0, 12.0, resting, 0.02) < 1.5
    # Slower one way: what he comes at most is that of the faster.
    assert back_m((1.8, 1.2), (1.8, 1.2), 8.0) > back_m((1.2, 1.2), (1.2, 1.2), 8.0)


@pytest.mark.parametrize("stops", [True, False])
def test_who_stops_at_the_edge_of_a_hole_may_turn_back_there(stops: bool) -> None:
    """A hole of 8 s across which he comes as far as at full speed, or begins it at rest."""
    ahead = np.arange(0.0, 20.0, 0.15)
    if stops:
        ahead = np.append(ahead, ahead[-1] + 0.1 * np.cumsum([1.2, 0.9, 0.6, 0.4, 0.2, 0.1, 0.0]))
    points = np.concatenate([ahead, ahead[-1] + 12.0 + np.arange(0.0, 3.0, 0.15)])
    gap_s = np.zeros(len(points))
    gap_s[0], gap_s[len(ahead)] = np.inf, 8.0
    track = plain(np.stack([np.zeros_like(points), points], axis=1), gap_s, 0.01)
    step_s = np.where(np.isfinite(gap_s) & (gap_s > 0.0), gap_s, 0.1)
    doubt = gears(track._replace(time_s=np.cumsum(step_s))).doubt[-1]
    assert (doubt > 0.0005) == stops


def test_the_speed_at_an_edge_is_that_of_its_last_half_second() -> None:
    time_s = np.arange(0.0, 2.05, 0.1)
    points = np.stack([np.zeros(21), np.minimum(1.5 * time_s, 2.25)], axis=1)
    assert edge_mps(points, time_s, 20, 0) == pytest.approx(0.0, abs=1e-9)
    assert edge_mps(points, time_s, 0, 20) == pytest.approx(1.5)
    assert edge_mps(points, time_s, 7, 7) == 0.0


def test_a_distance_that_no_speed_makes_says_nothing_of_turns() -> None:
    """Beside a hole of two seconds at 1.5 m/s: 2 m back where it came from takes a turn, and 12 m
    a jump of the positions; in eight seconds a vehicle may have sped up."""
    near, far = (np.array([0.0, -way_m]) for way_m in (2.0, 12.0))
    assert tight_nats(near, (0.0, 0.0), 2.0, 3.0, 2.0, 0.02) > 10.0
    assert tight_nats(far, (0.0, 0.0), 2.0, 3.0, 2.0, 0.02) == 0.0
    assert tight_nats(far, (0.0, 0.0), 2.0, 3.0, 8.0, 0.02) > 10.0
