"""How a sensor is mounted, by the drive alone: height, tilt, roll, and the yaw off the way."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Int64, MeasuredValue, RecordingError, mean_of
from fieldgrid.geometry import LeverArm, Mount, Rig, StereoCamera
from fieldgrid.perception import Refusal, RigidMotion, camera_motion
from fieldgrid.pipeline.mounting.frame_probe import FrameProbe, FrameSample
from fieldgrid.pipeline.mounting.gnss_check import GnssCheck, check_against_gnss, remarks
from fieldgrid.pipeline.mounting.ground_under_vehicle import MountSamples, ground_under_vehicle
from fieldgrid.pipeline.mounting.plane import SensorGround, median_plane
from fieldgrid.pipeline.mounting.selection import stretches, usual_every
from fieldgrid.pipeline.staging.perception import side_by_side
from fieldgrid.poses import LEAST_STEP_M, LEAST_WAY_M, MOST_TURN_DEG, Travel, Ways, travel
from fieldgrid.recordings import DriveOptions, Recording, open_drive

# Steps of the ground point below a sensor, from the visual odometry of the sensor.


def ground_steps(motions: Sequence[RigidMotion | None], plane: SensorGround) -> Ways:
    """The steps of the ground point, by the motions of the sensor and the plane it stands on.

    That point, and not the sensor, which sways by centimetres when the vehicle rolls.
    """
    R_level = plane.rotation()
    ground = -plane.height_m * plane.up
    rows = []
    for k, motion in enumerate(motions):
        if motion is None:
            continue
        R, t = motion
        right, forward, _ = (R_level @ (R.T @ (ground - t) - ground)).tolist()
        turned = R_level @ R.T @ R_level.T
        turn = math.atan2(float(turned[0, 1]), float(turned[1, 1]))
        distance_m = math.hypot(right, forward)
        gear = 1.0 if forward >= 0.0 else -1.0
        if distance_m < LEAST_STEP_M or abs(turn) > math.radians(MOST_TURN_DEG):
            continue
        direction = math.atan2(gear * right, gear * forward) - turn / 2.0
        rows.append((k + 1, gear * distance_m, direction, turn, gear * turn / distance_m))
    stop, forwards_m, directions, turns, curvatures = np.array(rows).reshape(-1, 5).T
    return Ways(
        stop.astype(np.int64), forwards_m, np.degrees(directions), np.degrees(turns), curvatures
    )


FEWEST_STANDS = 8
"""Number of frames under which the ground must have been seen; with fewer, the planes ahead are
used."""

FEWEST_PLANES = 3

TILT_FLOOR_DEG, ROLL_FLOOR_DEG = 0.06, 0.12
HEIGHT_FLOOR_M, HEIGHT_FLOOR_SHARE = 0.01, 0.006
"""What all frames share: calibration, stubble that is taken for ground, and for the roll that one
side of a lane is not like the other."""

AHEAD_ANGLE_DEG, AHEAD_HEIGHT_SHARE = 0.6, 0.02
"""What all frames share where only the ground ahead was seen: it is seldom the plane that the
vehicle is on."""

UNDER, AHEAD = "ground under the vehicle", "ground ahead"

HEIGHT, TILT = "camera_height_above_ground_m", "camera_tilt_down_deg"
ROLL, YAW, AXLE = "camera_roll_deg", "camera_yaw_deg", "camera_ahead_of_rear_axle_m"

DISAGREES = 3.0
"""Number of sigmas from which on a stated value disagrees with what was measured."""


class MountComparison(NamedTuple):
    """A value that was measured, and what the recording states for it."""

    key: str
    measured: MeasuredValue
    stated: float

    @property
    def sigmas(self) -> float:
        """How many sigmas the stated value is above the measured one."""
        return self.measured.off(self.stated)

    @property
    def disagrees(self) -> bool:
        """Whether that is more than chance."""
        return abs(self.sigmas) > DISAGREES

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "stated": self.stated,
            "difference": self.stated - self.measured.value,
            "sigmas": self.sigmas,
            "disagrees": self.disagrees,
        }


@dataclass(frozen=True, slots=True)
class MountEstimate:
    """How the sensor is mounted, each value with its 1-sigma error.

    `height_m` above the ground that the vehicle stands on; `tilt_deg` down, `roll_deg` positive
    when the right side is down, `yaw_deg` positive when the sensor looks to the right of where the
    vehicle goes; None when the drive does not tell. `axle_ahead_m` is how far the sensor is ahead
    of the axle that does not steer, None without turns. `method` is the ground that was measured.
    `mount_samples` are the frames' own values, `ways` the steps of the camera, `time_ns` the times
    of the `looked` frames, by the receiver's clock. `gnss` compares with the fixes, None without;
    `stated` is what the recording says of its rig itself, None when it does not.
    """

    name: str
    height_m: MeasuredValue
    tilt_deg: MeasuredValue
    roll_deg: MeasuredValue
    yaw_deg: MeasuredValue | None
    axle_ahead_m: MeasuredValue | None
    method: str
    frames: int
    looked: int
    steps: int
    forward_m: float
    reverse_m: float
    straight_m: float
    time_ns: Int64
    mount_samples: MountSamples
    ways: Ways
    gnss: GnssCheck | None
    stated: Rig | None
    notes: tuple[str, ...]

    @property
    def mount(self) -> Mount:
        """The mount; of a yaw that is not known, 0."""
        yaw_deg = 0.0 if self.yaw_deg is None else self.yaw_deg.value
        return Mount(self.height_m.value, self.tilt_deg.value, self.roll_deg.value, yaw_deg)

    def measured(self) -> dict[str, MeasuredValue | None]:
        """All that was measured, by the keys of a `mounting.json` as far as it has them."""
        return {
            HEIGHT: self.height_m,
            TILT: self.tilt_deg,
            ROLL: self.roll_deg,
            YAW: self.yaw_deg,
            AXLE: self.axle_ahead_m,
        }

    def compared(self) -> list[MountComparison]:
        """What was measured beside what the recording states; empty when it states nothing."""
        if self.stated is None:
            return []
        mount, axle_m = self.stated.mount, self.stated.rear_axle_forward_m
        stated = {
            HEIGHT: mount.height_m,
            TILT: mount.tilt_deg,
            ROLL: mount.roll_deg,
            YAW: mount.yaw_deg,
            AXLE: None if axle_m is None else -axle_m,
        }
        return [
            MountComparison(key, value, said)
            for key, value in self.measured().items()
            if value is not None and (said := stated[key]) is not None
        ]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is unknown is null."""
        return {
            "recording": self.name,
            **{
                key: None if value is None else value._asdict()
                for key, value in self.measured().items()
            },
            "method": self.method,
            "frames": self.frames,
            "frames_looked_at": self.looked,
            "frames_used": len(self.mount_samples.frame),
            "camera_steps": self.steps,
            "forward_m": self.forward_m,
            "reverse_m": self.reverse_m,
            "straight_m": self.straight_m,
            "gnss": None if self.gnss is None else self.gnss.as_dict(),
            "stated": (
                None if self.stated is None else {one.key: one.as_dict() for one in self.compared()}
            ),
            "notes": list(self.notes),
        }


def estimate_mount(
    recording: Recording | str | Path,
    options: DriveOptions | None = None,
    *,
    every: int | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MountEstimate:
    """Height, tilt, roll and yaw of a recording's sensor, by the drive alone.

    A path is opened with `options` as by `open_drive`; it needs no mounting. What
    the recording says of its mount does not enter, except where its unsteered axle is. Every
    `every`-th frame is looked at (None: frames about a metre apart), `jobs` at a time; `progress`
    is told how many of how many. Raises RecordingError when no ground is seen.
    """
    if isinstance(recording, str | Path):
        with open_drive(recording, replace(options or DriveOptions(), unmounted=True)) as drive:
            return estimate_mount(drive.recording(), every=every, jobs=jobs, progress=progress)
    found = measure_mount(recording, every, jobs, progress)
    check = check_against_gnss(recording, found.time_ns, found.ways, found.mount.yaw_deg)
    if isinstance(check, str):
        return replace(found, notes=(*found.notes, check))
    return replace(found, gnss=check, notes=(*found.notes, *remarks(check, recording.rig)))


def measure_mount(
    recording: Recording,
    every: int | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MountEstimate:
    """The same by the images alone, without a look at the fixes: what `inspect` compares with."""
    rig = recording.rig
    chosen = stretches(
        recording.frame_count, every or usual_every(recording.frame_times_ns(), recording.fixes())
    )
    looks, joined = _look(recording, chosen, jobs or os.cpu_count() or 1, progress)
    planes = [(k, look.ahead) for k, look in enumerate(looks) if look.ahead is not None]
    if len(planes) < FEWEST_PLANES:
        raise RecordingError(
            f"{recording.name} shows ground in {len(planes)} of {len(looks)} frames, and "
            f"{FEWEST_PLANES} are needed to tell how its sensor is mounted; take a drive over open "
            "ground, or measure the mounting."
        )
    rough = median_plane([plane for _, plane in planes])
    motions = _motions(looks, joined, rig, rough)
    found, plane = ground_under_vehicle([look.patches for look in looks], motions, rough)
    under = len(found.frame) >= FEWEST_STANDS
    if not under:
        found, plane = MountSamples.of(planes), rough
    steps = ground_steps(motions, plane)
    height_m = float(np.median(found.height_m))
    floors = (
        math.hypot(HEIGHT_FLOOR_M, HEIGHT_FLOOR_SHARE * height_m),
        TILT_FLOOR_DEG,
        ROLL_FLOOR_DEG,
    )
    if not under:
        floors = AHEAD_HEIGHT_SHARE * height_m, AHEAD_ANGLE_DEG, AHEAD_ANGLE_DEG
    columns = found.height_m, found.tilt_deg, found.roll_deg
    height, tilt, roll = map(mean_of, columns, floors)
    axle = rig.rear_axle_forward_m
    moved = travel(steps, None if axle is None else -axle)
    return MountEstimate(
        name=recording.name,
        height_m=height,
        tilt_deg=tilt,
        roll_deg=roll,
        yaw_deg=moved.yaw_deg,
        axle_ahead_m=moved.ahead_m,
        method=UNDER if under else AHEAD,
        frames=recording.frame_count,
        looked=len(looks),
        steps=len(steps.stop),
        forward_m=float(steps.forward_m[steps.forward_m > 0.0].sum()),
        reverse_m=float(np.abs(steps.forward_m[steps.forward_m < 0.0]).sum()),
        straight_m=moved.straight_m,
        time_ns=np.array([look.time_ns for look in looks], np.int64) + rig.image_time_offset_ns,
        mount_samples=found,
        ways=steps,
        gnss=None,
        stated=rig if recording.is_mounted else None,
        notes=tuple(_notes(rig, under, steps, moved)),
    )


def _look(
    recording: Recording,
    chosen: Sequence[range],
    jobs: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[list[FrameSample], list[bool]]:
    """The looks at the chosen frames, and whether each follows the one before in a stretch."""
    wanted = {k for stretch in chosen for k in stretch}
    starts = {stretch[0] for stretch in chosen if stretch}
    order = sorted(wanted)
    looks: list[FrameSample] = []
    picked = (frame for k, frame in enumerate(recording.frames()) if k in wanted)
    with closing(side_by_side(FrameProbe(recording.rig), picked, jobs)) as probed:
        for look in probed:
            looks.append(look)
            if progress is not None:
                progress(len(looks), len(order))
    return looks, [k not in starts for k in order[: len(looks)]]


def _motions(
    looks: Sequence[FrameSample], joined: Sequence[bool], rig: Rig, rough: SensorGround
) -> list[RigidMotion | None]:
    """The motion from each look to the next, of the middle of the baseline; None if not known."""
    camera = rig.sensor
    if not isinstance(camera, StereoCamera):
        return [None] * max(len(looks) - 1, 0)
    mount = Mount(rough.height_m, rough.tilt_deg, rough.roll_deg)
    roughly = Rig(camera, mount, LeverArm(0.0, 0.0, 0.0))
    middle = np.array([camera.baseline_m / 2.0, 0.0, 0.0])
    motions: list[RigidMotion | None] = []
    for (start, stop), follows in zip(pairwise(looks), joined[1:], strict=True):
        motion: RigidMotion | Refusal | None = None
        if follows and start.features is not None and stop.features is not None:
            motion = camera_motion(start.features, stop.features, roughly)
        if isinstance(motion, RigidMotion):
            R, t = motion
            motions.append(RigidMotion(R, R @ middle + t - middle))
        else:
            motions.append(None)
    return motions


def _notes(rig: Rig, under: bool, steps: Ways, moved: Travel) -> Iterator[str]:
    if not isinstance(rig.sensor, StereoCamera):
        yield (
            f"A {type(rig.sensor).__name__} alone does not tell its own motion, so yaw is not "
            "estimated, and the ground is that around the sensor, not the one under the wheels."
        )
    elif not under:
        yield (
            "The vehicle did not come to stand on ground that its camera had seen, so the ground "
            "ahead was measured, which is seldom the plane that the vehicle is on; drive 20 m or "
            "more straight on."
        )
    if isinstance(rig.sensor, StereoCamera) and moved.yaw_deg is None:
        yield (
            f"Yaw is not estimated: {moved.straight_m:.1f} m of the steps that the camera told are "
            f"nearly straight on, and more than {LEAST_WAY_M:.0f} m are needed that are not all of "
            "one curve; drive along a row."
        )
    forward_m = steps.forward_m[steps.forward_m > 0.0].sum()
    if len(steps.forward_m) and forward_m < 0.5 * np.abs(steps.forward_m).sum():
        yield (
            "Most of the way was driven in reverse, as the camera sees it; a camera that looks "
            "backwards has no mount here, so check which way it looks."
        )
