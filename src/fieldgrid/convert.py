"""One standard MCAP of what was understood of a recording, for Foxglove and every tool of ROS 2.

Frames by REP-103 and REP-105: `map` is the Local Tangent Plane (east, north, up), `base_footprint`
the grid origin (forward, left, up), below it the optical frames of the sensor, the antenna, and
the axle that does not steer where it is known.
All stamps are by the clock of the receiver. Topics: images with their camera_info (or depths, or
points), /gnss/fix, /imu/data, /wheel_odometry, /pose, /tf, /tf_static, and /datum, where `map` is.
"""

from __future__ import annotations

import heapq
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.angles import yaw_from_heading_rad
from fieldgrid.build import estimate_drive
from fieldgrid.errors import ConfigError, GnssError, RecordingError
from fieldgrid.gnss import Fix
from fieldgrid.gnss.fix import position_sigma_m
from fieldgrid.recording import (
    CloudFrame,
    DepthFrame,
    Frame,
    ImageFile,
    ImageSource,
    Recording,
    StereoFrame,
    open_recording,
)
from fieldgrid.recording.bag.images import CompressedImage
from fieldgrid.recording.images import AS_STORED
from fieldgrid.rig import DepthCamera, Rig, StereoCamera
from fieldgrid.ros import McapWriter, types
from fieldgrid.trajectory import Trajectory

_Float64 = npt.NDArray[np.float64]

MAP, BASE = "map", "base_footprint"
LEFT, RIGHT, DEPTH, LIDAR = "left_optical", "right_optical", "depth_optical", "lidar_optical"
ANTENNA, IMU, AXLE = "gnss_antenna", "imu", "rear_axle"

_FLU_FROM_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_SECOND = 1_000_000_000

# GGA's qualities as NavSatStatus: no fix, a fix, with satellite-based, with ground-based
# corrections. What no satellites gave (estimated, manual, simulated) is no fix.
_STATUS = {1: 0, 9: 1, 2: 2, 3: 2, 4: 2, 5: 2}
_NO_FIX, _ALL_SERVICES = -1, 15
_UNKNOWN, _APPROXIMATED, _DIAGONAL = 0, 1, 2
_RTK = (4, 5)
_UP_SHARE = 2.0
"""How much less sure a receiver's height is than its position."""

_ATTITUDE_RAD2 = math.radians(2.0) ** 2
_NOT_SAID = 1e6


class Images(StrEnum):
    """How images are written: as the files they are, as pixels, or not at all."""

    COMPRESSED = "compressed"
    RAW = "raw"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Converted:
    """What was written: the messages of each topic, the span of time, and remarks."""

    path: Path
    recording: str
    topics: dict[str, int]
    start_ns: int
    stop_ns: int
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "mcap": str(self.path),
            "recording": self.recording,
            "topics": self.topics,
            "start_ns": self.start_ns,
            "stop_ns": self.stop_ns,
            "notes": list(self.notes),
        }


class _Said(NamedTuple):
    """One message. The order decides among messages of one time."""

    time_ns: int
    order: int
    topic: str
    message: Any


def convert_recording(
    recording: Recording | str | Path,
    out: str | Path,
    *,
    images: Images | str = Images.COMPRESSED,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **opening: Any,
) -> Converted:
    """Write an MCAP of what a recording holds and what its poses are estimated to be.

    A path is opened here, `opening` being what `open_recording` takes. The file appears whole or
    not at all; no more than one frame is held in memory. Raises MapExistsError for a file that is
    there unless it may be overwritten, and what reading and estimating raise.
    """
    out = Path(out)
    if out.suffix.lower() != ".mcap":
        raise ConfigError(f"{out} is not named as an MCAP; give a name that ends in .mcap.")
    try:
        kind = Images(images)
    except ValueError:
        raise ConfigError(
            f"Images {images!r} cannot be written; give one of {', '.join(Images)}."
        ) from None
    if not isinstance(recording, str | Path):
        return _converted(recording, out, kind, overwrite, progress)
    with open_recording(recording, **opening) as drive:
        return _converted(drive, out, kind, overwrite, progress)


def _converted(
    recording: Recording,
    out: Path,
    images: Images,
    overwrite: bool,
    progress: Callable[[int, int], None] | None,
) -> Converted:
    with McapWriter(out, overwrite=overwrite) as writer:
        trajectory, notes = _trajectory(recording)
        counts: Counter[str] = Counter()
        start_ns, stop_ns = 0, 0
        for said in _everything(recording, trajectory, images, progress):
            if not counts:
                start_ns = said.time_ns
                for topic, message in _once(recording.rig, trajectory, said.time_ns):
                    writer.write(topic, message, said.time_ns)
                    counts[topic] += 1
            writer.write(said.topic, said.message, said.time_ns)
            counts[said.topic] += 1
            stop_ns = said.time_ns
        if not counts:
            raise RecordingError(
                f"{recording.name} has neither frames nor fixes, so there is nothing to convert; "
                "give another recording."
            )
    return Converted(
        out, recording.name, dict(sorted(counts.items())), start_ns, stop_ns, tuple(notes)
    )


def _trajectory(recording: Recording) -> tuple[Trajectory | None, list[str]]:
    """The estimated poses, or a remark on why there are none."""
    notes = list(recording.losses)
    if not recording.fixes():
        return None, [*notes, "There are no fixes, so no poses were written."]
    try:
        return estimate_drive(recording).trajectory, notes
    except GnssError as problem:
        return None, [*notes, f"No poses were written: {problem}"]


def _everything(
    recording: Recording,
    trajectory: Trajectory | None,
    images: Images,
    progress: Callable[[int, int], None] | None,
) -> Iterator[_Said]:
    """All messages in order of time."""
    streams = [_fixes(recording.fixes()), _motion(recording)]
    if trajectory is not None:
        streams.append(_poses(trajectory))
    if images is not Images.NONE:
        streams.append(_frames(recording, images, progress))
    return heapq.merge(*streams, key=lambda said: (said.time_ns, said.order))


# --- messages


def _new(name: str, /, **fields: Any) -> Any:
    """A message of a type, which ROS calls package/msg/Name."""
    package, short = name.split("/")
    return types().types[f"{package}/msg/{short}"](**fields)


def _header(time_ns: int, frame: str) -> Any:
    stamp = _new("builtin_interfaces/Time", sec=time_ns // _SECOND, nanosec=time_ns % _SECOND)
    return _new("std_msgs/Header", stamp=stamp, frame_id=frame)


def _vector(x: float, y: float, z: float, *, name: str = "Vector3") -> Any:
    """Three numbers as a message: a Vector3 or a Point."""
    return _new(f"geometry_msgs/{name}", x=float(x), y=float(y), z=float(z))


def _quaternion(R: _Float64) -> Any:
    """A rotation [3, 3] as a geometry_msgs/Quaternion."""
    # The eigenvector to the greatest eigenvalue, which is good for all rotations.
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    K = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(K)[1][:, -1].tolist()
    sign = 1.0 if w >= 0.0 else -1.0
    return _new("geometry_msgs/Quaternion", x=sign * x, y=sign * y, z=sign * z, w=sign * w)


def _transform(time_ns: int, parent: str, child: str, at_m: _Float64, turn: Any) -> Any:
    placed = _new("geometry_msgs/Transform", translation=_vector(*at_m.tolist()), rotation=turn)
    return _new(
        "geometry_msgs/TransformStamped",
        header=_header(time_ns, parent),
        child_frame_id=child,
        transform=placed,
    )


def _once(rig: Rig, trajectory: Trajectory | None, time_ns: int) -> Iterator[tuple[str, Any]]:
    """What is said once, at the start: where things sit, and where the map is."""
    R = _FLU_FROM_VEHICLE @ rig.mount.rotation()
    sensor, above = rig.sensor, np.array([0.0, 0.0, rig.mount.height_m])
    frames: dict[str, _Float64] = {}
    if isinstance(sensor, StereoCamera):
        half = R @ np.array([sensor.baseline_m / 2.0, 0.0, 0.0])
        frames = {LEFT: above - half, RIGHT: above + half}
    else:
        frames = {DEPTH if isinstance(sensor, DepthCamera) else LIDAR: above}
    turn, level = _quaternion(R), _quaternion(np.eye(3))
    antenna = rig.antenna
    at_antenna = np.array([antenna.forward_m, -antenna.right_m, antenna.up_m])
    placed = [_transform(time_ns, BASE, name, at, turn) for name, at in frames.items()]
    placed.append(_transform(time_ns, BASE, ANTENNA, at_antenna, level))
    placed.append(_transform(time_ns, BASE, IMU, above, level))
    if rig.rear_axle_forward_m is not None:
        axle = np.array([rig.rear_axle_forward_m, 0.0, 0.0])
        placed.append(_transform(time_ns, BASE, AXLE, axle, level))
    yield "/tf_static", _new("tf2_msgs/TFMessage", transforms=placed)
    if trajectory is not None:
        datum = trajectory.datum
        said = {
            "frame": MAP,
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
        }
        yield "/datum", _new("std_msgs/String", data=json.dumps(said))


def _fixes(fixes: Sequence[Fix]) -> Iterator[_Said]:
    for fix in sorted(fixes, key=lambda fix: fix.time_ns):
        yield _Said(fix.time_ns, 0, "/gnss/fix", nav_sat_fix(fix))


def nav_sat_fix(fix: Fix) -> Any:
    """A sensor_msgs/NavSatFix: altitude above the ellipsoid, what the message can hold."""
    status = _STATUS.get(fix.quality, _NO_FIX)
    if fix.sigma_m is not None and fix.sigma_m > 0.0 and math.isfinite(fix.sigma_m):
        sigma_m, known = fix.sigma_m, _DIAGONAL
    elif fix.quality in _RTK:
        # Without it nothing in the message would tell it from a plain differential fix.
        sigma_m, known = position_sigma_m(fix), _APPROXIMATED
    else:
        sigma_m, known = 0.0, _UNKNOWN
    variances = sigma_m**2 * np.array([1.0, 1.0, _UP_SHARE**2])
    return _new(
        "sensor_msgs/NavSatFix",
        header=_header(fix.time_ns, ANTENNA),
        status=_new("sensor_msgs/NavSatStatus", status=status, service=_ALL_SERVICES),
        latitude=fix.lat_deg,
        longitude=fix.lon_deg,
        altitude=fix.height_m,
        position_covariance=np.diag(variances).reshape(-1),
        position_covariance_type=known,
    )


def _motion(recording: Recording) -> Iterator[_Said]:
    motion = recording.motion()
    streams = []
    if motion.gyro is not None:
        times, rates = motion.gyro.time_ns.tolist(), motion.gyro.rate_rad_s.tolist()
        streams.append(
            _Said(t, 1, "/imu/data", _imu(t, rate)) for t, rate in zip(times, rates, strict=True)
        )
    if motion.wheels is not None:
        times, speeds = motion.wheels.time_ns.tolist(), motion.wheels.speed_mps.tolist()
        streams.append(
            _Said(t, 2, "/wheel_odometry", _odometry(t, speed))
            for t, speed in zip(times, speeds, strict=True)
        )
    return heapq.merge(*streams, key=lambda said: said.time_ns)


def _imu(time_ns: int, rate_rad_s: float) -> Any:
    """Of the three rates that about the vertical, upwards; the message says what it has not."""
    missing = np.array([-1.0, *[0.0] * 8])
    return _new(
        "sensor_msgs/Imu",
        header=_header(time_ns, IMU),
        orientation=_new("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=missing,
        angular_velocity=_vector(0.0, 0.0, -rate_rad_s),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=_vector(0.0, 0.0, 0.0),
        linear_acceleration_covariance=missing,
    )


def _odometry(time_ns: int, speed_mps: float) -> Any:
    pose = _new(
        "geometry_msgs/Pose",
        position=_vector(0.0, 0.0, 0.0, name="Point"),
        orientation=_new("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    twist = _new(
        "geometry_msgs/Twist",
        linear=_vector(speed_mps, 0.0, 0.0),
        angular=_vector(0.0, 0.0, 0.0),
    )
    return _new(
        "nav_msgs/Odometry",
        header=_header(time_ns, "odom"),
        child_frame_id=BASE,
        pose=_new(
            "geometry_msgs/PoseWithCovariance",
            pose=pose,
            covariance=np.diag([_NOT_SAID] * 6).reshape(-1),
        ),
        twist=_new("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def _poses(trajectory: Trajectory) -> Iterator[_Said]:
    """The poses that hold, of the grid origin in the map: three messages each."""
    yaws = yaw_from_heading_rad(trajectory.heading_deg)
    for k in np.flatnonzero(trajectory.accepted).tolist():
        time_ns, yaw = int(trajectory.time_ns[k]), float(yaws[k])
        at_m = np.array([trajectory.east_m[k], trajectory.north_m[k], trajectory.up_m[k]])
        turn = _new(
            "geometry_msgs/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0)
        )
        pose = _new(
            "geometry_msgs/Pose", position=_vector(*at_m.tolist(), name="Point"), orientation=turn
        )
        header = _header(time_ns, MAP)
        stamped = _new("geometry_msgs/PoseStamped", header=header, pose=pose)
        yield _Said(time_ns, 3, "/pose", stamped)
        variance_m2 = float(trajectory.position_sigma_m[k]) ** 2
        yaw_rad2 = math.radians(float(trajectory.heading_sigma_deg[k])) ** 2
        variances = [
            *(variance_m2, variance_m2, _UP_SHARE**2 * variance_m2),
            *(_ATTITUDE_RAD2, _ATTITUDE_RAD2, yaw_rad2),
        ]
        sure = _new(
            "geometry_msgs/PoseWithCovariance",
            pose=pose,
            covariance=np.diag(variances).reshape(-1),
        )
        said = _new("geometry_msgs/PoseWithCovarianceStamped", header=header, pose=sure)
        yield _Said(time_ns, 4, "/pose_with_covariance", said)
        placed = _new("tf2_msgs/TFMessage", transforms=[_transform(time_ns, MAP, BASE, at_m, turn)])
        yield _Said(time_ns, 5, "/tf", placed)


# --- frames


def _frames(
    recording: Recording, images: Images, progress: Callable[[int, int], None] | None
) -> Iterator[_Said]:
    rig = recording.rig
    for done, frame in enumerate(recording.frames(), start=1):
        time_ns = frame.time_ns + rig.image_time_offset_ns
        for order, (topic, message) in enumerate(_of_frame(frame, rig, images, time_ns), start=6):
            yield _Said(time_ns, order, topic, message)
        if progress is not None:
            progress(done, recording.frame_count)


def _of_frame(frame: Frame, rig: Rig, images: Images, time_ns: int) -> Iterator[tuple[str, Any]]:
    if isinstance(frame, StereoFrame):
        yield from _of_pair(frame, rig.camera, images, time_ns)
    elif isinstance(frame, DepthFrame) and isinstance(rig.sensor, DepthCamera):
        header = _header(time_ns, DEPTH)
        depth = np.ascontiguousarray(frame.depth.read(), dtype="<f4")
        yield "/depth/camera_info", _depth_info(rig.sensor, header)
        yield "/depth/image_rect", _image(depth, "32FC1", header)
    elif isinstance(frame, CloudFrame):
        yield "/lidar/points", _cloud(frame.cloud.read(), _header(time_ns, LIDAR))


def _of_pair(
    frame: StereoFrame, camera: StereoCamera, images: Images, time_ns: int
) -> Iterator[tuple[str, Any]]:
    pixels = frame.images()  # also what makes sure that they can be read
    right_cx_px = camera.cx_px if camera.cx_right_px is None else camera.cx_right_px
    sides = (
        ("left", LEFT, frame.left, pixels[0], camera.cx_px, 0.0),
        ("right", RIGHT, frame.right, pixels[1], right_cx_px, -camera.focal_baseline_px_m),
    )
    for side, name, source, grey, cx_px, shift_px_m in sides:
        header = _header(time_ns, name)
        yield f"/stereo/{side}/camera_info", _camera_info(camera, cx_px, shift_px_m, header)
        topic = f"/stereo/{side}/image_rect"
        if images is Images.RAW:
            yield topic, _image(grey, "mono8", header)
        else:
            stored = None if frame.rectifier else _stored(source)
            encoded, data = stored or ("png", _png(grey))
            yield (
                f"{topic}/compressed",
                _new(
                    "sensor_msgs/CompressedImage",
                    header=header,
                    format=encoded,
                    data=np.frombuffer(data, dtype=np.uint8),
                ),
            )


def _stored(source: ImageSource) -> tuple[str, bytes] | None:
    """The bytes of an image as recorded, if they are a JPEG or a PNG that says all of itself."""
    if isinstance(source, ImageFile):
        if source.format != AS_STORED:
            return None
        data = source.path.read_bytes()
    elif isinstance(source, CompressedImage):
        data = source.decoded().data.tobytes()
    else:
        return None
    if data.startswith(b"\xff\xd8\xff"):
        return "jpeg", data
    return ("png", data) if data.startswith(b"\x89PNG\r\n\x1a\n") else None


def _png(grey: npt.NDArray[np.uint8]) -> bytes:
    """Rectified pixels without loss."""
    _, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return bytes(data)


def _image(pixels: npt.NDArray[Any], encoding: str, header: Any) -> Any:
    height, width = pixels.shape
    return _new(
        "sensor_msgs/Image",
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=np.ascontiguousarray(pixels).view(np.uint8).reshape(-1),
    )


def _camera_info(camera: StereoCamera, cx_px: float, shift_px_m: float, header: Any) -> Any:
    size_px, f = (camera.width_px, camera.height_px), camera.focal_px
    return _info(size_px, (f, f), (cx_px, camera.cy_px), shift_px_m, header)


def _depth_info(camera: DepthCamera, header: Any) -> Any:
    size_px, focal_px = (camera.width_px, camera.height_px), (camera.fx_px, camera.fy_px)
    return _info(size_px, focal_px, (camera.cx_px, camera.cy_px), 0.0, header)


def _info(
    size_px: tuple[int, int],
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    shift_px_m: float,
    header: Any,
) -> Any:
    (fx, fy), (cx, cy) = focal_px, centre_px
    return _new(
        "sensor_msgs/CameraInfo",
        header=header,
        height=size_px[1],
        width=size_px[0],
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        r=np.eye(3).reshape(-1),
        p=np.array([fx, 0.0, cx, shift_px_m, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
        binning_x=0,
        binning_y=0,
        roi=_new(
            "sensor_msgs/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    )


def _cloud(points_m: npt.NDArray[np.float32], header: Any) -> Any:
    fields = [
        _new("sensor_msgs/PointField", name=axis, offset=4 * k, datatype=7, count=1)
        for k, axis in enumerate("xyz")
    ]
    data = np.ascontiguousarray(points_m, dtype="<f4")
    return _new(
        "sensor_msgs/PointCloud2",
        header=header,
        height=1,
        width=len(data),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(data),
        data=data.view(np.uint8).reshape(-1),
        is_dense=True,
    )
