"""From a vehicle that leans to one that stands level, and back.

The batch estimate is one of the plane: it takes the vehicle for level. So what leans with the
vehicle is carried to where it would be if the vehicle stood level on its axle's place on the
ground: the antenna of each fix, the camera's way, the gyro's axis, the wheels' speed. With the
same attitude the pose's point is carried back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, Int64, warning
from fieldgrid.geometry import (
    Gyro,
    Inertial,
    Motion,
    R_enu_level,
    R_level_vehicle,
    Rig,
    Steps,
    Trajectory,
    VehicleGeometry,
    heading_rad,
)
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.attitude.attitude import Attitude
from fieldgrid.poses.attitude.axes import ANTENNAS, AxisTilt, axes_of_tilt
from fieldgrid.poses.attitude.estimate import estimate_attitude
from fieldgrid.poses.attitude.track import AntennaTrack, KnownHeadings
from fieldgrid.poses.axle import axle_forward_m
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.sigmas import AddedSigma

SUSPECT_PUSH_MISFIT, MOST_PUSH_MISFIT = 0.45, 8.0
"""An accelerometer that is this number of sigmas from the motion of the fixes may be mounted
sideways, where it is at 0.3 to 12; good ones are at 0.1 to 0.4, on real vehicles at up to 1.7, with
shocks at up to 7. From the second on it contradicts them anyhow."""

MOST_TRIED = 1000
"""As many fixes tell how an IMU is mounted."""

TWICE, CLEARLY, FITTING = 0.5, 0.75, 0.6
"""An IMU is mounted as it fits best, where it fits twice as well there, or fits clearly better and
is then no more than this number of sigmas off."""


class Lean(NamedTuple):
    """How a vehicle leans over a drive, and its points, [3] metres right, forward, up of the ground
    below the sensor: the `antenna_m`, the middle of the `axle_m` on the ground, the `sensor_m`.
    Without an IMU that fits the drive it is not `by_imu`."""

    attitude: Attitude
    antenna_m: Float64
    axle_m: Float64
    sensor_m: Float64
    by_imu: bool

    def shift_m(
        self, time_ns: Int64, point_m: Float64, heading_deg: Float64 | None = None
    ) -> Float64:
        """How far the lean moves a point east, north and up [n, 3], seen from the axle."""
        at = self.attitude.at(time_ns)
        heading = at.heading_deg if heading_deg is None else np.nan_to_num(heading_deg)
        moved = R_level_vehicle(at.roll_deg, at.pitch_deg) - np.eye(3)
        return np.asarray(R_enu_level(heading) @ moved @ (point_m - self.axle_m))


def tells_attitude(motion: Motion, fix_ns: Int64) -> bool:
    """Whether a drive says how its vehicle leans, whatever its camera sees: an accelerometer over
    most of what its IMU logged, or recorded angles at most of the fixes."""
    return _feels_force(motion) or any(axis.is_known(fix_ns) for axis in _axes_of(motion))


def levelling_attitude(attitude: Attitude | None) -> Attitude | None:
    """The attitude by which local grids are made level, before their images are read; None where
    nothing but the camera or antennas tells it, or the drive denies what does."""
    by_imu = attitude is not None and not math.isnan(attitude.push_misfit)
    return attitude if by_imu or (attitude and attitude.bodies - {ANTENNAS}) else None


def _feels_force(motion: Motion) -> bool:
    return motion.inertial is not None and motion.inertial.feels_force()


def _axes_of(motion: Motion) -> Iterator[AxisTilt]:
    for said in (motion.tilt, motion.orientation):
        if said is not None:
            yield from axes_of_tilt(said)


def track_m(fixes: AcceptedFixes) -> Float64:
    """Accepted fixes east, north and up, [n, 3]."""
    return np.stack([fixes.east_m, fixes.north_m, fixes.up_m], axis=1)


def find_lean(
    fixes: AcceptedFixes,
    drive: DriveEstimate,
    motion: Motion,
    rig: VehicleGeometry | None,
    frame_ns: Int64 | None,
    stated: Sequence[AxisTilt] = (),
) -> tuple[Lean | None, tuple[Finding, ...]]:
    """The lean of a drive whose heading is known, None where nothing tells it, and findings on what
    was not used for it. `stated` are the axes whose rise the receiver states."""
    if not isinstance(rig, Rig) or len(fixes.time_ns) < 2:
        return None, ()
    recorded = (*_axes_of(motion), *stated)
    axes = [axis for axis in recorded if axis.is_known(fixes.time_ns)]
    few = {axis.body for axis in recorded} - {axis.body for axis in axes}
    findings = [
        warning(
            "tilt-unused",
            f"Roll and pitch by the {body} are recorded at less than half of the fixes, and were "
            "not used.",
        )
        for body in sorted(few)
    ]
    seen = motion.steps is not None and bool(np.isfinite(motion.steps.up_m).any())
    if not (seen or axes or _feels_force(motion)):
        return None, tuple(findings)
    # Headings of all nodes: in a hole of the fixes gyro or camera saw how the vehicle turned.
    heading_deg = np.degrees(drive.smoothed.state[:, 2])
    track = AntennaTrack(
        fixes.time_ns,
        track_m(fixes),
        np.outer(fixes.noise.across_m, [1.0, 1.0, 2.0]),
        fixes.sigma_m,
        KnownHeadings(drive.time_ns, heading_deg, drive.heading_sigma_deg),
    )
    antenna, sensor_m = rig.antenna, np.array([0.0, 0.0, rig.mount.height_m])
    antenna_m = np.array([antenna.right_m, antenna.forward_m, antenna.up_m])
    said, sensed = (track, antenna_m - sensor_m, frame_ns, motion.steps, axes), motion.inertial
    attitude = estimate_attitude(*said, sensed=sensed)
    if sensed is not None and (denial := _imu_denial(*said[:2], sensed, attitude.push_misfit)):
        findings.append(denial)
        attitude, sensed = estimate_attitude(*said), None
    elif not math.isnan(attitude.push_misfit):
        attitude = attitude.if_late(drive.smoothed.declared.unsure_late_s)
    findings += attitude.findings
    if not (seen or attitude.bodies or (sensed is not None and sensed.feels_force())):
        return None, tuple(findings)
    axle_m = np.array([0.0, axle_forward_m(rig), 0.0])
    return Lean(attitude, antenna_m, axle_m, sensor_m, sensed is not None), tuple(findings)


def _imu_denial(
    track: AntennaTrack, antenna_m: Float64, sensed: Inertial, misfit: float
) -> Finding | None:
    """What is wrong with an IMU that contradicts the fixes, and what to do; None if nothing is."""
    if not misfit > SUSPECT_PUSH_MISFIT:
        return None
    # As it fits turned to the left by so much.
    brief = track._replace(
        time_ns=track.time_ns[:MOST_TRIED],
        enu_m=track.enu_m[:MOST_TRIED],
        noise_m=track.noise_m[:MOST_TRIED],
        wander_m=track.wander_m[:MOST_TRIED],
    )
    fits = {
        left_deg: estimate_attitude(brief, antenna_m, sensed=_turned(sensed, left_deg)).push_misfit
        for left_deg in range(0, 360, 45)
    }
    left_deg = min(fits, key=lambda deg: fits[deg])
    if fits[left_deg] < max(TWICE * fits[0], min(CLEARLY * fits[0], FITTING)):
        side = "left" if left_deg < 180 else "right"
        remedy = f"It fits turned by about {min(left_deg, 360 - left_deg)}° to the {side}: "
        axes = f"correct imu_axes, from flu to {('flu', 'lbu', 'bru', 'rfu')[left_deg // 90]}"
        remedy += "mount it square to the vehicle" if left_deg % 90 else axes
    elif misfit > MOST_PUSH_MISFIT:
        remedy = "Check imu_axes, and the stamps of the IMU"
    else:
        return None
    return warning(
        "accelerometer-unused",
        f"The accelerometer contradicts the motion of the fixes by {misfit:.1f} sigmas and was not "
        "used for roll and pitch.",
        f"{remedy}.",
        Figure(misfit, "sigmas"),
    )


def _turned(sensed: Inertial, left_deg: float) -> Inertial:
    """What an IMU measured, in the vehicle's axes if it is turned to the left in it."""
    R_imu_vehicle = R_enu_level(-left_deg).T.astype(sensed.rate_rad_s.dtype)
    return Inertial(
        sensed.time_ns, sensed.rate_rad_s @ R_imu_vehicle, sensed.force_mps2 @ R_imu_vehicle
    )


def levelled_fixes(fixes: AcceptedFixes, lean: Lean) -> AcceptedFixes:
    """The antenna where it would be on a level vehicle."""
    east_m, north_m, up_m = (track_m(fixes) - lean.shift_m(fixes.time_ns, lean.antenna_m)).T
    return fixes._replace(east_m=east_m, north_m=north_m, up_m=up_m)


def levelled_motion(motion: Motion, lean: Lean) -> Motion:
    """Gyro, wheels and camera as on a level vehicle."""
    sensed, gyro, wheels, steps = motion.inertial, motion.gyro, motion.wheels, motion.steps
    if sensed is not None and lean.by_imu:
        at = lean.attitude.at(sensed.time_ns)
        roll, pitch = np.radians(at.roll_deg), np.radians(at.pitch_deg)
        right, _, up = sensed.rate_rad_s.astype(np.float64).T
        gyro = Gyro(sensed.time_ns, (np.sin(roll) * right - np.cos(roll) * up) / np.cos(pitch))
    if wheels is not None:
        pitch = np.radians(lean.attitude.at(wheels.time_ns).pitch_deg)
        wheels = wheels._replace(speed_mps=wheels.speed_mps * np.cos(pitch))
    return motion._replace(
        gyro=gyro, wheels=wheels, steps=None if steps is None else _levelled_steps(steps, lean)
    )


def _levelled_steps(steps: Steps, lean: Lean) -> Steps:
    """The camera's steps seen from above; those that do not tell how they rose stay as they are."""
    known = np.isfinite(steps.up_m)
    start, stop = (lean.attitude.at(ends) for ends in (steps.start_ns, steps.stop_ns))
    R_start = R_level_vehicle(start.roll_deg, start.pitch_deg)
    R_stop = R_level_vehicle(stop.roll_deg, stop.pitch_deg)
    turned = R_enu_level(steps.turn_deg) @ R_level_vehicle(steps.roll_deg, steps.pitch_deg)
    turn_deg = np.degrees(heading_rad(R_start @ turned))
    way = np.stack([steps.right_m, steps.forward_m, steps.up_m], axis=1)
    arm = lean.sensor_m - lean.axle_m
    moved = np.einsum("nij,nj->ni", R_start, way) - (
        R_enu_level(turn_deg) @ (R_stop - np.eye(3)) @ arm - (R_start - np.eye(3)) @ arm
    )
    return steps._replace(
        right_m=np.where(known, moved[:, 0], steps.right_m),
        forward_m=np.where(known, moved[:, 1], steps.forward_m),
        turn_deg=np.where(known, turn_deg, steps.turn_deg),
    )


def leaning(trajectory: Trajectory, lean: Lean, *, level_grids: bool) -> Trajectory:
    """The poses of a levelled drive, as the vehicle leans.

    Of `level_grids` the origin lies vertically below the sensor; of others, which are square to the
    ground ahead, below the sensor along the vehicle's own axis.
    """
    point_m = lean.sensor_m if level_grids else np.zeros(3)
    time_ns = trajectory.time_ns
    east, north, _ = lean.shift_m(time_ns, point_m, trajectory.heading_deg).T
    return replace(
        trajectory,
        east_m=trajectory.east_m + east,
        north_m=trajectory.north_m + north,
        up_m=lean.attitude.at(time_ns).up_m - float(lean.sensor_m[2]),
    )


def lean_doubt(time_ns: Int64, lean: Lean, *, level_grids: bool) -> AddedSigma:
    """What an unsure lean of the antenna above the origin does to positions."""
    at = lean.attitude.at(time_ns)
    above_m = abs(float(lean.antenna_m[2]) - (float(lean.sensor_m[2]) if level_grids else 0.0))
    off_m = above_m * np.radians(np.maximum(at.roll_sigma_deg, at.pitch_sigma_deg))
    return AddedSigma(position_m=off_m, relative_m=off_m)
