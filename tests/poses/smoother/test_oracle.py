"""The estimate of a drive beside GTSAM's: the equations of docs/poses.md, written again as factors
and solved by another program. Noise is drawn, so that many residuals have a Student weight."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.poses.smoother.batch import SmoothedDrive, smooth
from fieldgrid.poses.smoother.measurements import Measurements
from tests.poses.smoother.test_batch import guess, measured_at, steps_between
from tests.simulated import CIRCLE, K_TURN, SLALOM, STOP, Command, Drive, simulate

gtsam = pytest.importorskip("gtsam")

_Float64 = npt.NDArray[np.float64]
Law = Callable[..., list[Any]]

PLACE, E, N, PHI, V, KAPPA, GYRO, BIAS = slice(2), 0, 1, 2, 3, 4, 5, slice(6, 8)
STATES = "east", "north", "heading", "speed", "curvature", "gyro bias", "bias east", "bias north"
CONSTANTS = {
    "heading_offset": np.radians(20.0),
    "wheel_scale": 0.1,
    "camera_scale": 0.03,
    "camera_yaw_rad": np.radians(2.0),
    "gyro_scale": 0.04,
}
"""What is known of the constants before the drive, 1-sigma."""


# --- the equations, as residuals of nodes (their 8 states) and constants


def moves(h: float, slip: float) -> Law:
    """Along the heading, across it by an angle of slip, and turning."""

    def law(one: _Float64, two: _Float64) -> list[Any]:
        phi, v, kappa = (one[PHI:GYRO] + two[PHI:GYRO]) / 2.0
        along, across = in_frame(two[PLACE] - one[PLACE], phi)
        return [along - v * h, across + slip * v * h, two[PHI] - one[PHI] - kappa * v * h]

    return law


def slips(x: _Float64) -> _Float64:
    """Angles [n - 1] by which the axle slides outward from node to node."""
    v, kappa = (x[1:, [V, KAPPA]] + x[:-1, [V, KAPPA]]).T / 2.0
    return np.asarray(np.radians(0.2) * kappa * v * np.abs(v))


def in_frame(way: _Float64, phi: Any) -> tuple[Any, Any]:
    """Forward and right of a heading."""
    return way[E] * np.sin(phi) + way[N] * np.cos(phi), way[E] * np.cos(phi) - way[N] * np.sin(phi)


def point(node: _Float64, right: float, ahead: float) -> Any:
    """East and north of a point of the vehicle."""
    sin, cos = np.sin(node[PHI]), np.cos(node[PHI])
    return node[PLACE] + np.array([right * cos + ahead * sin, ahead * cos - right * sin])


def keeps(states: int | slice, share: float = 1.0) -> Law:
    """States of which a share is the same at the next node."""
    return lambda one, two: [*np.reshape(two[states] - share * one[states], (-1, *one.shape[1:]))]


def turns(gyro: float, h: float) -> Law:
    return lambda one, two, g: [two[PHI] - one[PHI] - (1.0 + g[0]) * gyro + one[GYRO] * h]


def fixed(fix: _Float64, lever: tuple[float, float], axes: float) -> Law:
    """How far the antenna and the slow error lie from a fix, along axes that are held."""
    return lambda x: [*in_frame(((point(x, *lever) + x[BIAS]).T - fix).T, axes)]


def steps(step: _Float64, ahead: float) -> tuple[Law, Law]:
    """The way and the turn of a camera."""

    def way(one: _Float64, two: _Float64, scale: _Float64, yaw: _Float64) -> list[Any]:
        moved = point(two, 0.0, ahead) - point(one, 0.0, ahead)
        forward, right = in_frame(moved, one[PHI] + yaw[0])
        return [(1.0 + scale[0]) * forward - step[0], (1.0 + scale[0]) * right - step[1]]

    return way, lambda one, two: [wrapped(two[PHI] - one[PHI] - step[2])]


def wrapped(angle: Any) -> Any:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


# --- the factors


def student(size: int) -> Any:
    """4 degrees of freedom, for residuals of one measurement, within its usual error as without."""

    def weight(off: float) -> float:
        return min((4.0 + size) / (4.0 + off**2), 1.0)

    def loss(off: float) -> float:
        beyond = max(off**2, size)
        return min(off**2, size) / 2.0 + (4 + size) / 2.0 * np.log((4 + beyond) / (4 + size))

    scheme = gtsam.noiseModel.mEstimator.Base.ReweightScheme.Block
    return gtsam.noiseModel.mEstimator.Custom(weight, loss, scheme, "student")


def factor(law: Law, sigma: Any, *keys: int, heavy: bool = False) -> Any:
    """A factor by a law, whose slopes are central differences."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.atleast_1d(np.array(sigma, dtype=np.float64)))
    if heavy:
        noise = gtsam.noiseModel.Robust.Create(student(noise.dim()), noise)

    def error(_: Any, values: Any, slopes: list[_Float64] | None) -> _Float64:
        at = [values.atVector(key) for key in keys]
        if slopes is not None:
            whole, ends = np.concatenate(at)[:, None], np.cumsum([0, *map(len, at)]).tolist()
            parts = [slice(*pair) for pair in pairwise(ends)]
            near = 1e-6 * np.eye(len(whole))
            one, two = (
                np.array(law(*((whole + by)[part] for part in parts))) for by in (-near, near)
            )
            for k, part in enumerate(parts):
                slopes[k] = np.asfortranarray((two - one)[:, part] / 2e-6)
        return np.array(law(*at), dtype=np.float64)

    return gtsam.CustomFactor(noise, list(keys), error)


def node(k: int) -> int:
    return int(gtsam.symbol("x", k))


def constant(name: str) -> int:
    return int(gtsam.symbol("c", list(CONSTANTS).index(name)))


class Case(NamedTuple):
    """What is measured of a drive, and where on the vehicle."""

    drive: Drive
    seen: Measurements
    lever: tuple[float, float] = (0.0, 0.0)
    ahead: float = 0.0


def motion(case: Case, kept: _Float64, variance: _Float64, x: _Float64) -> list[Any]:
    """The vehicle's laws, its gyro and the receiver's slow error; the slip is that of states."""
    seen, found, slip = case.seen, [], slips(x)
    start, bias_m = guess(case.drive, seen), np.maximum(seen.bias_m, 1e-4)
    found.append(factor(lambda x: [*x[GYRO:]], [np.radians(1.0), *bias_m[[0, 0]]], node(0)))
    for k in range(len(start)):
        if k == 0 or not seen.seen[k - 1]:
            usual = np.array([*start[k, :V], 0.0, 0.0])
            little = [1e5, 1e5, 10.0, 10.0, 0.3]
            found.append(factor(lambda x, usual=usual: [*(x[:GYRO].T - usual).T], little, node(k)))
        if seen.standing[k]:
            found.append(factor(lambda x: [x[V]], 0.01, node(k)))
    for k, h in enumerate(np.diff(seen.time_s)):
        ends, gyro, root = (node(k), node(k + 1)), seen.turned_rad[k], np.sqrt(h)
        less, more = sorted(bias_m[k : k + 2])
        stays = np.exp(-h / seen.bias_s[k]) * less / more
        joins = bias_m[k + 1] * np.sqrt(1.0 - stays**2)
        share = stays * bias_m[k + 1] / bias_m[k]
        found.append(factor(keeps(BIAS, share), [joins, joins], *ends))
        found.append(factor(keeps(GYRO), np.radians(0.003) * root, *ends))
        if np.isfinite(gyro):
            noise = np.radians(0.05) * root
            found.append(factor(turns(gyro, h), noise, *ends, constant("gyro_scale")))
        if seen.seen[k]:
            at_rest = seen.standing[k] and seen.standing[k + 1]
            turn = np.radians(0.05 if at_rest else 20.0 if np.isfinite(gyro) else 0.3)
            found.append(factor(moves(h, slip[k]), np.array([0.05, 0.01, turn]) * root, *ends))
            found.append(factor(keeps(V), root, *ends))
            found.append(factor(keeps(KAPPA, kept[k]), np.sqrt(variance[k]), *ends))
    return found


def sensors(case: Case, x: _Float64) -> list[Any]:
    """What is measured; the noise of fixes lies along and across the headings of states."""
    seen, found = case.seen, []
    for k in np.flatnonzero(np.isfinite(seen.fix_sigma_m[:, 0])).tolist():
        law = fixed(seen.fix_m[k], case.lever, x[k, PHI])
        found.append(factor(law, seen.fix_sigma_m[k], node(k), heavy=True))
    for k in np.flatnonzero(np.isfinite(seen.heading_sigma_rad)).tolist():
        heading, sigma = seen.heading_rad[k], seen.heading_sigma_rad[k]

        def nose(x: _Float64, offset: _Float64, heading: float = heading) -> list[Any]:
            return [wrapped(x[PHI] + offset[0] - heading)]

        found.append(factor(nose, sigma, node(k), constant("heading_offset"), heavy=True))
    for k in np.flatnonzero(np.isfinite(seen.speed_sigma_mps)).tolist():
        speed, sigma = seen.speed_mps[k], seen.speed_sigma_mps[k]

        def wheels(x: _Float64, scale: _Float64, speed: float = speed) -> list[Any]:
            return [(1.0 + scale[0]) * x[V] - speed]

        found.append(factor(wheels, sigma, node(k), constant("wheel_scale"), heavy=True))
    for (one, two), step, sigma in zip(seen.step_nodes, seen.step, seen.step_sigma, strict=True):
        ends, (way, turn) = (node(one), node(two)), steps(step, case.ahead)
        camera = constant("camera_scale"), constant("camera_yaw_rad")
        found.append(factor(way, sigma[[0, 0]], *ends, *camera, heavy=True))
        found.append(factor(turn, sigma[1], *ends, heavy=True))
    return found


def solved(case: Case, steering: tuple[_Float64, _Float64]) -> tuple[_Float64, Any, Any]:
    """States [n, 8] of a drive, all values, and what they are known to."""
    x, values = guess(case.drive, case.seen), gtsam.Values()
    for k, state in enumerate(x):
        values.insert(node(k), state)
    for name in CONSTANTS:
        values.insert(constant(name), np.zeros(1))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(200)
    settings.setRelativeErrorTol(1e-10)
    for _ in range(3):  # each with the axes and the slip of the one before
        graph = gtsam.NonlinearFactorGraph()
        for name, sigma in CONSTANTS.items():
            graph.push_back(factor(lambda c: [c[0]], sigma, constant(name), heavy=True))
        for one in [*motion(case, *steering, x), *sensors(case, x)]:
            graph.push_back(one)
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
        x = np.array([values.atVector(node(k)) for k in range(len(x))])
    return x, values, gtsam.Marginals(graph, values)


# --- ten drives and more

ROWS = [Command(12.0, 1.5), Command(9.0, 1.0, 0.35), Command(12.0, 1.5)]
ROAD = [Command(6.0, 8.0), Command(7.0, 8.0, 0.03), Command(7.0, 8.0, -0.04)]


def noise(size: Any, sigma: Any = 1.0) -> _Float64:
    return np.asarray(np.random.default_rng(1).normal(size=size) * sigma)


def camera(drive: Drive, nodes: int, ahead: float) -> dict[str, Any]:
    """Steps over some nodes, 2 % too long and seen from 1 degree to the right."""
    told = steps_between(drive, nodes, ahead)
    forward, right, turn = told["step"].T
    way = 1.02 * (forward + 1j * right) * np.exp(-1j * np.radians(1.0))
    told["step"] = np.stack([way.real, way.imag, turn], axis=1)
    told["step"] += noise(turn.size * 3).reshape(-1, 3) * told["step_sigma"][:, [0, 0, 1]]
    return told


def wheels_and_headings(drive: Drive) -> dict[str, Any]:
    """Wheels that are 4 % too fast, headings that are 3 degrees off."""
    n = len(drive.time_s)
    return {
        "speed_mps": 1.04 * drive.speed_mps + noise(n, 0.05),
        "speed_sigma_mps": np.full(n, 0.05),
        "heading_rad": drive.heading_rad + np.radians(3.0) + noise(n, np.radians(1.0)),
        "heading_sigma_rad": np.full(n, np.radians(1.0)),
    }


def slow(drive: Drive, size_m: float) -> _Float64:
    """An error [n, 2] that changes over half a minute."""
    return size_m * np.stack([np.sin(drive.time_s / 9.0), np.cos(drive.time_s / 7.0)], axis=1)


def positions_alone() -> Case:
    drive = simulate(SLALOM, 20.0).every(0.25)
    return Case(drive, measured_at(drive, 0.03))


def antenna_aside() -> Case:
    drive, lever = simulate(CIRCLE, 20.0).every(0.3), (0.6, 1.8)
    return Case(drive, measured_at(drive, 0.1, lever=lever), lever)


def reverse_with_a_gyro() -> Case:
    drive, lever = simulate(K_TURN, 20.0).every(0.3), (0.0, 1.8)
    return Case(drive, measured_at(drive, 0.03, lever=lever, gyro_bias_dps=0.3), lever)


def reverse_with_a_camera() -> Case:
    drive = simulate(K_TURN, 20.0).every(0.3)
    return Case(drive, measured_at(drive, 0.3, **camera(drive, 2, 1.5)), ahead=1.5)


def rows_with_a_slow_error() -> Case:
    drive = simulate(ROWS, 20.0).every(0.25)
    seen = measured_at(drive, 0.02, bias_m=0.3, gyro_bias_dps=-0.2)
    return Case(drive, seen._replace(fix_m=seen.fix_m + slow(drive, 0.3)))


def stop_with_wheels_and_headings() -> Case:
    drive = simulate(STOP, 20.0).every(0.3)
    return Case(drive, measured_at(drive, 0.2, **wheels_and_headings(drive)))


def everything() -> Case:
    """Fixes at each third node only."""
    drive, lever = simulate(SLALOM, 20.0).every(0.25), (-0.4, 1.2)
    told = camera(drive, 2, 1.5) | wheels_and_headings(drive)
    seen = measured_at(drive, 0.05, bias_m=0.2, lever=lever, gyro_bias_dps=0.3, **told)
    fixes = np.where(np.arange(len(drive.time_s)) % 3 == 0, 1.0, np.nan)[:, None]
    return Case(
        drive,
        seen._replace(
            fix_m=fixes * (seen.fix_m + slow(drive, 0.2)), fix_sigma_m=fixes * seen.fix_sigma_m
        ),
        lever,
        1.5,
    )


def outliers() -> Case:
    """Each twentieth fix is 5 m off."""
    drive = simulate(ROWS, 20.0).every(0.25)
    seen = measured_at(drive, 0.03, gyro_bias_dps=0.3)
    seen.fix_m[7::20] += [3.0, -4.0]
    return Case(drive, seen)


def fixed_and_float() -> Case:
    """Slow errors that grow and shrink; noise that is larger across the heading than along."""
    drive = simulate(SLALOM, 20.0).every(0.25)
    n = len(drive.time_s)
    bias_m = np.where(np.arange(n) // 30 % 2 == 0, 0.02, 0.3)
    seen = measured_at(drive, 0.03, gyro_bias_dps=0.3)._replace(
        bias_m=bias_m, bias_s=np.where(bias_m > 0.1, 10.0, 300.0)
    )
    seen.fix_sigma_m[:, 1] = 0.08
    return Case(drive, seen._replace(fix_m=seen.fix_m + bias_m[:, None] * slow(drive, 1.0)))


def hole() -> Case:
    """Of ten seconds, over which only a gyro goes on; it is missing elsewhere."""
    whole = simulate(SLALOM, 20.0)
    drive = whole.at(np.concatenate([np.arange(0.0, 13.0, 0.2), np.arange(23.0, 36.0, 0.2)]))
    seen = measured_at(drive, 0.03, gyro_bias_dps=0.3)
    seen.turned_rad[:40] = np.nan
    return Case(drive, seen._replace(seen=np.diff(drive.time_s) < 5.0))


def car() -> Case:
    drive = simulate(ROAD, 20.0, speed_mps=8.0).every(0.15)
    return Case(drive, measured_at(drive, 0.05, gyro_bias_dps=0.3, bias_m=0.1))


SOME = (
    antenna_aside,
    reverse_with_a_gyro,
    stop_with_wheels_and_headings,
    everything,
    fixed_and_float,
)
OTHERS = (
    positions_alone,
    reverse_with_a_camera,
    rows_with_a_slow_error,
    outliers,
    hole,
    car,
)


def differences(case: Case, found: SmoothedDrive) -> tuple[dict[str, float], dict[str, float]]:
    """The largest differences of states in sigmas, and the most different ratios of sigmas."""
    x, values, marginals = solved(case, found.steering)
    covariance = np.array([marginals.marginalCovariance(node(k)) for k in range(len(x))])
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    own_frame = np.eye(2, 8) + np.eye(2, 8, 6)  # place + slow error
    among = np.einsum("ij,njk,lk->nil", own_frame, covariance, own_frame)
    relative_m = np.sqrt(np.einsum("nii->ni", among))
    apart = found.state - x
    by_state = np.abs(apart / sigma).max(axis=0)
    off = dict(zip(STATES, by_state.tolist(), strict=True))
    off["relative"] = float(np.abs(apart @ own_frame.T / relative_m).max())
    ratios = {
        "position": found.position_sigma_m / np.sqrt((sigma[:, PLACE] ** 2).mean(axis=1)),
        "relative": found.relative_sigma_m / np.sqrt((relative_m**2).mean(axis=1)),
        "heading": found.heading_sigma_rad / sigma[:, PHI],
    }
    for name in CONSTANTS:
        told = getattr(found, name)
        if told is not None:
            known = np.sqrt(marginals.marginalCovariance(constant(name))[0, 0])
            off[name] = abs(told.value - values.atVector(constant(name))[0]) / known
            ratios[name] = np.array([told.sigma / known])
    return off, {name: float(max(one.max(), 1 / one.min())) for name, one in ratios.items()}


@pytest.mark.parametrize(
    "make", [*SOME, *(pytest.param(one, marks=pytest.mark.long) for one in OTHERS)]
)
def test_gtsam_says_the_same(make: Callable[[], Case]) -> None:
    case = make()
    found = smooth(case.seen, guess(case.drive, case.seen), case.lever, case.ahead)
    off, ratios = differences(case, found)
    assert max(off.values()) < 0.1, off
    assert max(ratios.values()) < 1.1, ratios
