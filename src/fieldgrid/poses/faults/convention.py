"""Whether a recorded heading means what it says: its comparison with the estimated one.

Zero and sign of a heading are what users of receivers and inertial units get wrong most often:
radians from east for degrees from north, an antenna pair across the vehicle, a compass mounted
backwards. Against the course of the drive each of them shows as what it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import VehicleGeometry, wrap_deg

FEWEST = 20
"""Fewer sure headings while driving decide nothing."""

FEWEST_BACK = 3
"""Least number of poses in reverse: a course turns around there, and a heading does not."""

SURE_DEG = 5.0
"""Only where the heading is this sure is another compared with it."""

COARSE_DEG = 25.0
"""Where it is this sure, it tells at least which way round another is."""

FEW_TURNED_SHARE = 0.02
"""No more than this that is the other way round is not worth a word beside other sensors."""

TELLING_TURN_DEG = 10.0
"""A mirrored sign shows only in a drive that has turned by as much."""


class Comparison(NamedTuple):
    """What a heading has more than the nose: `offset_deg` ± `offset_sigma_deg`, and its scatter
    about that; `mirrored` when it turns the other way; `course` when it turns around in reverse,
    so that it is the direction of travel and no heading. `compared` instants were compared, all of
    them in reverse where `backing`. `flipped` is the share of the instants of a coarsely known
    heading at which it is on the other side of that offset."""

    offset_deg: float
    offset_sigma_deg: float
    scatter_deg: float
    mirrored: bool
    course: bool
    compared: int
    backing: bool = False
    flipped: float = 0.0

    @property
    def flips(self) -> bool:
        """Whether it is the other way round in most of the drive than where it was compared."""
        return self.flipped > 0.5

    @property
    def scatters(self) -> bool:
        """Whether the two are so far apart here and there that one of them is none."""
        return self.offset_sigma_deg > SURE_DEG

    def is_denied(self, most_offset_deg: float) -> bool:
        """Whether the drive denies what is declared of the heading."""
        return self.mirrored or abs(self.offset_deg) > most_offset_deg

    def correction(self, rig: VehicleGeometry | None) -> str:
        """What to declare in the mounting instead of what the rig does, as a clause."""
        declared_deg = 0.0 if rig is None else rig.heading_offset_deg or 0.0
        counter = rig is not None and rig.heading_convention == "ccw_east"
        if not self.mirrored:
            return f'"heading_offset_deg": {wrap_deg(declared_deg + self.offset_deg):.1f}'
        # By the rig's words the nose would be the offset minus what it is.
        rest = float(wrap_deg(90.0 - declared_deg - self.offset_deg))
        degrees = (
            f' and "heading_offset_deg": {rest:.1f}' if declared_deg or abs(rest) > 1.0 else ""
        )
        return f'"heading_convention": "{"cw_north" if counter else "ccw_east"}"{degrees}'

    def diagnosis(self) -> str:
        """What is wrong, as a clause."""
        if self.mirrored:
            return "turns the other way: it is counted counter-clockwise"
        if abs(wrap_deg(self.offset_deg - 180.0)) < 15.0 and self.backing:
            return (
                f"is {self.offset_deg:.1f}° off the nose of a vehicle that by its motion only "
                "backs up, so it is the course, or the camera looks backwards, or images or gyro "
                "are in a wrong order or sign"
            )
        if abs(wrap_deg(self.offset_deg - 180.0)) < 15.0:
            return f"points backwards: it is {self.offset_deg:.1f}° off the nose"
        return f"is {self.offset_deg:.1f}° off the nose throughout"


def compare(
    recorded_deg: Float64,
    heading_deg: Float64,
    sigma_deg: Float64,
    gear: Int64,
) -> Comparison | None:
    """A recorded heading beside an estimated one that did not use it; None when too little is
    sure. All length n; NaN where nothing is recorded, gear 0 at rest."""
    sure = np.isfinite(recorded_deg) & (sigma_deg < SURE_DEG)
    use, back = sure & (gear > 0), sure & (gear < 0)
    backing = bool(use.sum() < FEWEST <= back.sum())
    if backing:
        use, back = back, np.zeros_like(back)
    if use.sum() < FEWEST:
        return None
    recorded, heading = recorded_deg[use], heading_deg[use]
    straight, straight_scatter = _circular(recorded - heading)
    mirror, mirror_scatter = _circular(recorded + heading)
    _, spread = _circular(heading)
    # On a straight drive both fit, and the sign stays unknown.
    mirrored = spread > TELLING_TURN_DEG and mirror_scatter < straight_scatter / 2.0
    offset, scatter = (mirror, mirror_scatter) if mirrored else (straight, straight_scatter)
    # Neighbours err alike; a hundredth of them is taken to be independent.
    sigma = scatter / np.sqrt(max(use.sum() / 100.0, 1.0))
    sign = -1.0 if mirrored else 1.0
    behind = np.abs(wrap_deg(recorded_deg[back] - sign * heading_deg[back] - offset))
    course = bool(back.sum() >= FEWEST_BACK and np.median(behind) > 90.0)
    found = Comparison(offset, float(sigma), scatter, mirrored, course, int(use.sum()), backing)
    coarse = np.isfinite(recorded_deg) & (sigma_deg < COARSE_DEG) & (gear == (-1 if backing else 1))
    around = turned_around(found, recorded_deg, heading_deg, sigma_deg)
    return found._replace(flipped=float(np.mean(around[coarse])))


def turned_around(
    found: Comparison, recorded_deg: Float64, heading_deg: Float64, sigma_deg: Float64
) -> Bool:
    """Where a recorded heading is the other way round than its comparison says, [n]."""
    sign = -1.0 if found.mirrored else 1.0
    away = np.abs(wrap_deg(recorded_deg - sign * heading_deg - found.offset_deg))
    return (sigma_deg < COARSE_DEG) & (away > 90.0)


def _circular(angles_deg: Float64) -> tuple[float, float]:
    """Circular median and 1.48 times the median deviation from it, degrees."""
    rad = np.radians(angles_deg)
    mean = np.degrees(np.arctan2(np.sin(rad).mean(), np.cos(rad).mean()))
    off = np.asarray(wrap_deg(angles_deg - mean))
    middle = float(np.median(off))
    return float(wrap_deg(mean + middle)), float(1.48 * np.median(np.abs(off - middle)))
