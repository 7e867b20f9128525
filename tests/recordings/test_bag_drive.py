"""What a bag tells of the vehicle: fixes, motion, mount, other sensors, order of messages."""

from __future__ import annotations

import math
import shutil
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fieldgrid.core import CalibrationError, LackingError, RecordingError
from fieldgrid.geometry import DepthCamera, LeverArm, Lidar, Mount, StereoCamera
from fieldgrid.recordings import (
    CloudFrame,
    DepthFrame,
    DriveOptions,
    Recording,
    Transforms,
    open_drive,
    open_recording,
    quality_of,
)
from fieldgrid.recordings.bag.sensors.clouds import MessageCloud
from tests.conftest import TWO_LANES
from tests.recordings import bags
from tests.recordings.bags import CONTAINERS, Container, Maker, Said
from tests.recordings.test_packed_depth import config, png, rvl

SharedData = Callable[[str], Path]

UTC = 1_700_000_000_000_000_000
STEP = 100_000_000
P = np.array([[100.0, 0, 15.5, 0], [0, 100.0, 11.5, 0], [0, 0, 1, 0]])
P_RIGHT = P + np.array([[0, 0, 0, -20.0], [0, 0, 0, 0], [0, 0, 0, 0]])
LAT, LON, HEIGHT = 41.65, -4.72, 787.4
# Camera axes (right, down, forward) in those of a vehicle (forward, left, up).
OPTICAL = (-0.5, 0.5, -0.5, 0.5)


def xyzw(R: np.ndarray) -> tuple[float, float, float, float]:
    vector = cv2.Rodrigues(np.asarray(R, dtype=np.float64))[0].ravel()
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle else vector
    x, y, z = (math.sin(angle / 2) * axis).tolist()
    return x, y, z, math.cos(angle / 2)


def stereo_said(
    maker: Maker, count: int = 4, size: tuple[int, int] = (24, 32), frame: str = "cam_optical"
) -> Iterator[Said]:
    """Pairs whose pixels tell their number, with their calibration."""
    for k in range(count):
        time_ns = UTC + k * STEP
        for side, projection in (("left", P), ("right", P_RIGHT)):
            pixels = np.full(size, k % 100 + 100 * (side == "right"), dtype=np.uint8)
            image = maker.image(time_ns, pixels, "mono8", frame)
            yield Said(time_ns, f"/s/{side}/image_rect", image)
            info = maker.info(time_ns, (size[1], size[0]), projection, frame)
            yield Said(time_ns, f"/s/{side}/camera_info", info)


def fixes_said(maker: Maker, count: int = 4) -> Iterator[Said]:
    for k in range(count):
        time_ns = UTC + k * STEP
        fix = maker.fix(time_ns, LAT + k * 1e-6, LON, HEIGHT, sigma_m=0.02)
        yield Said(time_ns, "/fix", fix)


@pytest.fixture
def opened(tmp_path: Path) -> Callable[..., Recording]:
    """Writes messages and opens them as a recording, with the mounting of the example."""

    def do(
        *said: Callable[[Maker], Any],
        container: Container = "mcap",
        mounting: bool = True,
        settings: str = "",
        in_order: bool = True,
        **options: Any,
    ) -> Recording:
        maker = Maker(container)
        messages = [one for part in said for one in part(maker)]
        path = tmp_path / "b" / "bag"
        shutil.rmtree(path.parent, ignore_errors=True)
        path = bags.write_bag(path, container, maker, messages, in_order=in_order)
        folder = path if path.is_dir() else path.parent
        (folder / "recording.toml").write_text(settings)
        if mounting:
            shutil.copy(TWO_LANES / "calibration" / "mounting.json", folder)
            text = (folder / "mounting.json").read_text()
            (folder / "mounting.json").write_text(text.replace('"stereo_baseline_m": 0.18,', ""))
        return open_recording(path, **options)

    return do


Opened = Callable[..., Recording]


def numbers(recording: Recording) -> list[tuple[int, int]]:
    """What the pixels of the pairs tell."""
    pairs = [frame.images() for frame in recording.frames()]
    return [(int(left[0, 0]), int(right[0, 0]) - 100) for left, right in pairs]


def test_all_that_a_bag_lacks_is_told_at_once(opened: Opened) -> None:
    def images(maker: Maker) -> Iterator[Said]:
        return (one for one in stereo_said(maker) if one.topic.endswith("image_rect"))

    with pytest.raises(LackingError) as caught:
        opened(images, mounting=False)
    camera, mounting, fixes = map(str, caught.value.problems)
    assert "camera_info" in camera
    assert "fieldgrid mount" in mounting
    assert "--gnss" in fixes
    with pytest.raises(CalibrationError) as one:
        opened(images, fixes_said)
    assert not isinstance(one.value, LackingError)


# Fixes


@pytest.mark.parametrize(
    ("status", "sigma_m", "covariance_type", "quality"),
    [
        (-1, 0.01, 2, 0),
        (0, 2.0, 2, 1),
        (1, 2.0, 2, 9),
        (2, 2.0, 2, 2),
        (2, 0.3, 2, 2),
        (2, 0.02, 2, 4),
        (0, 0.02, 3, 4),
        (0, 0.02, 0, 1),
        (2, 0.0, 2, 2),
        (-2, 2.0, 2, -1),
        (7, 2.0, 2, -1),
    ],
)
def test_the_quality_is_by_status_and_covariance(
    status: int, sigma_m: float, covariance_type: int, quality: int
) -> None:
    message = Maker("mcap").fix(
        UTC, LAT, LON, HEIGHT, status=status, sigma_m=sigma_m, covariance_type=covariance_type
    )
    found, stated_m = quality_of(message)
    assert found == quality
    known = sigma_m > 0.0 and covariance_type != 0
    assert stated_m == (pytest.approx(sigma_m) if known else None)


def test_the_covariance_is_east_north_up_by_row() -> None:
    message = Maker("mcap").fix(UTC, LAT, LON, HEIGHT)
    message.position_covariance[:] = [0.09, 5, 5, 5, 0.16, 5, 5, 5, 100.0]
    assert quality_of(message)[1] == pytest.approx(math.sqrt(0.125))
    for nonsense in (math.nan, math.inf, -1.0):
        message.position_covariance[4] = nonsense
        assert quality_of(message)[1] is None


def test_fixes_are_those_said_without_those_that_have_no_position(opened: Opened) -> None:
    def said(maker: Maker) -> Iterator[Said]:
        for k, (lat, altitude) in enumerate([(LAT, HEIGHT), (math.nan, 1.0), (LAT, math.nan)]):
            time_ns = UTC + k * STEP
            yield Said(time_ns, "/fix", maker.fix(time_ns, lat, LON, altitude, sigma_m=0.02))

    with opened(stereo_said, said) as recording:
        fixes, notes = list(recording.fixes()), " ".join(recording.notes)
    assert [(fix.time_ns, fix.height_m) for fix in fixes] == [(UTC, HEIGHT), (UTC + 2 * STEP, 0.0)]
    assert [(fix.lat_deg, fix.lon_deg, fix.quality) for fix in fixes] == [(LAT, LON, 4)] * 2
    assert [fix.sigma_m for fix in fixes] == pytest.approx([0.02] * 2, abs=1e-12)
    assert "1 message without a position" in notes
    assert "1 message without a height" in notes


# Motion


def imu_said(
    maker: Maker,
    frame: str = "imu_link",
    forces: tuple[float, float, float] = (0.0, 0.0, 9.81),
    across: tuple[float, float] = (0.1, 0.2),
    **changes: Any,
) -> Iterator[Said]:
    for k in range(5):
        time_ns = UTC + k * 10_000_000
        message = maker.imu(time_ns, (*across, 0.3 + k), frame, forces)
        for name, value in changes.items():
            getattr(message, name)[0] = value
        yield Said(time_ns, "/imu/data", message)


CLOCKWISE = [-0.3, -1.3, -2.3, -3.3, -4.3]
UPWARD = "gravity is felt upward"
USED, DENIED = True, False


@pytest.mark.parametrize(
    ("imu", "rates", "note", "forces"),
    [
        ({}, CLOCKWISE, "axes taken as flu", USED),
        # Upside down, in m/s² and in g: of the other axes nothing is known.
        *(
            (
                {"forces": (0.01, 0.02, -gravity)},
                [-rate for rate in CLOCKWISE],
                f"{UPWARD}, along [0, 0, -1]",
                None,
            )
            for gravity in (9.81, 1.0)
        ),
        # A driver that removes gravity leaves a bias, which points anywhere.
        *(
            ({"forces": bias}, CLOCKWISE, "axes taken as flu", DENIED)
            for bias in ((0, 0, -0.3), (0, 0.4, 0), (0, 0, -5.0), (0, 0, -12.0), (0, 0, 0))
        ),
        ({"across": (math.nan, math.nan)}, CLOCKWISE, "axes taken as flu", None),
        # Its y axis points down.
        ({"frame": "camera_imu_optical_frame"}, [0.2] * 5, "axes taken as rdf", DENIED),
    ],
)
def test_the_gyro_turns_clockwise_about_the_vertical(
    imu: dict[str, Any], rates: list[float], note: str, forces: bool | None, opened: Opened
) -> None:
    with opened(stereo_said, lambda m: imu_said(m, **imu)) as recording:
        gyro, inertial = recording.motion().gyro, recording.motion().inertial
        notes = recording.notes
    assert gyro is not None
    assert gyro.rate_rad_s.tolist() == rates
    assert gyro.time_ns.tolist() == [UTC + k * 10_000_000 for k in range(5)]
    assert f"/imu/data: {note}." in [one.replace("axes taken so that ", "") for one in notes]
    assert (inertial is None) == (forces is None)
    if inertial is not None:
        assert np.isfinite(inertial.force_mps2).all() == forces


def test_transforms_tell_how_an_imu_sits_unless_the_mounting_does(opened: Opened) -> None:
    def upside_down(maker: Maker) -> Iterator[Said]:
        down = (1.0, 0.0, 0.0, 0.0)  # half a turn about x
        tree = maker.transforms(maker.transform("base_link", "imu_link", (0, 0, 0), down))
        yield Said(UTC, "/tf_static", tree)

    with opened(stereo_said, imu_said, upside_down) as recording:
        gyro = recording.motion().gyro
        assert gyro is not None
        assert gyro.rate_rad_s.tolist() == [0.3, 1.3, 2.3, 3.3, 4.3]
        mounting = recording.path.parent / "mounting.json"  # type: ignore[attr-defined]
    text = mounting.read_text()
    mounting.write_text(text.replace('"camera_roll_deg"', '"imu_axes": "ulb", "camera_roll_deg"'))
    with open_recording(mounting.parent / "bag.mcap") as recording:
        gyro = recording.motion().gyro
        assert gyro is not None
        assert gyro.rate_rad_s.tolist() == [-0.1] * 5


def test_an_imu_without_gyro_and_times_that_repeat(opened: Opened) -> None:
    def said(maker: Maker) -> Iterator[Said]:
        yield from imu_said(maker, angular_velocity_covariance=-1.0)
        for time_ns, speed in ((UTC, 1.0), (UTC + 2, 2.0), (UTC + 1, -1.5), (UTC + 2, 9.0)):
            yield Said(time_ns, "/wheels/odom", maker.odometry(time_ns, speed))

    with opened(stereo_said, said) as recording:
        gyro, wheels = recording.motion().gyro, recording.motion().wheels
        assert gyro is None
        assert wheels is not None
        assert wheels.time_ns.tolist() == [UTC, UTC + 1, UTC + 2]
        assert wheels.speed_mps.tolist() == [1.0, -1.5, 2.0]
        notes = " ".join(recording.notes)
    assert "/imu/data: 5 messages without a gyro." in notes
    assert "/wheels/odom: 1 message without a time or value, or repeated" in notes


# Mount by transforms


def tree_said(
    maker: Maker,
    camera: Any,
    sensor: str = "cam_optical",
    axle_m: tuple[float, float, float] | None = None,
) -> Iterator[Said]:
    """A vehicle whose camera is 1.2 m ahead and 1.5 m up, and antenna 0.3 m behind, 2 m up."""
    yield Said(
        UTC,
        "/tf_static",
        maker.transforms(
            maker.transform("base_footprint", "base_link", (0.0, 0.0, 0.5)),
            maker.transform("base_link", "mast", (1.0, 0.1, 1.0)),
            maker.transform("mast", sensor, (0.2, 0.0, 0.0), camera),
            maker.transform("base_link", "gps", (-0.3, 0.0, 1.5)),
            *([] if axle_m is None else [maker.transform("base_link", "rear_axle", axle_m)]),
        ),
    )


@pytest.mark.parametrize("container", ["bag", "mcap"])
def test_static_transforms_stand_for_a_mounting(container: Container, opened: Opened) -> None:
    tilt = Mount(1.0, 20.0).rotation()
    flu_of_vehicle = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    camera = xyzw(flu_of_vehicle @ tilt)
    said = stereo_said, fixes_said, lambda maker: tree_said(maker, camera)
    with opened(*said, container=container, mounting=False) as recording:
        mount, arm = recording.rig.mount, recording.rig.antenna
    assert mount.height_m == pytest.approx(1.5)
    assert mount.tilt_deg == pytest.approx(20.0, abs=1e-6)
    assert (mount.roll_deg, mount.yaw_deg) == pytest.approx((0.0, 0.0), abs=1e-6)
    # The middle of the baseline of 0.2 m is 0.1 m right of the left camera, which is 0.1 m left.
    assert arm.forward_m == pytest.approx(-1.5)
    assert arm.right_m == pytest.approx(0.0, abs=1e-9)
    assert arm.up_m == pytest.approx(2.0)


def test_a_frame_tells_where_the_axle_is_that_does_not_steer(opened: Opened) -> None:
    def tree(maker: Maker) -> Iterator[Said]:
        return tree_said(maker, OPTICAL, axle_m=(-0.35, 0.2, 0.1))

    with opened(stereo_said, fixes_said, tree, mounting=False) as recording:
        assert recording.rig.rear_axle_forward_m == -1.55  # of the camera, 1.2 m ahead
        # What rounding errors of quaternions add is taken off.
        assert recording.rig.mount == Mount(1.5, 0.0)
        assert recording.rig.antenna == LeverArm(0.0, -1.5, 2.0)
    without = stereo_said, fixes_said, lambda maker: tree_said(maker, OPTICAL)
    with opened(*without, mounting=False) as recording:
        assert recording.rig.rear_axle_forward_m is None


def test_the_mount_is_that_of_the_rectified_camera(opened: Opened) -> None:
    flu_of_vehicle = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    raw = Mount(1.0, 20.0).rotation()
    R_rect_raw = cv2.Rodrigues(np.array([0.03, -0.02, 0.01]))[0]

    def said(maker: Maker) -> Iterator[Said]:
        for one in stereo_said(maker):
            if "info" in one.topic:
                one.message.r[:] = R_rect_raw.ravel()
            yield one
        yield from tree_said(maker, xyzw(flu_of_vehicle @ raw))

    with opened(said, fixes_said, mounting=False) as recording:
        found = recording.rig.mount.rotation()
    np.testing.assert_allclose(found, raw @ R_rect_raw.T, atol=1e-9)


def without_ground(said: list[Said]) -> None:
    del said[-1].message.transforms[0]


def lost_antenna(said: list[Said]) -> None:
    for one in said:
        if one.topic == "/fix":
            one.message.header.frame_id = "mars"


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lost_antenna, r"not the antenna \('mars'\)"),
        (without_ground, "from base_footprint to base_link, or write"),
        (
            lambda said: said.pop(),
            r"fieldgrid mount \S+ --write --antenna .* or write \S+bag\.mounting",
        ),
    ],
)
def test_a_tree_without_the_antenna_or_the_ground_is_told(
    change: Callable[[list[Said]], None], match: str, opened: Opened
) -> None:
    def said(maker: Maker) -> list[Said]:
        messages = [*stereo_said(maker), *fixes_said(maker), *tree_said(maker, OPTICAL)]
        change(messages)
        return messages

    with pytest.raises(CalibrationError, match=match):
        opened(said, mounting=False)


def test_a_camera_frame_that_looks_along_x_is_no_optical_one(opened: Opened) -> None:
    def said(maker: Maker) -> Iterator[Said]:
        yield from stereo_said(maker, frame="cam_link")
        yield from tree_said(maker, (0.0, 0.0, 0.0, 1.0), "cam_link")

    with opened(said, fixes_said, mounting=False) as recording:
        assert recording.rig.mount.tilt_deg == pytest.approx(0.0, abs=1e-9)


def test_transforms_in_a_circle_are_told(opened: Opened) -> None:
    maker = Maker("mcap")
    transforms = Transforms()
    transforms.add(
        maker.transforms(maker.transform("a", "b", (0, 0, 0)), maker.transform("b", "a", (0, 0, 0)))
    )
    with pytest.raises(CalibrationError, match="circle"):
        transforms.place("a", "c")


# Other sensors


def test_cameras_whose_names_say_nothing_are_told_by_their_calibration(opened: Opened) -> None:
    def said(maker: Maker, more: bool = False) -> Iterator[Said]:
        names = {"left": "/port", "right": "/starboard"}
        for one in stereo_said(maker):
            _, side, last = one.topic.strip("/").split("/")
            yield one._replace(topic=f"{names[side]}/{last}")
            if more and side == "right":
                yield one._replace(topic=f"/roof/{last}")

    with opened(said) as recording:
        assert recording.rig.camera.baseline_m == pytest.approx(0.2)
        assert numbers(recording) == [(k, k) for k in range(4)]
    with pytest.raises(RecordingError, match="no pair of a left and a right image"):
        opened(lambda maker: said(maker, more=True))


def test_disparities_are_of_the_left_camera_and_the_mounting_of_the_middle(
    opened: Opened,
) -> None:
    def said(maker: Maker) -> Iterator[Said]:
        values = np.full((24, 32), 10.0, dtype=np.float32)
        image = maker.image(UTC, values, "32FC1", "cam_optical")
        yield Said(UTC, "/s/disparity", maker.disparity(UTC, image, 100.0, 0.2, 64.0, 1.0))
        yield Said(UTC, "/s/left/camera_info", maker.info(UTC, (32, 24), P, "cam_optical"))

    with opened(said) as recording:
        baseline_m = float(np.float32(0.2))  # as the message has it
        rig = recording.rig
        assert rig.sensor == DepthCamera(32, 24, 100.0, 100.0, 15.5, 11.5, baseline_m)
        (frame,) = recording.frames()
        assert isinstance(frame, DepthFrame)
        assert frame.source.read()[5, 5] == np.float32(2.0)
        assert len(frame.source.sha256()) == 64
    with opened(stereo_said) as recording:
        middle = recording.rig
    assert rig.antenna.right_m == pytest.approx(middle.antenna.right_m + 0.1)
    assert rig.antenna.forward_m == pytest.approx(middle.antenna.forward_m)
    assert (rig.mount, rig.antenna.up_m) == (middle.mount, middle.antenna.up_m)
    assert rig.rear_axle_forward_m == middle.rear_axle_forward_m


@pytest.mark.parametrize("transport", ["", "/compressed", "/compressedDepth"])
def test_depth_images_are_depth_frames(transport: str, opened: Opened) -> None:
    def said(maker: Maker) -> Iterator[Said]:
        depth = np.full((24, 32), 1500, dtype=np.uint16)
        image = {
            "": maker.image(UTC, depth, "16UC1"),
            "/compressed": maker.compressed(UTC, png(depth), "16UC1; png compressed "),
            "/compressedDepth": maker.compressed(
                UTC, config() + rvl(depth), "16UC1; compressedDepth rvl"
            ),
        }[transport]
        yield Said(UTC, f"/camera/depth/image_rect_raw{transport}", image)
        yield Said(UTC, "/camera/depth/camera_info", maker.info(UTC, (32, 24), P))

    with opened(said) as recording:
        assert recording.rig.sensor == DepthCamera(32, 24, 100.0, 100.0, 15.5, 11.5)
        (frame,) = recording.frames()
        assert isinstance(frame, DepthFrame)
        assert frame.source.read() == pytest.approx(np.full((24, 32), 1.5), rel=1e-6)


def clouds_said(maker: Maker, frame: str = "lidar") -> Iterator[Said]:
    azimuth, elevation = np.meshgrid(np.linspace(-0.5, 0.5, 60), np.linspace(-0.4, 0.1, 40))
    ahead = np.cos(azimuth) * np.cos(elevation)
    left = np.sin(azimuth) * np.cos(elevation)
    points = 5.0 * np.column_stack([ahead.ravel(), left.ravel(), np.sin(elevation).ravel()])
    for k in range(2):
        time_ns = UTC + k * STEP
        cloud = maker.cloud(time_ns, points.astype("<f4"), frame)
        yield Said(time_ns, "/lidar/points", cloud)


def test_clouds_are_turned_to_right_down_forward(opened: Opened) -> None:
    with opened(clouds_said) as recording:
        assert isinstance(recording.rig.sensor, Lidar)
        # 2400 points in 1 rad of azimuth times the sines of the elevations.
        expected = 2400 / (math.sin(0.4) + math.sin(0.1))
        assert recording.rig.sensor.points_per_sr == pytest.approx(expected, rel=0.3)
        (frame, *_) = recording.frames()
        assert isinstance(frame, CloudFrame)
        points = frame.source.read()
    assert points[:, 2].min() > 3.0
    assert points[:, 1].max() == pytest.approx(5.0 * math.sin(0.4), rel=1e-5)  # below the sensor


@pytest.mark.parametrize(
    ("topic", "settings", "corrected"),
    [
        ("/lidar/points", "", False),
        ("/lidar/points_undistorted", "", True),
        ("/lidar/points_undistorted", "[cloud]\ncorrected = false\n", False),
        ("/lidar/points", "[cloud]\ncorrected = true\n", True),
    ],
)
def test_clouds_that_were_corrected_have_no_times_any_more(
    topic: str, settings: str, corrected: bool, opened: Opened
) -> None:
    def said(maker: Maker) -> list[Said]:
        return [one._replace(topic=topic) for one in clouds_said(maker)]

    with opened(said, settings=settings) as recording:
        (frame, *_) = recording.frames()
        assert isinstance(frame, CloudFrame)
        assert isinstance(frame.source, MessageCloud)
        assert frame.source.corrected == corrected


def test_the_settings_tell_of_a_bag_what_it_does_not(opened: Opened) -> None:
    with opened(clouds_said, stereo_said) as recording:
        assert isinstance(recording.rig.sensor, StereoCamera)
    settings = 'sensor = "cloud"\n[cloud]\naxes = "rdf"\npoints_per_sr = 1234.0\n'
    with opened(clouds_said, stereo_said, settings=settings) as recording:
        assert recording.rig.sensor == Lidar(1234.0)
        (frame, *_) = recording.frames()
        assert isinstance(frame, CloudFrame)
        assert frame.source.read()[:, 0].min() > 3.0  # what was ahead, taken as right


def test_a_cloud_of_a_lidar_that_looks_back_is_turned_to_look_ahead(opened: Opened) -> None:
    def tree(maker: Maker) -> Iterator[Said]:
        return tree_said(maker, (0.0, 0.0, 1.0, 0.0), "lidar")  # half a turn about z

    with opened(clouds_said, fixes_said, tree, mounting=False) as recording:
        mount = recording.rig.mount
        assert (mount.tilt_deg, mount.roll_deg, mount.yaw_deg) == (0.0, 0.0, 0.0)
        (frame, *_) = recording.frames()
        assert isinstance(frame, CloudFrame)
        assert frame.source.read()[:, 2].max() < -3.0  # what it sees lies behind the vehicle


# Raw pairs


def test_raw_pairs_are_rectified_by_their_calibration(
    shared_data: SharedData, opened: Opened
) -> None:
    import yaml

    folder = shared_data("vineyard_two_lanes")

    def said(maker: Maker) -> Iterator[Said]:
        for side in ("left", "right"):
            path = folder / f"raw_{side}" / "000003.jpg"
            pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            assert pixels is not None
            name = f"stereo_raw_{side}_camera_info.yaml"
            document = yaml.safe_load((folder / "calibration" / name).read_text())
            matrix = {k: v["data"] for k, v in document.items() if isinstance(v, dict)}
            info = maker.info(
                UTC,
                (640, 480),
                matrix["projection_matrix"],
                K=matrix["camera_matrix"],
                D=matrix["distortion_coefficients"],
                R=matrix["rectification_matrix"],
            )
            yield Said(UTC, f"/s/{side}/image_raw", maker.image(UTC, pixels, "mono8"))
            yield Said(UTC, f"/s/{side}/camera_info", info)

    with opened(said) as recording:
        assert recording.rig.camera == StereoCamera(640, 480, 905.4, 316.2, 243.9, 162.972 / 905.4)
        assert any("are raw, and rectified by" in note for note in recording.notes)
        (frame,) = recording.frames()
        left, right = frame.images()
    for image, side in ((left, "left"), (right, "right")):
        wanted = cv2.imread(str(folder / side / "000003.jpg"), cv2.IMREAD_GRAYSCALE)
        assert wanted is not None
        smooth = [cv2.GaussianBlur(one, (0, 0), 2.0)[40:-40, 40:-40] for one in (image, wanted)]
        assert np.corrcoef(smooth[0].ravel(), smooth[1].ravel())[0, 1] > 0.99


@pytest.mark.parametrize("change", ["binning", "roi", "sizes", "nan"])
def test_calibrations_that_are_not_of_whole_images_are_told(change: str, opened: Opened) -> None:
    def said(maker: Maker) -> list[Said]:
        messages = list(stereo_said(maker))
        for one in messages:
            if one.topic == "/s/left/camera_info":
                if change == "binning":
                    one.message.binning_x = 2
                elif change == "roi":
                    one.message.roi.width = 16
                elif change == "sizes":
                    one.message.width = 33
                else:
                    one.message.p[0] = math.nan
        return messages

    with pytest.raises(CalibrationError, match="/s/left/camera_info"):
        opened(said)


# Order and memory


@pytest.mark.parametrize("container", CONTAINERS)
def test_frames_come_in_order_though_messages_do_not(container: Container, opened: Opened) -> None:
    def said(maker: Maker) -> list[Said]:
        messages = list(stereo_said(maker, 60))
        lefts = [one for one in messages if one.topic == "/s/left/image_rect"]
        rest = [one for one in messages if one.topic != "/s/left/image_rect"]
        lefts[2:5] = lefts[4:1:-1]
        return lefts + rest  # and one topic after the other

    with opened(said, container=container, in_order=False) as recording:
        assert recording.frame_times_ns().tolist() == [UTC + k * STEP for k in range(60)]
        assert numbers(recording) == [(k, k) for k in range(60)]


def test_pairs_miss_a_side_and_the_rest_stays_together(opened: Opened) -> None:
    def said(maker: Maker) -> list[Said]:
        messages = list(stereo_said(maker, 10))
        gone = {("/s/left/image_rect", 3), ("/s/right/image_rect", 6)}
        return [m for m in messages if (m.topic, (m.receive_ns - UTC) // STEP) not in gone]

    with opened(said) as recording:
        assert numbers(recording) == [(k, k) for k in range(10) if k not in (3, 6)]
        assert len(recording.frame_times_ns()) == recording.frame_count == 8
        assert any("1 left and 1 right images without" in note for note in recording.notes)


def test_a_recording_that_changes_while_it_is_read_is_told(opened: Opened, tmp_path: Path) -> None:
    recording = opened(lambda m: stereo_said(m, 8))
    maker = Maker("mcap")
    bags.write_bag(tmp_path / "b" / "bag", "mcap", maker, list(stereo_said(maker, 4)))
    with recording, pytest.raises(RecordingError, match="fewer messages"):
        list(recording.frames())


def peak_bytes(recording: Recording) -> int:
    tracemalloc.start()
    for frame in recording.frames():
        frame.images()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


LARGE = (240, 320)


def after_another(maker: Maker, count: int) -> list[Said]:
    return sorted(stereo_said(maker, count, LARGE), key=lambda one: one.topic)


def with_a_side_that_stops(maker: Maker, count: int) -> list[Said]:
    messages, ends = stereo_said(maker, count, LARGE), UTC + 5 * STEP
    return [m for m in messages if m.topic != "/s/left/image_rect" or m.receive_ns < ends]


@pytest.mark.parametrize(
    ("said", "frames"),
    [
        (partial(stereo_said, size=LARGE), (40, 160)),
        (after_another, (40, 160)),
        (with_a_side_that_stops, (5, 5)),
    ],
)
def test_memory_does_not_grow_with_the_recording(
    said: Callable[..., Any], frames: tuple[int, int], opened: Opened
) -> None:
    peaks = []
    for count, wanted in zip((40, 160), frames, strict=True):
        with opened(partial(said, count=count), container="bag", in_order=False) as recording:
            assert recording.frame_count == wanted
            peaks.append(peak_bytes(recording))
    assert peaks[1] < 1.25 * peaks[0]


def test_how_many_bits_a_camera_fills_is_found_out_once(opened: Opened) -> None:
    def said(maker: Maker) -> Iterator[Said]:
        for k, one in enumerate(stereo_said(maker)):
            deep = np.full((24, 32), 16 * k + 1000 * (k == 4), dtype=np.uint16)
            image = maker.image(one.receive_ns, deep, "mono16")
            yield one._replace(message=image) if "image" in one.topic else one

    with opened(said) as recording:  # the brightest has 1064, of 11 bits
        assert any("lower 12 are taken as filled" in note for note in recording.notes)
        brightest = [frame.images()[0][0, 0] for frame in recording.frames()]
        assert brightest == [0, 1064 >> 4, 128 >> 4, 192 >> 4]


EPOCH = 1_600_000_000_000_000_000


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("start_ns", [5_000_000_000, UTC])
def test_a_simulations_clock_has_its_epoch_from_the_user(
    start_ns: int, container: Container, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fixes, images, gyro and topics count from the start of the simulation, if not in UTC."""
    is_utc = start_ns == UTC
    monkeypatch.setattr(sys.modules[__name__], "UTC", start_ns)
    maker = Maker(container)
    said = [*stereo_said(maker), *fixes_said(maker), *imu_said(maker)]
    path = bags.write_bag(tmp_path / "bag", container, maker, said)
    if not is_utc:
        with pytest.raises(RecordingError, match=r"are no UTC: .* say with --epoch 2026"):
            open_drive(path)
    options = DriveOptions(unmounted=True, epoch_ns=EPOCH)
    with open_drive(path, options).recording() as drive:
        wanted = start_ns + STEP * np.arange(4) + (0 if is_utc else EPOCH)
        assert drive.fixes().time_ns.tolist() == wanted.tolist()
        assert [frame.time_ns for frame in drive.frames()] == wanted.tolist()
        gyro = drive.motion().gyro
        assert gyro is not None
        assert gyro.time_ns[0] == wanted[0]
        assert {int(ns) // EPOCH for one in drive.topics for ns in one.stamp_ns} == {1}
