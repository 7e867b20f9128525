"""Shortest curves of bounded curvature: Dubins' forward ones, and Reeds and Shepp's with reverse.

Lengths are in turning radii, angles in radians counter-clockwise from east; the start is at the
origin, facing east. A word is up to five segments, each left (1), straight (0) or right (-1), with
a signed length: negative is driven backwards.

Dubins, L. E. (1957), American Journal of Mathematics 79, 497-516. Reeds, J. A. and Shepp, L. A.
(1990), Pacific Journal of Mathematics 145, 367-393: the numbers in comments are of its equations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

Word = tuple[tuple[int, float], ...]
"""Segments: turn and signed length."""

_ZERO = 1e-9
_HALF = 0.5 * math.pi


def words(x: float, y: float, phi: float, *, reverse: bool) -> list[Word]:
    """The words from the origin to a pose, in no order."""
    return list(_reeds_shepp(x, y, phi) if reverse else _dubins(x, y, phi))


def _reeds_shepp(x: float, y: float, phi: float) -> Iterator[Word]:
    # Driven from the goal to the start, a word is the same one read backwards.
    back_x = x * math.cos(phi) + y * math.sin(phi)
    back_y = x * math.sin(phi) - y * math.cos(phi)
    for flip in (1.0, -1.0):
        for mirror in (1, -1):
            angle = flip * mirror * phi

            def turned(word: Word, flip: float = flip, mirror: int = mirror) -> Word:
                return tuple((mirror * turn, flip * length) for turn, length in word)

            for word in _symmetric(flip * x, mirror * y, angle):
                yield turned(word)
            for word in _asymmetric(flip * x, mirror * y, angle):
                yield turned(word)
            for word in _asymmetric(flip * back_x, mirror * back_y, angle):
                yield turned(word[::-1])


def _symmetric(x: float, y: float, phi: float) -> Iterator[Word]:
    """The formulas whose words read the same from either end."""
    s, c = math.sin(phi), math.cos(phi)
    ax, ay, bx, by = x - s, y - 1.0 + c, x + s, y - 1.0 - c
    rho, theta = math.hypot(bx, by), math.atan2(by, bx)
    t = math.atan2(ay, ax)
    v = _wrapped(phi - t)
    if t >= -_ZERO and v >= -_ZERO:  # 8.1: L+ S+ L+
        yield (1, t), (0, math.hypot(ax, ay)), (1, v)
    if rho >= 2.0:  # 8.2: L+ S+ R+
        u = math.sqrt(rho * rho - 4.0)
        t = _wrapped(theta + math.atan2(2.0, u))
        v = _wrapped(t - phi)
        if t >= -_ZERO and v >= -_ZERO:
            yield (1, t), (0, u), (-1, v)
    if rho <= 2.0:  # 8.7: L+ R+u L-u R-
        u = math.acos(0.25 * (2.0 + rho))
        t, v = _tau_omega(u, -u, bx, by, phi)
        if t >= -_ZERO and v <= _ZERO:
            yield (1, t), (-1, u), (1, -u), (-1, v)
    cosine = (20.0 - rho * rho) / 16.0
    if 0.0 <= cosine <= 1.0:  # 8.8: L+ R-u L-u R+
        u = -math.acos(cosine)
        t, v = _tau_omega(u, u, bx, by, phi)
        if t >= -_ZERO and v >= -_ZERO:
            yield (1, t), (-1, u), (1, u), (-1, v)
    if rho >= 2.0:  # 8.11: L+ R- S- L- R+
        u = 4.0 - math.sqrt(rho * rho - 4.0)
        t = _wrapped(math.atan2((4.0 - u) * bx - 2.0 * by, -2.0 * bx + (u - 4.0) * by))
        v = _wrapped(t - phi)
        if u <= _ZERO and t >= -_ZERO and v >= -_ZERO:
            yield (1, t), (-1, -_HALF), (0, u), (1, -_HALF), (-1, v)


def _asymmetric(x: float, y: float, phi: float) -> Iterator[Word]:
    """The others, which count from both ends."""
    s, c = math.sin(phi), math.cos(phi)
    ax, ay, bx, by = x - s, y - 1.0 + c, x + s, y - 1.0 - c
    rho, theta = math.hypot(ax, ay), math.atan2(ay, ax)
    if rho <= 4.0:  # 8.3 and 8.4: L+ R- L
        u = -2.0 * math.asin(0.25 * rho)
        t = _wrapped(theta + 0.5 * u + math.pi)
        if t >= -_ZERO and u <= _ZERO:
            yield (1, t), (-1, u), (1, _wrapped(phi - t + u))
    if rho >= 2.0:  # 8.9: L+ R- S- L-
        r = math.sqrt(rho * rho - 4.0)
        t = _wrapped(theta + math.atan2(r, -2.0))
        v = _wrapped(phi - _HALF - t)
        if t >= -_ZERO and 2.0 - r <= _ZERO and v <= _ZERO:
            yield (1, t), (-1, -_HALF), (0, 2.0 - r), (1, v)
    rho = math.hypot(bx, by)
    if rho >= 2.0:  # 8.10: L+ R- S- R-
        t = math.atan2(bx, -by)
        v = _wrapped(t + _HALF - phi)
        if t >= -_ZERO and v <= _ZERO:
            yield (1, t), (-1, -_HALF), (0, 2.0 - rho), (-1, v)


def _tau_omega(u: float, v: float, xi: float, eta: float, phi: float) -> tuple[float, float]:
    delta = _wrapped(u - v)
    a = math.sin(u) - math.sin(delta)
    b = math.cos(u) - math.cos(delta) - 1.0
    t1 = math.atan2(eta * a - xi * b, xi * a + eta * b)
    t2 = 2.0 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3.0
    tau = _wrapped(t1 + math.pi) if t2 < 0.0 else _wrapped(t1)
    return tau, _wrapped(tau - u + v - phi)


def _dubins(x: float, y: float, phi: float) -> Iterator[Word]:
    for mirror in (1, -1):
        angle = mirror * phi
        s, c = math.sin(angle), math.cos(angle)
        ax, ay, bx, by = x - s, mirror * y - 1.0 + c, x + s, mirror * y - 1.0 - c
        size, theta = math.hypot(ax, ay), math.atan2(ay, ax)
        t = _forward(theta)  # L S L
        yield (mirror, t), (0, size), (mirror, _forward(angle - t))
        if bx * bx + by * by >= 4.0:  # L S R
            u = math.sqrt(bx * bx + by * by - 4.0)
            t = _forward(math.atan2(by, bx) + math.atan2(2.0, u))
            yield (mirror, t), (0, u), (-mirror, _forward(t - angle))
        if size <= 4.0:  # L R L, whose middle arc is over half a turn
            u = 2.0 * math.pi - 2.0 * math.asin(0.25 * size)
            t = _forward(theta + _HALF + math.acos(0.25 * size))
            yield (mirror, t), (-mirror, u), (mirror, _forward(angle - t + u))


def _wrapped(angle: float) -> float:
    """The angle in (-π, π]."""
    turn = angle % (2.0 * math.pi)
    return turn - 2.0 * math.pi if turn > math.pi else turn


def _forward(angle: float) -> float:
    """The angle in [0, 2π), with a hair below 2π taken for none."""
    turn = angle % (2.0 * math.pi)
    return 0.0 if 2.0 * math.pi - turn < _ZERO else turn
