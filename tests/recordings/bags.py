"""Writes ROS bags for tests, by the libraries rosbags and mcap: a drive in every container.

Messages are made by a `Maker`, which knows how ROS 1 and ROS 2 differ; `write_bag` puts what it
made into a container.
"""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Container = Literal["bag", "db3 folder", "db3", "mcap"]
CONTAINERS: tuple[Container, ...] = ("bag", "db3 folder", "db3", "mcap")

NANO = 1_000_000_000


class Said(NamedTuple):
    """A message for a topic, when it was received, and its type."""

    receive_ns: int
    topic: str
    message: Any


class Maker:
    """Makes messages of ROS 1 or ROS 2."""

    def __init__(self, container: Container) -> None:
        self.ros1 = container == "bag"
        self.store: Typestore = get_typestore(
            Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE
        )
        sentence = "std_msgs/Header header\nstring sentence\n"
        self.store.register(get_types_from_msg(sentence, "nmea_msgs/msg/Sentence"))
        if self.ros1:
            tf = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(tf, "tf2_msgs/msg/TFMessage"))

    def of(self, type_: str, **fields: Any) -> Any:
        """A message by the ROS 2 spelling of its type; what is not given is zero or empty. ROS 1
        spells some names of fields with capitals."""
        said = {}
        for name, kind in self.store.fielddefs[type_][1]:
            given = fields.pop(name.lower(), None)
            said[name] = self._zero(*kind) if given is None else given
        assert not fields, fields
        return self.store.types[type_](**said)

    def _zero(self, kind: Nodetype, of: Any) -> Any:
        if kind == Nodetype.NAME:
            return self.of(of)
        if kind == Nodetype.BASE:
            return "" if of[0] == "string" else 0
        (inner, of_inner), length = of
        if inner == Nodetype.NAME or of_inner[0] == "string":
            return []
        return np.zeros(length, dtype=of_inner[0])

    def time(self, time_ns: int) -> Any:
        return self.of("builtin_interfaces/msg/Time", sec=time_ns // NANO, nanosec=time_ns % NANO)

    def header(self, time_ns: int, frame: str = "") -> Any:
        return self.of("std_msgs/msg/Header", stamp=self.time(time_ns), frame_id=frame)

    def vector(self, x: float, y: float, z: float) -> Any:
        return self.of("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def quaternion(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> Any:
        return self.of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def image(
        self, time_ns: int, pixels: npt.NDArray[Any], encoding: str, frame: str = "", **fields: Any
    ) -> Any:
        """A sensor_msgs/Image; `fields` replace what follows from the pixels."""
        values = {
            "height": pixels.shape[0],
            "width": pixels.shape[1],
            "encoding": encoding,
            "is_bigendian": int(pixels.dtype.byteorder == ">"),
            "step": pixels.dtype.itemsize * int(np.prod(pixels.shape[1:])),
            "data": np.frombuffer(pixels.tobytes(), dtype=np.uint8),
        }
        header = self.header(time_ns, frame)
        return self.of("sensor_msgs/msg/Image", header=header, **(values | fields))

    def compressed(self, time_ns: int, data: bytes, format_: str, frame: str = "") -> Any:
        header, packed = self.header(time_ns, frame), np.frombuffer(data, dtype=np.uint8)
        return self.of(
            "sensor_msgs/msg/CompressedImage", header=header, format=format_, data=packed
        )

    def info(
        self,
        time_ns: int,
        size_px: tuple[int, int],
        P: npt.ArrayLike,
        frame: str = "",
        *,
        K: npt.ArrayLike | None = None,
        D: Sequence[float] = (0.0,) * 5,
        R: npt.ArrayLike | None = None,
        model: str = "plumb_bob",
    ) -> Any:
        """A sensor_msgs/CameraInfo; K is that of P, and R none, unless they are given."""
        projection = np.array(P, dtype=np.float64).reshape(3, 4)
        return self.of(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(time_ns, frame),
            width=size_px[0],
            height=size_px[1],
            distortion_model=model,
            d=np.array(D, dtype=np.float64),
            k=np.array(projection[:, :3] if K is None else K, dtype=np.float64).ravel(),
            r=np.array(np.eye(3) if R is None else R, dtype=np.float64).ravel(),
            p=projection.ravel(),
        )

    def disparity(
        self, time_ns: int, image: Any, f: float, T: float, nearest: float, farthest: float
    ) -> Any:
        return self.of(
            "stereo_msgs/msg/DisparityImage",
            header=image.header,
            image=image,
            f=f,
            t=T,
            min_disparity=farthest,
            max_disparity=nearest,
            delta_d=1.0 / 16.0,
        )

    def sentence(self, time_ns: int, text: str, frame: str = "gps") -> Any:
        header = self.header(time_ns, frame)
        return self.of("nmea_msgs/msg/Sentence", header=header, sentence=text)

    def fix(
        self,
        time_ns: int,
        lat_deg: float,
        lon_deg: float,
        altitude_m: float,
        *,
        status: int = 0,
        sigma_m: float = 0.0,
        covariance_type: int = 2,
        frame: str = "gps",
    ) -> Any:
        return self.of(
            "sensor_msgs/msg/NavSatFix",
            header=self.header(time_ns, frame),
            status=self.of("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=lat_deg,
            longitude=lon_deg,
            altitude=altitude_m,
            position_covariance=np.diag(sigma_m**2 * np.array([1.0, 1.0, 4.0])).ravel(),
            position_covariance_type=covariance_type,
        )

    def imu(
        self,
        time_ns: int,
        rates: tuple[float, float, float],
        frame: str = "imu_link",
        forces: tuple[float, float, float] = (0.0, 0.0, 9.81),
    ) -> Any:
        return self.of(
            "sensor_msgs/msg/Imu",
            header=self.header(time_ns, frame),
            orientation=self.quaternion(),
            angular_velocity=self.vector(*rates),
            linear_acceleration=self.vector(*forces),
        )

    def odometry(self, time_ns: int, speed_mps: float) -> Any:
        twist = self.of("geometry_msgs/msg/Twist", linear=self.vector(speed_mps, 0.0, 0.0))
        pose = self.of("geometry_msgs/msg/Pose", orientation=self.quaternion())
        return self.of(
            "nav_msgs/msg/Odometry",
            header=self.header(time_ns, "odom"),
            child_frame_id="base_link",
            pose=self.of("geometry_msgs/msg/PoseWithCovariance", pose=pose),
            twist=self.of("geometry_msgs/msg/TwistWithCovariance", twist=twist),
        )

    def transform(
        self,
        parent: str,
        child: str,
        at_m: tuple[float, float, float],
        xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    ) -> Any:
        turn = self.quaternion(*xyzw)
        place = self.of(
            "geometry_msgs/msg/Transform", translation=self.vector(*at_m), rotation=turn
        )
        header = self.header(0, parent)
        return self.of(
            "geometry_msgs/msg/TransformStamped",
            header=header,
            child_frame_id=child,
            transform=place,
        )

    def transforms(self, *transforms: Any) -> Any:
        return self.of("tf2_msgs/msg/TFMessage", transforms=list(transforms))

    def cloud(
        self,
        time_ns: int,
        points: npt.NDArray[Any],
        frame: str = "lidar",
        *,
        step: int | None = None,
        offsets: tuple[int, int, int] | None = None,
        **fields: Any,
    ) -> Any:
        """A sensor_msgs/PointCloud2 of points [n, 3] of 32 or 64 bit, of either byte order."""
        size = points.dtype.itemsize
        at, step = offsets or (0, size, 2 * size), step or 3 * size
        layout = {
            "names": ["x", "y", "z"],
            "formats": [points.dtype] * 3,
            "offsets": at,
            "itemsize": step,
        }
        cells = np.zeros(len(points), dtype=np.dtype(layout))
        for axis, column in zip("xyz", points.T, strict=True):
            cells[axis] = column
        named = [
            self.of("sensor_msgs/msg/PointField", name=k, offset=o, datatype=6 + size // 4, count=1)
            for k, o in zip("xyz", at, strict=True)
        ]
        values = {
            "height": 1,
            "width": len(points),
            "fields": named,
            "is_bigendian": points.dtype.byteorder == ">",
            "point_step": step,
            "row_step": step * len(points),
            "data": np.frombuffer(cells.tobytes(), dtype=np.uint8),
        }
        header = self.header(time_ns, frame)
        return self.of("sensor_msgs/msg/PointCloud2", header=header, **(values | fields))


def write_bag(
    path: Path,
    container: Container,
    maker: Maker,
    said: Iterable[Said],
    *,
    in_order: bool = True,
    packed: bool = True,
) -> Path:
    """Write messages, by default in the order in which they were received. Returns the path of
    the bag, which gets the suffix of its container. An MCAP's chunks are `packed` by zstd."""
    messages = sorted(said, key=lambda one: one.receive_ns) if in_order else list(said)
    path.parent.mkdir(parents=True, exist_ok=True)
    store = maker.store
    if container == "mcap":
        return _write_mcap(path.with_suffix(".mcap"), store, messages, packed=packed)
    folder = path if container == "db3 folder" else path.with_name(path.name + "_folder")
    serialize = store.serialize_ros1 if container == "bag" else store.serialize_cdr
    made = Ros1Writer(path.with_suffix(".bag")) if maker.ros1 else Ros2Writer(folder, version=8)
    with made as writer:
        connections: dict[str, Any] = {}
        for receive_ns, topic, message in messages:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], receive_ns, serialize(message, name))
    if container == "bag":
        return path.with_suffix(".bag")
    if container == "db3":
        (database,) = folder.glob("*.db3")
        shutil.move(database, path.with_suffix(".db3"))
        shutil.rmtree(folder)
    return folder if container == "db3 folder" else path.with_suffix(".db3")


def _write_mcap(path: Path, store: Typestore, messages: Sequence[Said], *, packed: bool) -> Path:
    with path.open("wb") as file:
        kind = CompressionType.ZSTD if packed else CompressionType.NONE
        writer = McapWriter(file, compression=kind)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for receive_ns, topic, message in messages:
            name = message.__msgtype__
            if topic not in channels:
                text, _ = store.generate_msgdef(name, ros_version=2)
                schema = writer.register_schema(name, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message, name))
            writer.add_message(channels[topic], receive_ns, data, receive_ns)
        writer.finish()
    return path


LEFT, RIGHT = "/stereo/left/image_rect", "/stereo/right/image_rect"
LEFT_INFO, RIGHT_INFO = "/stereo/left/camera_info", "/stereo/right/camera_info"
NMEA, FIX, IMU, ODOMETRY = "/gps/nmea_sentence", "/gps/fix", "/imu/data", "/wheels/odom"


def images_said(
    maker: Maker,
    folder: Path,
    pairs: Iterable[tuple[int, str, str]],
    projections: tuple[npt.ArrayLike, npt.ArrayLike],
    *,
    compressed: bool = False,
) -> Iterator[Said]:
    """Rectified pairs of image files with their calibration: grey pixels, or the files as they
    are."""
    size_px = (0, 0)
    for time_ns, *names in pairs:
        for topic, name in zip((LEFT, RIGHT), names, strict=True):
            data = (folder / name).read_bytes()
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
            size_px = pixels.shape[1], pixels.shape[0]
            frame = "left_camera_optical_frame"
            if compressed:
                kind = f"mono8; {Path(name).suffix[1:]} compressed mono8"
                packed = maker.compressed(time_ns, data, kind, frame)
                yield Said(time_ns + 20_000_000, f"{topic}/compressed", packed)
            else:
                image = maker.image(time_ns, pixels, "mono8", frame)
                yield Said(time_ns + 20_000_000, topic, image)
        for topic, P in zip((LEFT_INFO, RIGHT_INFO), projections, strict=True):
            info = maker.info(time_ns, size_px, P, "left_camera_optical_frame")
            yield Said(time_ns + 20_000_000, topic, info)


def sentences_said(maker: Maker, path: Path, start_ns: int) -> Iterator[Said]:
    """The lines of an NMEA log, received a millisecond after each other."""
    for k, line in enumerate(path.read_text().splitlines()):
        time_ns = start_ns + k * 1_000_000
        yield Said(time_ns, NMEA, maker.sentence(time_ns, line))


def gyro_said(maker: Maker, path: Path) -> Iterator[Said]:
    """The gyro of a plain folder's imu/*.csv."""
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            whole, _, part = row["timestamp_utc_s"].partition(".")
            time_ns = int(whole) * NANO + int(part.ljust(9, "0"))
            x, y, z = (float(row[f"gyro_{axis}_rad_s"]) for axis in "xyz")
            felt = tuple(float(row[f"acc_{axis}_m_s2"]) for axis in "xyz")
            yield Said(time_ns, IMU, maker.imu(time_ns, (x, y, z), forces=felt))
