"""All drives at once, by matches that are made up."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.field.align.drives import Role, SubmapDrive
from fieldgrid.field.align.matches import Match
from fieldgrid.field.align.network import FACE_M, NetworkSolution, solve
from fieldgrid.field.align.submaps import Submap
from fieldgrid.maps import Transform

N = 8
MIDDLE_M = np.column_stack([np.zeros(N), np.linspace(-30.0, 30.0, N)])


def drive(name: str, sigma_m: float, role: Role = Role.MOVES) -> SubmapDrive:
    """A drive north past the origin in two minutes."""
    time_ns = (np.linspace(0.0, 120.0, N) * 1e9).astype(np.int64)
    submaps = tuple(Submap(name, ()) for _ in range(N))
    return SubmapDrive(
        name,
        role,
        submaps,
        Transform(),
        sigma_m,
        0.7 * sigma_m,
        time_ns,
        MIDDLE_M,
        np.zeros(2),
        sigma_m,
    )


def matches(
    off: dict[int, Float64], pairs: list[tuple[int, int]], sigma_m: float = 0.02
) -> list[Match]:
    """What drives that are off [N, 2] show against each other, a match a submap."""
    information = np.eye(2) / sigma_m**2
    return [
        Match(
            a,
            k,
            b,
            k,
            MIDDLE_M[k],
            np.zeros(2),
            np.zeros(2),
            1.0,
            off[b][k] - off[a][k],
            information,
        )
        for a, b in pairs
        for k in range(N)
    ]


def constant(east_m: float, north_m: float) -> Float64:
    return np.tile([east_m, north_m], (N, 1))


def moved(solution: NetworkSolution, n: int) -> Float64:
    """What the transform of a drive does to its submaps [N, 2]."""
    times = drive("", 1.0).time_ns
    placed = solution.transforms[n].points(MIDDLE_M[:, 0], MIDDLE_M[:, 1], times)
    return np.column_stack(placed) - MIDDLE_M


def test_the_better_receiver_holds_and_the_worse_comes_to_it() -> None:
    drives = [drive("rtk", 0.02), drive("sf1", 0.3)]
    found = solve(
        drives, [Transform()] * 2,
        matches({0: constant(0.0, 0.0), 1: constant(0.3, -0.2)}, [(0, 1)]))  # fmt: skip
    assert np.abs(moved(found, 0)).max() < 0.01
    assert moved(found, 1) == pytest.approx(constant(-0.3, 0.2), abs=0.02)
    assert found.sigma_m[0, 1] < 0.06
    assert found.sigma_m[1, 1] < 0.08
    assert found.turn_sigma_deg[1] < 0.2


def test_equal_receivers_meet_half_way_and_neither_is_sure_of_the_place() -> None:
    drives = [drive("a", 0.3), drive("b", 0.3)]
    found = solve(
        drives, [Transform()] * 2,
        matches({0: constant(0.0, 0.0), 1: constant(0.3, 0.0)}, [(0, 1)]))  # fmt: skip
    assert moved(found, 0) == pytest.approx(constant(0.15, 0.0), abs=0.02)
    assert moved(found, 1) == pytest.approx(constant(-0.15, 0.0), abs=0.02)
    assert found.sigma_m[0, 0] > 0.2
    assert found.sigma_m[0, 1] < 0.06


def test_who_is_held_stays_bit_for_bit() -> None:
    held = Transform(0.1, 0.2, 0.0, 3.0, 4.0)
    drives = [drive("a", 0.3, Role.HOLDS), drive("b", 0.01)]
    found = solve(
        drives, [held, Transform()],
        matches({0: constant(0.0, 0.0), 1: constant(0.3, 0.0)}, [(0, 1)]))  # fmt: skip
    assert found.transforms[0] is held
    # The matches were made with `a` at its transform: b comes to where a is.
    assert moved(found, 1) == pytest.approx(constant(-0.3, 0.0), abs=0.03)


def test_who_stays_though_it_is_poor_is_not_followed() -> None:
    """A poor drive beside a good one, neither of which is to move: the third comes to the good."""
    off = {0: constant(0.0, 0.0), 1: constant(0.5, 0.0), 2: constant(0.2, 0.0)}
    drives = [
        drive("good", 0.02, Role.STAYS), drive("poor", 0.5, Role.STAYS), drive("new", 0.5),
    ]  # fmt: skip
    found = solve(drives, [Transform()] * 3, matches(off, [(0, 1), (0, 2), (1, 2)]))
    assert found.transforms[0].is_identity
    assert found.transforms[1].is_identity
    assert moved(found, 2) == pytest.approx(constant(-0.2, 0.0), abs=0.03)


def test_a_turn_and_a_wander_are_told_apart_from_a_shift() -> None:
    turn = np.radians(0.4)
    by_turn = np.column_stack([MIDDLE_M[:, 1] * turn, -MIDDLE_M[:, 0] * turn])
    wave = 0.15 * np.column_stack([np.zeros(N), np.sin(np.linspace(0.0, 3.0, N))])
    off = {0: constant(0.0, 0.0), 1: constant(0.5, 0.1) + by_turn + wave}
    told = [m._replace(turn_deg=-0.4, turn_information=100.0) for m in matches(off, [(0, 1)])]
    drives = [drive("a", 0.02, Role.HOLDS), drive("b", 0.3)]
    found = solve(drives, [Transform()] * 2, told)
    assert moved(found, 1) == pytest.approx(-off[1], abs=0.06)
    assert found.transforms[1].turn_deg == pytest.approx(-0.4, abs=0.1)
    assert found.transforms[1].wander is not None


def test_matches_that_contradict_the_rest_lose_their_weight() -> None:
    off = {0: constant(0.0, 0.0), 1: constant(0.2, 0.1)}
    some = matches(off, [(0, 1)])
    some[2] = some[2]._replace(shift_m=np.array([1.4, -1.0]))
    found = solve([drive("a", 0.02), drive("b", 0.3)], [Transform()] * 2, some)
    assert moved(found, 1) == pytest.approx(constant(-0.2, -0.1), abs=0.04)
    assert found.misfit[2] > 5.0


def test_what_contradicts_the_others_is_left_between_two() -> None:
    off = {n: constant(0.0, 0.0) for n in range(3)}
    lying = {0: constant(0.0, 0.0), 2: constant(0.3, 0.0)}
    some = [*matches(off, [(0, 1), (1, 2)]), *matches(lying, [(0, 2)])]
    found = solve([drive(name, 0.05) for name in "abc"], [Transform()] * 3, some)
    left = found.left_m.reshape(3, N, 2).mean(axis=1)
    assert left[2, 0] > 0.08
    assert (left[0] - left[2] + left[1])[0] == pytest.approx(-0.3, abs=1e-6)


def test_of_four_receivers_the_one_that_lies_is_moved() -> None:
    off = {n: constant(0.0, 0.0) for n in range(3)} | {3: constant(2.0, 0.0)}
    pairs = [(a, b) for a in range(4) for b in range(a + 1, 4)]
    drives = [drive(name, 0.02) for name in "abcd"]
    found = solve(drives, [Transform()] * 4, matches(off, pairs))
    for n in range(3):
        assert np.abs(moved(found, n)).max() < 0.05
    assert moved(found, 3) == pytest.approx(constant(-2.0, 0.0), abs=0.05)


def test_the_faces_of_a_row_are_apart_and_along_it_other_leaves_say_little() -> None:
    off = {0: constant(0.0, 0.0), 1: constant(FACE_M, 0.4)}
    across = np.array([1.0, 0.0])
    some = [match._replace(across=across) for match in matches(off, [(0, 1)])]
    found = solve([drive("a", 0.02, Role.HOLDS), drive("b", 0.3)], [Transform()] * 2, some)
    assert np.abs(moved(found, 1)[:, 0]).max() < 0.03
    assert found.face_m == pytest.approx(FACE_M, abs=0.02)
    assert found.sigma_m[0, 1] > 0.08


def test_submaps_of_one_drive_straighten_it_and_do_not_move_it() -> None:
    drives = [drive("a", 0.3)]
    information = np.eye(2) / 0.02**2
    some = [
        Match(
            0,
            0,
            0,
            N - 1,
            MIDDLE_M[0],
            np.zeros(2),
            np.zeros(2),
            1.0,
            np.array([0.2, 0.0]),
            information,
        )
    ]
    found = solve(drives, [Transform()], some)
    by = moved(found, 0)
    assert by[0, 0] - by[-1, 0] == pytest.approx(0.2, abs=0.06)
    assert np.abs(by.mean(axis=0)).max() < 0.05
    assert 0.25 < found.sigma_m[0, 0] < 0.5


def test_without_matches_a_drive_is_as_sure_as_its_receiver() -> None:
    found = solve([drive("a", 0.3)], [Transform()], [])
    assert np.abs(moved(found, 0)).max() < 1e-9
    assert 0.3 < found.sigma_m[0, 0] < 0.5


@pytest.mark.parametrize("poor", [1, 2])
def test_drives_that_follow_a_leap_of_a_better_one_are_as_unsure_as_that(poor: int) -> None:
    """Half way the better receiver, which is the last one, is 1.5 m off: the others bend."""
    leap = np.where(np.arange(N)[:, None] < N // 2, 0.0, [[1.5, 0.0]])
    off = {n: constant(0.0, 0.0) for n in range(poor)} | {poor: leap}
    drives = [*(drive(name, 0.3) for name in "ab"[:poor]), drive("rtk", 0.02)]
    pairs = [(n, poor) for n in range(poor)] + ([(0, 1)] if poor == 2 else [])
    some = matches(off, pairs)
    solution = solve(drives, [Transform()] * len(drives), some)
    for n in range(len(drives)):
        off_m = np.hypot(*(moved(solution, n) + off[n]).T)
        assert (off_m < 3.0 * solution.sigma_m[n, n]).all()


@pytest.mark.parametrize("stated_m", [(0.02, 0.02), (0.02, 0.3)])
def test_a_match_that_stands_alone_does_not_make_drives_less_sure(
    stated_m: tuple[float, float],
) -> None:
    drives = [drive(name, sigma_m) for name, sigma_m in zip("ab", stated_m, strict=True)]
    good = matches({0: constant(0.0, 0.0), 1: constant(0.0, 0.0)}, [(0, 1)] * 3)
    wrong = [*good[:-1], good[-1]._replace(shift_m=np.array([2.0, -1.8]))]
    without, with_it = (solve(drives, [Transform()] * 2, some) for some in (good, wrong))
    assert (with_it.sigma_m < 1.5 * without.sigma_m).all()
    assert np.abs(moved(with_it, 1)).max() < 0.02


def test_of_two_camps_that_nobody_can_tell_apart_the_sigma_covers_both() -> None:
    off = {0: constant(0.0, 0.0), 1: constant(0.0, 0.0)}
    camps = matches(off, [(0, 1)]) + matches({**off, 1: constant(0.8, 0.0)}, [(0, 1)])
    found = solve([drive("a", 0.02), drive("b", 0.3)], [Transform()] * 2, camps)
    for camp in off[1], constant(0.8, 0.0):
        assert np.hypot(*(moved(found, 1) + camp).mean(axis=0)) < 3.0 * found.sigma_m[0, 1]
    assert (found.misfit > 4.0).any()


@pytest.mark.parametrize(
    ("rounds", "wrong"), [(1, 0.0), (3, 0.1), (3, 0.45), (10, 0.1), (10, 0.45)]
)
def test_however_many_matches_are_wrong_the_error_is_within_three_sigma(
    rounds: int, wrong: float
) -> None:
    """And only where nearly half are wrong may half of the drives be less sure than 5 cm."""
    random, sigmas_m = np.random.default_rng(5), list[float]()
    for _ in range(20):
        stated_m = random.choice([0.02, 0.05, 0.3], 2)
        off = {n: np.tile(random.normal(0.0, stated_m[n], 2), (N, 1)) for n in (0, 1)}
        some = [
            one._replace(
                shift_m=one.shift_m
                + random.normal(0.0, 2.0 if random.random() < wrong else 0.02, 2)
            )
            for one in matches(off, [(0, 1)] * rounds)
        ]
        drives = [drive(name, sigma_m) for name, sigma_m in zip("ab", stated_m, strict=True)]
        found = solve(drives, [Transform()] * 2, some)
        apart_m = np.hypot(*(moved(found, 1) + off[1] - moved(found, 0) - off[0]).mean(axis=0))
        assert apart_m < 3.0 * found.sigma_m[0, 1]
        sigmas_m.append(found.sigma_m[0, 1])
    assert np.median(sigmas_m) < (0.05 if wrong < 0.4 else 0.2)
