"""Bags of RealSense's recorder, made after its source: `src/media/ros/ros_file_format.h`,
`ros_writer.cpp` and `third-party/realsense-file` in github.com/IntelRealSense/librealsense."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import DepthCamera, StereoCamera
from fieldgrid.recordings import DepthFrame, DriveOptions, StereoFrame, open_drive, open_recording
from tests.conftest import TWO_LANES
from tests.recordings.bags import NANO, Maker

UTC_NS = 1_780_000_000 * NANO
SIZE_PX = 640, 480
K = np.array([[385.5, 0.0, 322.0], [0.0, 385.5, 238.0], [0.0, 0.0, 1.0]])
DEPTH, LEFT, RIGHT = (
    f"/device_0/sensor_0/{stream}" for stream in ("Depth_0", "Infrared_1", "Infrared_2")
)
GYRO, ACCEL = "/device_0/sensor_2/Gyro_0", "/device_0/sensor_2/Accel_0"
UNIT = "/device_0/sensor_0/option/Depth_Units/value"
MAKER = Maker("bag")


class Recorder:
    """Writes what `ros_writer` writes: times since the start of the recording, stamps in UTC, a
    version in the place of the frame, and the unit of depths after an image."""

    def __init__(self, path: Path) -> None:
        self._writer = Writer(path)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Recorder:
        self._writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def write(self, topic: str, message: Any, since_ns: int = 1, more: bytes = b"") -> None:
        name = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, name, typestore=MAKER.store
            )
        data = bytes(MAKER.store.serialize_ros1(message, name)) + more
        self._writer.write(self._connections[topic], since_ns, data)

    def describe(self, stream: str, at_m: tuple[float, float, float]) -> None:
        """Intrinsics without R and P, and where a stream is, seen from the first."""
        none = np.zeros((3, 4))
        info = MAKER.info(0, SIZE_PX, none, K=K, R=np.zeros(9), model="Brown Conrady")
        self.write(f"{stream}/info/camera_info", info)
        turn = MAKER.quaternion(w=-1.0)
        place = MAKER.of(
            "geometry_msgs/msg/Transform", translation=MAKER.vector(*at_m), rotation=turn
        )
        self.write(f"{stream}/tf/0", place)

    def image(self, stream: str, k: int, pixels: Any, encoding: str, unit_m: float) -> None:
        message = MAKER.image(UTC_NS + k * NANO // 30, pixels, encoding, frame="1")
        self.write(f"{stream}/image/data", message, k * NANO // 30 + 2, struct.pack("<f", unit_m))

    def feel(self, topic: str, k: int, rates: Any, forces: Any) -> None:
        message = MAKER.imu(UTC_NS + k * NANO // 200, rates, frame="1", forces=forces)
        self.write(f"{topic}/imu/data", message, k * NANO // 200 + 2)


def record(path: Path, frames: int = 4) -> Path:
    rng = np.random.default_rng(3)
    with Recorder(path) as bag:
        bag.write("/file_version", MAKER.of("std_msgs/msg/UInt32", data=4))
        bag.write(UNIT, MAKER.of("std_msgs/msg/Float32", data=0.0001))
        for stream, x_m in ((DEPTH, 0.0), (LEFT, 0.0), (RIGHT, 0.095)):
            bag.describe(stream, (x_m, 0.0, 0.0))
        for k in range(frames):
            for stream in (LEFT, RIGHT):
                pixels = rng.integers(0, 256, SIZE_PX[::-1], dtype=np.uint8)
                bag.image(stream, k, pixels, "8UC1", 0.0)
            depth = np.full(SIZE_PX[::-1], 25_000, dtype=np.uint16)
            depth[0, 0] = 0
            bag.image(DEPTH, k, depth, "mono16", 0.0001)
        for k in range(40):
            bag.feel(GYRO, k, (0.01, -0.2, 0.03), (0.0, 0.0, 0.0))
            bag.feel(ACCEL, k, (0.0, 0.0, 0.0), (0.1, -9.8, 0.2))
    (path.parent / "mounting.json").write_text(
        (TWO_LANES / "calibration" / "mounting.json")
        .read_text()
        .replace('"stereo_baseline_m": 0.18,', "")
    )
    return path


@pytest.fixture
def bag(tmp_path: Path) -> Iterator[Path]:
    shutil.copy(TWO_LANES / "gnss" / "gnss_rtk.nmea", tmp_path)
    return record(tmp_path / "20260528_101112.bag")


def test_the_infrared_pair_is_a_stereo_camera(bag: Path) -> None:
    with open_recording(bag, gnss="gnss_rtk.nmea") as recording:
        camera = recording.rig.sensor
        assert isinstance(camera, StereoCamera)
        assert (camera.width_px, camera.height_px) == SIZE_PX
        assert camera.focal_px == 385.5
        assert camera.baseline_m == pytest.approx(0.095)
        assert len(recording.fixes().time_ns) > 0
        frames = list(recording.frames())
        assert [frame.time_ns for frame in frames] == [UTC_NS + k * NANO // 30 for k in range(4)]
        assert isinstance(frames[0], StereoFrame)
        left, right = frames[0].images()
        wanted = np.random.default_rng(3).integers(0, 256, SIZE_PX[::-1], dtype=np.uint8)
        assert np.array_equal(left, wanted)
        assert not np.array_equal(left, right)


def test_depths_have_the_unit_that_the_sensor_says(bag: Path) -> None:
    (bag.parent / "recording.toml").write_text('sensor = "depth"\n')
    with open_recording(bag, gnss="gnss_rtk.nmea") as recording:
        assert isinstance(recording.rig.sensor, DepthCamera)
        assert recording.rig.sensor.fx_px == 385.5
        frame = next(iter(recording.frames()))
        assert isinstance(frame, DepthFrame)
        depth_m = frame.source.read()
        assert np.isnan(depth_m[0, 0])
        assert np.nanmax(depth_m) == np.nanmin(depth_m) == pytest.approx(2.5)


def test_gyro_and_accelerometer_have_the_axes_of_a_camera(bag: Path) -> None:
    with open_drive(bag, DriveOptions(gnss="gnss_rtk.nmea")) as drive:
        motion = drive.motion()
        assert motion.gyro is not None
        assert motion.gyro.rate_rad_s.tolist() == pytest.approx([-0.2] * 40)
        assert motion.inertial is not None
        right_forward_up = np.nanmean(motion.inertial.force_mps2, axis=0)
        assert right_forward_up.tolist() == pytest.approx([0.1, 0.2, 9.8], abs=1e-4)


def test_without_a_log_and_without_places_it_is_said_what_to_give(bag: Path) -> None:
    with open_drive(bag) as drive:
        assert "No topic with fixes; give a log with --gnss FILE." in drive.notes
    with Recorder(bag.with_name("bare.bag")) as bare:
        for k in range(2):
            for stream in (LEFT, RIGHT):
                none = np.zeros((3, 4))
                info = MAKER.info(0, SIZE_PX, none, K=K, R=np.zeros(9), model="Brown Conrady")
                bare.write(f"{stream}/info/camera_info", info)
                pixels = np.zeros(SIZE_PX[::-1], dtype=np.uint8)
                bare.image(stream, k, pixels, "8UC1", 0.0)
    with pytest.raises(CalibrationError, match="have no P, and no static transform joins"):
        open_recording(bag.with_name("bare.bag"))
