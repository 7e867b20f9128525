"""What a wheeled vehicle can do, and what its sensors measure, as weighted residuals.

The state of a node is [east, north, heading, speed, curvature, gyro bias, bias east, bias
north]: the middle of the axle that does not steer, in metres; the heading, radians clockwise from
north; metres a second, negative in reverse; radians of turn a metre; radians a second; and the
slow part of the receiver's error, metres. Beside the nodes stand a few constants of the drive:
the offset of a recorded heading (radians), the relative errors of the wheels' and of the camera's
scale, by how much the camera looks farther right than declared (radians), and by which share the
vehicle turns more than the gyro says.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, kernel, part_of_kernel
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.equations import CONSTANTS, NormalEquations

E, N, PHI, V, KAPPA, GYRO, BIAS_E, BIAS_N = range(STATES)

HEADING_OFFSET, WHEEL_SCALE, CAMERA_SCALE, CAMERA_YAW, GYRO_SCALE = range(CONSTANTS)

SCALE_SIGMAS = 0.1, 0.03
"""What is known of the scales before the drive: tyres are off by a tenth; a stereo baseline, and
disparities that are off by a tenth of a pixel at a range of some metres, make some per cent."""

CAMERA_YAW_SIGMA = np.radians(2.0)
"""Where a camera looks is hardly ever measured better, rad; and a vehicle that crabs on a side
slope moves as if its camera were turned."""

GYRO_SCALE_SIGMA = 0.04
"""A gyro's scale with its mounting."""

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

_DRIFTS = [[state, STATES + state] for state in (BIAS_E, BIAS_N, GYRO, V, KAPPA)]
_MOVE = [E, N, STATES + E, STATES + N, PHI, STATES + PHI, V, STATES + V]
_TURN = [PHI, STATES + PHI, V, STATES + V, KAPPA, STATES + KAPPA]
_LAWS = [*_DRIFTS[:3], [PHI, STATES + PHI, GYRO], _MOVE, _MOVE, _TURN, *_DRIFTS[3:]]
LAWS, FIRST_SEEN = len(_LAWS), 4
"""How many laws there are between a node and the next, and the first that a hole has not: slow
errors and the gyro's bias drift, the gyro turns; moving along, across and turning; speed and
curvature drift."""

LAW_SIZES = np.array([len(law) for law in _LAWS])
LAW_STATES = np.array([[*law, *[0] * (STATES - len(law))] for law in _LAWS])
"""Which states of the two nodes each is of."""


@kernel
def add_rows(system, index, slope, residual, weight):  # type: ignore[no-untyped-def]
    """Weighted residuals [n, m] with their slopes [n, m, k] into the normal equations. They are of
    the unknowns `index` [n, k], those beyond the states of constants."""
    shape, values, right, border, corner, right_constants, total = system
    first, start = shape[0], shape[1]
    states = len(right)
    for n in range(weight.shape[0]):
        for m in range(weight.shape[1]):
            total[0] += weight[n, m] * residual[n, m] * residual[n, m]
            total[1] += np.log(weight[n, m])
            for a in range(index.shape[1]):
                i, scaled = index[n, a], weight[n, m] * slope[n, m, a]
                if i >= states:
                    right_constants[i - states] -= scaled * residual[n, m]
                    for b in range(index.shape[1]):
                        if index[n, b] >= states:
                            corner[i - states, index[n, b] - states] += scaled * slope[n, m, b]
                    continue
                right[i] -= scaled * residual[n, m]
                node, row = i // STATES, i % STATES
                before = STATES * (node - first[node])
                at = start[node] + row * before + row * (row + 1) // 2 - STATES * first[node]
                for b in range(index.shape[1]):
                    j = index[n, b]
                    if j <= i:
                        values[at + j] += scaled * slope[n, m, b]
                    elif j >= states:
                        border[i, j - states] += scaled * slope[n, m, b]


@kernel
def add_motion(system, x, step_s, kept, steering, bias_m, bias_s, leap_m2, turned, seen, standing):  # type: ignore[no-untyped-def]
    """The vehicle's own laws between neighbouring nodes, and its gyro [n - 1] (NaN: none), in place
    of whatever the matrix held: to clear a large one takes as long as this.

    Of the curvature the share `kept` [n - 1] goes on over each step, and what joins has the
    variance `steering` [n - 1]. Slow errors leap with the variance `leap_m2` [n - 1]. Over a hole
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
    total = system[6]
    for state in (BIAS_E, BIAS_N):
        weight = 1.0 / max(bias_m[0], NO_BIAS_M) ** 2
        pair[state, state] += weight
        side[state] -= weight * x[0, state]
        total[0] += weight * x[0, state] ** 2
        total[1] += np.log(weight)
    pair[GYRO, GYRO] += 1.0 / GYRO_BIAS_SIGMA**2
    side[GYRO] -= x[0, GYRO] / GYRO_BIAS_SIGMA**2
    slope, off, variance = np.empty((LAWS, STATES)), np.empty(LAWS), np.empty(LAWS)
    for law in range(LAWS):
        slope[law, 1] = 1.0  # of a drift, and of the gyro
    for k in range(len(x)):
        if k == 0 or not seen[k - 1]:
            _add_start(pair, side, x, k)
        if k + 1 < len(x):
            h = step_s[k]
            one, two = max(bias_m[k], NO_BIAS_M), max(bias_m[k + 1], NO_BIAS_M)
            # Of a growing slow error a new part joins, of a shrinking one a part leaves: the same
            # is said forward and backward in time, and at each node it has the stated sigma.
            correlation = np.exp(-h / bias_s[k]) * min(one, two) / max(one, two)
            slope[0, 0] = slope[1, 0] = -correlation * two / one
            variance[0] = variance[1] = two**2 * (1.0 - correlation**2) + leap_m2[k]
            total[1] -= 2.0 * np.log(variance[0])
            slope[2, 0], variance[2] = -1.0, GYRO_BIAS_NOISE**2 * h
            gyro = not np.isnan(turned[k])
            slope[3, 0], slope[3, 2], variance[3] = -1.0, h, GYRO_NOISE**2 * h
            off[3] = x[k + 1, PHI] - x[k, PHI] - (turned[k] - x[k, GYRO] * h)
            if seen[k]:
                turn_noise = FREE_TURN_NOISE if gyro else TURN_NOISE
                if standing[k] and standing[k + 1]:
                    turn_noise = STANDING_TURN_NOISE
                _move(x, k, h, slope, off, variance)
                variance[6] = turn_noise**2 * h
                slope[7, 0], variance[7] = -1.0, ACCELERATION_NOISE**2 * h
                slope[8, 0], variance[8] = -kept[k], steering[k]
                total[1] -= np.log(steering[k])
            squared = 0.0
            for law in range(LAWS if seen[k] else FIRST_SEEN):
                if law == 3 and not gyro:
                    continue
                if law < 3 or law > 6:
                    state = LAW_STATES[law, 0]
                    off[law] = x[k + 1, state] + slope[law, 0] * x[k, state]
                weight = 1.0 / variance[law]
                for a in range(LAW_SIZES[law]):
                    i, scaled = LAW_STATES[law, a], weight * slope[law, a]
                    side[i] -= scaled * off[law]
                    for b in range(LAW_SIZES[law]):
                        j = LAW_STATES[law, b]
                        if j <= i:
                            pair[i, j] += scaled * slope[law, b]
                squared += weight * off[law] * off[law]
                if law < 4 or law > 5:  # moving along, across and turning is one law
                    total[0] += squared
                    squared = 0.0
        _put_node(system, pair, side, k)


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
def _move(x, k, h, slope, off, variance):  # type: ignore[no-untyped-def]
    """A vehicle moves along its heading, and turns by its curvature: laws 4 to 6."""
    east, north = x[k + 1, E] - x[k, E], x[k + 1, N] - x[k, N]
    middle, speed = (x[k, PHI] + x[k + 1, PHI]) / 2.0, (x[k, V] + x[k + 1, V]) / 2.0
    curvature = (x[k, KAPPA] + x[k + 1, KAPPA]) / 2.0
    sin, cos, distance = np.sin(middle), np.cos(middle), h * speed
    along, across = east * sin + north * cos, east * cos - north * sin
    # In a turn the tail slides outward: the path points outside of the heading.
    slide = -SLIP_ANGLE * curvature * speed * abs(speed)
    slope[4, 0], slope[4, 1], slope[4, 2], slope[4, 3] = -sin, -cos, sin, cos
    slope[4, 4] = slope[4, 5] = across / 2.0
    slope[4, 6] = slope[4, 7] = -h / 2.0
    off[4], variance[4] = along - distance, ALONG_NOISE**2 * h
    slope[5, 0], slope[5, 1], slope[5, 2], slope[5, 3] = -cos, sin, cos, -sin
    slope[5, 4] = slope[5, 5] = -along / 2.0
    slope[5, 6] = slope[5, 7] = -h / 2.0 * slide
    off[5], variance[5] = across - distance * slide, ACROSS_NOISE**2 * h
    slope[6, 0] = -1.0
    slope[6, 2] = slope[6, 3] = -h / 2.0 * curvature
    slope[6, 4] = slope[6, 5] = -distance / 2.0
    off[6] = x[k + 1, PHI] - x[k, PHI] - distance * curvature


@part_of_kernel
def _add_start(pair, side, x, k):  # type: ignore[no-untyped-def]
    """What is known of a node with nothing before it: little."""
    for state, sigma in ((E, 1e5), (N, 1e5), (PHI, 10.0), (V, 10.0), (KAPPA, CURVATURE_SIGMA)):
        weight = 1.0 / sigma**2
        pair[state, state] += weight
        if state in (V, KAPPA):
            side[state] -= weight * x[k, state]


def fixes_off(x: Float64, fix_en: Float64, weight: Float64, lever: Float64) -> Float64:
    """How far each fix lies ahead and to the right of where it should be [n, 2], 0 where there is
    none (a `weight` [n, 2] of 0): positions of the antenna, `lever` = (right, ahead) of the axle;
    fix = point + slow error.
    """
    at = np.flatnonzero(weight[:, 0] > 0.0)
    here = x[at]
    sin, cos = np.sin(here[:, PHI]), np.cos(here[:, PHI])
    east = here[:, E] + lever[0] * cos + lever[1] * sin + here[:, BIAS_E] - fix_en[at, 0]
    north = here[:, N] - lever[0] * sin + lever[1] * cos + here[:, BIAS_N] - fix_en[at, 1]
    off = np.zeros((len(weight), 2))
    off[at, 0], off[at, 1] = -(east * sin + north * cos), -(east * cos - north * sin)
    return off


def add_fixes(
    system: NormalEquations, x: Float64, off: Float64, weight: Float64, lever: Float64
) -> None:
    """Fixes that are `off` by :func:`fixes_off`, `weight` [n, 2] along the heading and across."""
    at = np.flatnonzero(weight[:, 0] > 0.0)
    sin, cos = np.sin(x[at, PHI]), np.cos(x[at, PHI])
    index = STATES * at[:, None] + np.array([E, N, PHI, BIAS_E, BIAS_N])
    slope = np.empty((len(at), 2, 5))
    # The axes are held while the antenna turns about the axle.
    for axis, (a, b, turned) in enumerate(((sin, cos, -lever[0]), (cos, -sin, lever[1]))):
        slope[:, axis, 0] = slope[:, axis, 3] = a
        slope[:, axis, 1] = slope[:, axis, 4] = b
        slope[:, axis, 2] = turned
    add_rows(system, index, slope, -off[at], weight[at])


def add_still(
    system: NormalEquations, x: Float64, standing: Bool, held_place: float, held_heading: float
) -> None:
    """Nodes at rest, the bound on how lost a node can be, and the weights by which it keeps to
    where it was in the last round."""
    shape, values, total = system.shape, system.values, system.total
    for state, weight in (
        (E, 1.0 / LOST_M**2 + held_place),
        (N, 1.0 / LOST_M**2 + held_place),
        (PHI, held_heading),
        (V, np.where(standing, 1.0 / STANDING_MPS**2, 0.0)),
    ):
        values[shape.own_start(state) + state] += weight
    system.right[V::STATES][standing] -= x[standing, V] / STANDING_MPS**2
    squared = (x[standing, V] / STANDING_MPS) ** 2
    total[0] = np.cumsum(np.append(total[0], squared))[-1]  # in their order, whatever NumPy's is


def headings_off(x: Float64, offset: float, heading: Float64, weight: Float64) -> Float64:
    """Residuals of recorded headings [n], which are off by one constant."""
    off = np.where(weight > 0.0, x[:, PHI] + offset - heading, 0.0)
    return np.asarray(off - 2.0 * np.pi * np.rint(off / (2.0 * np.pi)))


def add_headings(system: NormalEquations, off: Float64, weight: Float64) -> None:
    """Recorded headings that are `off` by :func:`headings_off`."""
    _added(system, (PHI, HEADING_OFFSET), off, (1.0, np.ones(len(off))), weight)


def speeds_off(x: Float64, scale: float, speed: Float64, weight: Float64) -> Float64:
    """Residuals of signed speeds [n] by wheels, whose size is off by one share."""
    return np.where(weight > 0.0, (1.0 + scale) * x[:, V] - speed, 0.0)


def add_speeds(
    system: NormalEquations, x: Float64, scale: float, off: Float64, weight: Float64
) -> None:
    """Signed speeds that are `off` by :func:`speeds_off`."""
    own = np.ascontiguousarray(x[:, V])
    _added(system, (V, WHEEL_SCALE), off, (1.0 + scale, own), weight)


def _added(
    system: NormalEquations,
    of: tuple[int, int],
    off: Float64,
    slopes: tuple[float, Float64],
    weight: Float64,
) -> None:
    """Residuals [n] `of` one state of each node and a constant."""
    at = np.flatnonzero(weight > 0.0)
    if len(at):  # most drives have none
        index = np.stack([STATES * at + of[0], np.full(len(at), len(system.right) + of[1])]).T
        slope = np.stack([np.full(len(at), slopes[0]), slopes[1][at]]).T
        rows = index.copy(), slope.reshape(-1, 1, 2).copy(), off[at, None], weight[at, None]
        add_rows(system, *rows)


def step_rows(
    x: Float64, constants: tuple[float, float], ends: Int64, moved: Float64, ahead_m: float
) -> tuple[Int64, Float64, Float64]:
    """Relative motions `moved` [s, 3] = (forward, right, turn) of a point `ahead_m` of the axle
    between the nodes `ends` [s, 2]; by the `constants` all distances are too long by one share, and
    are seen from a heading farther right by one angle. Returns the unknowns [s, 8] that they depend
    on (place and heading of both nodes, the two constants), the slopes [s, 3, 8] and the residuals
    [s, 3].
    """
    scale, yaw = constants
    start, stop, size = x[ends[:, 0]], x[ends[:, 1]], 1.0 + scale
    sin_b, cos_b = np.sin(stop[:, PHI]), np.cos(stop[:, PHI])
    east = stop[:, E] - start[:, E] + ahead_m * (sin_b - np.sin(start[:, PHI]))
    north = stop[:, N] - start[:, N] + ahead_m * (cos_b - np.cos(start[:, PHI]))
    sin, cos = np.sin(start[:, PHI] + yaw), np.cos(start[:, PHI] + yaw)
    forward, right = east * sin + north * cos, east * cos - north * sin
    turn = stop[:, PHI] - start[:, PHI] - moved[:, 2]
    turn -= 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
    off = np.empty((len(ends), 3))
    off[:, 0], off[:, 1] = size * forward - moved[:, 0], size * right - moved[:, 1]
    off[:, 2] = turn
    index, slope = np.empty((len(ends), 8), np.int64), np.zeros((len(ends), 3, 8))
    index[:, :3] = STATES * ends[:, :1] + np.array([E, N, PHI])
    index[:, 3:6] = STATES * ends[:, 1:] + np.array([E, N, PHI])
    index[:, 6:] = STATES * len(x) + np.array([CAMERA_SCALE, CAMERA_YAW])
    for row, (east_by, north_by) in enumerate(((sin, cos), (cos, -sin))):
        slope[:, row, 0], slope[:, row, 1] = -size * east_by, -size * north_by
        slope[:, row, 3], slope[:, row, 4] = size * east_by, size * north_by
    slope[:, 0, 7], slope[:, 1, 7] = size * right, -size * forward
    # The start's own lever turns with it and cancels, but for its place in the frame.
    slope[:, 0, 2] = size * (right - ahead_m * np.sin(yaw))
    slope[:, 1, 2] = -size * (forward + ahead_m * np.cos(yaw))
    slope[:, 0, 5] = size * ahead_m * (cos_b * sin - sin_b * cos)
    slope[:, 1, 5] = size * ahead_m * (cos_b * cos + sin_b * sin)
    slope[:, 0, 6], slope[:, 1, 6] = forward, right
    slope[:, 2, 2], slope[:, 2, 5] = -1.0, 1.0
    return index, slope, off
