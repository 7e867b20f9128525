"""One batch estimate of everything that was measured, after what each sensor says of the others.

A batch estimate is made first, and again whenever it shows that a fix, the gyro, the axle or the
attitude is not what was assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Bool, Finding, Float64, Int64, PoseSettings, warning
from fieldgrid.geometry import (
    Datum,
    FixColumns,
    Gyro,
    Motion,
    VehicleGeometry,
    nose_heading_deg,
)
from fieldgrid.poses.accepted import accepted_fixes, datum_of
from fieldgrid.poses.attitude.axes import AxisTilt, axes_of_fixes
from fieldgrid.poses.axle import (
    Axle,
    axle_of,
    axle_told,
    names_axle,
    ways_of,
    with_antenna_moved,
)
from fieldgrid.poses.drive import DriveEstimate, smooth_drive
from fieldgrid.poses.faults.convention import Comparison, compare, turned_around
from fieldgrid.poses.faults.gyro.check import GyroVerdict, with_trusted_gyro, without_wrong_gyro
from fieldgrid.poses.faults.gyro.dead_gyro import without_dead_gyro, without_faulty_samples
from fieldgrid.poses.faults.stray import MOST_ROUNDS, stray_fixes
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.single import check_single
from fieldgrid.poses.levelled import (
    Lean,
    find_lean,
    levelled_fixes,
    levelled_motion,
    tells_attitude,
)
from fieldgrid.poses.measured import turn_back, wheel_speed_at
from fieldgrid.poses.settled import settled
from fieldgrid.poses.smoother.declared import AHEAD, IMAGES, LATE, LIKELY, Constant
from fieldgrid.poses.table import ConditionedLog
from fieldgrid.poses.travel_direction import travel

FEWEST_STEPS = 8
"""So many steps of the camera tell the sense of the wheels."""

BACKING_SHARE, LEAST_WAY_M = 0.8, 50.0
"""Wheels whose sign is turned round go the other way than the camera in this share; without one,
hardly any vehicle backs up over this share of a drive of at least this length."""


def _with_right_wheels(
    drive: DriveEstimate, motion: Motion, estimated: Callable[[Motion], DriveEstimate]
) -> tuple[DriveEstimate, Motion, Finding | None]:
    """The drive and its motion with the sign of the wheels as the camera has it, or as the drive is
    likelier; and a finding where it was turned round, or nothing tells."""
    wheels, steps = motion.wheels, motion.steps
    if wheels is None or not turn_back(wheels):
        return drive, motion, None
    way_m = wheels.speed_mps[:-1] * np.diff(wheels.time_ns) / 1e9
    why, by_camera = "By its wheels the vehicle backs up over {:.0f} of {:.0f} m", False
    if steps is not None:
        beside = wheel_speed_at((steps.start_ns + steps.stop_ns) // 2, wheels) * steps.forward_m
        by_camera = bool(np.isfinite(beside).sum() >= FEWEST_STEPS)
    if by_camera:
        why, way_m = "The wheels go the other way than the camera", beside
    whole_m, back_m = float(np.nansum(np.abs(way_m))), float(-np.nansum(np.minimum(way_m, 0.0)))
    if back_m <= BACKING_SHARE * whole_m or not (by_camera or whole_m > LEAST_WAY_M):
        return drive, motion, None
    turned = motion._replace(wheels=wheels._replace(speed_mps=-wheels.speed_mps))
    other = estimated(turned)
    nats, clear = other.smoothed.nats - drive.smoothed.nats, np.log(LIKELY / (1.0 - LIKELY))
    if nats < -clear and not by_camera:
        return drive, motion, None
    end = ". If that is wrong, their sign is turned round, and headings with it."
    if by_camera or nats > clear:
        drive, motion, end = other, turned, ": the sign of their speed was turned round."
    told = f"{why.format(back_m, whole_m)}{end}"
    return drive, motion, warning("wheels-turned", told, "Correct it where it is recorded.")


class Fusion(NamedTuple):
    """A drive, and what it was estimated from: fixes and motion, of a vehicle that stands level
    where `lean` tells its attitude; its axle, and the gears that are known. `gyro` is the one that
    was recorded, used or not, `trusted` what became of it, and `gyro_finding` says why it was
    changed or left out. `findings` say which other sensors were changed or left out.
    `unleapt` is the drive as if its fixes did not leap, which a clock that is set looks like."""

    log: ConditionedLog
    drive: DriveEstimate
    motion: Motion
    axle: Axle
    hints: PoseSettings
    gyro: Gyro | None
    trusted: GyroVerdict
    lean: Lean | None = None
    gyro_finding: Finding | None = None
    findings: tuple[Finding, ...] = ()
    unleapt: DriveEstimate | None = None

    def again(self, *, as_stated: bool = False, **changes: Any) -> Fusion:
        """The drive estimated again, with other fixes, motion or axle, and with the slow error of
        its fixes learnt or `as_stated`."""
        new = self._replace(**changes)
        drive = smooth_drive(
            *(new.log.accepted, new.log.fixes.time_ns, new.motion, new.axle),
            hints=new.hints,
            as_stated=as_stated,
            near=self.drive,
        )
        return new._replace(drive=drive)

    def has_camera(self) -> bool:
        """Whether a camera saw the vehicle move."""
        return self.motion.steps is not None and len(self.motion.steps.start_ns) > 0

    def recorded_deg(self) -> Float64:
        """Headings of the nose that were recorded with the accepted fixes, by what is declared,
        degrees [fixes], NaN where there is none."""
        recorded, rig = self.log.accepted.recorded_deg, self.axle.vehicle
        return recorded if rig is None else nose_heading_deg(rig, recorded)

    def compared(self) -> Comparison | None:
        """Recorded headings beside those of the drive; None where too little is sure."""
        return compare(*self._headings(), self.drive.gear[self.drive.fix >= 0])

    def turned_around(self, found: Comparison) -> Bool:
        """At which accepted fixes the recorded heading is the other way round than it was found
        to be."""
        return turned_around(found, *self._headings())

    def _headings(self) -> tuple[Float64, Float64, Float64]:
        """Recorded headings, those of the drive, and the sigmas of these, [fixes]."""
        drive = self.drive
        at = drive.fix >= 0
        # Nodes stand in the order of the accepted fixes. An unsure axle, which shifts headings one
        # way in left and the other way in right turns, hides no convention.
        sigma_deg = np.degrees(drive.smoothed.heading_sigma_rad[at])
        return self.recorded_deg(), drive.heading_deg[at], sigma_deg


def fuse(
    log: ConditionedLog,
    rig: VehicleGeometry | None,
    motion: Motion,
    settings: PoseSettings,
    frame_ns: Int64 | None,
) -> Fusion:
    """One estimate of a drive from its fixes and all that its sensors say of its motion.

    A first estimate shows which fixes are strays, whether the gyro fits, where the axle is and how
    the vehicle leans (best at `frame_ns`); whatever was assumed otherwise is estimated again.
    """
    motion, faulty_gyro = without_faulty_samples(motion)
    motion, dead_gyro = without_dead_gyro(log.accepted, motion)
    gyro = motion.gyro
    motion, wrong_gyro = without_wrong_gyro(log.accepted, motion)
    axle = axle_of(rig)
    smoothed = partial(smooth_drive, log.accepted, log.fixes.time_ns, axle=axle, hints=settings)
    drive, motion, turned_wheels = _with_right_wheels(smoothed(motion), motion, smoothed)
    # Fixes that leave the drive at once and come back.
    strays: dict[int, str] = {}
    for _ in range(MOST_ROUNDS):
        if not (more := stray_fixes(drive, log)):
            break
        strays |= more
        verdicts = condition(log.fixes, settings.gnss, strays)
        accepted = accepted_fixes(log.fixes, verdicts, log.datum)
        log = log._replace(verdicts=verdicts, accepted=accepted)
        drive = smooth_drive(log.accepted, log.fixes.time_ns, motion, axle, hints=settings)
    # A gyro that contradicts the drive; of one that fits, where an undeclared axle is.
    trusted = _with_trusted_gyro(drive, log, motion, axle, settings, frame_ns)
    findings = (faulty_gyro, dead_gyro, turned_wheels)
    found = Fusion(
        *(log, trusted.drive, trusted.motion, axle, settings, gyro, trusted),
        gyro_finding=wrong_gyro or trusted.finding,
        findings=tuple(one for one in findings if one is not None),
    )
    if found.drive.measured.sees_turns() and not names_axle(rig):
        found = _with_axle(found)
    # The same of a vehicle that stands level, once its headings have told how it leans.
    rig = found.axle.vehicle
    axes = _stated_axes(found, settings)
    lean, unused = find_lean(log.accepted, found.drive, found.motion, rig, frame_ns, axes)
    found = found._replace(findings=(*found.findings, *unused))
    if lean is not None:
        level = log._replace(accepted=levelled_fixes(log.accepted, lean))
        found = found.again(log=level, motion=levelled_motion(found.motion, lean), lean=lean)
    # A solution that goes on elsewhere.
    if found.drive.leaps:
        found = found._replace(unleapt=found.drive)
        unsure = accepted_fixes(log.fixes, log.verdicts, log.datum, found.drive.leaps)
        if lean is not None:
            unsure = levelled_fixes(unsure, lean)
        found = found.again(log=log._replace(accepted=unsure))
    return found


def _with_axle(found: Fusion) -> Fusion:
    """The drive with the axle where it shows it: from where the camera has it, if that is
    likelier."""

    def moved(ahead_m: float) -> DriveEstimate:
        axle = with_antenna_moved(found.axle, ahead_m)
        return found.again(axle=axle, as_stated=True).drive

    begun, start_m, steps = found.drive, 0.0, found.motion.steps
    by_camera = None if steps is None else travel(ways_of(steps)).ahead_m
    if by_camera is not None:
        there = moved(by_camera.value)
        if there.smoothed.nats > begun.smoothed.nats:
            begun, start_m = there, by_camera.value
    ahead_m, drive = settled(begun, moved, lambda one: one.off(AHEAD), start_m)
    if start_m and by_camera is not None and by_camera.sigma < ahead_m.sigma:
        ahead_m, drive = Constant(*by_camera), begun
    # Clocks that differ look like a place, and what contradicts it even there is something else.
    declared = drive.smoothed.declared
    late = steps is not None and declared.probability(LATE, IMAGES) > 1.0 - LIKELY
    if late or declared.contradicts:
        return found
    told = axle_told(found.axle, ahead_m)
    return found if told is found.axle else found.again(axle=told)


def _with_trusted_gyro(
    drive: DriveEstimate,
    log: ConditionedLog,
    motion: Motion,
    axle: Axle,
    hints: PoseSettings,
    frame_ns: Int64 | None,
) -> GyroVerdict:
    """The drive with a gyro that fits. On hills antenna and gyro lean with the vehicle, so that
    good ones do not fit each other: what seems wrong counts only if it does on a vehicle that is
    levelled by this very IMU, too."""
    at_ns = log.fixes.time_ns
    trusted = with_trusted_gyro(drive, log.accepted, at_ns, motion, axle, hints)
    if trusted.finding is None or not tells_attitude(motion, at_ns):
        return trusted
    lean, findings = find_lean(log.accepted, drive, motion, axle.vehicle, frame_ns)
    if lean is None and trusted.motion.inertial is None:
        # Nothing looks at this IMU again.
        why = [str(one) for one in findings if one.code == "accelerometer-unused"]
        remedy = " ".join([trusted.finding.remedy, *why])
        return trusted._replace(finding=replace(trusted.finding, remedy=remedy))
    if lean is None:
        return trusted
    fixes, level = levelled_fixes(log.accepted, lean), levelled_motion(motion, lean)
    again = smooth_drive(fixes, at_ns, level, axle, hints=hints)
    if with_trusted_gyro(again, fixes, at_ns, level, axle, hints).finding is not None:
        return trusted
    return GyroVerdict(again, motion, np.zeros(len(again.time_ns)))


def _stated_axes(found: Fusion, settings: PoseSettings) -> tuple[AxisTilt, ...]:
    """The axes whose rise the receiver states beside its heading. Where they point is what the
    heading shows: none, where it is none of the vehicle or was not compared with the drive."""
    heading = found.compared()
    if (
        heading is None
        or heading.course
        or heading.flips
        or heading.scatters
        or heading.is_denied(settings.max_heading_offset_deg)
    ):
        return ()
    rig = found.axle.vehicle
    declared_deg = (rig and rig.heading_offset_deg) or 0.0
    used = found.log.fixes[found.log.verdicts.ok]
    return axes_of_fixes(used, declared_deg + heading.offset_deg)


def conditioned(
    fixes: FixColumns, settings: PoseSettings, datum: Datum | None = None
) -> ConditionedLog:
    """Fixes in order of time with what the settings declare of them, judged, and the accepted
    ones in the plane. Raises GnssError when none can be used, or they are of two logs."""
    check_single(fixes)
    fixes = fixes.in_order()
    if settings.quality is not None:
        fixes = fixes.replace(quality=np.full(len(fixes), settings.quality, dtype=np.int64))
    if settings.accuracy_m is not None:
        fixes = fixes.replace(sigma_m=np.full(len(fixes), settings.accuracy_m))
    verdicts = condition(fixes, settings.gnss)
    datum = datum or datum_of(fixes, verdicts)
    accepted = accepted_fixes(fixes, verdicts, datum)
    return ConditionedLog(fixes, verdicts, datum, accepted)
