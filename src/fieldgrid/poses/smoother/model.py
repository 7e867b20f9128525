"""What a wheeled vehicle can do, and what its sensors measure, as weighted residuals.

The state of a node is [east, north, heading, speed, curvature, gyro bias, bias east, bias
north]: the middle of the axle that does not steer, in metres; the heading, radians clockwise from
north; metres a second, negative in reverse; radians of turn a metre; radians a second; and the
slow part of the receiver's error, metres. Beside the nodes stand a few constants of the drive:
the offset of a recorded heading (radians), and the relative errors of the wheels' and of the
camera's scale.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Float64, kernel, part_of_kernel
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.equations import CONSTANTS, NormalEquations

E, N, PHI, V, KAPPA, GYRO, BIAS_E, BIAS_N = range(STATES)

HEADING_OFFSET, WHEEL_SCALE, CAMERA_SCALE = range(CONSTANTS)

SCALE_SIGMAS = 0.1, 0.03
"""What is known of the scales before the drive: tyres are off by a tenth; a stereo baseline, and
disparities that are off by a tenth of a pixel at a range of some metres, make some per cent."""

TURN_NOISE = np.radians(0.3)
"""Turning that neither speed nor curvature explains, rad/√s: slip."""

FREE_TURN_NOISE = np.radians(20.0)
"""Turning that neither speed nor curvature explains where a gyro sees it, rad/√s: some vehicles
turn on the spot."""

STANDING_TURN_NOISE = np.radians(0.05)
"""How a standing vehicle's heading may creep, rad/√s."""

ALONG_NOISE = 0.05
"""Distance that the speed does not explain, m/√s: late time stamps, wheel slip."""

ACROSS_NOISE = 0.01
"""Motion across the heading, m/√s: a wheel pushed off its line."""

ACCELERATION_NOISE = 1.0
"""Change of speed, (m/s)/√s."""

CURVATURE_SIGMA, CURVATURE_S = 0.3, 2.0
"""Curvatures usual on fields, 1/m, and for how many seconds one lasts."""

SLIP_ANGLE = np.radians(0.2)
"""By how much an unsteered axle slides outward, rad per m/s² of acceleration across."""

GYRO_NOISE = np.radians(0.05)
"""Noise of an integrated gyro with a vehicle's vibrations, rad/√s."""

GYRO_BIAS_SIGMA, GYRO_BIAS_NOISE = np.radians(1.0), np.radians(0.003)
"""A gyro's bias at first, rad/s, and how it wanders, (rad/s)/√s."""

STANDING_MPS = 0.01
"""How exactly a standing vehicle stands."""

LOST_M = 1e4
"""No node is less sure of its place, so that also a long way without a fix can be solved."""

NO_BIAS_M = 1e-4
"""The least sigma of a slow error, so that a receiver without one can be solved."""


@part_of_kernel
def _add_residual(system, index, slope, residual, weight):  # type: ignore[no-untyped-def]
    """One weighted residual with its slopes into the normal equations. An index beyond the
    states is a constant's."""
    shape, values, right, border, corner, right_constants, total = system
    first, start = shape[0], shape[1]
    states = len(right)
    total[0] += weight * residual * residual
    total[1] += np.log(weight)
    for a in range(len(index)):
        i, scaled = index[a], weight * slope[a]
        if i >= states:
            right_constants[i - states] -= scaled * residual
            for b in range(len(index)):
                if index[b] >= states:
                    corner[i - states, index[b] - states] += scaled * slope[b]
            continue
        right[i] -= scaled * residual
        node, row = i // STATES, i % STATES
        before = STATES * (node - first[node])
        at = start[node] + row * before + row * (row + 1) // 2 - STATES * first[node]
        for b in range(len(index)):
            j = index[b]
            if j <= i:
                values[at + j] += scaled * slope[b]
            elif j >= states:
                border[i, j - states] += scaled * slope[b]


@kernel
def add_motion(system, x, step_s, kept, steering, bias_m, bias_s, turned, seen, standing):  # type: ignore[no-untyped-def]
    """The vehicle's own laws between neighbouring nodes, and its gyro [n - 1] (NaN: none), in place
    of whatever the matrix held: to clear a large one takes as long as this.

    Of the curvature the share `kept` [n - 1] goes on over each step, and what joins has the
    variance `steering` [n - 1]. Over a hole
    (`seen` is False) only the gyro and the drifts go on. Of the weights only those of the steering
    and of the slow error enter the sum of their logarithms: the others are the same whatever is
    learnt.
    """
    # The equations of one node (0 to 7) and the next (8 to 15), lower triangle.
    pair, side = np.empty((2 * STATES, 2 * STATES)), np.empty(2 * STATES)
    for a in range(2 * STATES):
        side[a] = 0.0
        for b in range(2 * STATES):
            pair[a, b] = 0.0
    # Of literals Numba would compile a function anew for each.
    gyro_bias, speed, curvature = np.int64(GYRO), np.int64(V), np.int64(KAPPA)
    _add_start(pair, side, x, np.int64(0), np.int64(0))
    total = system[6]
    for state in (BIAS_E, BIAS_N):
        weight = 1.0 / max(bias_m[0], NO_BIAS_M) ** 2
        pair[state, state] += weight
        side[state] -= weight * x[0, state]
        total[0] += weight * x[0, state] ** 2
        total[1] += np.log(weight)
    pair[GYRO, GYRO] += 1.0 / GYRO_BIAS_SIGMA**2
    side[GYRO] -= x[0, GYRO] / GYRO_BIAS_SIGMA**2
    index, slope = np.empty(3, np.int64), np.empty(3)
    for k in range(len(step_s)):
        h = step_s[k]
        one, two = max(bias_m[k], NO_BIAS_M), max(bias_m[k + 1], NO_BIAS_M)
        # Of a growing slow error a new part joins, of a shrinking one a part leaves: the same is
        # said forward and backward in time, and at each node it has the sigma that is stated there.
        correlation = np.exp(-h / bias_s[k]) * min(one, two) / max(one, two)
        fading, variance = correlation * two / one, two**2 * (1.0 - correlation**2)
        for state in (BIAS_E, BIAS_N):
            total[0] += _add_drift(pair, side, x, k, state, fading, variance)
        total[1] -= 2.0 * np.log(variance)
        total[0] += _add_drift(pair, side, x, k, gyro_bias, 1.0, GYRO_BIAS_NOISE**2 * h)
        gyro = not np.isnan(turned[k])
        if gyro:
            index[0], index[1], index[2] = PHI, STATES + PHI, GYRO
            slope[0], slope[1], slope[2] = -1.0, 1.0, h
            off = x[k + 1, PHI] - x[k, PHI] - (turned[k] - x[k, GYRO] * h)
            total[0] += _add_to_pair(pair, side, index, slope, off, 1.0 / (GYRO_NOISE**2 * h))
        if seen[k]:
            turn_noise = FREE_TURN_NOISE if gyro else TURN_NOISE
            if standing[k] and standing[k + 1]:
                turn_noise = STANDING_TURN_NOISE
            total[0] += _add_kinematics(pair, side, x, k, h, turn_noise)
            total[0] += _add_drift(pair, side, x, k, speed, 1.0, ACCELERATION_NOISE**2 * h)
            total[0] += _add_drift(pair, side, x, k, curvature, kept[k], steering[k])
            total[1] -= np.log(steering[k])
        else:
            _add_start(pair, side, x, k + 1, np.int64(STATES))
        _put_node(system, pair, side, k)
    _put_node(system, pair, side, len(step_s))


@part_of_kernel
def _put_node(system, pair, side, k):  # type: ignore[no-untyped-def]
    """Write the equations of node k, which are complete, and what couples it with the next node,
    which becomes the first of the pair; nothing couples that with earlier ones yet."""
    shape, values, right = system[0], system[1], system[2]
    before = STATES * (k - shape[0][k])
    for a in range(STATES):
        own = shape[1][k] + (a + 1) * before + a * (a + 1) // 2
        right[STATES * k + a] += side[a]
        side[a] = side[STATES + a]
        side[STATES + a] = 0.0
        for b in range(a + 1):
            values[own + b] = pair[a, b]
            pair[a, b] = pair[STATES + a, STATES + b]
            pair[STATES + a, STATES + b] = 0.0
    if k + 1 < len(shape[0]):
        before = STATES * (k + 1 - shape[0][k + 1])
        for a in range(STATES):
            own = shape[1][k + 1] + (a + 1) * before + a * (a + 1) // 2
            for b in range(STATES, before):
                values[own - 1 - b] = 0.0
            for b in range(STATES):
                values[own - STATES + b] = pair[STATES + a, b]
                pair[STATES + a, b] = 0.0


@part_of_kernel
def _add_to_pair(pair, side, index, slope, residual, weight):  # type: ignore[no-untyped-def]
    for a in range(len(index)):
        scaled = weight * slope[a]
        side[index[a]] -= scaled * residual
        for b in range(len(index)):
            if index[b] <= index[a]:
                pair[index[a], index[b]] += scaled * slope[b]
    return weight * residual * residual


@part_of_kernel
def _add_drift(pair, side, x, k, state, fading, variance):  # type: ignore[no-untyped-def]
    residual = x[k + 1, state] - fading * x[k, state]
    weight = 1.0 / variance
    pair[state, state] += weight * fading * fading
    pair[STATES + state, state] -= weight * fading
    pair[STATES + state, STATES + state] += weight
    side[state] += weight * fading * residual
    side[STATES + state] -= weight * residual
    return weight * residual * residual


@part_of_kernel
def _add_kinematics(pair, side, x, k, h, turn_noise):  # type: ignore[no-untyped-def]
    """A vehicle moves along its heading, and turns by its curvature."""
    index, slope = np.empty(8, np.int64), np.empty(8)
    east, north = x[k + 1, E] - x[k, E], x[k + 1, N] - x[k, N]
    middle, speed = (x[k, PHI] + x[k + 1, PHI]) / 2.0, (x[k, V] + x[k + 1, V]) / 2.0
    curvature = (x[k, KAPPA] + x[k + 1, KAPPA]) / 2.0
    sin, cos, distance = np.sin(middle), np.cos(middle), h * speed
    along, across = east * sin + north * cos, east * cos - north * sin
    index[0], index[1], index[2], index[3] = E, N, STATES + E, STATES + N
    index[4], index[5], index[6], index[7] = PHI, STATES + PHI, V, STATES + V
    slope[0], slope[1], slope[2], slope[3] = -sin, -cos, sin, cos
    slope[4] = slope[5] = across / 2.0
    slope[6] = slope[7] = -h / 2.0
    squared = _add_to_pair(pair, side, index, slope, along - distance, 1.0 / (ALONG_NOISE**2 * h))
    # In a turn the tail slides outward: the path points outside of the heading.
    slide = -SLIP_ANGLE * curvature * speed * abs(speed)
    slope[0], slope[1], slope[2], slope[3] = -cos, sin, cos, -sin
    slope[4] = slope[5] = -along / 2.0
    slope[6] = slope[7] = -h / 2.0 * slide
    squared += _add_to_pair(
        pair, side, index, slope, across - distance * slide, 1.0 / (ACROSS_NOISE**2 * h)
    )
    index, slope = np.empty(6, np.int64), np.empty(6)
    index[0], index[1], index[2], index[3] = PHI, STATES + PHI, V, STATES + V
    index[4], index[5] = KAPPA, STATES + KAPPA
    slope[0], slope[1] = -1.0, 1.0
    slope[2] = slope[3] = -h / 2.0 * curvature
    slope[4] = slope[5] = -distance / 2.0
    turn = x[k + 1, PHI] - x[k, PHI] - distance * curvature
    return squared + _add_to_pair(pair, side, index, slope, turn, 1.0 / (turn_noise**2 * h))


@part_of_kernel
def _add_start(pair, side, x, k, at):  # type: ignore[no-untyped-def]
    """What is known of a node with nothing before it: little."""
    for state, sigma in ((E, 1e5), (N, 1e5), (PHI, 10.0), (V, 10.0), (KAPPA, CURVATURE_SIGMA)):
        weight = 1.0 / sigma**2
        pair[at + state, at + state] += weight
        if state in (V, KAPPA):
            side[at + state] -= weight * x[k, state]


@kernel
def add_fixes(system, x, fix_en, weight, lever):  # type: ignore[no-untyped-def]
    """Positions of the antenna, `lever` = (right, ahead) of the axle: fix = point + slow error.

    `weight` [n, 2] is that along the heading and across it; rows without a fix have weight 0.
    Returns how far each fix lies ahead and to the right of where it should be [n, 2].
    """
    off = np.empty((len(weight), 2))
    index, slope = np.empty(5, np.int64), np.empty(5)
    for k in range(len(weight)):
        if not weight[k, 0] > 0.0:
            off[k, 0] = off[k, 1] = 0.0
            continue
        sin, cos = np.sin(x[k, PHI]), np.cos(x[k, PHI])
        east = x[k, E] + lever[0] * cos + lever[1] * sin + x[k, BIAS_E] - fix_en[k, 0]
        north = x[k, N] - lever[0] * sin + lever[1] * cos + x[k, BIAS_N] - fix_en[k, 1]
        ahead, right = east * sin + north * cos, east * cos - north * sin
        index[0], index[1], index[2] = STATES * k + E, STATES * k + N, STATES * k + PHI
        index[3], index[4] = STATES * k + BIAS_E, STATES * k + BIAS_N
        # The axes are held while the antenna turns about the axle.
        slope[0], slope[1], slope[2], slope[3], slope[4] = sin, cos, -lever[0], sin, cos
        _add_residual(system, index, slope, ahead, weight[k, 0])
        slope[0], slope[1], slope[2], slope[3], slope[4] = cos, -sin, lever[1], cos, -sin
        _add_residual(system, index, slope, right, weight[k, 1])
        off[k, 0], off[k, 1] = -ahead, -right
    return off


@kernel
def add_still(system, x, standing, held_place, held_heading):  # type: ignore[no-untyped-def]
    """Nodes at rest, the bound on how lost a node can be, and the weights by which it keeps to
    where it was in the last round."""
    shape, values, right, total = system[0], system[1], system[2], system[6]
    for k in range(len(x)):
        before = STATES * (k - shape[0][k])
        at = shape[1][k] + before
        for state in (E, N):
            values[at + state * before + state * (state + 3) // 2] += 1.0 / LOST_M**2 + held_place
        values[at + PHI * before + PHI * (PHI + 3) // 2] += held_heading
        if standing[k]:
            values[at + V * before + V * (V + 3) // 2] += 1.0 / STANDING_MPS**2
            right[STATES * k + V] -= x[k, V] / STANDING_MPS**2
            total[0] += (x[k, V] / STANDING_MPS) ** 2


def add_headings(
    system: NormalEquations, x: Float64, offset: float, heading: Float64, weight: Float64
) -> Float64:
    """Recorded headings [n], which are off by one constant. Returns the residuals."""
    off = np.where(weight > 0.0, x[:, PHI] + offset - heading, 0.0)
    off -= 2.0 * np.pi * np.rint(off / (2.0 * np.pi))
    return _added(system, (PHI, HEADING_OFFSET), off, (1.0, np.ones(len(off))), weight)


def add_speeds(
    system: NormalEquations, x: Float64, scale: float, speed: Float64, weight: Float64
) -> Float64:
    """Signed speeds [n] by wheels, whose size is off by one share. Returns the residuals."""
    own = np.ascontiguousarray(x[:, V])
    off = np.where(weight > 0.0, (1.0 + scale) * own - speed, 0.0)
    return _added(system, (V, WHEEL_SCALE), off, (1.0 + scale, own), weight)


def _added(
    system: NormalEquations,
    of: tuple[int, int],
    off: Float64,
    slopes: tuple[float, Float64],
    weight: Float64,
) -> Float64:
    """Residuals [n] `of` one state of each node and a constant. Most drives have none, and need no
    kernel then."""
    if (weight > 0.0).any():
        _add_to_nodes(system, *of, off, *slopes, weight)
    return off


@kernel
def _add_to_nodes(system, state, constant, off, slope, constant_slope, weight):  # type: ignore[no-untyped-def]
    index, slopes = np.empty(2, np.int64), np.empty(2)
    index[1], slopes[0] = len(system[2]) + constant, slope
    for k in range(len(weight)):
        if weight[k] > 0.0:
            index[0], slopes[1] = STATES * k + state, constant_slope[k]
            _add_residual(system, index, slopes, off[k], weight[k])


@kernel
def add_steps(system, x, scale, ends, moved, weight, ahead_m):  # type: ignore[no-untyped-def]
    """Relative motions `moved` [s, 3] = (forward, right, turn) of a point `ahead_m` of the axle
    between the nodes `ends` [s, 2], `weight` [s, 2] of distance and turn; all distances are too
    long by one share. Returns residuals [s, 3].
    """
    off = np.empty((len(ends), 3))
    index, slope = np.empty(7, np.int64), np.empty(7)
    turns, turn_slope = np.empty(2, np.int64), np.empty(2)
    turn_slope[0], turn_slope[1] = -1.0, 1.0
    index[6] = STATES * len(x) + CAMERA_SCALE
    size = 1.0 + scale
    for s in range(len(ends)):
        a, b = ends[s]
        sin, cos = np.sin(x[a, PHI]), np.cos(x[a, PHI])
        sin_b, cos_b = np.sin(x[b, PHI]), np.cos(x[b, PHI])
        east = x[b, E] - x[a, E] + ahead_m * (sin_b - sin)
        north = x[b, N] - x[a, N] + ahead_m * (cos_b - cos)
        forward, right = east * sin + north * cos, east * cos - north * sin
        off[s, 0], off[s, 1] = size * forward - moved[s, 0], size * right - moved[s, 1]
        off[s, 2] = x[b, PHI] - x[a, PHI] - moved[s, 2]
        off[s, 2] -= 2.0 * np.pi * np.rint(off[s, 2] / (2.0 * np.pi))
        index[0], index[1], index[2] = STATES * a + E, STATES * a + N, STATES * a + PHI
        index[3], index[4], index[5] = STATES * b + E, STATES * b + N, STATES * b + PHI
        # The start's own lever turns with it and cancels, but for its place in the frame.
        slope[0], slope[1], slope[3], slope[4] = -size * sin, -size * cos, size * sin, size * cos
        slope[2] = size * right
        slope[5] = size * ahead_m * (cos_b * sin - sin_b * cos)
        slope[6] = forward
        _add_residual(system, index, slope, off[s, 0], weight[s, 0])
        slope[0], slope[1], slope[3], slope[4] = -size * cos, size * sin, size * cos, -size * sin
        slope[2] = -size * (forward + ahead_m)
        slope[5] = size * ahead_m * (cos_b * cos + sin_b * sin)
        slope[6] = right
        _add_residual(system, index, slope, off[s, 1], weight[s, 0])
        turns[0], turns[1] = STATES * a + PHI, STATES * b + PHI
        _add_residual(system, turns, turn_slope, off[s, 2], weight[s, 1])
    return off
