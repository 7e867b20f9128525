"""Where the frame of given poses lies in the LTP: one rigid horizontal transform, by the fixes.

Places are complex numbers, east + i north. A point z = x + i y of the frame lies at

    P = P0 + z·t        t = exp(-i τ)

where τ is the clockwise turn of the frame. The scale is not free: it is only measured, to tell
poses that are not metric.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Figure, Finding, Float64, GnssError, info, warning
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.measured import BIAS_S
from fieldgrid.poses.smoother.rounds import OUTLIER_FREEDOM
from fieldgrid.poses.verdict import LEAST_OFFSET_M

Complex = npt.NDArray[np.complex128]
AnyFloat = float | Float64

FEWEST_FIXES = 3

ROUNDS = 50
"""Of reweighting, at most."""

WINDOWS_M = (20.0, 40.0, 80.0, 160.0, 320.0, 640.0)
"""Ways over which the turn of the poses against the fixes is measured, to see it drift: the
shortest on which it is told to :data:`LEAST_HEADING_SIGMA_DEG`."""

LEAST_HEADING_SIGMA_DEG = 0.5
"""What no comparison shows of the headings of another program."""

CLEAR_SIGMAS, WRONG_SCALE = 5.0, 0.05
"""Poses whose scale is off by more than this, and clearly, are not in metres; poses that are
clearly off their fixes, by what these state, do not belong where they were put."""

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
    fixes: int = 0
    scatter_m: float = np.nan
    residual_median_m: float = np.nan
    residual_p95_m: float = np.nan
    residual_most_m: float = np.nan
    scale: float = np.nan
    scale_sigma: float = np.nan
    drift_deg: float = np.nan

    def place(self, x_m: Float64, y_m: Float64) -> Float64:
        """East and north [n, 2] of points of the frame."""
        turned = (x_m + 1j * y_m) * _turn(self.frame_heading_deg)
        return np.stack([self.origin_east_m + turned.real, self.origin_north_m + turned.imag], 1)

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
    fixes, p, q = pairs.fixes, _places(pairs.frame_m), _places(pairs.fixes.points_m())
    if len(p) < FEWEST_FIXES:
        raise GnssError(
            f"Only {len(p)} fixes are of the time of the poses, which do not tell where these lie; "
            "declare it with --frame-origin LAT,LON,HEIGHT and --frame-heading DEG."
        )
    weight, t = _robust(p, q, fixes.sigma_m, None if heading_deg is None else _turn(heading_deg))
    pivot_p, pivot_q = (weight @ points / weight.sum() for points in (p, q))
    pc, qc = p - pivot_p, q - pivot_q
    residual = pc * t - qc
    scatter_m, independent = _scatter(residual, weight)
    moment = float(weight @ abs(pc) ** 2)
    spread_m = max(float(np.sqrt(moment / weight.sum())), 1e-6)
    slow_m, duration_s = float(np.median(fixes.sigma_m)), float(np.ptp(fixes.time_ns)) / 1e9
    slow_rad = float(_slow_rad(slow_m, duration_s, spread_m))
    turn_rad = np.hypot(scatter_m / np.sqrt(independent) / spread_m, slow_rad)
    # A scale, and how unsure it is by the residuals that it leaves.
    scale = float((weight @ (np.conj(pc * t) * qc)).real) / max(moment, 1e-12)
    scaled_m, of_scaled = _scatter(residual + (scale - 1.0) * pc * t, weight)
    scale_sigma = float(np.hypot(scaled_m / np.sqrt(of_scaled) / spread_m, slow_rad))
    if abs(scale - 1.0) > max(WRONG_SCALE, CLEAR_SIGMAS * scale_sigma):
        raise GnssError(
            f"The fixes' way is {scale:.3f} ± {scale_sigma:.3f} times as long as that of the poses "
            f"(over {spread_m:.0f} m), so the poses are not in metres; multiply them by that, as "
            "the program that made them can, or check the baseline of its camera."
        )
    left = float(weight @ abs(residual) ** 2)
    mirrored = pc.conj() * _best_turn(pc.conj(), qc, weight) - qc
    most_m = CLEAR_SIGMAS * max(slow_m, LEAST_OFFSET_M)
    if left > max(most_m**2 * weight.sum(), float(weight @ abs(mirrored) ** 2) / MIRRORED_SHARE):
        raise GnssError(
            "The poses are a mirror image of the fixes' way, so one axis of their frame is "
            "reversed; if x is forward, y right and z down, give --poses-axes frd."
        )
    origin = pivot_q - pivot_p * t
    found = Georeference(
        by="fixes" if heading_deg is None else "fixes, declared heading",
        frame_heading_deg=float(wrap_deg(90.0 - np.degrees(np.angle(t)))),
        frame_heading_sigma_deg=float(np.degrees(turn_rad)) if heading_deg is None else 0.0,
        origin_east_m=float(origin.real),
        origin_north_m=float(origin.imag),
        up_m=float(np.median(fixes.up_m - pairs.frame_m[:, 2])),
        place_sigma_m=float(
            np.hypot(
                scatter_m / np.sqrt(independent), slow_m / np.sqrt(1.0 + duration_s / (2 * BIAS_S))
            )
        ),
        pivot_east_m=float(pivot_q.real),
        pivot_north_m=float(pivot_q.imag),
        scatter_m=scatter_m,
        scale=scale,
        scale_sigma=scale_sigma,
        drift_deg=_drift_deg(p, q, fixes, weight, t),
    )
    return _compared(found, abs(residual))


def declared(
    east_m: float, north_m: float, up_m: float, heading_deg: float, pairs: Pairs | None
) -> Georeference:
    """A transform that is declared; the fixes, if there are any, are only compared with it."""
    heading_deg = float(wrap_deg(heading_deg))
    place = east_m, north_m
    found = Georeference("declared", heading_deg, 0.0, *place, up_m, 0.0, *place)
    if pairs is None:
        return found
    off_m = np.hypot(*(found.place(*pairs.frame_m[:, :2].T) - pairs.fixes.points_m()).T)
    found = _compared(found, off_m)._replace(scatter_m=float(np.sqrt((off_m**2).mean() / 2.0)))
    stated_m = float(np.median(pairs.fixes.sigma_m))
    if found.residual_median_m > CLEAR_SIGMAS * max(stated_m, LEAST_OFFSET_M):
        raise GnssError(
            f"Where the frame of the poses is declared, they lie {found.residual_median_m:.2f} m "
            f"(median) from fixes that state {stated_m:.2f} m; correct --frame-origin and "
            "--frame-heading, or leave them out, so that the fixes tell."
        )
    return found


def _compared(found: Georeference, away_m: Float64) -> Georeference:
    """The transform with how far poses lie from their fixes."""
    return found._replace(
        fixes=len(away_m),
        residual_median_m=float(np.median(away_m)),
        residual_p95_m=float(np.percentile(away_m, 95.0)),
        residual_most_m=float(away_m.max()),
    )


def _places(points_m: Float64) -> Complex:
    return np.asarray(points_m[:, 0] + 1j * points_m[:, 1])


def _turn(heading_deg: float) -> complex:
    """The turn of a frame whose x axis heads there."""
    return complex(np.exp(1j * np.radians(90.0 - heading_deg)))


def _best_turn(pc: Complex, qc: Complex, weight: Float64) -> complex:
    """The turn that brings centred points onto others best."""
    return complex(np.exp(1j * np.angle(weight @ (pc.conj() * qc))))


def _robust(
    p: Complex, q: Complex, sigma_m: Float64, turn: complex | None
) -> tuple[Float64, complex]:
    """Weights [n] and turn of the fit, which outliers hardly move."""
    stated = 1.0 / sigma_m**2
    weight = stated / stated.mean()
    for _ in range(ROUNDS):
        pc, qc = (points - weight @ points / weight.sum() for points in (p, q))
        t = _best_turn(pc, qc, weight) if turn is None else turn
        squared = abs(pc * t - qc) ** 2 * stated
        unit = max(float(np.median(squared)) / 1.386, 1e-12)  # of two axes, by their median
        last, weight = weight, stated / stated.mean()
        weight = weight * (OUTLIER_FREEDOM + 2.0) / (OUTLIER_FREEDOM + squared / unit)
        if abs(weight - last).max() < 1e-9:
            break
    return weight, t


def _scatter(residual: Complex, weight: Float64) -> tuple[float, float]:
    """The residuals' sigma along one axis, and how many of them are independent: what changes
    slowly is seen less often than it is measured."""
    scaled = residual * np.sqrt(weight)
    n = len(scaled)
    spectrum = np.fft.fft(scaled - scaled.mean(), 2 * n)
    lags = np.fft.ifft(abs(spectrum) ** 2)[:n].real
    if lags[0] <= 0.0:
        return 0.0, float(n)
    share = lags / lags[0]
    stop = int(np.argmax(share <= 0.0)) or n
    independent = max(n / (1.0 + 2.0 * float(share[1:stop].sum())), 2.0)
    variance = float(weight @ abs(residual) ** 2) / (2.0 * float(weight.sum()))
    return float(np.sqrt(variance * independent / (independent - 1.5))), independent


def _slow_rad(slow_m: AnyFloat, duration_s: AnyFloat, spread_m: AnyFloat) -> Float64:
    """What a slow error of the receiver, which a turn may hide, leaves of a turn."""
    duration_s = np.maximum(duration_s, 1.0)
    changed_m = slow_m * np.sqrt(2.0 * -np.expm1(-duration_s / BIAS_S))
    return np.asarray(changed_m / (2.0 * spread_m) * np.sqrt(np.minimum(BIAS_S / duration_s, 1.0)))


def _drift_deg(p: Complex, q: Complex, fixes: AcceptedFixes, weight: Float64, t: complex) -> float:
    """How far the turn against the fixes wanders along the way, beyond what the fixes show; NaN
    where the drive is too short to tell."""
    way_m = np.append(0.0, np.cumsum(abs(np.diff(p))))
    drift_deg = float("nan")
    for length_m in WINDOWS_M:
        part = np.minimum(way_m // length_m, max(way_m[-1] // length_m - 1.0, 0.0))
        if part[-1] < 1.0:
            break
        turn, sigma = _window_turns(
            np.flatnonzero(np.diff(part, prepend=-1.0)), p, q, weight, fixes
        )
        off = np.degrees(np.angle(turn / t))
        shown = float((np.degrees(sigma) ** 2).mean())
        excess = max(float((off**2).mean()) - shown, 0.0)
        # What so few turns may hide by chance is not denied.
        drift_deg = float(np.sqrt(excess + shown * np.sqrt(2.0 / len(off))))
        if np.degrees(np.median(sigma)) < LEAST_HEADING_SIGMA_DEG:
            break
    return drift_deg


def _window_turns(
    first: npt.NDArray[np.intp], p: Complex, q: Complex, weight: Float64, fixes: AcceptedFixes
) -> tuple[Complex, Float64]:
    """The turn in each part of the way that begins at the fixes `first`, and its sigma by them,
    radians."""

    def total(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.add.reduceat(values, first)

    count = np.diff(first, append=len(p))
    mass = total(weight)
    pc, qc = (z - np.repeat(total(weight * z) / mass, count) for z in (p, q))
    spread2 = np.maximum(total(weight * abs(pc) ** 2), 1e-9)
    white = np.sqrt(total((weight * fixes.noise.across_m * abs(pc)) ** 2)) / spread2
    duration_s = (fixes.time_ns[first + count - 1] - fixes.time_ns[first]) / 1e9
    slow_m = total(weight * fixes.sigma_m) / mass
    slow = _slow_rad(slow_m, duration_s, np.sqrt(spread2 / mass))
    known = count >= FEWEST_FIXES
    return total(weight * pc.conj() * qc)[known], np.hypot(white, slow)[known]
