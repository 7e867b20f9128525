"""What a wheeled vehicle can do, and what its sensors see, as weighted residuals.

The state of a node is [east, north, heading, speed, curvature, gyro bias, bias east, bias
north]: the middle of the axle that does not steer, in metres; the nose's direction, radians
clockwise from north; metres a second, negative in reverse; radians of turn a metre; radians a
second; and the slow part of the receiver's error in units of its own sigma.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.kernel import kernel

STATES = 8
E, N, PHI, V, KAPPA, GYRO, BIAS_E, BIAS_N = range(STATES)

TURN_NOISE = np.radians(0.3)
"""Turning that neither speed nor curvature explains, rad/√s: slip."""

FREE_TURN_NOISE = np.radians(20.0)
"""The same where a gyro sees it: some vehicles turn on the spot."""

STANDING_TURN_NOISE = np.radians(0.05)
"""How a standing vehicle's nose may creep, rad/√s."""

ALONG_NOISE = 0.05
"""Way that the speed does not explain, m/√s: late time stamps, wheel slip."""

ACROSS_NOISE = 0.01
"""Way across the nose, m/√s: a wheel pushed off its line."""

ACCELERATION_NOISE = 1.0
"""Change of speed, (m/s)/√s."""

CURVATURE_SIGMA, CURVATURE_S = 0.3, 2.0
"""Curvatures usual on fields, 1/m, and for how many seconds one lasts."""

ALWAYS_SHARE = 0.5
"""Of the expected steering, what is due to the vehicle's usual restlessness."""

MOST_STEERING = 8.0 * CURVATURE_SIGMA**2 / CURVATURE_S
"""(1/m)²/s: from lock to lock in a second."""

STEERING_S = 2.0
"""Steering at one moment makes more of it likely for about a second before and after."""

SLIP_ANGLE = np.radians(0.2)
"""By how much an unsteered axle slides outward, rad per m/s² of acceleration across."""

GYRO_NOISE = np.radians(0.05)
"""Noise of an integrated gyro with a vehicle's vibrations, rad/√s."""

GYRO_BIAS_SIGMA, GYRO_BIAS_NOISE = np.radians(1.0), np.radians(0.003)
"""A gyro's bias at first, rad/s, and how it wanders, (rad/s)/√s."""

STANDING_MPS = 0.01
"""How exactly a standing vehicle stands."""


def usual_steering(step_s: Float64) -> Float64:
    """Variance of the curvature's change over steps [n - 1] of a drive not looked at yet."""
    return np.asarray(CURVATURE_SIGMA**2 * (1.0 - np.exp(-2.0 * step_s / CURVATURE_S)))


def local_steering(
    curvature: Float64,
    variance: Float64,
    onward: Float64,
    time_s: Float64,
    restlessness: float,
) -> Float64:
    """The same by what the curvatures [n] do around each step, as far as that is known:
    `variance` [n] is theirs, `onward` [n] their covariance with the next one.

    A vehicle goes straight for long and then turns in. `restlessness`, (1/m)/√s, is how much
    it steers always; a part of the variance is that, and the rest what was seen nearby. What
    noise hides counts as steering: it is expected there, not ruled out.
    """
    step_s = np.diff(time_s)
    fading = np.exp(-step_s / CURVATURE_S)
    change = (curvature[1:] - fading * curvature[:-1]) ** 2
    change += variance[1:] + fading**2 * variance[:-1] - 2.0 * fading * onward[:-1]
    middle_s = (time_s[1:] + time_s[:-1]) / 2.0
    first = np.searchsorted(middle_s, middle_s - STEERING_S / 2.0)
    last = np.searchsorted(middle_s, middle_s + STEERING_S / 2.0, side="right")
    changed = np.concatenate([[0.0], np.cumsum(change)])
    passed_s = np.concatenate([[0.0], np.cumsum(step_s)])
    near = (changed[last] - changed[first]) / (passed_s[last] - passed_s[first])
    mixed = ALWAYS_SHARE * restlessness**2 + (1.0 - ALWAYS_SHARE) * near
    return np.asarray(np.minimum(mixed, MOST_STEERING) * step_s)


@kernel
def add(system, index, slope, count, residual, weight):  # type: ignore[no-untyped-def]
    """One weighted residual with `count` slopes into the normal equations.

    `system` is (band, right side, total), total being the sum of the squared residuals in
    units of their sigmas, and that of the logarithms of the weights.
    """
    band, right, total = system
    total[0] += weight * residual * residual
    total[1] += np.log(weight)
    for a in range(count):
        right[index[a]] -= weight * slope[a] * residual
        for b in range(count):
            if index[a] >= index[b]:
                band[index[a] - index[b], index[b]] += weight * slope[a] * slope[b]


@kernel
def add_motion(system, x, step_s, steering, bias_s, turned, seen, standing):  # type: ignore[no-untyped-def]
    """The vehicle's own laws between neighbouring nodes, and its gyro [n - 1] (NaN: none).

    `steering` [n - 1] is the variance of the curvature's change over each step, `bias_s` [n]
    for how long the slow part of the receiver's error lasts there. Over a hole
    (`seen` is False) only the gyro and the drifts go on.
    """
    index, slope = np.empty(8, np.int64), np.empty(8)
    for k in range(len(step_s)):
        a, b, h = STATES * k, STATES * (k + 1), step_s[k]
        fading = np.exp(-h / bias_s[k])
        _add_drift(system, x, k, BIAS_E, fading, 1.0 - fading**2)
        _add_drift(system, x, k, BIAS_N, fading, 1.0 - fading**2)
        _add_drift(system, x, k, GYRO, 1.0, GYRO_BIAS_NOISE**2 * h)
        gyro = not np.isnan(turned[k])
        if gyro:
            index[0], index[1], index[2] = a + PHI, b + PHI, a + GYRO
            slope[0], slope[1], slope[2] = -1.0, 1.0, h
            off = x[k + 1, PHI] - x[k, PHI] - (turned[k] - x[k, GYRO] * h)
            add(system, index, slope, 3, off, 1.0 / (GYRO_NOISE**2 * h))
        if not seen[k]:
            add_start(system, x, k + 1)
            continue
        east, north = x[k + 1, E] - x[k, E], x[k + 1, N] - x[k, N]
        middle, speed = (x[k, PHI] + x[k + 1, PHI]) / 2.0, (x[k, V] + x[k + 1, V]) / 2.0
        curvature = (x[k, KAPPA] + x[k + 1, KAPPA]) / 2.0
        sin, cos, way = np.sin(middle), np.cos(middle), h * speed
        along, across = east * sin + north * cos, east * cos - north * sin
        index[:4] = a + E, a + N, b + E, b + N
        index[4], index[5], index[6], index[7] = a + PHI, b + PHI, a + V, b + V
        slope[:4] = -sin, -cos, sin, cos
        slope[4] = slope[5] = across / 2.0
        slope[6] = slope[7] = -h / 2.0
        add(system, index, slope, 8, along - way, 1.0 / (ALONG_NOISE**2 * h))
        # In a turn the tail slides outward: the way points outside of the nose.
        slide = -SLIP_ANGLE * curvature * speed * abs(speed)
        slope[:4] = -cos, sin, cos, -sin
        slope[4] = slope[5] = -along / 2.0
        slope[6] = slope[7] = -h / 2.0 * slide
        add(system, index, slope, 8, across - way * slide, 1.0 / (ACROSS_NOISE**2 * h))
        turn_noise = FREE_TURN_NOISE if gyro else TURN_NOISE
        if standing[k] and standing[k + 1]:
            turn_noise = STANDING_TURN_NOISE
        index[0], index[1], index[2], index[3] = a + PHI, b + PHI, a + V, b + V
        index[4], index[5] = a + KAPPA, b + KAPPA
        slope[0], slope[1] = -1.0, 1.0
        slope[2] = slope[3] = -h / 2.0 * curvature
        slope[4] = slope[5] = -way / 2.0
        turn = x[k + 1, PHI] - x[k, PHI]
        add(system, index, slope, 6, turn - way * curvature, 1.0 / (turn_noise**2 * h))
        _add_drift(system, x, k, V, 1.0, ACCELERATION_NOISE**2 * h)
        fading = np.exp(-h / CURVATURE_S)
        _add_drift(system, x, k, KAPPA, fading, steering[k])


@kernel
def _add_drift(system, x, k, state, fading, variance):  # type: ignore[no-untyped-def]
    index, slope = np.empty(2, np.int64), np.empty(2)
    index[0], index[1] = STATES * k + state, STATES * (k + 1) + state
    slope[0], slope[1] = -fading, 1.0
    residual = x[k + 1, state] - fading * x[k, state]
    add(system, index, slope, 2, residual, 1.0 / variance)


@kernel
def add_start(system, x, k):  # type: ignore[no-untyped-def]
    """What is known of a node with nothing before it: little."""
    index, slope = np.zeros(1, np.int64), np.ones(1)
    for state, sigma in (
        (E, 1e5),
        (N, 1e5),
        (PHI, 10.0),
        (V, 10.0),
        (KAPPA, CURVATURE_SIGMA),
    ):
        index[0] = STATES * k + state
        off = x[k, state] if state in (V, KAPPA) else 0.0
        add(system, index, slope, 1, off, 1.0 / sigma**2)
    if k == 0:
        for state, sigma in ((GYRO, GYRO_BIAS_SIGMA), (BIAS_E, 1.0), (BIAS_N, 1.0)):
            index[0] = state
            add(system, index, slope, 1, x[0, state], 1.0 / sigma**2)


@kernel
def add_fixes(system, x, fix_en, bias_m, weight, lever):  # type: ignore[no-untyped-def]
    """Positions of the antenna, `lever` = (right, ahead) of the axle: fix = point + bias.

    Rows without a fix have weight 0. Returns the distance of each fix from where it should be.
    """
    n = len(weight)
    off_m = np.zeros(n)
    index, slope = np.empty(3, np.int64), np.empty(3)
    for k in range(n):
        if not weight[k] > 0.0:
            continue
        sin, cos = np.sin(x[k, PHI]), np.cos(x[k, PHI])
        aside_e, aside_n = (
            lever[0] * cos + lever[1] * sin,
            -lever[0] * sin + lever[1] * cos,
        )
        off_e = x[k, E] + aside_e + bias_m[k] * x[k, BIAS_E] - fix_en[k, 0]
        off_n = x[k, N] + aside_n + bias_m[k] * x[k, BIAS_N] - fix_en[k, 1]
        index[0], index[1], index[2] = (
            STATES * k + E,
            STATES * k + PHI,
            STATES * k + BIAS_E,
        )
        slope[0], slope[1], slope[2] = 1.0, aside_n, bias_m[k]
        add(system, index, slope, 3, off_e, weight[k])
        index[0], index[2] = STATES * k + N, STATES * k + BIAS_N
        slope[1] = -aside_e
        add(system, index, slope, 3, off_n, weight[k])
        off_m[k] = np.hypot(off_e, off_n)
    return off_m


@kernel
def add_values(system, x, state, value, weight):  # type: ignore[no-untyped-def]
    """Direct sightings of one state [n]; weight 0 where there is none. Returns the residuals."""
    off = np.zeros(len(weight))
    index, slope = np.zeros(1, np.int64), np.ones(1)
    for k in range(len(weight)):
        if weight[k] > 0.0:
            off[k] = x[k, state] - value[k]
            if state == PHI:
                off[k] -= 2.0 * np.pi * np.round(off[k] / (2.0 * np.pi))
            index[0] = STATES * k + state
            add(system, index, slope, 1, off[k], weight[k])
    return off


@kernel
def add_steps(system, x, ends, moved, weight, ahead_m):  # type: ignore[no-untyped-def]
    """Relative motions `moved` [s, 3] = (forward, right, turn) of a point `ahead_m` of the axle
    between the nodes `ends` [s, 2], `weight` [s, 2] of way and turn. Returns residuals [s, 3].
    """
    off = np.zeros((len(ends), 3))
    index, slope = np.empty(6, np.int64), np.empty(6)
    for s in range(len(ends)):
        a, b = ends[s]
        sin, cos = np.sin(x[a, PHI]), np.cos(x[a, PHI])
        sin_b, cos_b = np.sin(x[b, PHI]), np.cos(x[b, PHI])
        east = x[b, E] - x[a, E] + ahead_m * (sin_b - sin)
        north = x[b, N] - x[a, N] + ahead_m * (cos_b - cos)
        forward, aside = east * sin + north * cos, east * cos - north * sin
        off[s, 0], off[s, 1] = forward - moved[s, 0], aside - moved[s, 1]
        off[s, 2] = x[b, PHI] - x[a, PHI] - moved[s, 2]
        off[s, 2] -= 2.0 * np.pi * np.round(off[s, 2] / (2.0 * np.pi))
        index[0], index[1], index[2] = STATES * a + E, STATES * a + N, STATES * a + PHI
        index[3], index[4], index[5] = STATES * b + E, STATES * b + N, STATES * b + PHI
        # The start's own lever turns with it and cancels, but for its place in the frame.
        slope[0], slope[1], slope[3], slope[4] = -sin, -cos, sin, cos
        slope[2] = aside
        slope[5] = ahead_m * (cos_b * sin - sin_b * cos)
        add(system, index, slope, 6, off[s, 0], weight[s, 0])
        slope[0], slope[1], slope[3], slope[4] = -cos, sin, cos, -sin
        slope[2] = -forward - ahead_m
        slope[5] = ahead_m * (cos_b * cos + sin_b * sin)
        add(system, index, slope, 6, off[s, 1], weight[s, 0])
        index[0], index[1] = STATES * a + PHI, STATES * b + PHI
        slope[0], slope[1] = -1.0, 1.0
        add(system, index, slope, 2, off[s, 2], weight[s, 1])
    return off
