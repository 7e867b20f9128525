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

from fieldgrid.core import Figure, Finding, Float64, Int64, Quality, info
from fieldgrid.geometry import Rig, VehicleGeometry, least_sigma_m, position_sigma_m
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import names_axle
from fieldgrid.poses.drive import DRIVING_MPS, DriveEstimate
from fieldgrid.poses.faults.denied import CLEAR_SIGMAS, FAR_M
from fieldgrid.poses.sigmas import AddedSigma
from fieldgrid.poses.smoother.declared import AHEAD, ASIDE, IMAGES, LATE, Constant

FIXED_NEAR_S = 60.0
"""A float solution so near in time to a fixed one is hardly worse than it states."""

_CLEARLY, _VISIBLY_M, _LEAST_SHARE = 1.5, 0.02, 0.05
"""Fixes whose sigmas are larger than stated by this factor and this distance are reported where
they are at least this share. No map shows the half centimetre of RTK."""

_NEARLY_ALL = 0.95
"""What may be declared of all fixes is named where this share of them is of one quality."""


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


def unseen_faults(
    drive: DriveEstimate, vehicle: VehicleGeometry | None, *, smooth: bool
) -> tuple[UnseenFault, ...]:
    """The faults that this drive would not show, of a vehicle as it was declared.

    Of a log alone positions are those of its antenna in its own clock, so that neither can be
    wrong; and where nobody says where the axle is, no place ahead of it is either. Only a camera
    shows a slow drift, to headings that are `smooth`.
    """
    declared, placed = drive.smoothed.declared, isinstance(vehicle, Rig)
    aside_m = declared.off(ASIDE, AHEAD, LATE, IMAGES)
    ahead_m = declared.off(AHEAD, ASIDE, LATE, IMAGES)
    late_s = declared.off(LATE, ASIDE, AHEAD, IMAGES)
    turns, speed = drive.measured.sees_turns(), drive.measured.sees_speed()
    turned = turns or (names_axle(vehicle) and drive.headings_recorded)
    moving = np.abs(drive.speed_mps)[np.abs(drive.speed_mps) > DRIVING_MPS]
    usual_mps = float(np.median(moving)) if len(moving) else 0.0
    hidden = {
        UnseenFault.ANTENNA_ASIDE: placed and not (turned and speed and _is_told(aside_m)),
        UnseenFault.ANTENNA_AHEAD: placed
        and names_axle(vehicle)
        and not (turned and _is_told(ahead_m)),
        # Only turns show stamps that are late beside a gyro's or a camera's: what moves the antenna
        # ahead shows there, too.
        UnseenFault.LATE_STAMPS: placed
        and not drive.measured.one_clock
        and not (turns and _is_told(ahead_m) and _is_told(late_s, usual_mps)),
        UnseenFault.SLOW_DRIFT: not (smooth and declared.tells_drift(FAR_M)),
    }
    return tuple(fault for fault, unseen in hidden.items() if unseen)


def _is_told(one: Constant, per_unit_m: float = 1.0) -> bool:
    """Whether a drive denies what is off by less than :data:`FAR_M`."""
    return CLEAR_SIGMAS * one.sigma * per_unit_m < FAR_M


def unseen_findings(faults: Sequence[UnseenFault]) -> Iterator[Finding]:
    """What the faults that a drive would not show mean for its sigmas."""
    if faults:
        *others, last = (_WORDS[fault] for fault in faults)
        named = f"{', '.join(others)} or {last}" if others else last
        yield info("unseen", f"This drive would not show {named}; no sigma covers that.")


def receiver_doubt(time_ns: Int64, fixes: AcceptedFixes) -> AddedSigma:
    """What makes positions as unsure as if the receiver had stated at least `least_sigma_m`.
    Neighbours share it.

    The missing variance is added, and is linear in time from one fix to the next: in a gap the
    estimate passes from the error of one end to that of the other, and what it drifts itself is
    not the receiver's.
    """
    first_ns = fixes.time_ns[0]
    at_ns, fix_ns = time_ns - first_ns, fixes.time_ns - first_ns
    missing_m2 = np.maximum(_least_m(fixes) ** 2 - _believed_m(fixes) ** 2, 0.0)
    return AddedSigma(position_m=np.sqrt(np.interp(at_ns, fix_ns, missing_m2)))


def accuracy_findings(fixes: AcceptedFixes) -> Iterator[Finding]:
    """That fixes count as much less sure than stated."""
    least_m, believed_m = _least_m(fixes), _believed_m(fixes)
    raised = (least_m > _CLEARLY * believed_m) & (least_m > believed_m + _VISIBLY_M)
    for quality in map(Quality, np.unique(fixes.quality[raised])):
        these = raised & (fixes.quality == quality)
        if np.mean(these) < _LEAST_SHARE:
            continue
        stated_m, counts_m = np.median([fixes.stated_m[these], least_m[these]], axis=1)
        # A declared accuracy is that of all fixes: it would spoil the others of a mixed log.
        alone = np.mean(fixes.quality == quality) >= _NEARLY_ALL
        yield info(
            "accuracy",
            "A receiver's own figure does not contain its slow errors: "
            f"{int(these.sum())} {quality.label} fixes state {stated_m:.3g} m in the median and "
            f"count as {counts_m:.3g} m.",
            "If yours is known to be surer, as with PPP, give --accuracy METRES." if alone else "",
            Figure(float(counts_m), "m"),
        )


def _believed_m(fixes: AcceptedFixes) -> Float64:
    """What the receiver states, as far as it is believed. What seams and few digits add to it are
    other errors."""
    return position_sigma_m(fixes.quality, fixes.stated_m)


def _least_m(fixes: AcceptedFixes) -> Float64:
    """The least error along one axis, metres [n]. Float positions near fixed ones are believed:
    those vouch for them."""
    # Which fixes [n] come within :data:`FIXED_NEAR_S` of a fixed solution.
    fixed_ns = fixes.time_ns[fixes.quality == Quality.RTK_FIXED]
    near_ns = round(FIXED_NEAR_S * 1e9)
    first = np.searchsorted(fixed_ns, fixes.time_ns - near_ns)
    stop = np.searchsorted(fixed_ns, fixes.time_ns + near_ns, side="right")
    vouched = (fixes.quality == Quality.RTK_FLOAT) & (stop > first)
    return np.where(vouched, 0.0, least_sigma_m(fixes.quality))
