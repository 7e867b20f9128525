"""The verdict on a pose: is it sure enough that its grid lands in the right cells?"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Bool, Float64
from fieldgrid.settings import PoseSettings

JUMP_SIGMAS, JUMP_DEG = 4.0, 5.0
"""A nose does not turn faster than its tightest turn by more than this."""


class Budget(NamedTuple):
    """How far off a cell at the far end of a local grid may be, metres, 1-sigma, and how far
    ahead that end is."""

    cell_m: float
    reach_m: float


def doubt(
    heading_sigma_deg: float,
    position_sigma_m: float,
    relative_sigma_m: float,
    gear_doubt: float,
    settings: PoseSettings,
    budget: Budget | None,
) -> str:
    """Why a pose is not sure enough for a map; empty when it is."""
    if not heading_sigma_deg < 90.0:
        return "heading unknown: none is recorded, and the vehicle does not move"
    if heading_sigma_deg > settings.max_heading_sigma_deg:
        return f"heading sigma {heading_sigma_deg:.1f}° > {settings.max_heading_sigma_deg:g}°"
    if gear_doubt > settings.max_gear_doubt:
        return (
            f"forward or reverse is unsure: {100.0 * gear_doubt:.1f} % > "
            f"{100.0 * settings.max_gear_doubt:g} % for the other"
        )
    if position_sigma_m > settings.max_position_sigma_m:
        return f"position sigma {position_sigma_m:.2f} m > {settings.max_position_sigma_m:g} m"
    if budget is not None:
        off_m = math.hypot(relative_sigma_m, budget.reach_m * math.radians(heading_sigma_deg))
        if off_m > budget.cell_m:
            return (
                f"a cell {budget.reach_m:.0f} m ahead would be off by {off_m:.2f} m > "
                f"{budget.cell_m:g} m: heading sigma {heading_sigma_deg:.1f}°"
            )
    return ""


def jumps(
    east_m: Float64,
    north_m: Float64,
    heading_deg: Float64,
    sigma_deg: Float64,
    min_turn_radius_m: float,
) -> Bool:
    """Which of n headings jump away from both neighbours further than a vehicle can turn.

    The paper's indicator: a few isolated jumps corrupt a map, so their grids are discarded.
    """
    n = len(heading_deg)
    found = np.zeros(n, dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(heading_deg) & np.isfinite(sigma_deg))
    if known.size < 3:
        return found
    turn = np.abs(wrap_deg(np.diff(heading_deg[known])))
    way_m = np.hypot(np.diff(east_m[known]), np.diff(north_m[known]))
    sigma = np.hypot(sigma_deg[known][1:], sigma_deg[known][:-1])
    possible = np.degrees(way_m / min_turn_radius_m) + JUMP_SIGMAS * sigma + JUMP_DEG
    impossible = turn > possible
    found[known[1:-1]] = impossible[:-1] & impossible[1:]
    return found
