"""The rigid motion between two frames: found among wrong matches, then refined, with its error.

A motion takes the points of the start into the camera frame of the stop:
X_stop = R_stop_start · X_start + t_stop_start. What is made small is the distance between the
measured (column, row, disparity) of a point at the stop and the one predicted from the start:
pixels have an error that is known, points in metres do not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, kernel, part_of_kernel

SEARCH_SIGMA_PX = (1.5, 1.5, 1.0)
"""How far off a right match may be in the search: column, row, disparity. Generous, since a
motion from three points is only roughly right."""

SEARCH_CUTOFF = 12.0
"""Squared distance, in those sigmas, beyond which a match counts as wrong."""

MOST_TRIES, CONFIDENCE = 1000, 0.999
"""The search ends when a better motion would have been found so surely."""

DRAWS_A_TRY = 30
"""Three matches that change their mutual distances are no motion, and drawing them is cheap."""

SIGMA_PX = (0.5, 0.5, 0.25)
"""1-sigma errors of column, row and disparity of a corner found at full size."""

INLIER = 16.0
"""Squared distance in sigmas up to which a match is right: 1 in 1000 right ones exceeds it."""

ROUNDS, CONVERGED = 6, 1e-14
"""Of refining; it ends earlier where a round changes the squared motion (rad², m²) by less."""

WORST_CONDITION = 1e12
"""Of the normal equations; beyond, the points leave a direction of the motion open."""

NEAREST_DEPTH_M = 0.3
MIN_SPREAD_M = 0.5


class Lens(NamedTuple):
    """What turns points into pixels: focal length, principal point, f·b."""

    focal_px: float
    cx_px: float
    cy_px: float
    focal_baseline_px_m: float


class RigidMotion(NamedTuple):
    """A rigid motion of the camera, [3, 3] and [3] metres."""

    R_stop_start: Float64
    t_stop_start_m: Float64


class RefinedMotion(NamedTuple):
    """A refined motion.

    `covariance` [6, 6] is that of a small rotation w (rad) and translation d (m) in the camera
    frame of the stop, exp(w) · R · X + t + d; `inliers` [n] marks the matches that agree.
    """

    motion: RigidMotion
    covariance: Float64
    inliers: Bool


def predicted(points_m: Float64, motion: RigidMotion, lens: Lens) -> Float64:
    """Column, row and disparity of points [n, 3] after a motion, NaN behind the camera."""
    x, y, z = (points_m @ motion.R_stop_start.T + motion.t_stop_start_m).T
    per_px = lens.focal_px / np.where(z > NEAREST_DEPTH_M, z, np.nan)
    baseline_m = lens.focal_baseline_px_m / lens.focal_px
    return np.column_stack([lens.cx_px + x * per_px, lens.cy_px + y * per_px, baseline_m * per_px])


def search(start_m: Float64, stop_m: Float64, stop_px: Float64, lens: Lens) -> RigidMotion | None:
    """The motion that most matches agree with, from three at a time (RANSAC), None for none.

    Points [n, 3] of both frames and the measured pixels [n, 3] of the stop. The draws come
    from a generator of its own with a fixed seed.
    """
    R, t = np.empty((3, 3)), np.empty(3)
    sigma_px = np.array(SEARCH_SIGMA_PX)
    if len(start_m) < 3 or not _search(start_m, stop_m, stop_px, np.array(lens), sigma_px, R, t):
        return None
    return RigidMotion(R, t)


def refine(
    motion: RigidMotion,
    start_m: Float64,
    start_px: Float64,
    stop_px: Float64,
    blur_px: Float64,
    lens: Lens,
) -> RefinedMotion | None:
    """The most likely motion near one, by Gauss-Newton with Tukey's weights; None if singular.

    `blur_px` [n, 2] is the size of a pixel in which each corner was found, start and stop.
    """
    R, t = motion.R_stop_start.copy(), motion.t_stop_start_m.copy()
    H, squared = np.zeros((6, 6)), np.empty(len(start_m))
    sigma_px = np.array(SIGMA_PX)
    if not _refine(
        start_m, start_px, stop_px, blur_px, np.array(lens), sigma_px, INLIER, ROUNDS, CONVERGED,
        R, t, H, squared,
    ):  # fmt: skip
        return None
    H = np.tril(H) + np.tril(H, -1).T
    inliers = squared <= INLIER
    if not inliers.any() or np.linalg.cond(H) > WORST_CONDITION:
        return None
    # 2.37 is the median of the squared distance (chi squared, 3 degrees) were the sigmas true.
    scale = float(np.median(squared[inliers])) / 2.37
    covariance = np.asarray(np.linalg.inv(H) * max(scale, 1.0), dtype=np.float64)
    return RefinedMotion(RigidMotion(R, t), covariance, inliers)


@kernel
def _search(start, stop, pixels, lens, sigma, R_best, t_best):  # type: ignore[no-untyped-def]
    """Whether a motion was found; the best one is filled in."""
    n = len(start)
    R, t, H, axes = np.empty((3, 3)), np.empty(3), np.empty((6, 6)), np.empty((6, 3))
    # Three matches, as if their start were exact.
    drawn, points, seen = np.empty(3, dtype=np.int64), np.empty((3, 3)), np.empty((3, 3))
    exact, blur, squared = np.empty((3, 3)), np.empty((3, 2)), np.empty(3)
    for k in range(3):
        exact[k, 2], blur[k, 0], blur[k, 1] = np.inf, 0.0, 1.0
    # Of a literal Numba would compile a function anew.
    state, twice = np.uint64(1), np.int64(2)
    least_cost, enough = SEARCH_CUTOFF * n, float(MOST_TRIES)
    found, tries, draws = False, 0, 0
    while tries < enough and draws < MOST_TRIES * DRAWS_A_TRY:
        draws += 1
        for k in range(3):
            # Knuth's linear congruential generator; its upper bits are the good ones.
            state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
            drawn[k] = np.int64((state >> np.uint64(33)) % np.uint64(n))
        if not _is_rigid(start, stop, drawn, lens[3]):
            continue
        tries += 1
        _align(start, stop, drawn, axes, R, t)
        for k in range(3):
            for axis in range(3):
                points[k, axis] = start[drawn[k], axis]
                seen[k, axis] = pixels[drawn[k], axis]
        # By the pixels, whose errors are alike in all directions.
        if not _refine(
            points, exact, seen, blur, lens, sigma, np.inf, twice, 0.0, R, t, H, squared
        ):
            continue
        cost, agreeing = 0.0, 0
        for k in range(n):
            x, y, z = _moved(start, k, R, t)
            u = (pixels[k, 0] - lens[1] - lens[0] * x / z) / sigma[0]
            v = (pixels[k, 1] - lens[2] - lens[0] * y / z) / sigma[1]
            d = (pixels[k, 2] - lens[3] / z) / sigma[2]
            e = u * u + v * v + d * d
            if z > NEAREST_DEPTH_M and e < SEARCH_CUTOFF:
                cost += e
                agreeing += 1
            else:
                cost += SEARCH_CUTOFF
            if cost >= least_cost:
                break
        if cost < least_cost:
            found, least_cost = True, cost
            for i in range(3):
                t_best[i] = t[i]
                for j in range(3):
                    R_best[i, j] = R[i, j]
            # After so many tries three right matches were drawn at once, with CONFIDENCE. Draws
            # that are not rigid do not count as tries, so that this errs towards more of them.
            share = agreeing / n
            missed = math.log(max(1.0 - share * share * share, 1e-300))
            enough = min(enough, math.log(1.0 - CONFIDENCE) / missed)
    return found


@part_of_kernel
def _is_rigid(start, stop, drawn, focal_baseline):  # type: ignore[no-untyped-def]
    """Whether three points keep their distances, as far as their depth is known."""
    for k in range(3):
        i, j = drawn[k], drawn[(k + 1) % 3]
        before, after = 0.0, 0.0
        for axis in range(3):
            before += (start[i, axis] - start[j, axis]) ** 2
            after += (stop[i, axis] - stop[j, axis]) ** 2
        before, after = math.sqrt(before), math.sqrt(after)
        depth = max(max(start[i, 2], start[j, 2]), max(stop[i, 2], stop[j, 2]))
        # One and a half pixels of disparity, of the farthest of them.
        slack = 0.1 + 1.5 * depth * depth / focal_baseline
        if before < MIN_SPREAD_M or abs(before - after) > slack:
            return False
    return True


@part_of_kernel
def _align(start, stop, drawn, axes, R, t):  # type: ignore[no-untyped-def]
    """Fill in the motion that lays one triangle on another: middles, planes and first sides agree.

    `axes` [6, 3] is room for three orthogonal unit vectors of each: along the first side, in the
    plane, normal to it.
    """
    for side in range(2):
        points = stop if side else start
        first = 3 * side
        for i in range(3):
            axes[first, i] = points[drawn[1], i] - points[drawn[0], i]
            axes[first + 1, i] = points[drawn[2], i] - points[drawn[0], i]
        for to, a, b in ((first + 2, first, first + 1), (first + 1, first + 2, first)):
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                axes[to, i] = axes[a, j] * axes[b, k] - axes[a, k] * axes[b, j]
        for axis in range(first, first + 3):
            square = 0.0
            for i in range(3):
                square += axes[axis, i] * axes[axis, i]
            for i in range(3):
                axes[axis, i] /= max(math.sqrt(square), 1e-12)
    for i in range(3):
        for j in range(3):
            R[i, j] = 0.0
            for axis in range(3):
                R[i, j] += axes[3 + axis, i] * axes[axis, j]
        t[i] = 0.0
        for k in drawn:
            t[i] += stop[k, i] / 3.0
            for j in range(3):
                t[i] -= R[i, j] * start[k, j] / 3.0


@kernel
def _refine(  # type: ignore[no-untyped-def]
    start, start_px, pixels, blur, lens, sigma, inlier, rounds, converged, R, t, H, squared
):
    """Refine R and t in place; fill in the normal equations there, up to the diagonal, and the
    squared distances [n]. False where the points do not determine the motion."""
    r, J, S, g = np.empty(3), np.empty((3, 6)), np.empty((3, 3)), np.empty(6)
    change = np.inf
    for round_ in range(rounds + 1):
        for i in range(6):
            g[i] = 0.0
            for j in range(6):
                H[i, j] = 0.0
        # Wide at first, since the search is only roughly right.
        cutoff = inlier * max(1.5, 4.0 - round_)
        for k in range(len(start)):
            squared[k] = np.inf
            x, y, z = _moved(start, k, R, t)
            if z <= NEAREST_DEPTH_M:
                continue
            _linearise(pixels, k, x, y, z, t, lens, r, J)
            # Covariance of the residual: the error at the stop and that of the start, which is
            # one of the point, and that one of the prediction.
            for i in range(3):
                for j in range(3):
                    S[i, j] = 0.0
                size = sigma[i] * (blur[k, 1] if i < 2 else 1.0)
                S[i, i] = size * size
            for source in range(3):
                # How the point moves when column, row or disparity of the start are off by a sigma.
                if source < 2:
                    size = sigma[source] * blur[k, 0] * start[k, 2] / lens[0]
                    dx, dy, dz = R[0, source] * size, R[1, source] * size, R[2, source] * size
                else:
                    size = -sigma[2] / start_px[k, 2]
                    dx, dy, dz = size * (x - t[0]), size * (y - t[1]), size * (z - t[2])
                for i in range(3):
                    one = J[i, 3] * dx + J[i, 4] * dy + J[i, 5] * dz
                    for j in range(i + 1):
                        other = J[j, 3] * dx + J[j, 4] * dy + J[j, 5] * dz
                        S[i, j] += one * other
            squared[k] = _whiten(S, r, J)
            if squared[k] < cutoff:
                share = 1.0 - squared[k] / cutoff
                for i in range(6):
                    for row in range(3):
                        weighted = share * share * J[row, i]
                        g[i] += weighted * r[row]
                        for j in range(i + 1):
                            H[i, j] += weighted * J[row, j]
        if round_ == rounds or change < converged:
            break
        change = _move(H, g, R, t)
        if change < 0.0:
            return False
    return True


@part_of_kernel
def _whiten(S, r, J):  # type: ignore[no-untyped-def]
    """Scale a residual and its derivatives in place by their covariance, given below the diagonal:
    L⁻¹ r and L⁻¹ J, L · L' = S. Returns the residual's squared length."""
    square = 0.0
    for i in range(3):
        for j in range(i):
            for k in range(j):
                S[i, j] -= S[i, k] * S[j, k]
            S[i, j] /= S[j, j]
            S[i, i] -= S[i, j] * S[i, j]
            r[i] -= S[i, j] * r[j]
            for column in range(6):
                J[i, column] -= S[i, j] * J[j, column]
        S[i, i] = math.sqrt(S[i, i])
        r[i] /= S[i, i]
        square += r[i] * r[i]
        for column in range(6):
            J[i, column] /= S[i, i]
    return square


@part_of_kernel
def _moved(points, k, R, t):  # type: ignore[no-untyped-def]
    """R · p + t of point k, as three numbers."""
    x, y, z = points[k, 0], points[k, 1], points[k, 2]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@part_of_kernel
def _linearise(pixels, k, x, y, z, t, lens, r, J):  # type: ignore[no-untyped-def]
    """Fill in the residual [3] of match k, whose point was moved to (x, y, z), and the derivative
    [3, 6] of its prediction by a small rotation and translation."""
    r[0] = pixels[k, 0] - lens[1] - lens[0] * x / z
    r[1] = pixels[k, 1] - lens[2] - lens[0] * y / z
    r[2] = pixels[k, 2] - lens[3] / z
    J[0, 3], J[0, 4], J[0, 5] = lens[0] / z, 0.0, -lens[0] * x / (z * z)
    J[1, 3], J[1, 4], J[1, 5] = 0.0, lens[0] / z, -lens[0] * y / (z * z)
    J[2, 3], J[2, 4], J[2, 5] = 0.0, 0.0, -lens[3] / (z * z)
    x, y, z = x - t[0], y - t[1], z - t[2]  # turning about the camera moves R · p, not t
    for row in range(3):
        J[row, 0] = J[row, 5] * y - J[row, 4] * z
        J[row, 1] = J[row, 3] * z - J[row, 5] * x
        J[row, 2] = J[row, 4] * x - J[row, 3] * y


@part_of_kernel
def _move(H, g, R, t):  # type: ignore[no-untyped-def]
    """Apply the solution of H · d = g to a motion in place, overwriting H and g.

    Returns d · d, -1 when H is singular. By Cholesky's decomposition, below the diagonal.
    """
    for i in range(6):
        least = 1e-12 * H[i, i]
        for j in range(i + 1):
            for k in range(j):
                H[i, j] -= H[i, k] * H[j, k]
            if j < i:
                H[i, j] /= H[j, j]
                g[i] -= H[i, j] * g[j]
        if not H[i, i] > least:
            return -1.0
        H[i, i] = math.sqrt(H[i, i])
        g[i] /= H[i, i]
    size = 0.0
    for back in range(6):
        i = 5 - back
        for j in range(i + 1, 6):
            g[i] -= H[j, i] * g[j]
        g[i] /= H[i, i]
        size += g[i] * g[i]
    # R := exp([w]) · R by Rodrigues' formula.
    x, y, z = g[0], g[1], g[2]
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = 1.0, 0.5
    if angle > 1e-8:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    for column in range(3):
        p, q, s = R[0, column], R[1, column], R[2, column]
        cp, cq, cs = y * s - z * q, z * p - x * s, x * q - y * p
        R[0, column] = p + a * cp + b * (y * cs - z * cq)
        R[1, column] = q + a * cq + b * (z * cp - x * cs)
        R[2, column] = s + a * cs + b * (x * cq - y * cp)
        t[column] += g[3 + column]
    return size
