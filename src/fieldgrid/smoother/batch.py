"""One estimate of a whole drive: least squares over every node at once, robust to outliers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.smoother import model
from fieldgrid.smoother.banded import factor, inverse_blocks, solve

MOST_ROUNDS = 25
ENOUGH_M, ENOUGH_RAD = 3e-3, 3e-4
"""Rounds end when no node moves or turns by more."""

OUTLIER_FREEDOM = 4.0
"""Of Student's distribution, which a fix or a step is taken to err by: outliers are believed
the less the farther they lie."""

RESTLESSNESSES = (0.01, 0.02, 0.05, 0.1, 0.2)
"""How much a vehicle steers all the time, (1/m)/√s: a robot in its row, a mower in the rough."""

USUAL_RESTLESSNESS = 0.05

ADAPTATIONS, ADAPTING_ROUNDS = 6, 2
"""So often the expected steering is brought up to date, for so many rounds each. More of it makes
rows straighter, and hides steering where noise could."""

GYRO_SHARE = 0.9
"""With a gyro over more of the drive than this, nothing needs to be expected of its steering."""

LOST_M = 1e4
"""No node is less sure of its place, so that also a long way without a fix can be solved."""

BLIND_S = 0.75
"""Farther in time from every fix, steering is not seen, and any is expected."""

CLEAR_NATS = 2.0
"""A drive is taken for a calm one only when its fixes clearly say so."""

STRETCHES, STRETCH_NODES = 4, 1000
"""A longer drive is looked at in so many places, to learn how restless it is."""

_System = tuple[Float64, Float64, Float64]


class Sightings(NamedTuple):
    """What was seen at n nodes, ordered by `time_s`; NaN where nothing was.

    `fix_m` [n, 2] is the antenna's east and north, `fix_sigma_m` the noise of one axis,
    `fix_bias_m` the 1-sigma of its slow error and `fix_bias_s` for how long that lasts, both
    at every node. `nose_rad` is a recorded heading, `speed_mps` a signed speed. `turned_rad`
    [n - 1] is the gyro's integral from node to node, `seen` [n - 1] whether the way to the next
    node is short enough to be known; `standing` marks nodes at rest.

    `step_nodes` [s, 2] are the start and the end of relative motions, `step` [s, 3] = forward,
    right (metres in the vehicle frame at the start) and clockwise turn (rad), `step_sigma`
    [s, 2] the sigma of way and turn.
    """

    time_s: Float64
    fix_m: Float64
    fix_sigma_m: Float64
    fix_bias_m: Float64
    fix_bias_s: Float64
    nose_rad: Float64
    nose_sigma_rad: Float64
    speed_mps: Float64
    speed_sigma_mps: Float64
    turned_rad: Float64
    seen: Bool
    standing: Bool
    step_nodes: Int64
    step: Float64
    step_sigma: Float64

    def part(self, start: int, stop: int) -> Sightings:
        """What was seen from node `start` to before node `stop`."""
        between = {"turned_rad", "seen"}
        inside = np.all((self.step_nodes >= start) & (self.step_nodes < stop), axis=1)
        columns = {
            name: column[start : stop - (name in between)]
            for name, column in self._asdict().items()
            if not name.startswith("step")
        }
        return Sightings(
            **columns,
            step_nodes=self.step_nodes[inside] - start,
            step=self.step[inside],
            step_sigma=self.step_sigma[inside],
        )


class Smoothed(NamedTuple):
    """The estimate at n nodes: `state` [n, 8] as in :mod:`fieldgrid.smoother.model`.

    `position_sigma_m` is absolute, `relative_sigma_m` that within the receiver's own frame:
    without the slow error that shifts neighbours alike. Both are 1-sigma along one axis.
    `fix_off_m` and `step_off_m` are how far fixes and steps lie from the estimate.
    """

    state: Float64
    position_sigma_m: Float64
    relative_sigma_m: Float64
    heading_sigma_rad: Float64
    fix_off_m: Float64
    step_off: Float64
    rounds: int
    restlessness: float


def smooth(
    seen: Sightings,
    start: Float64,
    lever_m: tuple[float, float] = (0.0, 0.0),
    step_ahead_m: float = 0.0,
) -> Smoothed:
    """The likeliest drive from a first guess `start` [n, 8] that has its gears right.

    `lever_m` is the antenna's place (right, ahead) and `step_ahead_m` that of the point whose
    motion the steps tell, from the middle of the axle that does not steer. How restlessly the
    vehicle steers is what makes its own fixes likeliest. The same input gives the same bits.
    """
    problem = _Problem(seen, np.array(lever_m), step_ahead_m)
    found = _converged(problem, start, _stated_weights(seen))
    restlessness = USUAL_RESTLESSNESS
    # A gyro sees the steering; without one the drive has to tell what to expect of it.
    gyro = np.isfinite(seen.turned_rad)
    if gyro.size and gyro.mean() < GYRO_SHARE:
        restlessness = _restlessness(problem, found)
        found = _adapted(problem, found, restlessness)
    system, off = _normal_equations(problem, found.x, found.weights)
    blocks, _ = inverse_blocks(factor(system[0]), model.STATES)
    return _with_sigmas(found, blocks, seen, off, restlessness)


class _Problem(NamedTuple):
    seen: Sightings
    lever_m: Float64
    step_ahead_m: float


class _Solution(NamedTuple):
    x: Float64
    weights: _Weights
    rounds: int
    last_change: Float64


def _converged(
    problem: _Problem, start: Float64, weights: _Weights, most_rounds: int = MOST_ROUNDS
) -> _Solution:
    """Rounds of least squares until nothing moves, each with the weights of the one before."""
    x, now, rounds = start.copy(), weights, 0
    stated = _stated_weights(problem.seen)._replace(steering=weights.steering)
    for rounds in range(1, most_rounds + 1):
        (band, right, _), off = _normal_equations(problem, x, now)
        change = solve(factor(band), right).reshape(x.shape)
        # A first guess may be far off: no node turns by more than a radian a round.
        x += change / max(1.0, float(np.abs(change[:, model.PHI]).max()))
        moved_m = float(np.abs(change[:, : model.PHI]).max())
        turned = float(np.abs(change[:, model.PHI]).max())
        if rounds > 2 and moved_m < ENOUGH_M and turned < ENOUGH_RAD:
            break
        now = _robust(stated, off)
    return _Solution(x, now, rounds, change)


def _adapted(problem: _Problem, found: _Solution, restlessness: float) -> _Solution:
    """The drive when steering is expected where it was seen, and where it may be hidden."""
    k, seen = model.KAPPA, problem.seen
    blind, usual = _blind(seen), model.usual_steering(np.diff(seen.time_s))
    for _ in range(ADAPTATIONS):
        (band, _, _), _ = _normal_equations(problem, found.x, found.weights)
        blocks, onward = inverse_blocks(factor(band), model.STATES)
        steering = model.local_steering(
            found.x[:, k], blocks[:, k, k], onward[:, k], seen.time_s, restlessness
        )
        weights = found.weights._replace(steering=np.where(blind, usual, steering))
        found = _converged(problem, found.x, weights, ADAPTING_ROUNDS)
    return _converged(problem, found.x, found.weights)


def _blind(seen: Sightings) -> Bool:
    """Steps [n - 1] on which no fix is near."""
    fixes_s = seen.time_s[np.isfinite(seen.fix_sigma_m)]
    at = np.concatenate([[-np.inf], fixes_s, [np.inf]])  # a stretch may have none
    middle = (seen.time_s[1:] + seen.time_s[:-1]) / 2.0
    after = np.searchsorted(at, middle)
    apart = np.minimum(middle - at[after - 1], at[after] - middle)
    return np.asarray(apart > BLIND_S)


def _restlessness(problem: _Problem, found: _Solution) -> float:
    """The restlessness of :data:`RESTLESSNESSES` under which the sightings are likeliest.

    Their likelihood rises to one top, so it is climbed from the usual one. Of a long drive
    some stretches are enough.
    """
    stretches = _stretches(problem, found.x)
    tried: dict[int, float] = {}

    def likelihood(k: int) -> float:
        if k not in tried:
            tried[k] = sum(_log_likelihood(part, x, RESTLESSNESSES[k]) for part, x in stretches)
        return tried[k]

    at = RESTLESSNESSES.index(USUAL_RESTLESSNESS)
    for step in (-1, 1):
        while 0 <= at + step < len(RESTLESSNESSES):
            if likelihood(at + step) <= likelihood(at) - step * CLEAR_NATS:
                break
            at += step
    return RESTLESSNESSES[at]


def _stretches(problem: _Problem, x: Float64) -> list[tuple[_Problem, Float64]]:
    """Parts of a drive that stand for it, each with its states."""
    n = len(x)
    if n <= STRETCHES * STRETCH_NODES:
        return [(problem, x)]
    starts = np.linspace(0, n - STRETCH_NODES, STRETCHES).astype(int).tolist()
    return [
        (
            problem._replace(seen=problem.seen.part(a, a + STRETCH_NODES)),
            x[a : a + STRETCH_NODES],
        )
        for a in starts
    ]


def _log_likelihood(problem: _Problem, start: Float64, restlessness: float) -> float:
    """Of the sightings, every drive considered: Laplace's approximation, up to a constant."""
    first = _converged(problem, start, _stated_weights(problem.seen))
    solution = _adapted(problem, first, restlessness)
    (band, _, total), _ = _normal_equations(problem, solution.x, solution.weights)
    log_determinant = 2.0 * float(np.log(factor(band)[0]).sum())
    return 0.5 * float(total[1] - total[0] - log_determinant)


def _stated_weights(seen: Sightings) -> _Weights:
    return _Weights(
        _squared_inverse(seen.fix_sigma_m),
        _squared_inverse(seen.nose_sigma_rad),
        _squared_inverse(seen.speed_sigma_mps),
        1.0 / seen.step_sigma**2,
        model.usual_steering(np.diff(seen.time_s)),
    )


class _Weights(NamedTuple):
    fix: Float64
    nose: Float64
    speed: Float64
    step: Float64
    steering: Float64


class _Off(NamedTuple):
    fix_m: Float64
    nose_rad: Float64
    speed_mps: Float64
    step: Float64


def _squared_inverse(sigma: Float64) -> Float64:
    return np.where(np.isnan(sigma), 0.0, 1.0 / np.where(np.isnan(sigma), 1.0, sigma) ** 2)


def _normal_equations(problem: _Problem, x: Float64, weights: _Weights) -> tuple[_System, _Off]:
    """The normal equations, and how far each sighting is off."""
    seen = problem.seen
    reach = int(np.diff(seen.step_nodes).max()) if len(seen.step_nodes) else 1
    system = (
        np.zeros((model.STATES * (reach + 1), x.size)),
        np.zeros(x.size),
        np.zeros(2),
    )
    step_s = np.diff(seen.time_s)
    model.add_start(system, x, 0)
    model.add_motion(
        system,
        x,
        step_s,
        weights.steering,
        seen.fix_bias_s,
        seen.turned_rad,
        seen.seen,
        seen.standing,
    )
    still = np.where(seen.standing, 1.0 / model.STANDING_MPS**2, 0.0)
    model.add_values(system, x, model.V, np.zeros(len(x)), still)
    for axis in (model.E, model.N):
        model.add_values(system, x, axis, x[:, axis], np.full(len(x), 1.0 / LOST_M**2))
    off = _Off(
        model.add_fixes(system, x, seen.fix_m, seen.fix_bias_m, weights.fix, problem.lever_m),
        model.add_values(system, x, model.PHI, seen.nose_rad, weights.nose),
        model.add_values(system, x, model.V, seen.speed_mps, weights.speed),
        model.add_steps(system, x, seen.step_nodes, seen.step, weights.step, problem.step_ahead_m),
    )
    return system, off


def _robust(weights: _Weights, off: _Off) -> _Weights:
    """Student's weights for the next round; 1 sigma off costs nothing, 10 nearly everything."""

    def less(weight: Float64, squared: Float64, size: int) -> Float64:
        share = (OUTLIER_FREEDOM + size) / (OUTLIER_FREEDOM + weight * squared)
        return weight * np.minimum(share, 1.0)

    way = less(weights.step[:, 0], (off.step[:, :2] ** 2).sum(axis=1), 2)
    return _Weights(
        less(weights.fix, off.fix_m**2, 2),
        less(weights.nose, off.nose_rad**2, 1),
        less(weights.speed, off.speed_mps**2, 1),
        np.stack([way, less(weights.step[:, 1], off.step[:, 2] ** 2, 1)], axis=1),
        weights.steering,
    )


def _with_sigmas(
    found: _Solution, blocks: Float64, seen: Sightings, off: _Off, restlessness: float
) -> Smoothed:
    """The estimate with its sigmas; where it has not settled, what still changes counts too."""
    east, north, phi = model.E, model.N, model.PHI
    b = np.nan_to_num(seen.fix_bias_m)
    relative = sum(
        blocks[:, axis, axis] + 2.0 * b * blocks[:, axis, bias] + b**2 * blocks[:, bias, bias]
        for axis, bias in ((east, model.BIAS_E), (north, model.BIAS_N))
    )
    moved, turned = found.last_change[:, : model.PHI], found.last_change[:, model.PHI]
    unsettled = (moved**2).sum(axis=1)
    absolute = blocks[:, east, east] + blocks[:, north, north]
    return Smoothed(
        found.x,
        np.sqrt((absolute + unsettled) / 2.0),
        np.sqrt((np.maximum(relative, 0.0) + unsettled) / 2.0),
        np.sqrt(blocks[:, phi, phi] + turned**2),
        off.fix_m,
        off.step,
        found.rounds,
        restlessness,
    )
