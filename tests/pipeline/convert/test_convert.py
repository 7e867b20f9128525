"""MCAPs of recordings: what an independent reader finds in them, and what our own makes of them."""

from __future__ import annotations

import math
import tempfile
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import fieldgrid as fg
from fieldgrid.core import BuildSettings, ConfigError, MapExistsError, Quality, RecordingError
from fieldgrid.geometry import (
    DepthCamera,
    Fix,
    FixColumns,
    GivenPoses,
    Gyro,
    Inertial,
    LeverArm,
    Lidar,
    Motion,
    Mount,
    Orientation,
    RecordedTilt,
    Rig,
    WheelSpeed,
)
from fieldgrid.pipeline import Images, build_map, convert_recording
from fieldgrid.recordings import DepthFrame, Drive, DriveOptions, FixLog, open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.mounting.drives import START_NS, Memory, in_memory, swept

pytestmark = pytest.mark.usefixtures("worked_out_once")

MakeDrive = Callable[..., Path]
DATUM = "[datum]\nlat_deg = 41.65\nlon_deg = -4.72\nheight_m = 780.0\n"
OFFSET = "image_time_offset_s = 0.015\n"
Messages = dict[str, list[tuple[int, Any]]]


def messages(path: Path) -> Messages:
    """Log time and message by topic, read by a library that is not ours."""
    found: Messages = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        last_ns = 0
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert message.log_time >= last_ns  # written in order of time
            last_ns = message.log_time
            found[channel.topic].append((message.log_time, decoded))
    return found


def rotation(q: Any) -> np.ndarray:
    """The matrix of a quaternion."""
    w, v = q.w, np.array([q.x, q.y, q.z])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("convert") / "two_lanes.mcap"
    convert_recording(TWO_LANES, out, DriveOptions("gnss_rtk.nmea"))
    return out


@pytest.fixture(scope="module")
def found(converted: Path) -> Messages:
    return messages(converted)


def test_images_are_the_files_as_recorded(found: Messages) -> None:
    with open_recording(TWO_LANES, "gnss_rtk.nmea") as recording:
        frames = list(recording.frames())
    for side in ("left", "right"):
        sent = found[f"/stereo/{side}/image_rect/compressed"]
        infos = found[f"/stereo/{side}/camera_info"]
        assert len(sent) == len(infos) == len(frames)
        for (time_ns, image), (_, info), frame in zip(sent, infos, frames, strict=True):
            assert time_ns == stamp_ns(image) == stamp_ns(info) == frame.time_ns
            assert image.format == "jpeg"
            assert bytes(image.data) == getattr(frame, side).path.read_bytes()
            assert image.header.frame_id == info.header.frame_id == f"{side}_optical"


def test_the_calibration_by_ros(found: Messages) -> None:
    _, left = found["/stereo/left/camera_info"][0]
    _, right = found["/stereo/right/camera_info"][0]
    for info in (left, right):
        assert (info.width, info.height, info.distortion_model) == (640, 480, "plumb_bob")
        np.testing.assert_allclose(info.k, [905.4, 0, 316.2, 0, 905.4, 243.9, 0, 0, 1])
        assert list(info.d) == [0.0] * 5
    assert left.p[3] == 0.0
    assert right.p[3] == pytest.approx(-905.4 * 0.18)


def test_what_is_said_once_is_played_to_those_who_come_later(converted: Path) -> None:
    with converted.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    latched = {
        channel.topic
        for channel in summary.channels.values()
        if "durability: 1" in channel.metadata.get("offered_qos_profiles", "")  # transient local
    }
    assert latched == {"/datum", "/fieldgrid/rig", "/tf_static"}


def test_fixes_and_gyro(found: Messages) -> None:
    with open_recording(TWO_LANES, "gnss_rtk.nmea") as recording:
        fixes, gyro = recording.fixes(), recording.motion().gyro
        inertial = recording.motion().inertial
    assert gyro is not None
    assert inertial is not None
    assert len(found["/gnss/fix"]) == len(fixes)
    for (time_ns, message), fix in zip(found["/gnss/fix"], fixes, strict=True):
        assert time_ns == fix.time_ns
        position = (message.latitude, message.longitude, message.altitude)
        assert position == (fix.lat_deg, fix.lon_deg, fix.height_m)  # above the ellipsoid
        assert message.status.status == 2
        assert fix.sigma_m is not None
        assert message.position_covariance[0] == pytest.approx(fix.sigma_m**2)
        assert message.position_covariance[4] == pytest.approx(fix.sigma_m**2)
    rates = np.array([imu.angular_velocity.z for _, imu in found["/imu/data"]])
    np.testing.assert_array_equal(rates, -gyro.rate_rad_s)  # counter-clockwise, by REP-103
    _, imu = found["/imu/data"][0]
    assert imu.orientation_covariance[0] == -1.0  # not measured
    # Forward, left, up of what is kept as right, forward, up.
    right, forward, up = inertial.force_mps2[0].tolist()
    felt = imu.linear_acceleration
    assert (felt.x, felt.y, felt.z) == (forward, -right, up)
    assert imu.linear_acceleration_covariance[0] == 0.0


def test_poses_are_east_north_up_and_counter_clockwise(found: Messages) -> None:
    with open_recording(TWO_LANES, "gnss_rtk.nmea") as recording:
        trajectory = fg.estimate_trajectory(recording)
    rows = np.flatnonzero(trajectory.accepted)
    assert len(found["/pose"]) == len(found["/tf"]) == len(rows)
    for k, (time_ns, pose), (_, sure), (_, tf) in zip(
        rows, found["/pose"], found["/pose_with_covariance"], found["/tf"], strict=True
    ):
        assert time_ns == trajectory.time_ns[k]
        assert pose.header.frame_id == "map"
        at = pose.pose.position
        expected = (trajectory.east_m[k], trajectory.north_m[k], trajectory.up_m[k])
        assert (at.x, at.y, at.z) == expected
        phi = math.radians(trajectory.heading_deg[k])
        nose = rotation(pose.pose.orientation)[:, 0]
        np.testing.assert_allclose(nose, [math.sin(phi), math.cos(phi), 0.0], atol=1e-9)
        assert sure.pose.covariance[0] == pytest.approx(trajectory.position_sigma_m[k] ** 2)
        yaw_deg = math.degrees(math.sqrt(sure.pose.covariance[35]))
        assert yaw_deg == pytest.approx(trajectory.heading_sigma_deg[k])
        (placed,) = tf.transforms
        assert (placed.header.frame_id, placed.child_frame_id) == ("map", "base_footprint")
        assert placed.transform.translation.x == trajectory.east_m[k]
    ((_, said),) = found["/datum"]
    datum = trajectory.datum
    assert said.header.frame_id == "map"
    assert (said.latitude, said.longitude, said.altitude) == (
        datum.lat_deg,
        datum.lon_deg,
        datum.height_m,
    )


def test_where_things_sit_on_the_vehicle(found: Messages) -> None:
    ((_, said),) = found["/tf_static"]
    placed = {one.child_frame_id: one.transform for one in said.transforms}
    assert {one.header.frame_id for one in said.transforms} == {"base_footprint"}

    def at(name: str) -> list[float]:
        shift = placed[name].translation
        return [shift.x, shift.y, shift.z]

    np.testing.assert_allclose(at("left_optical"), [0.0, 0.09, 2.65], atol=1e-12)
    np.testing.assert_allclose(at("right_optical"), [0.0, -0.09, 2.65], atol=1e-12)
    np.testing.assert_allclose(at("gnss_antenna"), [-0.45, 0.12, 3.0], atol=1e-12)
    np.testing.assert_allclose(at("rear_axle"), [-1.4, 0.0, 0.0], atol=1e-12)
    R, tilt = rotation(placed["left_optical"].rotation), math.radians(16.0)
    np.testing.assert_allclose(R[:, 2], [math.cos(tilt), 0.0, -math.sin(tilt)], atol=1e-9)
    np.testing.assert_allclose(R[:, 0], [0.0, -1.0, 0.0], atol=1e-9)


def test_our_own_reader_finds_the_same_drive(converted: Path) -> None:
    with open_recording(TWO_LANES, "gnss_rtk.nmea") as one, open_recording(converted) as other:
        assert other.rig == one.rig
        np.testing.assert_array_equal(other.frame_times_ns(), one.frame_times_ns())
        for ours, theirs in list(zip(one.frames(), other.frames(), strict=True))[::10]:
            for a, b in zip(ours.images(), theirs.images(), strict=True):  # type: ignore[union-attr]
                np.testing.assert_array_equal(a, b)
        assert other.fixes() == one.fixes()
        assert one.motion().gyro is not None
        np.testing.assert_array_equal(other.motion().gyro, one.motion().gyro)


def test_a_map_can_be_built(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive("june", range(4, 8)), tmp_path / "june.mcap"
    convert_recording(drive, out, images="raw")
    for side in ("left", "right"):
        sent = messages(out)[f"/stereo/{side}/image_rect"]
        for (_, image), file in zip(sent, sorted((drive / side).iterdir()), strict=True):
            assert (image.encoding, image.step) == ("mono8", 640)
            grey = np.frombuffer(image.data, np.uint8).reshape(480, 640)
            np.testing.assert_array_equal(grey, cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
    (report,) = build_map([out], tmp_path / "map.gpkg", BuildSettings())
    assert report.used == report.frames == 4


def test_raw_pairs_are_rectified(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    """The same instants come raw and rectified; what is written is of the second kind."""
    folder, drive = shared_data("vineyard_two_lanes"), tmp_path / "raw"
    for name in ("calibration", "gnss"):
        (drive / name).mkdir(parents=True)
    for side in ("left", "right"):
        (drive / side).symlink_to(folder / f"raw_{side}")
        source = folder / "calibration" / f"stereo_raw_{side}_camera_info.yaml"
        (drive / "calibration" / f"stereo_{side}_camera_info.yaml").symlink_to(source)
    (drive / "calibration" / "mounting.json").symlink_to(folder / "calibration" / "mounting.json")
    table = (folder / "frames_raw.csv").read_text().replace("raw_", "").splitlines()
    (drive / "frames.csv").write_text("\n".join(table[:3]) + "\n")
    (drive / "recording.toml").write_text("[images]\nrectified = false\n")
    (drive / "gnss" / "rtk.nmea").symlink_to(folder / "gnss" / "gnss_rtk.nmea")
    out = tmp_path / "raw.mcap"
    with open_recording(drive) as recording:
        assert convert_recording(recording, out).topics["/stereo/left/camera_info"] == 2
        pairs = [frame.images() for frame in recording.frames()]  # type: ignore[union-attr]
    for side, name in enumerate(("left", "right")):
        for (_, image), pair in zip(
            messages(out)[f"/stereo/{name}/image_rect/compressed"], pairs, strict=True
        ):
            assert image.format == "png"
            data = np.frombuffer(image.data, dtype=np.uint8)
            np.testing.assert_array_equal(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), pair[side])


def test_depths(tmp_path: Path) -> None:
    camera = DepthCamera(32, 24, 30.0, 31.0, 15.5, 11.5)
    mount = Mount(1.2, 20.0, 3.0, -4.0)
    rig = Rig(camera, mount, LeverArm(0.1, -0.4, 2.0), image_time_offset_ns=7_000_000)
    depth = np.linspace(0.5, 9.0, 32 * 24, dtype=np.float32).reshape(24, 32)
    depth[3, 4] = np.nan
    shots = [DepthFrame("a", START_NS, Memory("a", depth), (32, 24))]  # type: ignore[arg-type]
    out = tmp_path / "depth.mcap"
    done = convert_recording(in_memory(rig, shots), out)
    assert done.notes == ("There are no fixes, so no poses were written.",)
    ((time_ns, image),) = messages(out)["/depth/image_rect"]
    assert time_ns == stamp_ns(image) == START_NS + 7_000_000  # by the clock of the receiver
    assert image.encoding == "32FC1"
    got = np.frombuffer(image.data, np.float32).reshape(24, 32)
    np.testing.assert_array_equal(got, depth)
    ((_, info),) = messages(out)["/depth/camera_info"]
    np.testing.assert_allclose(info.k, [30, 0, 15.5, 0, 31, 11.5, 0, 0, 1])


def test_clouds(tmp_path: Path) -> None:
    out = tmp_path / "cloud.mcap"
    drive = swept(Mount(1.9, 3.0, -2.0), sweeps=2)
    times = START_NS + np.arange(5) * 10**8
    fixes = FixColumns.of(times, lat_deg=40.0, lon_deg=-3.0, height_m=700.0, quality=4)
    rig = replace(drive.rig, mount=Mount(1.9, 3.0, -2.0))
    drive = replace(drive, rig=rig, log=FixLog(fixes))
    convert_recording(drive, out)
    (_, cloud), _ = messages(out)["/lidar/points"]
    assert [field.name for field in cloud.fields] == ["x", "y", "z"]
    points = np.frombuffer(cloud.data, np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(points, next(drive.frames()).source.read())  # type: ignore[union-attr]
    with open_recording(out) as again:
        assert isinstance(again.rig.sensor, Lidar)
        assert again.rig == drive.rig
        first = next(again.frames())
        np.testing.assert_array_equal(first.source.read(), points)  # type: ignore[union-attr]


def test_gyro_and_wheels_come_back(make_drive: MakeDrive, tmp_path: Path) -> None:
    out, times = tmp_path / "june.mcap", START_NS + np.arange(5) * 10**7
    moved = Motion(
        gyro=Gyro(times, np.linspace(-0.1, 0.1, 5)), wheels=WheelSpeed(times, np.linspace(-1, 2, 5))
    )
    with open_recording(make_drive()) as recording:
        log = recording.log._replace(motion=moved)
        convert_recording(replace(recording, log=log), out)
    with open_recording(out) as again:
        np.testing.assert_array_equal(again.motion().gyro, moved.gyro)
        np.testing.assert_array_equal(again.motion().wheels, moved.wheels)


@pytest.mark.parametrize("told", [0, 3])
def test_rates_that_are_not_known_are_written_as_unknown(
    told: int, make_drive: MakeDrive, tmp_path: Path
) -> None:
    out, times = tmp_path / "june.mcap", START_NS + np.arange(5) * 10**7
    rates = np.tile(np.float32([0.1, 0.2, 0.3]), (told, 1))
    forces = np.tile(np.float32([0.5, 0.7, 9.8]), (told, 1))
    moved = Motion(
        gyro=Gyro(times, np.full(5, -0.3)), inertial=Inertial(times[1 : 1 + told], rates, forces)
    )
    with open_recording(make_drive()) as recording:
        done = convert_recording(
            replace(recording, log=recording.log._replace(motion=moved)), out, images="none"
        )
    assert (
        f"Rates about the axes forward and left are not known in {5 - told} of 5 messages of "
        "/imu/data and are written as NaN."
    ) in done.notes
    sent = [message for _, message in messages(out)["/imu/data"]]
    known = range(1, 1 + told)
    for k, message in enumerate(sent):
        rate = message.angular_velocity
        expected = [0.2, -0.1] if k in known else [math.nan, math.nan]
        np.testing.assert_allclose([rate.x, rate.y], expected, rtol=1e-6)
        assert rate.z == 0.3
        assert message.linear_acceleration_covariance[0] == (0.0 if k in known else -1.0)
    with fg.open_drive(out) as again:
        np.testing.assert_array_equal(again.motion().gyro, moved.gyro)
        found = again.motion().inertial
        assert (0 if found is None else len(found.time_ns)) == told


@pytest.mark.parametrize("posed", [False, True], ids=["alone", "beside given poses"])
@pytest.mark.parametrize("kind", [RecordedTilt, Orientation])
def test_recorded_roll_and_pitch_come_back_bit_by_bit(
    kind: type[Any], posed: bool, make_drive: MakeDrive, tmp_path: Path
) -> None:
    out, times = tmp_path / "june.mcap", START_NS + np.arange(5) * 10**8
    columns = np.random.default_rng(0).normal(size=(len(kind._fields) - 1, 5))
    told = kind(times, *columns)
    name = "tilt" if kind is RecordedTilt else "orientation"
    with open_recording(make_drive()) as recording:
        motion = Motion(**{name: told})
        if posed:  # which are written without roll and pitch
            motion = motion._replace(poses=GivenPoses(times, *np.zeros((8, 5))))
        log = recording.log._replace(motion=motion)
        convert_recording(replace(recording, log=log), out, images="none")
    with fg.open_drive(out) as again:
        found = getattr(again.motion(), name)
        assert type(found) is kind
        np.testing.assert_array_equal(found, told)


def content(path: Path) -> tuple[list[Any], Any]:
    """Everything of a map that comes from images, fixes and motion, but for names."""
    with fg.open_map(path) as universal:
        (session,) = universal.sessions()
        frames = [
            (frame.pose, frame.grid().density.tobytes(), frame.grid().observed.tobytes())
            for frame in universal.frames(with_grid=True)
        ]
        inputs = {k: v.tobytes() for k, v in universal.session_inputs(session.name).items()}
        return [universal.datum, *frames], inputs


@pytest.mark.parametrize(
    "settings_file",
    [
        pytest.param("", id="plain", marks=pytest.mark.long),
        pytest.param(DATUM, id="datum"),
        pytest.param(OFFSET, id="offset", marks=pytest.mark.long),
    ],
)
def test_a_converted_drive_gives_the_map_of_the_original(
    settings_file: str, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive, out = make_drive("june", range(4, 8)), tmp_path / "converted.mcap"
    (drive / "recording.toml").write_text(settings_file)
    convert_recording(drive, out)
    for path in (drive, out):
        build_map([path], tmp_path / f"{path.stem}.gpkg", BuildSettings())
    assert content(tmp_path / "converted.gpkg") == content(tmp_path / "june.gpkg")


def test_a_converted_drive_of_kitti_keeps_headings_and_rig(
    shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    drive, out = shared_data("kitti_2011_09_30_drive_0020"), tmp_path / "kitti.mcap"
    convert_recording(drive, out, images="none")
    with fg.open_drive(drive) as one, fg.open_drive(out) as other:
        assert other.fixes() == one.fixes()
        assert other.motion().gyro is not None
        np.testing.assert_array_equal(other.motion().gyro, one.motion().gyro)
        assert one.motion().tilt is not None
        np.testing.assert_array_equal(other.motion().tilt, one.motion().tilt)
        assert other.datum_hint == fg.estimate_trajectory(one.recording()).datum


FIXES = st.builds(
    Fix,
    st.integers(START_NS, START_NS + 10**12),
    st.floats(-90.0, 90.0),
    st.floats(-180.0, 180.0),
    st.floats(-500.0, 9000.0),
    quality=st.sampled_from(Quality),
    satellites=st.none() | st.integers(0, 60),
    hdop=st.none() | st.floats(0.0, 99.0),
    age_s=st.none() | st.floats(0.0, 999.0),
    sigma_m=st.none() | st.floats(0.001, 20.0),
    speed_mps=st.none() | st.floats(0.0, 30.0),
    heading_deg=st.none() | st.floats(-179.9, 180.0),
    heading_sigma_deg=st.none() | st.floats(0.0, 90.0),
    heading_quality=st.none() | st.sampled_from(list(Quality)[1:]),
    course_deg=st.none() | st.floats(-179.9, 180.0),
    pitch_deg=st.none() | st.floats(-90.0, 90.0),
    roll_deg=st.none() | st.floats(-90.0, 90.0),
    tilt_sigma_deg=st.none() | st.floats(0.0, 90.0),
    stamp_sigma_s=st.none() | st.floats(0.0, 60.0),
)


@settings(max_examples=20)
@given(st.lists(FIXES, min_size=1, max_size=6))
def test_every_field_of_a_fix_comes_back(fixes: list[Fix]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        log, out = FixLog(FixColumns.of_rows(fixes)), Path(folder, "log.mcap")
        convert_recording(Drive(path=Path("log"), name="log", log=log), out)
        with fg.open_drive(out) as again:
            assert again.fixes() == log.fixes.in_order()


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("gnss/lawn_tractor_5hz", 100_000),
        pytest.param("gnss/lawn_tractor_5hz", 1 << 30, marks=pytest.mark.long),
        pytest.param("gnss/isoxml_harvester/csv", 1 << 30, marks=pytest.mark.long),
        ("vineyard_two_lanes/gnss", 1 << 30),
        ("gnss/gpsd_corpus", 1 << 30),
    ],
)
def test_a_log_comes_back_as_it_is(
    name: str, most: int, shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    """Of each file the first bytes, `most` of them."""
    done = 0
    (tmp_path / "logs").mkdir()
    for whole in sorted(p for p in shared_data(name).iterdir() if p.is_file())[:8]:
        path = tmp_path / "logs" / whole.name
        path.write_bytes(whole.read_bytes()[:most])
        try:
            with fg.open_drive(path) as one:
                convert_recording(one, tmp_path / f"{path.name}.mcap")
        except fg.FieldgridError:
            continue  # no fix, or no log at all
        with fg.open_drive(path) as one, fg.open_drive(tmp_path / f"{path.name}.mcap") as other:
            assert other.fixes() == one.fixes().in_order(), path
            assert (other.rig, other.refusal is None) == (None, False)
            done += 1
    assert done


def test_progress_and_bounds(make_drive: MakeDrive, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    convert_recording(make_drive(), tmp_path / "a.mcap", progress=lambda *now: told.append(now))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_what_cannot_be_written(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(), tmp_path / "a.mcap"
    with pytest.raises(ConfigError, match=r"ends in \.mcap"):
        convert_recording(drive, tmp_path / "a.bag")
    with pytest.raises(ConfigError, match="compressed, raw, none"):
        convert_recording(drive, out, images="jpeg")
    out.write_text("mine")
    with pytest.raises(MapExistsError):
        convert_recording(drive, out)
    assert out.read_text() == "mine"
    rig = Rig(Lidar(1000.0), Mount(1.0, 0.0), LeverArm(0.0, 0.0, 2.0))
    with pytest.raises(RecordingError, match="nothing to convert"):
        convert_recording(in_memory(rig, []), tmp_path / "b.mcap", images=Images.NONE)
    assert not (tmp_path / "b.mcap").exists()
