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

from fieldgrid.array_types import Bool, Float64
from fieldgrid.kernel import kernel

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

REFINE_ROUNDS = 6
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


class Motion3(NamedTuple):
    """A rigid motion of the camera, [3, 3] and [3] metres."""

    R_stop_start: Float64
    t_stop_start_m: Float64


class Refined(NamedTuple):
    """A refined motion.

    `covariance` [6, 6] is that of a small rotation w (rad) and translation d (m) in the camera
    frame of the stop, exp(w) · R · X + t + d; `inliers` [n] marks the matches that agree.
    """

    motion: Motion3
    covariance: Float64
    inliers: Bool


def search(start_m: Float64, stop_m: Float64, stop_px: Float64, lens: Lens) -> Motion3 | None:
    """The motion that most matches agree with, from three at a time (RANSAC), None for none.

    Points [n, 3] of both frames and the measured pixels [n, 3] of the stop. The draws come
    from a generator of its own with a fixed seed.
    """
    if len(start_m) < 3:
        return None
    found, R, t = _search(start_m, stop_m, stop_px, *lens, np.array(SEARCH_SIGMA_PX))
    return Motion3(R, t) if found else None


def refine(
    motion: Motion3,
    start_m: Float64,
    start_px: Float64,
    stop_px: Float64,
    blur_px: Float64,
    lens: Lens,
) -> Refined | None:
    """The most likely motion near one, by Gauss-Newton with Tukey's weights; None if singular.

    `blur_px` [n, 2] is the size of a pixel in which each corner was found, start and stop.
    """
    R, t = motion.R_stop_start.copy(), motion.t_stop_start_m.copy()
    sigma = np.array(SIGMA_PX)
    H, squared = _refine(start_m, start_px, stop_px, blur_px, *lens, sigma, R, t)
    inliers = squared <= INLIER
    if not inliers.any() or np.linalg.cond(H) > WORST_CONDITION:
        return None
    # 2.37 is the median of the squared distance (chi squared, 3 degrees) were the sigmas true.
    scale = float(np.median(squared[inliers])) / 2.37
    return Refined(Motion3(R, t), np.linalg.inv(H) * max(scale, 1.0), inliers)


@kernel
def predicted(points_m, R, t, focal, cx, cy, focal_baseline):  # type: ignore[no-untyped-def]
    """Column, row and disparity [n, 3] after a motion, NaN behind the camera."""
    pixels = np.full((len(points_m), 3), np.nan)
    for k in range(len(points_m)):
        x, y, z = moved(points_m[k], R, t)
        if z > NEAREST_DEPTH_M:
            pixels[k, 0] = cx + focal * x / z
            pixels[k, 1] = cy + focal * y / z
            pixels[k, 2] = focal_baseline / z
    return pixels


@kernel
def moved(p, R, t):  # type: ignore[no-untyped-def]
    """R · p + t, as three numbers."""
    return (
        R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2] + t[0],
        R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2] + t[1],
        R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2],
    )


@kernel
def _search(start, stop, pixels, focal, cx, cy, focal_baseline, sigma):  # type: ignore[no-untyped-def]
    """Whether a motion was found, and the best one."""
    n = len(start)
    weights = np.diag(1.0 / sigma**2)
    state, drawn = np.uint64(1), np.empty(3, dtype=np.int64)
    found, least_cost = False, SEARCH_CUTOFF * n
    best = np.eye(3), np.zeros(3)
    tries, draws, enough = 0, 0, float(MOST_TRIES)
    while tries < enough and draws < MOST_TRIES * DRAWS_A_TRY:
        draws += 1
        for k in range(3):
            # Knuth's linear congruential generator; its upper bits are the good ones.
            state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
            drawn[k] = np.int64((state >> np.uint64(33)) % np.uint64(n))
        if not is_rigid(start, stop, drawn, focal_baseline):
            continue
        tries += 1
        R, t = aligned(start, stop, drawn)
        if not fit_pixels(start, pixels, drawn, R, t, focal, cx, cy, focal_baseline, weights):
            continue
        cost, agreeing = 0.0, 0
        for k in range(n):
            e = squared_distance(start[k], pixels[k], R, t, focal, cx, cy, focal_baseline, weights)
            cost += min(e, SEARCH_CUTOFF)
            agreeing += e < SEARCH_CUTOFF
            if cost >= least_cost:
                break
        if cost < least_cost:
            found, best, least_cost = True, (R, t), cost
            enough = min(enough, tries_needed(agreeing / n))
    return found, best[0], best[1]


@kernel
def tries_needed(share):  # type: ignore[no-untyped-def]
    """After how many tries three right matches were drawn at once, with `CONFIDENCE`.

    Draws that are not rigid do not count as tries, so that this errs towards more of them.
    """
    missed = 1.0 - share**3
    return math.log(1.0 - CONFIDENCE) / math.log(missed) if missed > 0.0 else 0.0


@kernel
def fit_pixels(start, pixels, drawn, R, t, focal, cx, cy, focal_baseline, weights):  # type: ignore[no-untyped-def]
    """Improve R and t in place by the pixels of a few matches; False where these are too few."""
    for _ in range(2):
        H, g = np.zeros((6, 6)), np.zeros(6)
        for k in drawn:
            add_match(H, g, start[k], pixels[k], R, t, focal, cx, cy, focal_baseline, weights)
        if not nudge(H, g, R, t):
            return False
    return True


@kernel
def is_rigid(start, stop, drawn, focal_baseline):  # type: ignore[no-untyped-def]
    """Whether three points keep their distances, as far as their depth is known."""
    for k in range(3):
        i, j = drawn[k], drawn[(k + 1) % 3]
        before, after = distance(start[i], start[j]), distance(stop[i], stop[j])
        depth = max(max(start[i, 2], start[j, 2]), max(stop[i, 2], stop[j, 2]))
        # One and a half pixels of disparity, of the farthest of them.
        slack = 0.1 + 1.5 * depth * depth / focal_baseline
        if before < MIN_SPREAD_M or abs(before - after) > slack:
            return False
    return True


@kernel
def distance(p, q):  # type: ignore[no-untyped-def]
    """Metres between two points."""
    return math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@kernel
def aligned(start, stop, drawn):  # type: ignore[no-untyped-def]
    """The motion that lays one triangle on another: middles, planes and first sides agree."""
    before, after = triangle_axes(start, drawn), triangle_axes(stop, drawn)
    R, t = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        for j in range(3):
            for axis in range(3):
                R[i, j] += after[axis, i] * before[axis, j]
    for i in range(3):
        for k in drawn:
            rotated = R[i, 0] * start[k, 0] + R[i, 1] * start[k, 1] + R[i, 2] * start[k, 2]
            t[i] += (stop[k, i] - rotated) / 3.0
    return R, t


@kernel
def triangle_axes(points, drawn):  # type: ignore[no-untyped-def]
    """Three orthogonal unit vectors, by row: along the first side, in the plane, normal to it."""
    axes = np.empty((3, 3))
    for i in range(3):
        axes[0, i] = points[drawn[1], i] - points[drawn[0], i]
        axes[1, i] = points[drawn[2], i] - points[drawn[0], i]
    set_cross(axes, 2, 0, 1)
    set_cross(axes, 1, 2, 0)
    for axis in range(3):
        norm = math.sqrt(axes[axis, 0] ** 2 + axes[axis, 1] ** 2 + axes[axis, 2] ** 2)
        for i in range(3):
            axes[axis, i] /= max(norm, 1e-12)
    return axes


@kernel
def set_cross(rows, to, a, b):  # type: ignore[no-untyped-def]
    """Row `to` becomes the vector product of rows a and b."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rows[to, i] = rows[a, j] * rows[b, k] - rows[a, k] * rows[b, j]


@kernel
def squared_distance(p, pixel, R, t, focal, cx, cy, focal_baseline, weights):  # type: ignore[no-untyped-def]
    """r' · W · r of the residual of one match, infinite behind the camera."""
    x, y, z = moved(p, R, t)
    if z <= NEAREST_DEPTH_M:
        return np.inf
    r0 = pixel[0] - cx - focal * x / z
    r1 = pixel[1] - cy - focal * y / z
    r2 = pixel[2] - focal_baseline / z
    return (
        weights[0, 0] * r0 * r0
        + weights[1, 1] * r1 * r1
        + weights[2, 2] * r2 * r2
        + 2.0 * (weights[0, 1] * r0 * r1 + weights[0, 2] * r0 * r2 + weights[1, 2] * r1 * r2)
    )


@kernel
def add_match(H, g, p, pixel, R, t, focal, cx, cy, focal_baseline, weights):  # type: ignore[no-untyped-def]
    """Add a match to the normal equations H · (rotation, translation) = g."""
    x, y, z = moved(p, R, t)
    if z <= NEAREST_DEPTH_M:
        return
    residual = np.empty(3)
    residual[0] = pixel[0] - cx - focal * x / z
    residual[1] = pixel[1] - cy - focal * y / z
    residual[2] = pixel[2] - focal_baseline / z
    # Turning about the camera moves R · p, not t.
    x0, y0, z0 = x - t[0], y - t[1], z - t[2]
    J = np.empty((3, 6))
    for row in range(3):
        if row == 0:
            a, b, c = focal / z, 0.0, -focal * x / (z * z)
        elif row == 1:
            a, b, c = 0.0, focal / z, -focal * y / (z * z)
        else:
            a, b, c = 0.0, 0.0, -focal_baseline / (z * z)
        J[row, 0], J[row, 1], J[row, 2] = c * y0 - b * z0, a * z0 - c * x0, b * x0 - a * y0
        J[row, 3], J[row, 4], J[row, 5] = a, b, c
    for row in range(3):
        for i in range(6):
            weighted = weights[0, row] * J[0, i] + weights[1, row] * J[1, i]
            weighted += weights[2, row] * J[2, i]
            g[i] += weighted * residual[row]
            for j in range(6):
                H[i, j] += weighted * J[row, j]


@kernel
def nudge(H, g, R, t):  # type: ignore[no-untyped-def]
    """Apply the solution of H · d = g to a motion in place; False when H is singular."""
    L = np.zeros((6, 6))
    for i in range(6):
        for j in range(i + 1):
            rest = H[i, j] - (L[i, :j] * L[j, :j]).sum()
            if i == j:
                if not rest > 1e-12 * H[i, i]:
                    return False
                L[i, i] = math.sqrt(rest)
            else:
                L[i, j] = rest / L[j, j]
    d = g.copy()
    for i in range(6):
        d[i] = (d[i] - (L[i, :i] * d[:i]).sum()) / L[i, i]
    for i in range(5, -1, -1):
        d[i] = (d[i] - (L[i + 1 :, i] * d[i + 1 :]).sum()) / L[i, i]
    turn(R, d)
    for i in range(3):
        t[i] += d[3 + i]
    return True


@kernel
def turn(R, vector):  # type: ignore[no-untyped-def]
    """R := exp([vector]) · R in place, by Rodrigues' formula."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = 1.0, 0.5
    if angle > 1e-8:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    for column in range(3):
        p, q, r = R[0, column], R[1, column], R[2, column]
        cp, cq, cr = y * r - z * q, z * p - x * r, x * q - y * p
        R[0, column] = p + a * cp + b * (y * cr - z * cq)
        R[1, column] = q + a * cq + b * (z * cp - x * cr)
        R[2, column] = r + a * cr + b * (x * cq - y * cp)


@kernel
def _refine(start, start_px, pixels, blur, focal, cx, cy, focal_baseline, sigma, R, t):  # type: ignore[no-untyped-def]
    """Refine R and t in place: the normal equations' matrix there, and squared distances [n]."""
    n = len(start)
    squared = np.empty(n)
    H, g = np.zeros((6, 6)), np.zeros(6)
    for round_ in range(REFINE_ROUNDS + 1):
        H[:], g[:] = 0.0, 0.0
        # Wide at first, since the search is only roughly right.
        cutoff = INLIER * max(1.5, 4.0 - round_)
        for k in range(n):
            weights = information(
                start[k], start_px[k], R, t, focal, cx, cy, focal_baseline, sigma, blur[k]
            )
            e = squared_distance(start[k], pixels[k], R, t, focal, cx, cy, focal_baseline, weights)
            squared[k] = e
            if e < cutoff:
                weights *= (1.0 - e / cutoff) ** 2
                add_match(H, g, start[k], pixels[k], R, t, focal, cx, cy, focal_baseline, weights)
        if round_ == REFINE_ROUNDS or not nudge(H, g, R, t):
            break
    return H, squared


@kernel
def information(p, pixel, R, t, focal, cx, cy, focal_baseline, sigma, blur):  # type: ignore[no-untyped-def]
    """Inverse covariance [3, 3] of a residual: the error at the stop and that of the start.

    The error of the start, in pixels, becomes one of the point, and that one of the prediction.
    """
    x, y, z = moved(p, R, t)
    S = np.zeros((3, 3))
    if z <= NEAREST_DEPTH_M:
        return S
    S[0, 0] = (sigma[0] * blur[1]) ** 2
    S[1, 1] = (sigma[1] * blur[1]) ** 2
    S[2, 2] = sigma[2] ** 2
    for source in range(3):
        # How the point moves when column, row or disparity of the start are off by one sigma.
        if source < 2:
            size = sigma[source] * blur[0] * p[2] / focal
            dx, dy, dz = R[0, source] * size, R[1, source] * size, R[2, source] * size
        else:
            size = -sigma[2] / pixel[2]
            dx, dy, dz = size * (x - t[0]), size * (y - t[1]), size * (z - t[2])
        d = (
            focal * (dx - x * dz / z) / z,
            focal * (dy - y * dz / z) / z,
            -focal_baseline * dz / (z * z),
        )
        for i in range(3):
            for j in range(3):
                S[i, j] += d[i] * d[j]
    return inverse(S)


@kernel
def inverse(S):  # type: ignore[no-untyped-def]
    """The inverse of a symmetric [3, 3], by cofactors."""
    cofactors = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            cofactors[i, j] = S[a, c] * S[b, d] - S[a, d] * S[b, c]
    determinant = S[0, 0] * cofactors[0, 0] + S[0, 1] * cofactors[0, 1] + S[0, 2] * cofactors[0, 2]
    for i in range(3):
        for j in range(3):
            cofactors[i, j] /= determinant
    return cofactors
