"""A gyro that was left out because it does not turn as the path does, and is right once the antenna
or the stamps are put right.

An antenna far ahead of the axle or behind it swings out in each turn, so that its path turns by
half as much as the vehicle, or the other way; late stamps shift turns to where there are none. A
gyro whose axes or unit are wrong fits nothing that is put right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Gyro, VehicleGeometry, wrap_deg
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.denied import DriveContradiction
from fieldgrid.poses.faults.explained import MOST_LEFT, UNTOLD, Correction, Explanation, explanation
from fieldgrid.poses.faults.gyro.check import MOST_SCALE, apart_deg
from fieldgrid.poses.fused import Fusion

MOST_NODES = 3_000
"""Of a longer drive the part that turns most is tried first, since there are up to 16 estimates."""

FAR_OFF, MORE_FAR_OFF = 5.0, 0.01
"""A fix that lies beside the drive by this multiple of its noise does not fit it. With a gyro that
is right no larger share of them does than without it, and with one that is wrong 0.03 to 0.9 more:
it fits a drive that leaves the fixes."""

LEFT_SHARE = 0.25
"""Largest share that is left of what the gyro contradicted."""


class GyroExcuse(NamedTuple):
    """What such a gyro denies of antenna and stamps, and how far headings by it, with these put
    right, are from those without it at the nodes of the drive [n]."""

    denied: DriveContradiction
    time_ns: Int64
    unsure_deg: Float64


def excused(found: Fusion, vehicle: VehicleGeometry | None) -> GyroExcuse | None:
    """What excuses the gyro that the drive was estimated without; None where nothing does. A
    camera shows by itself what was declared wrongly."""
    drive, gyro = found.drive, found.gyro
    if gyro is None or drive.at.has_gyro() or found.has_camera():
        return None
    part = _most_turning(found)
    if _is_of_other_size(part, gyro):
        return None
    tried = _fitting(part, gyro, vehicle, (0.0, 0.0))
    if tried is not None and part is not found:
        place, delay = (one.value.value if one.drive is not None else None for one in tried)
        tried = _fitting(found, gyro, vehicle, (place, delay))
    if tried is None:
        return None
    either = ((tried.is_place, tried.place), (tried.is_late, tried.delay))
    fitting = [one.drive for may_be, one in either if may_be and one.drive is not None]
    unsure_deg = np.max([apart_deg(drive, one) for one in fitting], axis=0)
    denied = tried.denies(drive, vehicle)._replace(gyro_unused=True)
    return GyroExcuse(denied, drive.time_ns, unsure_deg)


def _most_turning(found: Fusion) -> Fusion:
    """The part of a drive in which it turns most, or all of a short one."""
    drive, log = found.drive, found.log
    at_fix = np.flatnonzero(drive.fix >= 0)
    count = max(len(at_fix) * MOST_NODES // len(drive.time_ns), 2)
    if count >= len(at_fix):
        return found
    turned_deg = np.abs(wrap_deg(np.diff(drive.heading_deg[at_fix])))
    in_all = np.concatenate([[0.0], np.cumsum(turned_deg)])
    first = int(np.argmax(in_all[count - 1 :] - in_all[: len(in_all) - count + 1]))
    accepted = log.accepted.part(np.arange(first, first + count))
    within = (log.fixes.time_ns >= accepted.time_ns[0]) & (
        log.fixes.time_ns <= accepted.time_ns[-1]
    )
    return found.again(log=log._replace(fixes=log.fixes[within], accepted=accepted))


def _is_of_other_size(without: Fusion, gyro: Gyro) -> bool:
    """Whether a gyro fits once it turns by as much as the drive has it: then its axes or its unit
    are wrong, and nothing else."""
    beside = without.again(motion=without.motion._replace(gyro=gyro), as_stated=True)
    smoothed = beside.drive.smoothed
    wrong = smoothed.gyro_scale is not None and abs(smoothed.gyro_scale.value) > MOST_SCALE
    return wrong and smoothed.declared.misfit() < MOST_LEFT


def _fitting(
    without: Fusion,
    gyro: Gyro,
    vehicle: VehicleGeometry | None,
    start: tuple[float | None, float | None],
) -> Explanation | None:
    """What explains the gyro, of place and stamps that the fixes fit as well as the drive without
    it, from where they start."""
    beside = without.again(motion=without.motion._replace(gyro=gyro), as_stated=True)
    if not beside.drive.measured.sees_turns():
        return None
    tried = explanation(beside, vehicle, *start)
    if tried is None:
        return None
    noise_m = without.log.accepted.noise.across_m
    most_far_off = _far_off(without.drive, noise_m) + MORE_FAR_OFF

    def fits(one: Correction) -> bool:
        return (
            one.drive is not None and one.is_clear and _far_off(one.drive, noise_m) <= most_far_off
        )

    told = Explanation(*(one if fits(one) else UNTOLD for one in tried))
    most_left = max(MOST_LEFT, LEFT_SHARE * beside.drive.smoothed.declared.misfit())
    return told if told.left <= most_left else None


def _far_off(drive: DriveEstimate, noise_m: Float64) -> float:
    """The share of the fixes that do not fit a drive."""
    off_m = np.abs(drive.smoothed.fix_off_m[drive.fix >= 0])
    return float(np.mean((off_m > FAR_OFF * noise_m[:, None]).any(axis=1)))
