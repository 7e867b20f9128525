"""An MCAP out of a pipe: the map of a build of the same file, and what cannot be read of it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from fieldgrid.core import BuildSettings, ConfigError
from fieldgrid.geometry import Orientation, R_enu_level, R_level_vehicle, RecordedTilt
from fieldgrid.live import LiveOptions, McapStream, PoseTopic, Sources, live_folder
from fieldgrid.live.pose.sensor_rows import PARTS
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map, convert_recording, estimate_drive
from fieldgrid.poses import Attitude
from fieldgrid.recordings import (
    ORIENTATION,
    TILT,
    CloudFrame,
    CloudKind,
    DriveOptions,
    PairKind,
    PoseBody,
    PoseSource,
    open_drive,
    open_growing,
    open_recording,
)
from fieldgrid.recordings.frames.depth_files import DepthFormat, DepthKind
from fieldgrid.recordings.poses.pose_files import read_pose_file
from fieldgrid.recordings.ros.gnss_messages import tilt_messages
from tests.live.making import begin, slam
from tests.live.sources import QUICK, Heard, running
from tests.pipeline.drives.making import content
from tests.pipeline.drives.yard import recorded as recorded_yard
from tests.recordings.bags import Maker

pytestmark = pytest.mark.usefixtures("worked_out_once")

R_FLU_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

Written = tuple[int, str, str, str, bytes, bytes]
"""When a message was written, its topic, encoding, type with its definition, and its data."""


def write_as_it_comes(path: Path, messages: Iterable[Written]) -> Path:
    """An MCAP without chunks."""
    with path.open("wb") as to:
        writer = Writer(to, use_chunking=False)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for time_ns, topic, encoding, type_, definition, data in messages:
            if topic not in channels:
                number = writer.register_schema(type_, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, encoding, number)
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()
    return path


def messages_of(path: Path) -> Iterator[Written]:
    """The messages of an MCAP, without remarks on fixes, whose topic comes after them."""
    with path.open("rb") as source:
        for schema, channel, message in make_reader(source).iter_messages(log_time_order=True):
            assert schema is not None
            if not channel.topic.endswith("/details"):
                about = channel.topic, channel.message_encoding, schema.name, schema.data
                yield (message.log_time, *about, message.data)


@pytest.fixture(scope="module")
def recorded(short_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short drive as an MCAP that is written as it comes."""
    folder = tmp_path_factory.mktemp("mcap")
    convert_recording(short_drive, folder / "all.mcap")
    return write_as_it_comes(folder / "drive.mcap", messages_of(folder / "all.mcap"))


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    return path


def test_clouds_out_of_a_pipe_are_those_of_a_bag(pipe: Path, tmp_path: Path) -> None:
    """With the times of their points, and the axes that the name of their frame tells."""
    drive = recorded_yard(tmp_path / "yard")
    convert_recording(drive, tmp_path / "all.mcap")
    bag = write_as_it_comes(tmp_path / "drive.mcap", messages_of(tmp_path / "all.mcap"))
    with (drive / "recording.toml").open("a") as settings:
        settings.write("\n[cloud]\npoints_per_sr = 1000.0\n")
    kind = open_growing(drive).kind
    with open_recording(bag) as recording, open_recording(drive) as stored:
        theirs, first = list(recording.frames()), next(iter(stored.frames()))
        fixes = len(recording.fixes())
        with running(McapStream(str(pipe), kind)) as notes:
            write(pipe, bag.read_bytes())
            notes.wait(lambda: len(notes.frames) == len(theirs) and len(notes.fixes) == fixes)
        for one, other in zip(notes.frames, theirs, strict=True):
            assert isinstance(one, CloudFrame)
            assert isinstance(other, CloudFrame)
            assert (one.frame_id, one.time_ns) == (other.frame_id, other.time_ns)
            for ours, its in zip(one.source.sweep(), other.source.sweep(), strict=True):
                assert np.array_equal(ours, its)
        assert isinstance(first, CloudFrame)
        points_m = notes.frames[0].source.sweep().points_m  # type: ignore[union-attr]
        assert np.allclose(points_m, first.source.sweep().points_m, atol=1e-5)


def test_a_transform_of_a_lidar_that_comes_late_is_reported(pipe: Path, tmp_path: Path) -> None:
    ros, text = Maker("mcap"), "tf2_msgs/msg/TFMessage"
    drive = recorded_yard(tmp_path / "yard")
    convert_recording(drive, tmp_path / "all.mcap")
    said = []
    for *about, data in messages_of(tmp_path / "all.mcap"):
        message = ros.store.deserialize_cdr(data, about[3])
        if about[1] != "/tf_static":
            if about[3] == "sensor_msgs/msg/PointCloud2":
                message.header.frame_id = "lidar"
            said.append((*about, bytes(ros.store.serialize_cdr(message, about[3]))))
    # As a camera's: x to the right, z ahead.
    tree = ros.transforms(ros.transform("base_link", "lidar", (0, 0, 1), (0.5, -0.5, 0.5, -0.5)))
    definition = ros.store.generate_msgdef(text, ros_version=2)[0].encode()
    late = (said[-1][0], "/tf_static", "cdr", text, definition)
    said.append((*late, bytes(ros.store.serialize_cdr(tree, text))))
    bag = write_as_it_comes(tmp_path / "late.mcap", said)
    with running(McapStream(str(pipe), CloudKind())) as notes:
        write(pipe, bag.read_bytes())
        notes.wait_told("came after the first cloud")
    assert notes.frames


def test_the_rig_says_whether_pairs_or_clouds_are_taken(
    short_drive: Path, recorded: Path, pipe: Path
) -> None:
    with running(McapStream(str(pipe), CloudKind())) as notes:
        write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.fixes) == 110)
    assert not notes.frames
    with pytest.raises(ConfigError, match="a stereo camera or a lidar"):
        McapStream(str(pipe), DepthKind((4, 4), DepthFormat("depth")))


def stream(drive: Path, pipe: Path, poses: PoseTopic | None = None, **topics: str) -> McapStream:
    kind = open_growing(drive).kind
    assert isinstance(kind, PairKind)
    return McapStream(str(pipe), kind, topics, poses=poses)


def write(pipe: Path, data: bytes) -> threading.Thread:
    def run() -> None:
        with suppress(BrokenPipeError):  # the reader may have all that it waits for before
            pipe.write_bytes(data)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


@pytest.fixture(scope="module")
def recorded_leaning(leaning_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same drive with its IMU."""
    folder = tmp_path_factory.mktemp("mcap_leaning")
    convert_recording(leaning_drive, folder / "all.mcap")
    return write_as_it_comes(folder / "drive.mcap", messages_of(folder / "all.mcap"))


def test_the_map_out_of_a_pipe_with_an_imu_is_that_of_a_build(
    short_drive: Path, recorded_leaning: Path, pipe: Path, tmp_path: Path
) -> None:
    out, heard = tmp_path / "m.gpkg", Heard()
    build_map([recorded_leaning], tmp_path / "built.gpkg", BuildSettings())
    with open_recording(recorded_leaning) as recording:
        live = begin(recording, out, on_result=heard, options=LiveOptions(queue_frames=6))
        motion, fixes = recording.motion(), len(recording.fixes())
        rows = {"gyro": len(motion.gyro.time_ns), "inertial": len(motion.inertial.time_ns)}
        with Sources(live, (stream(short_drive, pipe),), QUICK):
            write(pipe, recorded_leaning.read_bytes())
            heard.wait(
                lambda: (
                    live.counts.frames == 6
                    and live.counts.fixes == fixes
                    and live.counts.rows == rows
                )
            )
        live.finish()
    with open_map(out) as universal:
        assert universal.sessions()[0].config["level_grids"] is True
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for kind in theirs:
        if kind != "fieldgrid_session":
            assert ours[kind] == theirs[kind], kind


def with_orientations(bag: Path, out: Path, source: str, attitude: Attitude, off: float) -> Path:
    """The same drive, whose `source` (imu or odometry) tells its lean by orientation, `off` by so
    many degrees to and fro, and whose IMU has no accelerometer."""
    ros = Maker("mcap")
    odometry = "nav_msgs/msg/Odometry"
    text, _ = ros.store.generate_msgdef(odometry, ros_version=2)

    def turned(time_ns: int) -> Any:
        at = attitude.at(np.array([time_ns], dtype=np.int64))
        sway = off * np.sin(time_ns / 1e9)
        R = R_enu_level(at.heading_deg) @ R_level_vehicle(at.roll_deg + sway, at.pitch_deg - sway)
        return ros.quaternion(*Rotation.from_matrix(R[0] @ R_FLU_VEHICLE.T).as_quat().tolist())

    def said() -> Iterator[Written]:
        for one in messages_of(bag):
            if one[1] != "/imu/data":
                yield one
                continue
            message = ros.store.deserialize_cdr(one[-1], one[3])
            none = np.array([-1.0, *[0.0] * 8])
            message.linear_acceleration_covariance = message.orientation_covariance = none
            if source == "imu":
                message.orientation_covariance = np.full(9, 1e-4)
                message.orientation = turned(one[0])
            yield (*one[:-1], bytes(ros.store.serialize_cdr(message, one[3])))
            if source == "odometry":
                moving = ros.odometry(one[0], 1.0)
                moving.pose.pose.orientation = turned(one[0])
                moving.pose.covariance = np.full(36, 1e-4)
                data = bytes(ros.store.serialize_cdr(moving, odometry))
                yield one[0], "/odom", "cdr", odometry, text.encode(), data

    return write_as_it_comes(out, said())


@pytest.mark.parametrize(
    ("source", "off"),
    [
        ("imu", 0.0),
        ("odometry", 12.0),
        pytest.param("imu", 12.0, marks=pytest.mark.long),
        pytest.param("odometry", 0.0, marks=pytest.mark.long),
    ],
)
def test_orientations_out_of_a_pipe_make_the_map_of_a_build(
    source: str,
    off: float,
    short_drive: Path,
    recorded_leaning: Path,
    pipe: Path,
    tmp_path: Path,
) -> None:
    """Also those that the drive denies, of which no grid is level."""
    out, heard = tmp_path / "m.gpkg", Heard()
    with open_recording(recorded_leaning) as recording:
        attitude = estimate_drive(recording).report.attitude
    assert attitude is not None
    bag = with_orientations(recorded_leaning, tmp_path / "bag.mcap", source, attitude, off)
    build_map([bag], tmp_path / "built.gpkg", BuildSettings())
    with open_recording(bag) as recording:
        motion, fixes = recording.motion(), len(recording.fixes())
        assert motion.inertial is None or not np.isfinite(motion.inertial.force_mps2).any()
        assert motion.orientation is not None
        live = begin(recording, out, on_result=heard, options=LiveOptions(queue_frames=6))
        with Sources(live, (stream(short_drive, pipe),), QUICK):
            write(pipe, bag.read_bytes())
            heard.wait(lambda: live.counts.frames == 6 and live.counts.fixes == fixes)
            rows = len(motion.orientation.time_ns)
            heard.wait(lambda: live.counts.rows.get("orientation") == rows)
        live.finish()
    with open_map(out) as universal:
        assert universal.sessions()[0].config["level_grids"] is (off == 0.0)
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for kind in theirs:
        if kind != "fieldgrid_session":
            assert ours[kind] == theirs[kind], kind


def with_stated_lean(bag: Path, out: Path, source: str, attitude: Attitude) -> Path:
    """The same drive without its IMU, in which poses on a topic, or texts of a converted drive,
    state how it leans."""
    ros = Maker("mcap")
    text, pose = "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped"
    definitions = {
        type_: ros.store.generate_msgdef(type_, ros_version=2)[0] for type_ in (text, pose)
    }

    def stated(time_ns: int) -> Iterator[Written]:
        at = attitude.at(np.array([time_ns], dtype=np.int64))
        if source == "pose":
            R = R_enu_level(at.heading_deg) @ R_level_vehicle(at.roll_deg, at.pitch_deg)
            turned = Rotation.from_matrix(R[0] @ R_FLU_VEHICLE.T).as_quat().tolist()
            place = ros.of("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
            kind, quaternion = "geometry_msgs/msg/Pose", ros.quaternion(*turned)
            held = ros.of(kind, position=place, orientation=quaternion)
            message = ros.of(pose, header=ros.header(time_ns, "map"), pose=held)
            data = bytes(ros.store.serialize_cdr(message, pose))
            yield time_ns, "/slam/pose", "cdr", pose, definitions[pose].encode(), data
            return
        columns = np.array([time_ns]), at.roll_deg, at.pitch_deg, np.array([0.3])
        tilt = RecordedTilt(*columns)
        topic = TILT
        if source == "orientation":
            tilt, topic = Orientation(*columns, np.array([1.0])), ORIENTATION
        for _, said in tilt_messages(tilt):
            message = ros.of(text, data=said.data)
            data = bytes(ros.store.serialize_cdr(message, text))
            yield time_ns, topic, "cdr", text, definitions[text].encode(), data

    def said() -> Iterator[Written]:
        for one in messages_of(bag):
            if one[1] != "/imu/data":
                yield one
                continue
            # What an IMU says of its orientation does not count beside it.
            message = ros.store.deserialize_cdr(one[-1], one[3])
            message.linear_acceleration_covariance = np.array([-1.0, *[0.0] * 8])
            message.orientation_covariance = np.full(9, 1e-4)
            x, y, z, w = Rotation.from_euler("x", 5.0 * np.sin(one[0] / 1e9), True).as_quat()
            message.orientation = ros.quaternion(x, y, z, w)
            yield (*one[:-1], bytes(ros.store.serialize_cdr(message, one[3])))
            if one[0] // 10_000_000 % 5 == 0:  # each 50 ms
                yield from stated(one[0])

    return write_as_it_comes(out, said())


@pytest.mark.parametrize("source", ["tilt", "orientation", "pose"])
def test_stated_roll_and_pitch_out_of_a_pipe_make_the_map_of_a_build(
    source: str, short_drive: Path, recorded_leaning: Path, pipe: Path, tmp_path: Path
) -> None:
    """On the topics of converted drives, and on one that is given for them."""
    out, heard = tmp_path / "m.gpkg", Heard()
    with open_recording(recorded_leaning) as recording:
        attitude = estimate_drive(recording).report.attitude
    assert attitude is not None
    bag = with_stated_lean(recorded_leaning, tmp_path / "bag.mcap", source, attitude)
    topics = {"attitude": "/slam/pose"} if source == "pose" else {}
    options = DriveOptions(topics=topics)
    build_map([bag], tmp_path / "built.gpkg", BuildSettings(), options)
    with open_drive(bag, options) as opened:
        recording = opened.recording()
        motion, fixes = recording.motion(), len(recording.fixes())
        parts = {part: getattr(motion, part) for part in PARTS}
        rows = {part: len(one.time_ns) for part, one in parts.items() if one is not None}
        assert rows["tilt" if source == "tilt" else "orientation"] > 100
        live = begin(recording, out, on_result=heard, options=LiveOptions(queue_frames=6))
        with Sources(live, (stream(short_drive, pipe, **topics),), QUICK):
            write(pipe, bag.read_bytes())
            heard.wait(lambda: live.counts.frames == 6 and live.counts.fixes == fixes)
            heard.wait(lambda: sum(live.counts.rows.values()) >= sum(rows.values()))
        assert live.counts.rows == rows
        live.finish()
    with open_map(out) as universal:
        assert universal.sessions()[0].config["level_grids"] is True
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for kind in theirs:
        if kind != "fieldgrid_session":
            assert ours[kind] == theirs[kind], kind


def test_a_topic_of_another_type_is_reported_and_not_used(
    short_drive: Path, recorded_leaning: Path, pipe: Path
) -> None:
    with running(stream(short_drive, pipe, odometry="/imu/data")) as notes:
        write(pipe, recorded_leaning.read_bytes())
        notes.wait_told("of the type sensor_msgs/Imu, not nav_msgs/Odometry, which is not used")
        notes.wait(lambda: len(notes.frames) == 6)


def turned_imu(bag: Path, out: Path) -> Path:
    """The same drive from an IMU that is mounted upside down, as the static transforms say."""
    ros = Maker("mcap")

    def turned(one: Written) -> Written:
        type_ = one[3]
        if one[1] not in ("/tf_static", "/imu/data"):
            return one
        message = ros.store.deserialize_cdr(one[-1], type_)
        if one[1] == "/tf_static":
            (imu,) = (each for each in message.transforms if each.child_frame_id == "imu")
            imu.transform.rotation = ros.quaternion(1.0, 0.0, 0.0, 0.0)
        else:
            for vector in (message.angular_velocity, message.linear_acceleration):
                vector.y, vector.z = -vector.y, -vector.z
        return (*one[:-1], bytes(ros.store.serialize_cdr(message, type_)))

    return write_as_it_comes(out, (turned(one) for one in messages_of(bag)))


def test_static_transforms_say_how_an_imu_sits_as_in_a_bag(
    short_drive: Path, recorded_leaning: Path, pipe: Path, tmp_path: Path
) -> None:
    bag = turned_imu(recorded_leaning, tmp_path / "turned.mcap")
    with open_recording(recorded_leaning) as one, open_recording(bag) as other:
        motion, same = other.motion(), one.motion()
    assert np.array_equal(motion.gyro.rate_rad_s, same.gyro.rate_rad_s)  # type: ignore[union-attr]
    inertial = motion.inertial
    assert inertial is not None
    with running(stream(short_drive, pipe)) as notes:
        write(pipe, bag.read_bytes())
        notes.wait(lambda: sum(len(r.time_ns) for p, r in notes.rows if p == "inertial") >= 500)
    columns = [rows.columns for part, rows in notes.rows if part == "inertial"]
    rates, forces = (np.concatenate([one[k] for one in columns]) for k in range(2))
    assert np.array_equal(rates, inertial.rate_rad_s[: len(rates)])
    assert np.array_equal(forces, inertial.force_mps2[: len(forces)])


def test_the_map_out_of_a_pipe_is_that_of_a_build(
    short_drive: Path, recorded: Path, pipe: Path, tmp_path: Path
) -> None:
    out, heard = tmp_path / "m.gpkg", Heard()
    build_map([recorded], tmp_path / "built.gpkg", BuildSettings())
    with open_recording(recorded) as recording:
        live = begin(recording, out, on_result=heard, options=LiveOptions(queue_frames=6))
        fixes = len(recording.fixes())
        with Sources(live, (stream(short_drive, pipe),), QUICK):
            write(pipe, recorded.read_bytes())
            heard.wait(lambda: live.counts.frames == 6 and live.counts.fixes == fixes)
        live.finish()
    assert not live_folder(out).exists()
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for kind in theirs:
        if kind != "fieldgrid_session":  # which says where its data come from
            assert ours[kind] == theirs[kind], kind


def poses_said(tum: Path, kind: str) -> Iterator[Written]:
    """The poses of a file as messages."""
    ros, unknown = Maker("mcap"), np.zeros(36)
    type_ = f"{'nav' if kind == 'Odometry' else 'geometry'}_msgs/msg/{kind}"
    text, _ = ros.store.generate_msgdef(type_, ros_version=2)
    poses = read_pose_file(tum)
    assert poses.time_ns is not None
    rows = np.loadtxt(tum)[:, 1:].tolist()
    for time_ns, (x, y, z, *turned) in zip(poses.time_ns.tolist(), rows, strict=True):
        header = ros.header(time_ns, "map")
        place = ros.of("geometry_msgs/msg/Point", x=x, y=y, z=z)
        pose = ros.of("geometry_msgs/msg/Pose", position=place, orientation=ros.quaternion(*turned))
        fields = {"header": header, "pose": pose}
        if kind == "Odometry":
            fields = {**vars(ros.odometry(time_ns, 0.5)), "header": header}
            fields.pop("__msgtype__", None)
            fields["pose"] = ros.of(
                "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=unknown
            )
        data = bytes(ros.store.serialize_cdr(ros.of(type_, **fields), type_))
        yield time_ns, "/slam", "cdr", type_, text.encode(), data


@pytest.mark.parametrize("kind", ["PoseStamped", "Odometry"])
def test_poses_out_of_a_pipe_make_the_map_of_a_build(
    kind: str, short_drive: Path, recorded: Path, pipe: Path, tmp_path: Path
) -> None:
    tum = slam(short_drive, tmp_path / "slam.tum")
    both = sorted([*messages_of(recorded), *poses_said(tum, kind)], key=itemgetter(0))
    drive = write_as_it_comes(tmp_path / "drive.mcap", both)
    out, heard = tmp_path / "m.gpkg", Heard()
    options = DriveOptions(poses=PoseSource(topic="/slam"))
    build_map([drive], tmp_path / "built.gpkg", BuildSettings(), options)
    poses = sum(one[1] == "/slam" for one in both)
    with open_recording(drive) as recording:
        fixes, about = len(recording.fixes()), {"poses": PoseBody("/slam")}
        many = LiveOptions(queue_frames=6)
        live = begin(recording, out, on_result=heard, options=many, **about)
        with Sources(live, (stream(short_drive, pipe, PoseTopic("/slam")),), QUICK):
            write(pipe, drive.read_bytes())
            heard.wait(
                lambda: (
                    live.counts.frames == 6
                    and live.counts.fixes == fixes
                    and live.counts.rows.get("poses") == poses
                )
            )
        live.finish()
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for table in theirs:
        if table != "fieldgrid_session":
            assert ours[table] == theirs[table], table
    with open_map(out) as one, open_map(tmp_path / "built.gpkg") as other:
        assert one.sessions()[0].config["poses"] == "/slam"
        inputs = [universal.session_inputs("drive") for universal in (one, other)]
        assert inputs[0].keys() == inputs[1].keys()
        for name in inputs[0]:
            np.testing.assert_array_equal(inputs[0][name], inputs[1][name])


def test_poses_that_cannot_be_are_told_once_and_left_out(
    short_drive: Path, recorded: Path, pipe: Path, tmp_path: Path
) -> None:
    text, out, heard = "geometry_msgs/msg/PoseStamped", tmp_path / "m.gpkg", Heard()
    said = list(poses_said(slam(short_drive, tmp_path / "slam.tum"), "PoseStamped"))
    ros = Maker("mcap")
    lost = ros.store.deserialize_cdr(said[1][-1], text)
    lost.pose.orientation.w = 0.0
    said[1] = (*said[1][:-1], bytes(ros.store.serialize_cdr(lost, text)))
    said[2] = (*said[2][:-1], said[1][-1])
    # A path is written anew with each pose: none is read while driving.
    path = ros.store.generate_msgdef("nav_msgs/msg/Path", ros_version=2)[0].encode()
    bag = write_as_it_comes(tmp_path / "some.mcap", said)
    with open_recording(recorded) as recording:
        live = begin(recording, out, on_result=heard, poses=PoseBody())
        source = stream(short_drive, pipe, PoseTopic("/slam"))
        with Sources(live, (source,), QUICK):
            write(pipe, bag.read_bytes())
            heard.wait(lambda: live.counts.rows.get("poses") == len(said) - 2)
        live.stop()
        (told,) = (one for one in heard.texts("input") if "length 1" in one)
        assert "has messages on /slam that are left out" in told
        with running(stream(short_drive, pipe, PoseTopic("/path"))) as notes:
            one = (*said[0][:1], "/path", "cdr", "nav_msgs/msg/Path", path, b"")
            write(pipe, write_as_it_comes(tmp_path / "path.mcap", [one]).read_bytes())
            notes.wait_told("give another with --poses-topic")


def test_what_is_no_mcap_is_told_and_what_follows_is_read(
    short_drive: Path, recorded: Path, pipe: Path
) -> None:
    with running(stream(short_drive, pipe)) as notes:
        write(pipe, b"no MCAP at all" * 10).join()
        notes.wait_told("what comes is no MCAP")
        notes.wait_told("is tried again")
        write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.frames) == 6)


def test_a_simulations_clock_has_its_epoch_from_the_user(
    short_drive: Path, recorded: Path, pipe: Path, tmp_path: Path
) -> None:
    """Stamps and the recorder's times count from the start of the simulation."""
    ros, messages = Maker("mcap"), list(messages_of(recorded))
    epoch_ns = messages[0][0] // 10**9 * 10**9 - 5 * 10**9
    said = []
    for time_ns, *about, data in messages:
        if about[2] != "std_msgs/msg/String":
            message = ros.store.deserialize_cdr(data, about[2])
            for one in (message, *getattr(message, "transforms", ())):
                if hasattr(one, "header") and one.header.stamp.sec:
                    one.header.stamp.sec -= epoch_ns // 10**9
            data = bytes(ros.store.serialize_cdr(message, about[2]))
        said.append((time_ns - epoch_ns, *about, data))
    simulated = write_as_it_comes(tmp_path / "simulated.mcap", said)
    kind = stream(short_drive, pipe)._kind
    with running(McapStream(str(pipe), kind)) as notes:
        writing = write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.frames) == 6 and len(notes.fixes) > 20)
        writing.join()
    frames_ns, fixes_ns = ([one.time_ns for one in them] for them in (notes.frames, notes.fixes))
    with running(McapStream(str(pipe), kind, epoch_ns=epoch_ns)) as notes:
        writing = write(pipe, simulated.read_bytes())
        notes.wait(lambda: len(notes.frames) == 6 and len(notes.fixes) > 20)
        writing.join()
    assert [frame.time_ns for frame in notes.frames] == frames_ns
    assert [fix.time_ns for fix in notes.fixes] == fixes_ns
    with running(McapStream(str(pipe), kind)) as notes:
        write(pipe, simulated.read_bytes())
        notes.wait(lambda: any("say with --epoch" in text for text in notes.told))
    assert not notes.frames
    assert not notes.fixes


def test_topics_of_other_names(short_drive: Path, recorded: Path, pipe: Path) -> None:
    with running(stream(short_drive, pipe, left="/nothing")) as notes:
        writing = write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.fixes) > 20)
    assert not notes.frames
    writing.join()  # what it has left would be the begin of what is read next
    images = McapStream(str(pipe), stream(short_drive, pipe)._kind, takes_fixes=False)
    with running(images) as notes:
        write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.frames) == 6)
    assert not notes.fixes
    with pytest.raises(ConfigError, match="give one of left, right"):
        stream(short_drive, pipe, middle="/camera")
    with pytest.raises(ConfigError, match="is no MCAP; give"):
        McapStream("udp://:9000", stream(short_drive, pipe)._kind)
