"""What would not be seen if it were wrong, by the sensors that a drive has.

Positions alone fit an antenna that sits elsewhere, stamps that are late and a receiver that drifts
slowly as well as what was declared. Sigmas that covered all of this would be too large for every
good drive; so these faults are named, and do not enter the sigmas. What does is the slow error
that every receiver of a kind has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum

import numpy as np

from fieldgrid.array_types import Bool, Float64
from fieldgrid.fixes import least_sigma_m
from fieldgrid.pose.accepted import AcceptedFixes
from fieldgrid.pose.axle import names_axle
from fieldgrid.pose.denied import CLEAR_SIGMAS, sees_speed, sees_turns
from fieldgrid.pose.drive import DRIVING_MPS, DriveEstimate
from fieldgrid.pose.table import PoseTable
from fieldgrid.quality import Quality
from fieldgrid.rig import Rig, VehicleGeometry
from fieldgrid.smoother import Constant

FAR_M = 1.0
"""A fault that is denied only from an error of so much on is not seen."""

FIXED_NEAR_S = 60.0
"""A float solution so near in time to a fixed one is hardly worse than it states."""

_CLEARLY, _LEAST_SHARE = 1.5, 0.05
"""Fixes that count as so many times less sure than stated are reported, where they are so many."""


class UnseenFault(StrEnum):
    """A fault that moves poses, as the report names it."""

    ANTENNA_ASIDE = "antenna aside"
    ANTENNA_AHEAD = "antenna ahead"
    LATE_STAMPS = "late stamps"
    SLOW_DRIFT = "slow drift"


_WORDS = {
    UnseenFault.ANTENNA_ASIDE: "an antenna that sits farther left or right than declared",
    UnseenFault.ANTENNA_AHEAD: "an antenna that sits farther ahead or back than declared",
    UnseenFault.LATE_STAMPS: "fixes that are stamped late",
    UnseenFault.SLOW_DRIFT: "a receiver that drifts slowly by more than it states",
}


def unseen_faults(drive: DriveEstimate, vehicle: VehicleGeometry | None) -> tuple[UnseenFault, ...]:
    """The faults that this drive would not show, of a vehicle as it was declared.

    Of a log alone positions are those of its antenna in its own clock, so that neither can be
    wrong; and where nobody says where the axle is, no place ahead of it is either.
    """
    told, placed = drive.smoothed.declared, isinstance(vehicle, Rig)
    turns, speed = sees_turns(drive), sees_speed(drive)
    turned = turns or (names_axle(vehicle) and drive.headings_recorded)
    moving = np.abs(drive.speed_mps)[np.abs(drive.speed_mps) > DRIVING_MPS]
    usual_mps = float(np.median(moving)) if len(moving) else 0.0
    hidden = {
        UnseenFault.ANTENNA_ASIDE: placed and not (turned and speed and _is_told(told.right_m)),
        UnseenFault.ANTENNA_AHEAD: placed
        and names_axle(vehicle)
        and not (turned and _is_told(told.ahead_m)),
        # Only turns show stamps that are late beside a gyro's or a camera's: what moves the antenna
        # ahead shows there, too.
        UnseenFault.LATE_STAMPS: placed
        and not (turns and _is_told(told.ahead_m) and _is_told(told.late_s, usual_mps)),
        UnseenFault.SLOW_DRIFT: not len(drive.measured.step),
    }
    return tuple(fault for fault, unseen in hidden.items() if unseen)


def _is_told(one: Constant, per_unit_m: float = 1.0) -> bool:
    """Whether a drive denies what is off by less than :data:`FAR_M`."""
    return CLEAR_SIGMAS * one.sigma * per_unit_m < FAR_M


def unseen_sentence(faults: Sequence[UnseenFault]) -> str:
    """What the faults that a drive would not show mean for its sigmas, for people."""
    *others, last = (_WORDS[fault] for fault in faults)
    named = f"{', '.join(others)} or {last}" if others else last
    return f"This drive would not show {named}; no sigma covers that."


def unsure_receiver(table: PoseTable, fixes: AcceptedFixes) -> PoseTable:
    """The same poses, their positions as unsure as if the receiver had stated at least
    :func:`~fieldgrid.fixes.least_sigma_m`. Neighbours share it.

    Float positions near fixed ones are believed: those vouch for them.
    """
    last = np.searchsorted(fixes.time_ns, table.time_ns, side="right") - 1
    times = np.maximum(_least_m(fixes) / fixes.sigma_m, 1.0)[np.maximum(last, 0)]
    return table._replace(position_sigma_m=table.position_sigma_m * times)


def unsure_notes(fixes: AcceptedFixes) -> Iterator[str]:
    """What the report says of fixes that :func:`unsure_receiver` makes much less sure."""
    least_m = _least_m(fixes)
    raised = least_m > _CLEARLY * fixes.sigma_m
    for quality in map(Quality, np.unique(fixes.quality[raised])):
        these = raised & (fixes.quality == quality)
        if np.mean(these) >= _LEAST_SHARE:
            stated_m, counts_m = np.median([fixes.sigma_m[these], least_m[these]], axis=1)
            yield (
                f"{int(these.sum())} {quality.label} fixes state {stated_m:.2f} m in the median "
                f"and count as {counts_m:.2f} m, since a receiver's own figure does not contain "
                "its slow errors. If yours is known to be surer, as with PPP, give --accuracy "
                "METRES."
            )


def _least_m(fixes: AcceptedFixes) -> Float64:
    vouched = (fixes.quality == Quality.RTK_FLOAT) & _near_fixed(fixes)
    return np.where(vouched, 0.0, least_sigma_m(fixes.quality))


def _near_fixed(fixes: AcceptedFixes) -> Bool:
    """Which fixes [n] come within :data:`FIXED_NEAR_S` of a fixed solution."""
    fixed_ns = fixes.time_ns[fixes.quality == Quality.RTK_FIXED]
    near_ns = round(FIXED_NEAR_S * 1e9)
    first = np.searchsorted(fixed_ns, fixes.time_ns - near_ns)
    stop = np.searchsorted(fixed_ns, fixes.time_ns + near_ns, side="right")
    return np.asarray(stop > first)
