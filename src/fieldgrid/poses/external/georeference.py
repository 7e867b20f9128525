"""Where the frame of given poses lies in the LTP: one rigid horizontal transform, by the fixes.

A point (x, y) of the frame lies at

    E = E0 + x·cos τ + y·sin τ        N = N0 - x·sin τ + y·cos τ

The scale is not free: it is only measured, to tell poses that are not metric.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, GnssError, Int64, info, warning
from fieldgrid.geometry import R_enu_level, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes

FEWEST_FIXES = 3

FREEDOM, ROUNDS = 4.0, 50
"""Of Student's distribution, by which fixes err; and rounds of reweighting."""

SLOW_S = 300.0
"""Time in which the slow error of a receiver changes (as in the batch estimate)."""

WINDOWS_M = (20.0, 40.0, 80.0, 160.0, 320.0, 640.0)
"""Ways over which the turn of the poses against the fixes is measured, to see it drift: the
shortest on which it is told to :data:`SEEN_DEG`."""

SEEN_DEG = 0.5

CLEAR_SIGMAS, WRONG_SCALE = 5.0, 0.05
"""Poses whose scale is off by more than this, and clearly, are not in metres."""

MISFIT_SIGMAS, LEAST_MISFIT_M = 5.0, 0.1
"""Poses this far from their fixes, by what these state, do not belong where they were put."""

MIRRORED_SHARE = 0.1
"""Poses are mirrored where a mirrored fit leaves so little of the residuals."""


class Georeference(NamedTuple):
    """How poses of another program came to their place.

    `by` is fixes, "fixes, declared heading" or declared. `frame_heading_deg` is the heading of the
    frame's forward axis, x. Its origin lies at `origin_east_m`, `origin_north_m`, and `up_m` is
    added to its z. `place_sigma_m` is the error of the fit along one axis at its pivot, which is
    the mean place of the fixes, and grows with the distance from there by the sigma of the heading.
    `fixes` were compared; `scatter_m` is that of their residuals along one axis, and the
    `residual_..._m` are distances. `scale` is how much longer the fixes' way is than that of the
    poses. `drift_deg` is how far the heading of the poses wanders beside that of the fixes, beyond
    what these show. NaN stands for what nothing tells.
    """

    by: str
    frame_heading_deg: float
    frame_heading_sigma_deg: float
    origin_east_m: float
    origin_north_m: float
    up_m: float
    place_sigma_m: float
    pivot_east_m: float
    pivot_north_m: float
    fixes: int
    scatter_m: float
    residual_median_m: float
    residual_p95_m: float
    residual_most_m: float
    scale: float
    scale_sigma: float
    drift_deg: float

    def place(self, x_m: Float64, y_m: Float64) -> Float64:
        """East and north [n, 2] of points of the frame."""
        R = R_enu_level(self.frame_heading_deg - 90.0)[:2, :2]
        origin = np.array([self.origin_east_m, self.origin_north_m])
        return np.asarray(np.stack([x_m, y_m], axis=1) @ R.T + origin)

    def sigma_m(self, place_m: Float64) -> Float64:
        """The error of the transform along one axis at places [n, 2]."""
        away_m = np.hypot(*(place_m - [self.pivot_east_m, self.pivot_north_m]).T)
        turned_m = np.radians(self.frame_heading_sigma_deg) * away_m
        return np.asarray(np.hypot(self.place_sigma_m, turned_m))

    def findings(self) -> Iterator[Finding]:
        """The transform, and that the poses have another scale than the fixes."""
        heading = f"{self.frame_heading_deg:.2f}°"
        told = f"The frame of the poses is declared: its forward axis heads {heading}."
        if self.by != "declared":
            told = (
                f"The frame of the poses lies by {self.fixes} fixes: its forward axis heads "
                f"{heading} ± {self.frame_heading_sigma_deg:.2f}°, residuals "
                f"{self.residual_median_m:.3f} m (median), {self.residual_p95_m:.3f} m (95 %), "
                f"{self.residual_most_m:.3f} m (most)."
            )
        yield info("poses-frame", told)
        off = self.scale - 1.0
        if abs(off) > max(0.01, CLEAR_SIGMAS * self.scale_sigma):
            yield warning(
                "poses-scale",
                f"The fixes' way is {100.0 * off:+.1f} % ± {100.0 * self.scale_sigma:.1f} % longer "
                "than that of the poses; the scale was not changed.",
                figure=Figure(100.0 * off, "%"),
            )


class Pairs(NamedTuple):
    """n fixes, and where the poses have the antenna at their times: `frame_m` [n, 3] in the frame
    of the poses."""

    fixes: AcceptedFixes
    frame_m: Float64


def by_fixes(pairs: Pairs, heading_deg: float | None) -> Georeference:
    """The transform that lays poses along their fixes; with a `heading_deg` its turn is declared.

    Raises GnssError where the fixes cannot tell it, or contradict a rigid transform.
    """
    fixes, p, q = pairs.fixes, pairs.frame_m[:, :2], pairs.fixes.points_m()
    if len(p) < FEWEST_FIXES:
        raise GnssError(
            f"Only {len(p)} fixes are of the time of the poses, which do not tell where these lie; "
            "declare it with --frame-origin LAT,LON,HEIGHT and --frame-heading DEG."
        )
    given_rad = None if heading_deg is None else float(np.radians(heading_deg - 90.0))
    weight, turn_rad, residual = _robust(p, q, fixes.sigma_m, given_rad)
    scatter_m, independent = _scatter(residual, weight)
    pivot_p, pivot_q = _mean(p, weight), _mean(q, weight)
    spread_m = float(np.sqrt(_mean(((p - pivot_p) ** 2).sum(axis=1), weight)))
    slow_m = float(np.median(fixes.sigma_m))
    duration_s = float(np.ptp(fixes.time_ns)) / 1e9
    own, slow = _turn_sigma_rad(scatter_m, independent, slow_m, duration_s, max(spread_m, 1e-6))
    sigma_rad = float(np.hypot(own, slow))
    pc, qc = p - pivot_p, q - pivot_q
    R = R_enu_level(np.degrees(turn_rad))[:2, :2]
    along = weight @ ((pc @ R.T) * qc).sum(axis=1)
    scale = float(along / max(weight @ (pc**2).sum(axis=1), 1e-12))
    scale_sigma = _check_scale(scale, pc, residual, turn_rad, weight, slow, spread_m)
    _check_hand(pc, qc, weight, residual, slow_m)
    origin = pivot_q - pivot_p @ R.T
    up_m = float(np.median(fixes.up_m - pairs.frame_m[:, 2]))
    heading = float(np.degrees(turn_rad) + 90.0)
    free = heading_deg is None
    found = declared(float(origin[0]), float(origin[1]), up_m, heading, None)._replace(
        by="fixes" if free else "fixes, declared heading",
        frame_heading_sigma_deg=float(np.degrees(sigma_rad)) if free else 0.0,
        place_sigma_m=float(
            np.hypot(
                scatter_m / np.sqrt(independent), slow_m / np.sqrt(1.0 + duration_s / (2 * SLOW_S))
            )
        ),
        pivot_east_m=float(pivot_q[0]),
        pivot_north_m=float(pivot_q[1]),
        scatter_m=scatter_m,
        scale=scale,
        scale_sigma=scale_sigma,
        drift_deg=_drift_deg(pairs, weight, turn_rad),
    )
    return _compared(found, residual)


def declared(
    east_m: float, north_m: float, up_m: float, heading_deg: float, pairs: Pairs | None
) -> Georeference:
    """A transform that is declared; the fixes, if there are any, are only compared with it."""
    nan = float("nan")
    found = Georeference(
        by="declared",
        frame_heading_deg=float(wrap_deg(heading_deg)),
        frame_heading_sigma_deg=0.0,
        origin_east_m=east_m,
        origin_north_m=north_m,
        up_m=up_m,
        place_sigma_m=0.0,
        pivot_east_m=east_m,
        pivot_north_m=north_m,
        fixes=0,
        scatter_m=nan,
        residual_median_m=nan,
        residual_p95_m=nan,
        residual_most_m=nan,
        scale=nan,
        scale_sigma=nan,
        drift_deg=nan,
    )
    if pairs is None:
        return found
    off_m = found.place(*pairs.frame_m[:, :2].T) - pairs.fixes.points_m()
    found = _compared(found, off_m)._replace(scatter_m=float(np.sqrt((off_m**2).mean())))
    stated_m = float(np.median(pairs.fixes.sigma_m))
    if found.residual_median_m > MISFIT_SIGMAS * max(stated_m, LEAST_MISFIT_M):
        raise GnssError(
            f"Where the frame of the poses is declared, they lie {found.residual_median_m:.2f} m "
            f"(median) from fixes that state {stated_m:.2f} m; correct --frame-origin and "
            "--frame-heading, or leave them out, so that the fixes tell."
        )
    return found


def _compared(found: Georeference, off_m: Float64) -> Georeference:
    """The transform with how far poses lie from their fixes."""
    away_m = np.hypot(*off_m.T)
    return found._replace(
        fixes=len(away_m),
        residual_median_m=float(np.median(away_m)),
        residual_p95_m=float(np.percentile(away_m, 95.0)),
        residual_most_m=float(away_m.max()),
    )


def _robust(
    p: Float64, q: Float64, sigma_m: Float64, turn_rad: float | None
) -> tuple[Float64, float, Float64]:
    """Weights [n], turn and residuals [n, 2] of the fit, which outliers hardly move."""
    stated = 1.0 / sigma_m**2
    weight = stated / stated.mean()
    turn = 0.0
    for _ in range(ROUNDS):
        pc, qc = p - _mean(p, weight), q - _mean(q, weight)
        turn = _turn_rad(pc, qc, weight) if turn_rad is None else turn_rad
        residual = pc @ R_enu_level(np.degrees(turn))[:2, :2].T - qc
        squared = (residual**2).sum(axis=1) * stated
        unit = max(float(np.median(squared)) / 1.386, 1e-12)  # of two axes, by their median
        new = stated / stated.mean() * (FREEDOM + 2.0) / (FREEDOM + squared / unit)
        if np.abs(new - weight).max() < 1e-9:
            break
        weight = new
    return weight, float(turn), residual


def _turn_rad(pc: Float64, qc: Float64, weight: Float64) -> float:
    """The clockwise turn that brings centred points onto others best."""
    along = weight @ (pc * qc).sum(axis=1)
    across = weight @ (pc[:, 1] * qc[:, 0] - pc[:, 0] * qc[:, 1])
    return float(np.arctan2(across, along))


def _scatter(residual: Float64, weight: Float64) -> tuple[float, float]:
    """The residuals' sigma along one axis, and how many of them are independent: what changes
    slowly is seen less often than it is measured."""
    scaled = residual * np.sqrt(weight)[:, None]
    scaled = scaled - scaled.mean(axis=0)
    n = len(scaled)
    spectrum = np.fft.rfft(scaled, 2 * n, axis=0)
    lags = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:n].sum(axis=1)
    if lags[0] <= 0.0:
        return 0.0, float(n)
    share = lags / lags[0]
    ends = np.flatnonzero(share <= 0.0)
    stop = int(ends[0]) if ends.size else n
    independent = max(n / (1.0 + 2.0 * float(share[1:stop].sum())), 2.0)
    variance = float(weight @ (residual**2).sum(axis=1)) / (2.0 * float(weight.sum()))
    return float(np.sqrt(variance * independent / (independent - 1.5))), independent


def _turn_sigma_rad(
    scatter_m: float, independent: float, slow_m: float, duration_s: float, spread_m: float
) -> tuple[float, float]:
    """What residuals, and a slow error of the receiver that a turn may hide, leave of its turn."""
    changed_m = slow_m * np.sqrt(2.0 * -np.expm1(-duration_s / SLOW_S))
    slow = changed_m / (2.0 * spread_m) * min(1.0, np.sqrt(SLOW_S / max(duration_s, 1.0)))
    return float(scatter_m / np.sqrt(independent) / spread_m), float(slow)


def _check_hand(
    pc: Float64, qc: Float64, weight: Float64, residual: Float64, stated_m: float
) -> None:
    """Raise GnssError for poses whose mirror image fits their fixes instead of them."""
    left = float(weight @ (residual**2).sum(axis=1))
    if left < (MISFIT_SIGMAS * max(stated_m, LEAST_MISFIT_M)) ** 2 * float(weight.sum()):
        return
    flipped = pc * [1.0, -1.0]
    turn = _turn_rad(flipped, qc, weight)
    mirrored = flipped @ R_enu_level(np.degrees(turn))[:2, :2].T - qc
    if weight @ (mirrored**2).sum(axis=1) < MIRRORED_SHARE * left:
        raise GnssError(
            "The poses are a mirror image of the fixes' way, so one axis of their frame is "
            "reversed; if x is forward, y right and z down, give --poses-axes frd."
        )


def _check_scale(
    scale: float,
    pc: Float64,
    residual: Float64,
    turn_rad: float,
    weight: Float64,
    slow: float,
    spread_m: float,
) -> float:
    """The sigma of a scale by the residuals that it leaves; GnssError where it is none of poses in
    metres."""
    left = residual + (scale - 1.0) * pc @ R_enu_level(np.degrees(turn_rad))[:2, :2].T
    scatter_m, independent = _scatter(left, weight)
    sigma = float(np.hypot(scatter_m / np.sqrt(independent) / max(spread_m, 1e-6), slow))
    if abs(scale - 1.0) > max(WRONG_SCALE, CLEAR_SIGMAS * sigma):
        raise GnssError(
            f"The fixes' way is {scale:.3f} ± {sigma:.3f} times as long as that of the poses "
            f"(over {spread_m:.0f} m), so the poses are not in metres; multiply them by that, as "
            "the program that made them can, or check the baseline of its camera."
        )
    return sigma


def _drift_deg(pairs: Pairs, weight: Float64, turn_rad: float) -> float:
    """How far the turn against the fixes wanders along the way, beyond what the fixes show; NaN
    where the drive is too short to tell."""
    p, q, fixes = pairs.frame_m[:, :2], pairs.fixes.points_m(), pairs.fixes
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p, axis=0).T))])
    drift_deg = float("nan")
    for length_m in WINDOWS_M:
        part = np.minimum(way_m / length_m, max(way_m[-1] // length_m - 1.0, 0.0)).astype(np.int64)
        if part[-1] < 1:
            break
        turn, sigma = _window_turns(part, p, q, weight, fixes)
        off = np.asarray(wrap_deg(np.degrees(turn - turn_rad)))
        shown = float((np.degrees(sigma) ** 2).mean())
        excess = max(float((off**2).mean()) - shown, 0.0)
        # What so few turns may hide by chance is not denied.
        drift_deg = float(np.sqrt(excess + shown * np.sqrt(2.0 / len(off))))
        if np.degrees(np.median(sigma)) < SEEN_DEG:
            break
    return drift_deg


def _window_turns(
    part: Int64, p: Float64, q: Float64, weight: Float64, fixes: AcceptedFixes
) -> tuple[Float64, Float64]:
    """The turn in each part of the way, and its sigma by the fixes, radians."""

    def total(values: Float64) -> Float64:
        return np.asarray(np.bincount(part, values), dtype=np.float64)

    known = np.bincount(part) >= FEWEST_FIXES
    mass = np.where(known, total(weight), 1.0)
    pc, qc = (
        points - np.stack([total(weight * column) / mass for column in points.T], axis=1)[part]
        for points in (p, q)
    )
    along = total(weight * (pc * qc).sum(axis=1))
    across = total(weight * (pc[:, 1] * qc[:, 0] - pc[:, 0] * qc[:, 1]))
    spread2 = np.maximum(total(weight * (pc**2).sum(axis=1)), 1e-9)
    white = np.sqrt(total((weight * fixes.noise.across_m) ** 2 * (pc**2).sum(axis=1))) / spread2
    first = np.searchsorted(part, np.arange(len(mass)))
    last = np.searchsorted(part, np.arange(len(mass)), side="right") - 1
    duration_s = np.maximum(fixes.time_ns[last] - fixes.time_ns[np.minimum(first, last)], 0) / 1e9
    slow_m = total(weight * fixes.sigma_m) / mass
    changed_m = slow_m * np.sqrt(2.0 * -np.expm1(-duration_s / SLOW_S))
    slow = changed_m / (2.0 * np.sqrt(spread2 / mass))
    return np.arctan2(across, along)[known], np.hypot(white, slow)[known]


def _mean(values: Float64, weight: Float64) -> Float64:
    return np.asarray(weight @ values / weight.sum())
