"""Poses that another program estimated, as those of a drive's own sensor.

SLAM, motion capture in a greenhouse, odometry under canopy: each has a frame of its own and a body
of its own. Here they become level poses of the sensor; where the frame lies on the globe is for
`pose` to find out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fieldgrid.core import ConfigError, Float64, Int64, RecordingError, counted
from fieldgrid.geometry import (
    GivenPoses,
    Motion,
    RecordedTilt,
    Rig,
    StereoCamera,
    heading_rad,
    roll_pitch_deg,
)
from fieldgrid.recordings.drive import Drive, Recording, with_motion
from fieldgrid.recordings.poses.pose_files import BodyPoses, read_pose_file, read_time_file
from fieldgrid.recordings.poses.pose_source import PoseBody, PoseSource
from fieldgrid.recordings.tables.motion_files import (
    AXES,
    R_VEHICLE_FLU,
    check_axes,
    directions,
    in_order,
)

CAMERA_AXES = "rdf"
"""x right, y down, z forward: what visual SLAM and KITTI call a pose."""

MOST_TILT_DEG = 30.0
"""A vehicle leans less, and so does a camera that looks at the field."""

LEVEL_DEG = 0.01
"""Poses that lean less throughout were made in the plane, and do not tell how the vehicle leans."""

TILT_SIGMA_DEG = 0.5
"""How well the roll and pitch of another program are taken to be known."""

_CHORD_S, _LEAST_CHORD_M = 1.0, 0.2
_FORWARD_SHARE = 0.7
"""Least share of the squared way along the forward axis; below it, the axes are others."""

# From the axes of a frame to those of a level one: x forward, y left, z up.
_FRAMES = {
    "z up": np.eye(3),
    "y down": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
    "z down": np.diag([1.0, -1.0, -1.0]),
}


def with_given_poses(drive: Drive, source: PoseSource | None, epoch_ns: int | None = None) -> Drive:
    """The drive with the poses of a source as part of its motion; `epoch_ns` is when the clock of a
    bag began that counts from its own start.

    Raises RecordingError for what cannot be read or contradicts itself, ConfigError for what is
    said in vain.
    """
    if source is None:
        return drive
    if source.file is None and source.topic is None:
        raise ConfigError("It is said what poses are, and not where; give --poses FILE.")
    axes = AXES if source.axes is None else source.axes
    try:
        check_axes(axes)
    except ValueError as problem:
        raise ConfigError(str(problem).replace("an IMU", "the body of poses") + ".") from problem
    body = _read(drive, source, axes, epoch_ns)
    return with_body_poses(drive, body, PoseBody(body.name, axes, source.point_flu_m))


def with_body_poses(drive: Drive, body: BodyPoses, about: PoseBody) -> Drive:
    """The drive with poses that were read or pushed as part of its motion. Their order does not
    matter; of equal times the first counts. Raises RecordingError for what contradicts itself."""
    motion, notes = motion_of_body(body, about, drive.rig, has_tilt=drive.motion().tilt is not None)
    new = tuple(note for note in notes if note not in drive.notes)
    given = with_motion(drive, motion, new)
    return replace(given, pose_name=about.name, pose_body=about, body_poses=body)


def motion_of_body(
    body: BodyPoses, about: PoseBody, rig: Rig | None, *, has_tilt: bool
) -> tuple[Motion, list[str]]:
    """The motion that poses of a body are, and remarks on it. How the vehicle leans is told by
    them unless something else tells it (`has_tilt`)."""
    assert body.time_ns is not None
    axes = about.axes
    rows = np.concatenate([body.position_m, body.R.reshape(-1, 9), body.variance], axis=1)
    (time_ns, kept), lost = in_order(body.time_ns, rows, 12)
    if len(time_ns) < 2:
        raise RecordingError(f"{body.name} has {len(time_ns)} poses; give those of a drive.")
    place, R = kept[:, :3], kept[:, 3:12].reshape(-1, 3, 3)
    R_vehicle_body = R_VEHICLE_FLU @ np.array(directions(axes), dtype=np.float64).T
    if axes == CAMERA_AXES and rig is not None:
        R_vehicle_body = rig.mount.rotation()
    R_level, frame = _levelled(body.name, R, R_vehicle_body, axes)
    R = R_level @ R @ R_vehicle_body.T
    place = place @ R_level.T - R @ _point(rig, about)
    _check_motion(body.name, time_ns, place, R, axes)
    roll, pitch = roll_pitch_deg(R)
    if max(np.abs(roll).max(), np.abs(pitch).max()) < LEVEL_DEG:
        roll, pitch = np.zeros_like(roll), np.zeros_like(pitch)
    x_m, y_m, turn_rad = np.sqrt(kept[:, 12:].T)
    if frame == "y down":  # they are of other axes
        x_m, y_m, turn_rad = np.full((3, len(time_ns)), np.nan)
    angles = np.degrees(heading_rad(R)), roll, pitch
    poses = GivenPoses._make(
        [time_ns, *place.T, *angles, np.maximum(x_m, y_m), np.degrees(turn_rad)]
    )
    motion = Motion(poses=poses)
    if frame != "y down" and roll.any() and not has_tilt and rig is not None:
        # The frame of a camera's first image is level only on average.
        tilt = RecordedTilt(time_ns, roll, pitch, np.full(len(roll), TILT_SIGMA_DEG))
        motion = motion._replace(tilt=tilt)
    notes = [f"The poses are {len(time_ns)} of {body.name}, body axes {axes}, frame {frame}."]
    if lost:
        notes.append(
            f"{body.name}: {counted(lost, 'pose')} without a time, or of the same time, skipped."
        )
    return motion, notes


def _read(drive: Drive, source: PoseSource, axes: str, epoch_ns: int | None) -> BodyPoses:
    from fieldgrid.recordings.bag.trajectories import read_pose_topic  # late: few give poses
    from fieldgrid.recordings.ros.bag import is_bag

    path = drive.path if source.file is None else source.file
    offset_ns = source.offset_ns or 0
    image_offset_ns = 0 if drive.rig is None else drive.rig.image_time_offset_ns
    if is_bag(path):
        body = read_pose_topic(path, source.topic, offset_ns, epoch_ns)
    elif source.topic is not None:
        raise ConfigError(f"{path} is no bag and has no topics; leave --poses-topic out.")
    else:
        if source.offset_ns is None and axes == CAMERA_AXES:
            offset_ns = image_offset_ns  # they have the stamps of the images they were made of
        body = read_pose_file(path, offset_ns)
    if body.time_ns is not None:
        if source.times is not None:
            raise ConfigError(f"The poses of {path} have their own times; leave --poses-times out.")
        return body
    if source.times is not None:
        time_ns, whose = read_time_file(source.times, offset_ns), f"times in {source.times}"
    elif isinstance(drive, Recording):
        own_offset_ns = image_offset_ns if source.offset_ns is None else offset_ns
        time_ns, whose = drive.frame_times_ns() + own_offset_ns, "frames"
    else:
        raise RecordingError(
            f"{path} has poses without times, and there are no frames that they could be of; give "
            "their times, one a line, with --poses-times FILE."
        )
    if len(time_ns) != len(body.position_m):
        raise RecordingError(
            f"{path} has {len(body.position_m)} poses for {len(time_ns)} {whose}; give one for "
            "each, or their times with --poses-times FILE."
        )
    return body._replace(time_ns=time_ns)


def _point(rig: Rig | None, about: PoseBody) -> Float64:
    """The origin of the body, right, forward and up of the sensor [3]; by default the left camera
    of camera axes, the grid origin of others."""
    if about.point_flu_m is not None:
        forward, left, up = about.point_flu_m
        return np.array([-left, forward, up])
    if rig is None:
        return np.zeros(3)
    if about.axes != CAMERA_AXES:
        return np.array([0.0, 0.0, -rig.mount.height_m])
    half_m = rig.camera.baseline_m / 2.0 if isinstance(rig.sensor, StereoCamera) else 0.0
    return np.asarray(rig.mount.rotation() @ np.array([-half_m, 0.0, 0.0]))


def _levelled(
    whose: str, R_body: Float64, R_vehicle_body: Float64, axes: str
) -> tuple[Float64, str]:
    """From the frame of the poses to a level one (x forward, y left, z up) [3, 3], and which axis
    of it is the vertical: the one that the vehicle's own up axis is near on average."""
    up = (R_body @ R_vehicle_body.T[:, 2]).mean(axis=0)
    steady = float(np.linalg.norm(up))
    up /= max(steady, 1e-9)
    for name, R_flu_frame in _FRAMES.items():
        if name == "z down" and axes[2] != "d":
            continue  # a quaternion written w first looks like that
        if (R_flu_frame @ up)[2] < np.cos(np.radians(MOST_TILT_DEG)) or steady < 0.8:
            continue
        if name != "y down":
            return R_flu_frame, name
        # The first camera's frame leans as that camera did: level is where the vehicle stood.
        x, y, z = R_flu_frame @ up
        lean = np.array([[1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), -x],
                         [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), -y],
                         [x, y, z]])  # fmt: skip
        return lean @ R_flu_frame, name
    told = ", ".join(f"{part:+.2f}" for part in up)
    raise RecordingError(
        f"The vehicle's up axis points along ({told}) of the frame of {whose}, which is "
        f"neither its z axis nor a camera's -y, with the body's axes taken as {axes}; declare "
        "them with --poses-axes (flu: x forward, y left, z up; rdf: a camera's), and see that "
        "quaternions are written x y z w."
    )


def _check_motion(name: str, time_ns: Int64, place: Float64, R: Float64, axes: str) -> None:
    """Raise RecordingError where the vehicle does not move along its forward axis."""
    later = np.searchsorted(time_ns, time_ns + round(_CHORD_S * 1e9))
    first = np.flatnonzero(later < len(time_ns))
    chord = place[later[first]] - place[first]
    long = np.linalg.norm(chord, axis=1) > _LEAST_CHORD_M
    if not long.any():
        return
    way = np.einsum("nji,nj->ni", R[first[long]], chord[long])
    share = (way**2).sum(axis=0) / (way**2).sum()
    if share[1] < _FORWARD_SHARE:
        directions_of = ("to its side", "along its forward axis", "up or down")
        raise RecordingError(
            f"{name}: with the body's axes taken as {axes} the vehicle moves mostly "
            f"{directions_of[int(share.argmax())]} ({100 * share.max():.0f} % of its way, "
            "squared); declare where x, y and z of the body point with --poses-axes (flu: x "
            "forward, y left, z up; rdf: a camera's)."
        )
