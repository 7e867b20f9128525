"""The verdict on a pose: is it sure enough that its grid lands in the right cells?"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, PoseSettings
from fieldgrid.geometry import Datum, Status, Trajectory
from fieldgrid.poses.sigmas import AddedSigma, as_unsure
from fieldgrid.poses.table import PoseTable


class ErrorBudget(NamedTuple):
    """How far off a cell at the far end of a local grid may be, metres, 1-sigma, and how far
    ahead that end is."""

    cell_m: float
    reach_m: float


OFFSET_SIGMAS, LEAST_OFFSET_M = 2.0, 0.1
"""Poses may lie from their fixes by this multiple of what these state, and by this in any case."""


def refusals(table: PoseTable, settings: PoseSettings, budget: ErrorBudget | None) -> list[str]:
    """Why each pose is not sure enough for a map; empty where it is."""
    reasons = list(table.rejection)
    refused = np.array([bool(reason) for reason in reasons])

    def refuse(failing: Bool, reason: Callable[[int], str]) -> None:
        for k in np.flatnonzero(failing & ~refused).tolist():
            reasons[k] = reason(k)
        refused[failing] = True

    heading, doubt = table.heading_sigma_deg, table.gear_doubt
    position, offset = table.position_sigma_m, table.offset_m
    refuse(
        ~(heading < 90.0),
        lambda k: "heading unknown: none is recorded, and the vehicle does not move",
    )
    refuse(
        heading > settings.max_heading_sigma_deg,
        lambda k: f"heading sigma {heading[k]:.1f}° > {settings.max_heading_sigma_deg:g}°",
    )
    refuse(
        doubt > settings.max_gear_doubt,
        lambda k: (
            f"forward or reverse is unsure: {100.0 * doubt[k]:.1f} % > "
            f"{100.0 * settings.max_gear_doubt:g} % for the other"
        ),
    )
    refuse(
        position > settings.max_position_sigma_m,
        lambda k: f"position sigma {position[k]:.2f} m > {settings.max_position_sigma_m:g} m",
    )
    refuse(
        offset > np.maximum(OFFSET_SIGMAS * table.stated_m, LEAST_OFFSET_M),
        lambda k: (
            f"the estimate lies {offset[k]:.2f} m from the fixes around it, which state an error "
            f"of {table.stated_m[k]:.2f} m"
        ),
    )
    if budget is not None:
        reach_m, most_m = budget.reach_m, budget.cell_m
        off_m = np.hypot(table.relative_sigma_m, reach_m * np.radians(heading))
        refuse(
            off_m > most_m,
            lambda k: (
                f"a cell {reach_m:.0f} m ahead would be off by {off_m[k]:.2f} m > {most_m:g} m: "
                f"heading sigma {heading[k]:.1f}°"
            ),
        )
    return reasons


def judged(
    table: PoseTable,
    datum: Datum,
    settings: PoseSettings,
    budget: ErrorBudget | None,
    heading_source: str,
) -> Trajectory:
    """Rows of the grid origin, each with its verdict. That the fixes around a pose lie beside it
    has a verdict of its own, and then counts in its sigma."""
    refused = refusals(table, settings, budget)
    table = as_unsure(table, [AddedSigma(position_m=table.offset_m / np.sqrt(2.0))])
    good = [Status.HELD if rests else Status.OK for rests in table.resting.tolist()]
    status = [Status.REJECTED if why else ok for why, ok in zip(refused, good, strict=True)]
    reason = [why or remark for why, remark in zip(refused, table.remark, strict=True)]
    return Trajectory(
        datum=datum,
        time_ns=table.time_ns,
        east_m=table.east_m,
        north_m=table.north_m,
        up_m=table.up_m,
        heading_deg=table.heading_deg,
        position_sigma_m=table.position_sigma_m,
        heading_sigma_deg=table.heading_sigma_deg,
        speed_mps=table.speed_mps,
        gear=table.gear,
        quality=table.quality,
        status=tuple(status),
        reason=tuple(reason),
        heading_source=heading_source,
    )
