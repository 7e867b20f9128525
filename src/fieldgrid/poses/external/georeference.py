"""Where the frame of given poses lies in the LTP: declared, or by the estimate that they went into.

Places are complex numbers, east + i north. A point z = x + i y of the frame lies at

    P = P0 + z·t        t = exp(-i τ)

where τ is the clockwise turn of the frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Figure, Finding, Float64, GnssError, Int64, PoseSettings, info, warning
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.verdict import LEAST_OFFSET_M

Complex = npt.NDArray[np.complex128]

CLEAR_SIGMAS, WRONG_SCALE = 5.0, 0.05
"""Poses whose scale is off by more than this, and clearly, are not in metres; poses that are
clearly off their fixes, by what these state, do not belong where they were put."""

MIRRORED_SHARE = 0.1
"""Poses are mirrored where a mirrored fit leaves so little of the residuals."""


class Georeference(NamedTuple):
    """Where the frame of given poses lies.

    `by` is fixes, "fixes, declared heading" or declared. `frame_heading_deg` is the heading of the
    frame's forward axis, x. Its origin lies at `origin_east_m`, `origin_north_m`, and `up_m` is
    added to its z: the one turn and shift that lay the poses along their estimate best, which
    follows them where they drift. `place_sigma_m` is the least error of the estimate along one
    axis, the pivot the mean place of the fixes. `fixes` were compared; `scatter_m` is that of their
    residuals along one axis, and the `residual_..._m` are distances. `scale` is how much longer the
    fixes' way is than that of the poses. `drift_deg` is how far the heading of the poses wanders
    beside that of the estimate, beyond its sigma. NaN stands for what nothing tells.
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
        turned = (x_m + 1j * y_m) * np.exp(1j * np.radians(90.0 - self.frame_heading_deg))
        return np.stack([self.origin_east_m + turned.real, self.origin_north_m + turned.imag], 1)

    def compared(self, pairs: Pairs) -> Georeference:
        """With how far poses lie from their fixes."""
        away_m = np.hypot(*(self.place(*pairs.frame_m[:, :2].T) - pairs.fixes.points_m()).T)
        return self._replace(
            fixes=len(away_m),
            scatter_m=float(np.sqrt((away_m**2).mean() / 2.0)),
            residual_median_m=float(np.median(away_m)),
            residual_p95_m=float(np.percentile(away_m, 95.0)),
            residual_most_m=float(away_m.max()),
        )

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
                "than that of the poses; where there are no fixes, the scale was corrected.",
                figure=Figure(100.0 * off, "%"),
            )


class Pairs(NamedTuple):
    """n accepted fixes, `rows` of all of them, and where the poses have the antenna at their times:
    `frame_m` [n, 3] in the frame of the poses, and their headings there."""

    rows: Int64
    fixes: AcceptedFixes
    frame_m: Float64
    heading_deg: Float64


def by_estimate(pairs: Pairs | None, drive: DriveEstimate, settings: PoseSettings) -> Georeference:
    """How the frame lies by the estimate of a drive at its fixes. Raises GnssError where the fixes
    do not tell it, or deny that the poses are in metres."""
    by, scale, yaw = "fixes", drive.smoothed.camera_scale, drive.smoothed.camera_yaw_rad
    if settings.frame_heading_deg is not None:
        by = "fixes, declared heading"
    sigma_deg = float(np.degrees(drive.smoothed.heading_sigma_rad.min()))
    unsure = sigma_deg > settings.max_heading_sigma_deg
    if unsure or pairs is None or scale is None or yaw is None:
        raise GnssError(
            f"The fixes do not tell how the frame of the poses is turned: to "
            f"{sigma_deg:.1f}° > {settings.max_heading_sigma_deg:g}°; drive "
            "farther, take a better receiver, or declare it with --frame-heading DEG."
        )
    way, way_sigma = 1.0 / (1.0 + scale.value), scale.sigma / (1.0 + scale.value) ** 2
    if abs(way - 1.0) > max(WRONG_SCALE, CLEAR_SIGMAS * way_sigma):
        raise GnssError(
            f"The fixes' way is {way:.3f} ± {way_sigma:.3f} times as long as that of the poses, "
            "so the poses are not in metres; multiply them by that, as the program that made them "
            "can, or check the baseline of its camera."
        )
    fixes = pairs.fixes
    p = _places(pairs.frame_m)
    q = _places(fixes.points_m() + drive.offset_m[pairs.rows])
    t = _best_turn(p - p.mean(), q - q.mean())
    origin, pivot = q.mean() - p.mean() * t, q.mean()
    turn_deg = -float(np.degrees(np.angle(t)))
    node = np.flatnonzero(drive.fix >= 0)[pairs.rows]
    wander_deg = wrap_deg(
        drive.heading_deg[node] - (pairs.heading_deg + turn_deg - np.degrees(yaw.value))
    )
    shown_deg = np.degrees(drive.smoothed.heading_sigma_rad[node])
    found = Georeference(
        by,
        float(wrap_deg(90.0 + turn_deg)),
        sigma_deg,
        float(origin.real),
        float(origin.imag),
        float(np.median(fixes.up_m - pairs.frame_m[:, 2])),
        float(drive.position_sigma_m.min()),
        float(pivot.real),
        float(pivot.imag),
        scale=way,
        scale_sigma=way_sigma,
        drift_deg=float(np.sqrt(max(float((wander_deg**2 - shown_deg**2).mean()), 0.0))),
    )
    return found.compared(pairs)


def declared(
    east_m: float, north_m: float, up_m: float, heading_deg: float, pairs: Pairs | None
) -> Georeference:
    """A transform that is declared; the fixes, if there are any, are only compared with it."""
    place = east_m, north_m
    found = Georeference("declared", float(wrap_deg(heading_deg)), 0.0, *place, up_m, 0.0, *place)
    if pairs is None:
        return found
    found, stated_m = found.compared(pairs), float(np.median(pairs.fixes.sigma_m))
    if found.residual_median_m > CLEAR_SIGMAS * max(stated_m, LEAST_OFFSET_M):
        raise GnssError(
            f"Where the frame of the poses is declared, they lie {found.residual_median_m:.2f} m "
            f"(median) from fixes that state {stated_m:.2f} m; correct --frame-origin and "
            "--frame-heading, or leave them out, so that the fixes tell."
        )
    return found


def check_mirrored(pairs: Pairs) -> None:
    """Raise GnssError for poses that fit their fixes as a mirror image, and not as they are."""
    p, q = _places(pairs.frame_m), _places(pairs.fixes.points_m())
    p, q = p - p.mean(), q - q.mean()
    left_m2, mirrored_m2 = (
        float((abs(one * _best_turn(one, q) - q) ** 2).mean()) for one in (p, p.conj())
    )
    most_m = CLEAR_SIGMAS * max(float(np.median(pairs.fixes.sigma_m)), LEAST_OFFSET_M)
    if left_m2 > max(most_m**2, mirrored_m2 / MIRRORED_SHARE):
        raise GnssError(
            "The poses are a mirror image of the fixes' way, so one axis of their frame is "
            "reversed; if x is forward, y right and z down, give --poses-axes frd."
        )


def _places(points_m: Float64) -> Complex:
    return np.asarray(points_m[:, 0] + 1j * points_m[:, 1])


def _best_turn(pc: Complex, qc: Complex) -> complex:
    """The turn that brings centred points onto others best."""
    return complex(np.exp(1j * np.angle(np.vdot(pc, qc))))
