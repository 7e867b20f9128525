"""The batch estimate on simulated drives, of which everything is known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings, strategies as st

from fieldgrid.geometry import wrap_deg
from fieldgrid.poses.smoother import steering
from fieldgrid.poses.smoother.batch import SmoothedDrive, smooth
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.equations import CONSTANTS
from fieldgrid.poses.smoother.holes import Unseen
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.model import GYRO
from fieldgrid.poses.smoother.rounds import SmoothingProblem, Solution, Weights
from tests.simulated import CIRCLE, K_TURN, SLALOM, STOP, Command, Drive, simulate

_Float64 = npt.NDArray[np.float64]

DRIVES = {"circle": CIRCLE, "slalom": SLALOM, "K-turn": K_TURN, "stop": STOP}


def measured_at(
    drive: Drive,
    noise_m: float = 0.0,
    *,
    sigma_m: float | None = None,
    bias_m: float = 0.0,
    seed: int = 0,
    lever: tuple[float, float] = (0.0, 0.0),
    gyro_bias_dps: float | None = None,
    **columns: Any,
) -> Measurements:
    """Fixes at every node, with white noise; nothing else but for a gyro that is asked for."""
    n = len(drive.time_s)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (n, 2)) * noise_m
    step_s = np.diff(drive.time_s)
    turned = np.full(n - 1, np.nan)
    if gyro_bias_dps is not None:
        turned = np.diff(drive.heading_rad) + np.radians(gyro_bias_dps) * step_s
    found = Measurements(
        time_s=drive.time_s,
        fix_m=drive.point(*lever) + noise,
        fix_sigma_m=np.full((n, 2), sigma_m or noise_m or 0.01),
        bias_m=np.full(n, bias_m),
        bias_s=np.full(n, 60.0),
        heading_rad=np.full(n, np.nan),
        heading_sigma_rad=np.full(n, np.nan),
        speed_mps=np.full(n, np.nan),
        speed_sigma_mps=np.full(n, np.nan),
        turned_rad=turned,
        seen=np.ones(n - 1, dtype=np.bool_),
        standing=np.abs(drive.speed_mps) < 0.001,
        step_nodes=np.zeros((0, 2), dtype=np.int64),
        step=np.zeros((0, 3)),
        step_sigma=np.zeros((0, 2)),
    )
    return found._replace(**columns)


def guess(drive: Drive, seen: Measurements, off_deg: float = 15.0) -> _Float64:
    """The fixes as they are, the nose off by some degrees, speeds with the right sign."""
    start = np.zeros((len(drive.time_s), STATES))
    known = np.isfinite(seen.fix_m[:, 0])
    for axis in (0, 1):
        start[:, axis] = np.interp(drive.time_s, drive.time_s[known], seen.fix_m[known, axis])
    start[:, 2] = drive.heading_rad + np.radians(off_deg)
    start[:, 3] = drive.gear()
    return start


def steps_between(drive: Drive, every: int, ahead_m: float = 0.0) -> dict[str, Any]:
    """What a camera ahead of the axle would have told of the ways between nodes."""
    ends = np.stack([np.arange(0, len(drive.time_s) - every), np.arange(every, len(drive.time_s))])
    ends = ends[:, ::every].T
    place = drive.point(0.0, ahead_m) @ np.array([1.0, 1j])
    nose = 1j * np.exp(-1j * drive.heading_rad)
    moved = (place[ends[:, 1]] - place[ends[:, 0]]) / nose[ends[:, 0]]
    turn = np.diff(drive.heading_rad[ends], axis=1)[:, 0]
    return {
        "step_nodes": np.ascontiguousarray(ends, dtype=np.int64),
        "step": np.stack([moved.real, -moved.imag, turn], axis=1),
        "step_sigma": np.full((len(ends), 2), [0.01, np.radians(0.1)]),
    }


def heading_error_deg(found: SmoothedDrive, drive: Drive) -> _Float64:
    return np.abs(wrap_deg(np.degrees(found.state[:, 2] - drive.heading_rad)))


def position_error_m(found: SmoothedDrive, drive: Drive) -> _Float64:
    return np.hypot(found.state[:, 0] - drive.east_m, found.state[:, 1] - drive.north_m)


ASIDE = (0.6, 1.8)
BOTH = [(name, lever) for lever in ((0.0, 0.0), ASIDE) for name in DRIVES]
REVERSE_LEVER = pytest.mark.xfail(
    strict=True,
    reason="at the cusp after a reverse nothing but the usual steering tells the nose from an "
    "antenna ahead of the axle, and curvatures are taken to fade: 15 degrees off, sigma 5",
)
NEARLY_DEG = {("slalom", (0.0, 0.0)): 0.35, ("K-turn", (0.0, 0.0)): 0.4}
"""Above the usual 0.3° where steering that changes all the time is smoothed over the noise that
is stated (and is not there): half of what the sigma says."""


@pytest.mark.parametrize(("name", "lever"), BOTH)
def test_without_noise_the_sigma_says_where_the_nose_is_not_known(
    name: str, lever: tuple[float, float]
) -> None:
    """While an antenna aside sets off, nothing tells the nose; nor at a cusp."""
    drive = simulate(DRIVES[name], 110.0).every(0.2)
    seen = measured_at(drive, sigma_m=0.005, lever=lever)
    found = smooth(seen, guess(drive, seen), lever)
    error, sigma = heading_error_deg(found, drive), np.degrees(found.heading_sigma_rad)
    assert (error < 3.0 * np.hypot(sigma, 0.3)).all()
    # The antenna is fixed and the axle swings about it: all of the error is along one axis.
    one_axis_m = np.sqrt(2.0) * found.position_sigma_m
    assert (position_error_m(found, drive) < 3.0 * np.hypot(one_axis_m, 0.005)).all()
    assert np.median(sigma) < 0.7
    moving = np.abs(drive.speed_mps) > 0.5
    assert (np.sign(found.state[moving, 3]) == drive.gear()[moving]).all()


@pytest.mark.parametrize(
    ("name", "lever"),
    [
        pytest.param(*case, marks=REVERSE_LEVER if case == ("K-turn", ASIDE) else ())
        for case in BOTH
    ],
)
def test_without_noise_the_heading_is_exact(name: str, lever: tuple[float, float]) -> None:
    drive = simulate(DRIVES[name], 110.0).every(0.2)
    seen = measured_at(drive, sigma_m=0.005, lever=lever)
    found = smooth(seen, guess(drive, seen), lever)
    error = heading_error_deg(found, drive)
    moving = (np.abs(drive.speed_mps) > 0.5) & (drive.time_s > 10.0)
    assert np.percentile(error[moving], 90) < NEARLY_DEG.get((name, lever), 0.3)
    # At the end of a circle and at a cusp the next fixes are missing, or those of the other leg.
    assert error[moving].max() < (1.2 if name == "K-turn" else 0.6)
    assert position_error_m(found, drive)[moving].max() < 0.01
    assert found.state[moving, 3] == pytest.approx(drive.speed_mps[moving], abs=0.1)


def test_a_forgotten_lever_is_seen_in_the_heading() -> None:
    drive = simulate(CIRCLE, 110.0).every(0.2)
    seen = measured_at(drive, sigma_m=0.005, lever=(0.0, 1.8))
    found = smooth(seen, guess(drive, seen))
    assert np.median(heading_error_deg(found, drive)) > 10.0  # atan(1.8 · 0.2) = 20°


@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize("noise_m", [pytest.param(0.02, marks=pytest.mark.long), 0.1])
def test_sigmas_are_honest(name: str, noise_m: float) -> None:
    drive = simulate(DRIVES[name], -60.0).every(0.2)
    inside, turned, moved = [], [], []
    for seed in range(12):
        seen = measured_at(drive, noise_m, seed=seed)
        found = smooth(seen, guess(drive, seen))
        turned.append(heading_error_deg(found, drive) / np.degrees(found.heading_sigma_rad))
        moved.append(position_error_m(found, drive) / found.position_sigma_m)
        inside.append(np.degrees(np.median(found.heading_sigma_rad)))
    assert np.mean(np.array(turned) < 3.0) > 0.99
    assert np.mean(np.array(moved) < 3.5) > 0.99  # two axes
    # Not so large either that it says nothing.
    assert np.median(turned) > 0.3
    assert 0.8 < np.median(moved) < 1.2  # of two axes: 1.18
    assert np.median(inside) < (1.0 if noise_m == 0.02 else 3.0)


@pytest.mark.parametrize("name", ["slalom", "K-turn"])
def test_outliers_are_not_believed(name: str) -> None:
    """Each twentieth fix is 5 m off."""
    drive = simulate(DRIVES[name], 20.0).every(0.2)
    seen = measured_at(drive, 0.02)
    clean = smooth(seen, guess(drive, seen))
    random = np.random.default_rng(4)
    wrong = np.flatnonzero(random.random(len(drive.time_s)) < 0.05)
    assert 4 <= wrong.size <= 20
    fix = seen.fix_m.copy()
    angle = random.uniform(0.0, 2.0 * np.pi, wrong.size)
    fix[wrong] += 5.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = smooth(seen._replace(fix_m=fix), guess(drive, seen))
    assert position_error_m(found, drive).max() < 0.15
    assert np.abs(found.state[:, :2] - clean.state[:, :2]).max() < 0.1
    error = heading_error_deg(found, drive)
    assert np.mean(error < 3.0 * np.degrees(found.heading_sigma_rad)) > 0.97
    assert error.max() < 10.0
    assert (np.hypot(*found.fix_off_m[wrong].T) > 4.5).all()
    assert (np.hypot(*np.delete(found.fix_off_m, wrong, axis=0).T) < 0.2).all()


def test_a_step_that_lies_is_not_believed() -> None:
    drive = simulate(SLALOM, 20.0).every(0.2)
    columns = steps_between(drive, 2)
    columns["step"][10] = [3.0, -2.0, 1.0]
    seen = measured_at(drive, 0.02, **columns)
    found = smooth(seen, guess(drive, seen))
    assert heading_error_deg(found, drive).max() < 1.0


@pytest.mark.parametrize("ahead_m", [0.0, 1.5])
def test_steps_carry_through_poor_fixes(ahead_m: float) -> None:
    drive = simulate(K_TURN, 20.0).every(0.2)
    plain = measured_at(drive, 0.3, seed=3)
    without = smooth(plain, guess(drive, plain))
    seen = plain._replace(**steps_between(drive, 2, ahead_m))
    found = smooth(seen, guess(drive, seen), (0.0, 0.0), ahead_m)
    assert heading_error_deg(found, drive).max() < 1.5
    assert heading_error_deg(without, drive).max() > 2.0 * heading_error_deg(found, drive).max()
    assert np.median(found.heading_sigma_rad) < 0.5 * np.median(without.heading_sigma_rad)


def test_the_order_of_steps_does_not_matter() -> None:
    drive = simulate(SLALOM, 20.0).every(0.2)
    columns = steps_between(drive, 3, 1.0)
    random = np.random.default_rng(1)
    columns["step"] += random.normal(0.0, 0.01, columns["step"].shape)
    seen = measured_at(drive, 0.05, **columns)
    order = random.permutation(len(columns["step"]))
    shuffled = seen._replace(**{name: column[order] for name, column in columns.items()})
    a, b = (smooth(s, guess(drive, s), (0.0, 0.0), 1.0) for s in (seen, shuffled))
    assert a.state == pytest.approx(b.state, abs=1e-7)
    assert a.heading_sigma_rad == pytest.approx(b.heading_sigma_rad, rel=1e-6)


def bits(value: object) -> object:
    """Arrays as their bytes, in tuples of any depth."""
    if isinstance(value, tuple):
        return tuple(bits(one) for one in value)
    return value.tobytes() if isinstance(value, np.ndarray) else value


def test_the_same_drive_has_the_same_bits() -> None:
    drive = simulate(K_TURN, 20.0).every(0.2)
    seen = measured_at(drive, 0.05, gyro_bias_dps=0.3, **steps_between(drive, 3))
    start = guess(drive, seen)
    before = start.copy()
    a, b = smooth(seen, start), smooth(seen, start)
    for one, other in zip(a, b, strict=True):
        assert bits(one) == bits(other)
    assert np.array_equal(start, before)


@pytest.mark.parametrize("bias_dps", [0.8, -0.8])
def test_a_gyro_s_bias_is_found(bias_dps: float) -> None:
    """It is what the gyro shows more than the vehicle turns."""
    drive = simulate(SLALOM, 20.0).every(0.2)
    seen = measured_at(drive, 0.03, gyro_bias_dps=bias_dps)
    found = smooth(seen, guess(drive, seen))
    assert np.degrees(found.state[:, GYRO]) == pytest.approx(bias_dps, abs=0.15)
    assert heading_error_deg(found, drive).max() < 2.0


def test_a_slow_error_of_the_receiver_shifts_and_does_not_turn() -> None:
    drive = simulate([Command(60.0, 1.5)], 75.0, speed_mps=1.5).every(0.2)
    # One sigma and more of slow error across the way, over a minute.
    slow = 0.6 * np.sin(2.0 * np.pi * drive.time_s / 240.0)
    seen = measured_at(drive, 0.02, sigma_m=0.02, bias_m=0.4)
    seen = seen._replace(fix_m=seen.fix_m + np.outer(slow, [-np.cos(1.3), np.sin(1.3)]))
    found = smooth(seen, guess(drive, seen))
    assert heading_error_deg(found, drive).max() < 2.0
    assert np.median(heading_error_deg(found, drive)) < 0.8
    # Absolutely no better than the receiver; among neighbours better.
    assert 0.2 < np.median(found.position_sigma_m) < 0.4
    assert np.median(found.relative_sigma_m) < 0.05


def test_a_hole_of_a_minute_drags_nothing() -> None:
    whole = simulate([Command(20.0, 1.5), Command(60.0, 1.5, 0.05), Command(20.0, 1.5)], 20.0)
    times = np.concatenate([np.arange(0.0, 20.0, 0.2), np.arange(80.0, 100.0, 0.2)])
    drive = whole.at(times)
    seen = measured_at(drive, 0.02, sigma_m=0.02)
    seen = seen._replace(seen=np.diff(times) < 10.0)
    found = smooth(seen, guess(drive, seen))
    assert heading_error_deg(found, drive)[3:-3].max() < 3.0
    assert position_error_m(found, drive).max() < 0.1


def test_each_side_of_a_hole_is_what_it_would_be_without_the_other() -> None:
    """But for how restless the vehicle is, which the whole drive tells better."""
    whole = simulate([Command(20.0, 1.5), Command(60.0, 1.5, 0.05), Command(20.0, 1.5)], 20.0)
    times = np.concatenate([np.arange(0.0, 20.0, 0.2), np.arange(80.0, 100.0, 0.2)])
    drive = whole.at(times)
    seen = measured_at(drive, 0.02, sigma_m=0.02)
    seen = seen._replace(seen=np.diff(times) < 10.0)
    found = smooth(seen, guess(drive, seen))
    for a, b in ((0, 100), (100, 200)):
        own, alone = drive.at(times[a:b]), seen.part(a, b)
        apart = smooth(alone, guess(own, alone))
        off = np.abs(apart.state[:, :4] - found.state[a:b, :4])
        assert (off[:, 2] < 0.3 * found.heading_sigma_rad[a:b]).all()
        assert off[:, :2].max() < 0.01


def test_standing_holds_the_heading_while_its_sigma_grows() -> None:
    drive = simulate([Command(15.0, 1.5), Command(300.0, 0.0)], 20.0).every(0.5)
    random = np.random.default_rng(6)
    seen = measured_at(drive, 0.02, seed=6)
    # The receiver's fixes wander about the place.
    wander = np.cumsum(random.normal(0.0, 0.01, seen.fix_m.shape), axis=0)
    wander -= wander[np.argmax(drive.time_s > 16.0)]
    seen = seen._replace(fix_m=seen.fix_m + np.where(drive.time_s[:, None] > 16.0, wander, 0.0))
    found = smooth(seen, guess(drive, seen))
    at_rest = np.flatnonzero(seen.standing)
    sigma = found.heading_sigma_rad[at_rest]
    assert (np.diff(sigma[1:]) > -1e-4).all()
    assert sigma[-1] == pytest.approx(
        np.hypot(sigma[1], np.radians(0.05) * np.sqrt(285.0)), rel=0.1
    )
    assert heading_error_deg(found, drive)[at_rest].max() < 3.0
    assert np.abs(found.state[at_rest, 3]).max() < 0.05


def test_recorded_headings_and_speeds_are_used() -> None:
    """A crawl too short to tell anything: 0.3 m of path under 0.3 m of noise."""
    drive = simulate([Command(4.0, 0.1)], 20.0).every(0.2)
    n = len(drive.time_s)
    seen = measured_at(drive, 0.3, standing=np.zeros(n, dtype=np.bool_))
    nose = drive.heading_rad + 2.0 * np.pi  # a whole circle is none
    told = seen._replace(
        heading_rad=nose,
        heading_sigma_rad=np.full(n, np.radians(0.5)),
        speed_mps=drive.speed_mps,
        speed_sigma_mps=np.full(n, 0.02),
        heading_offset_sigma_rad=np.radians(0.2),
    )
    start = guess(drive, seen)
    without, found = smooth(seen, start), smooth(told, start)
    assert np.degrees(without.heading_sigma_rad).min() > 10.0
    assert np.degrees(found.heading_sigma_rad).max() < 0.6
    assert heading_error_deg(found, drive).max() < 0.5
    assert found.state[:, 3] == pytest.approx(drive.speed_mps, abs=0.03)


@pytest.mark.parametrize("times", [[0.5], [0.5, 0.7], [0.5, 60.0]])
@pytest.mark.parametrize("gyro", [True, False])
def test_the_shortest_drives(times: list[float], gyro: bool) -> None:
    drive = simulate([Command(61.0, 1.0)]).at(times)
    seen = measured_at(drive, 0.02, gyro_bias_dps=0.0 if gyro else None)
    seen = seen._replace(seen=np.diff(drive.time_s) < 10.0)
    found = smooth(seen, guess(drive, seen, 0.0))
    assert position_error_m(found, drive).max() < 0.1
    assert found.steers.noise == steering.USUAL_STEERING_NOISE or len(times) > 1
    assert all(np.isfinite(column).all() for column in found[:6])
    if times != [0.5, 0.7]:
        assert np.degrees(found.heading_sigma_rad).min() > 90.0


# --- what is learnt of the steering


def column_of(drive: Drive, **columns: Any) -> Measurements:
    n = len(drive.time_s)
    return measured_at(drive, 0.02, **columns)._replace(heading_rad=np.arange(float(n)))


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 30), st.integers(0, 30), st.integers(1, 6))
def test_a_part_is_what_was_seen_there(one: int, two: int, every: int) -> None:
    drive = simulate(K_TURN[:1], 20.0).at(np.arange(30) * 0.2)
    seen = column_of(drive, gyro_bias_dps=0.4, **steps_between(drive, every))
    start, stop = min(one, two), max(one, two)
    assume(start < stop)
    part = seen.part(start, stop)
    between = {"turned_rad", "seen"}
    for name, column in part._asdict().items():
        whole = getattr(seen, name)
        if isinstance(whole, float | bool):
            assert column == whole
            continue
        assert column.dtype == whole.dtype
        if not name.startswith("step"):
            own = whole[start : stop - 1] if name in between else whole[start:stop]
            assert np.array_equal(column, own, equal_nan=True)
    # Steps with both ends inside, and they tell of the same instants as before.
    ends = seen.step_nodes.tolist()
    inside = [k for k, (a, b) in enumerate(ends) if start <= a and b < stop]
    assert part.time_s[part.step_nodes].tolist() == drive.time_s[seen.step_nodes[inside]].tolist()
    assert np.array_equal(part.step, seen.step[inside])
    assert np.array_equal(part.step_sigma, seen.step_sigma[inside])


def test_the_whole_is_a_part() -> None:
    drive = simulate(K_TURN[:1], 20.0).every(0.2)
    seen = column_of(drive, gyro_bias_dps=0.4, **steps_between(drive, 3))
    for one, other in zip(seen, seen.part(0, len(seen.time_s)), strict=True):
        assert np.array_equal(one, other, equal_nan=True)


STRAIGHT = [Command(60.0, 1.5)]
WEAVING = [Command(5.0, 1.5)] + [Command(2.0, 1.5, 0.2 * (-1) ** k) for k in range(25)]


@pytest.mark.parametrize("noise_m", [0.02, 0.05])
def test_a_straight_drive_is_calm_and_a_weaving_one_restless(noise_m: float) -> None:
    """How much steering is expected follows the drive, not the noise of its fixes."""
    for seed in range(4):
        found = []
        for commands in (STRAIGHT, WEAVING):
            drive = simulate(commands, 30.0, speed_mps=1.5).every(0.2)
            seen = measured_at(drive, noise_m, seed=seed)
            found.append((smooth(seen, guess(drive, seen)), drive))
        (calm, straight), (restless, _) = found
        assert calm.steers.noise < steering.USUAL_STEERING_NOISE < restless.steers.noise
        # Where nothing is steered, noise turns the nose less; where much is, less is sure.
        assert 2.0 * np.median(calm.heading_sigma_rad) < np.median(restless.heading_sigma_rad)
        for smoothed, drive in found:
            error = heading_error_deg(smoothed, drive)
            assert np.mean(error < 3.0 * np.degrees(smoothed.heading_sigma_rad)) > 0.97
        assert np.sqrt(np.mean(heading_error_deg(calm, straight) ** 2)) < 30.0 * noise_m


def test_a_gyro_needs_no_expectation() -> None:
    drive = simulate(WEAVING, 30.0, speed_mps=1.5).every(0.2)
    seen = measured_at(drive, 0.02, gyro_bias_dps=0.1)
    assert smooth(seen, guess(drive, seen)).steers.noise == steering.USUAL_STEERING_NOISE
    # It has to be there for nearly all of the way.
    turned = seen.turned_rad.copy()
    turned[: len(turned) // 5] = np.nan
    found = smooth(seen._replace(turned_rad=turned), guess(drive, seen))
    assert found.steers.noise > steering.USUAL_STEERING_NOISE


def problem(drive: Drive, seen: Measurements) -> tuple[SmoothingProblem, Solution]:
    """What the sightings ask, and the estimate before anything is learnt."""
    asked = SmoothingProblem.of(seen, (0.0, 0.0), 0.0)
    return asked, steering.roughly(asked, guess(drive, seen), np.zeros(CONSTANTS))


@pytest.mark.parametrize("commands", [STRAIGHT, WEAVING, SLALOM, CIRCLE])
def test_the_likelihood_is_climbed_to_its_top(commands: list[Command]) -> None:
    """The noise is the likeliest of all, or more by what would not be clear."""
    drive = simulate(commands, 30.0, speed_mps=1.5).every(0.2)
    asked, first = problem(drive, measured_at(drive, 0.03, seed=1))
    found = steering.likeliest_steering(asked, first)
    likelihood = [
        steering.log_likelihood(asked, first, found._replace(noise=noise))
        for noise in steering.STEERING_NOISES
    ]
    at = steering.STEERING_NOISES.index(found.noise)
    best = int(np.argmax(likelihood))
    assert at >= best
    assert likelihood[at] >= likelihood[best] - steering.CLEAR_NATS * (at - best)


@pytest.mark.parametrize(
    ("likelihood", "expected", "asked"),
    [
        ([0.0, 1.0, 9.0, 1.0, 0.0], 2, {1, 2, 3}),
        ([99.0, 60.0, 9.0, 1.0, 0.0], 0, {0, 1, 2}),
        ([0.0, 1.0, 9.0, 60.0, 99.0], 4, {1, 2, 3, 4}),
        ([0.0, 1.0, 9.0, 60.0, 50.0], 3, {1, 2, 3, 4}),
        # A calmer one has to be clearly likelier, a more restless one need only not be less so.
        ([0.0, 10.5, 9.0, 6.5, 0.0], 2, {1, 2, 3}),
        ([0.0, 11.5, 9.0, 6.5, 0.0], 1, {0, 1, 2}),
        ([0.0, 0.0, 9.0, 7.5, 6.0], 4, {1, 2, 3, 4}),
        ([0.0, 0.0, 0.0, 0.0, 0.0], 4, {1, 2, 3, 4}),
    ],
)
def test_the_search_asks_no_more_than_it_must(
    likelihood: list[float], expected: int, asked: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[int] = []

    def told(_: SmoothingProblem, __: Solution, steers: steering.Steering) -> float:
        tried.append(steering.STEERING_NOISES.index(steers.noise))
        return likelihood[tried[-1]]

    drive = simulate(STRAIGHT, 30.0).at([0.0, 0.2])
    own, first = problem(drive, measured_at(drive, 0.02))
    monkeypatch.setattr(steering, "log_likelihood", told)
    assert steering.likeliest_steering(own, first).noise == steering.STEERING_NOISES[expected]
    assert len(tried) == len(set(tried))
    assert set(tried) == asked


@pytest.mark.parametrize(
    ("commands", "bent"),
    [
        ([Command(20.0, 1.5), Command(15.0, 1.5, 0.15), Command(20.0, 1.5)], 0.55),
        ([Command(20.0, 1.0), Command(6.0, 1.0, -0.9), Command(20.0, 1.0)], steering.MOST_BENT),
        # Who never turned round does not show it.
        ([Command(60.0, 1.5)], 1.0),
        ([Command(20.0, 1.5), Command(5.0, 1.5, 0.15), Command(20.0, 1.5)], 1.0),
        ([Command(99.0, 1.5, 0.03)], steering.LEAST_BENT),
    ],
)
def test_the_tightest_turns_say_how_a_vehicle_steers(commands: list[Command], bent: float) -> None:
    drive = simulate(commands, 40.0, speed_mps=commands[0].speed_mps).every(0.2)
    found = smooth(seen := measured_at(drive, 0.02), guess(drive, seen))
    assert found.steers.bent == pytest.approx(bent, rel=0.15)
    # A hole of the fixes, which nobody saw, says nothing.
    far = found.state.copy()
    far[50:60, 4] = 5.0
    unseen = seen.seen.copy()
    unseen[49:60] = False
    assert steering.bent_share(seen._replace(seen=unseen), far) == pytest.approx(bent, rel=0.25)


def test_a_calm_vehicle_turns_less_between_its_fixes() -> None:
    """Where no fix is near, and not in holes."""
    time_s = np.concatenate([np.arange(0.0, 40.1, 0.25), np.arange(45.0, 60.1, 0.25)])
    drive = simulate([Command(61.0, 1.5)], speed_mps=1.5).at(time_s)
    every = np.isclose(time_s % 2.0, 0.0)[:, None] * np.ones(2) > 0.0
    seen = measured_at(drive, 0.02)
    seen = seen._replace(fix_sigma_m=np.where(every, 0.02, np.nan))
    asked, first = problem(drive, seen)
    usual = steering.usual_steering(np.diff(time_s))
    unseen = Unseen.of(seen)
    (leaves,) = unseen.exits().tolist()
    inner = unseen.blind & (np.arange(len(time_s) - 1) != leaves)
    assert (inner & ~unseen.holes).any()
    for bent in (0.25, 2.0):
        steers = steering.Steering.usual()._replace(noise=0.02, bent=bent)
        found = steering.adapted(asked, first, steers).weights.steering
        expected = np.where(unseen.holes, max(bent, 1.0), bent) ** 2 * usual.variance
        assert found.variance[inner] == pytest.approx(expected[inner])
        assert (found.variance[~unseen.blind] <= expected[~unseen.blind]).all()
        # A curvature in the hole says little of the one behind it.
        assert found.kept[leaves] < 0.5 * usual.kept[leaves]
        others = np.arange(len(time_s) - 1) != leaves
        assert np.array_equal(found.kept[others], usual.kept[others])


@pytest.mark.parametrize("noise_m", [0.02, 0.1])
def test_learning_makes_the_sightings_likelier(
    noise_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up and up with each adaptation, when the noise is that of the drive. (The share
    that is always expected may take back a little in the end.)"""
    for commands in (STRAIGHT, SLALOM, CIRCLE):
        drive = simulate(commands, 30.0, speed_mps=1.5).every(0.2)
        asked, first = problem(drive, measured_at(drive, noise_m, seed=2))
        # Begun from the usual steering: one of the drive's own turns leaves less to be learnt.
        steers = steering.likeliest_steering(asked, first)._replace(bent=1.0)
        found = []
        with monkeypatch.context() as patch:
            for count in range(steering.ADAPTATIONS + 1):
                patch.setattr(steering, "ADAPTATIONS", count)
                found.append(steering.log_likelihood(asked, first, steers))
        gains = np.diff(found)
        assert len(gains) == steering.ADAPTATIONS
        assert (gains > -0.5).all()
        assert gains[0] == gains.max()
        assert gains.sum() > 4.0


def solution(found: SmoothedDrive) -> Solution:
    """The states of an estimate, as the search for the steering takes them."""
    nothing = Weights(*[np.zeros(0)] * len(Weights._fields))
    return Solution(found.state, np.zeros(CONSTANTS), nothing, 0, np.zeros(0))


LONG = [Command(5.0, 1.5)] + [Command(4.0, 1.5, 0.15 * (-1) ** k) for k in range(220)]


def test_a_long_drive_is_known_by_some_stretches() -> None:
    """And estimated as a short one: the same steering, the same headings and sigmas."""
    whole = simulate(LONG, 10.0, speed_mps=1.5).every(0.2)
    n = len(whole.time_s)
    assert n > steering.STRETCHES * steering.STRETCH_NODES
    seen = measured_at(whole, 0.02)
    found = smooth(seen, guess(whole, seen))
    asked = SmoothingProblem.of(seen, (0.0, 0.0), 0.0)
    stretches = steering.stretches(asked, solution(found))
    assert len(stretches) == steering.STRETCHES
    for part, x in stretches:
        assert len(x) == len(part.measured.time_s) == steering.STRETCH_NODES
        first = np.searchsorted(seen.time_s, part.measured.time_s[0])
        assert np.array_equal(x, found.state[first : first + len(x)])
    assert stretches[0][0].measured.time_s[0] == seen.time_s[0]
    assert stretches[-1][0].measured.time_s[-1] == seen.time_s[-1]
    short = seen.part(0, 1000)
    own = smooth(short, guess(whole.at(short.time_s), short))
    assert len(steering.stretches(SmoothingProblem.of(short, (0.0, 0.0), 0.0), solution(own))) == 1
    assert own.steers.noise == found.steers.noise
    inner = slice(0, 980)  # the rest knows what comes after
    assert own.state[inner, :3] == pytest.approx(found.state[inner, :3], abs=2e-3)
    ratio = own.heading_sigma_rad[inner] / found.heading_sigma_rad[inner]
    assert ratio == pytest.approx(1.0, abs=0.05)
    error = heading_error_deg(found, whole)
    assert np.mean(error < 3.0 * np.degrees(found.heading_sigma_rad)) > 0.99
    assert error.max() < 4.0


@pytest.mark.parametrize("gyro", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_long_way_without_a_fix_can_be_solved(gyro: bool) -> None:
    """Also when one of the stretches that stand for the drive has none."""
    drive = simulate(LONG, 10.0, speed_mps=1.5).every(0.2)
    n = len(drive.time_s)
    seen = measured_at(drive, 0.02, gyro_bias_dps=0.1 if gyro else None)
    start = int(np.linspace(0, n - steering.STRETCH_NODES, steering.STRETCHES)[1])
    lost = slice(start - 20, start + steering.STRETCH_NODES + 20)
    sigma, first = seen.fix_sigma_m.copy(), guess(drive, seen)
    sigma[lost] = np.nan
    found = smooth(seen._replace(fix_sigma_m=sigma), first)
    assert found.position_sigma_m[start + 500] > 2.0
    known = np.r_[0 : start - 30, start + steering.STRETCH_NODES + 30 : n]
    error = heading_error_deg(found, drive)[known]
    assert np.mean(error < 3.0 * np.degrees(found.heading_sigma_rad[known])) > 0.99
    assert position_error_m(found, drive)[known].max() < 0.15
    # Nothing at all is known of such a drive, and it says so.
    nothing = seen.part(0, 1000)
    nothing = nothing._replace(fix_sigma_m=np.full((1000, 2), np.nan))
    assert (smooth(nothing, first[:1000]).position_sigma_m > 100.0).all()


# --- symmetries


def test_where_the_drive_lies_does_not_matter() -> None:
    """Far from the origin, turned, later: the same estimate."""
    drive = simulate(SLALOM, 20.0).every(0.2)
    seen = measured_at(drive, 0.05)
    angle = np.radians(77.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    start = guess(drive, seen)
    moved, moved_start = seen._replace(fix_m=seen.fix_m @ turn + [4000.0, -9000.0]), start.copy()
    moved_start[:, :2] = start[:, :2] @ turn + [4000.0, -9000.0]
    moved_start[:, 2] += angle
    moved = moved._replace(time_s=seen.time_s + 1e5)
    a, b = smooth(seen, start), smooth(moved, moved_start)
    assert b.state[:, :2] == pytest.approx(a.state[:, :2] @ turn + [4000.0, -9000.0], abs=5e-3)
    assert b.state[:, 2] == pytest.approx(a.state[:, 2] + angle, abs=2e-3)
    assert b.heading_sigma_rad == pytest.approx(a.heading_sigma_rad, rel=1e-2)


FAR: Sequence[float] = (15.0, 30.0, -30.0)


@pytest.mark.parametrize("off_deg", FAR)
def test_a_poor_guess_is_left(off_deg: float) -> None:
    drive = simulate(K_TURN, 20.0).every(0.2)
    seen = measured_at(drive, 0.01)
    found, good = (smooth(seen, guess(drive, seen, off)) for off in (off_deg, 0.0))
    assert found.state[:, :4] == pytest.approx(good.state[:, :4], abs=5e-3)
    assert found.rounds < 25
