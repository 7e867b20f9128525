"""Poses of other programs: what is read, in which frame, and what is refused."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldgrid.core import ConfigError, FieldgridError, Float64, Int64, RecordingError
from fieldgrid.geometry import GivenPoses
from fieldgrid.recordings import DriveOptions, PoseSource, open_drive
from fieldgrid.recordings.poses.pose_files import read_pose_file, read_time_file
from tests.conftest import TWO_LANES
from tests.recordings.bags import Maker, Said, write_bag

RTK = "gnss_rtk.nmea"
R_FLU_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


class Truth(NamedTuple):
    """The frames of the example as they truly were: the left camera and the middle of the pair in
    the LTP, and the camera's axes."""

    time_ns: Int64
    left_m: Float64
    middle_m: Float64
    heading_deg: Float64
    R_enu_camera: Rotation


@pytest.fixture(scope="module")
def truth() -> Truth:
    with (TWO_LANES / "truth" / "poses_frames.csv").open() as file:
        rows = list(csv.DictReader(file))

    def columns(*names: str) -> Float64:
        return np.array([[float(row[name]) for name in names] for row in rows])

    return Truth(
        np.array([round(float(row["timestamp_utc_s"]) * 1000) * 1_000_000 for row in rows]),
        columns("cam_left_E", "cam_left_N", "cam_left_U"),
        columns("cam_mid_E", "cam_mid_N", "cam_mid_U"),
        columns("heading_deg")[:, 0],
        Rotation.from_quat(columns("qx_cam_to_enu", "qy", "qz", "qw")),
    )


def tum(path: Path, time_ns: Int64, place_m: Float64, turned: Rotation) -> Path:
    lines = ["# t x y z qx qy qz qw"]
    for time, place, q in zip(time_ns.tolist(), place_m, turned.as_quat(), strict=True):
        numbers = " ".join(f"{value:.9f}" for value in (*place, *q))
        lines.append(f"{time // 10**9}.{time % 10**9:09d} {numbers}")
    path.write_text("\n".join(lines) + "\n")
    return path


def kitti(path: Path, place_m: Float64, turned: Rotation) -> Path:
    rows = np.concatenate([turned.as_matrix(), place_m[:, :, None]], axis=2).reshape(-1, 12)
    path.write_text("\n".join(" ".join(f"{value:.9e}" for value in row) for row in rows))
    return path


def given(source: PoseSource, recording: Path = TWO_LANES) -> GivenPoses:
    with open_drive(recording, DriveOptions(RTK, poses=source)) as drive:
        poses = drive.motion().poses
        assert poses is not None
        assert source.file is None or drive.pose_name.startswith(source.file.name)
        return poses


def check(poses: GivenPoses, truth: Truth, *, most_m: float = 1e-3, most_deg: float = 0.01) -> None:
    """The poses are those of the middle of the pair, but for a turn and a shift of their frame."""
    assert poses.time_ns.tolist() == truth.time_ns.tolist()
    turn = np.radians(truth.heading_deg[0] - poses.heading_deg[0])
    off_deg = (poses.heading_deg - truth.heading_deg + np.degrees(turn) + 180.0) % 360.0 - 180.0
    assert np.abs(off_deg).max() < most_deg
    x, y = poses.x_m - poses.x_m[0], poses.y_m - poses.y_m[0]
    east, north = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    wanted = truth.middle_m - truth.middle_m[0]
    found = np.stack([east, north, poses.z_m - poses.z_m[0]], axis=1)
    assert np.abs(found - wanted).max() < most_m


# --- frames and bodies


def test_a_camera_in_a_level_frame(truth: Truth, tmp_path: Path) -> None:
    """A point ahead of the sensor leads it around: without it, places are off."""
    path = tum(tmp_path / "a.tum", truth.time_ns, truth.left_m, truth.R_enu_camera)
    for point in (None, (0.0, 0.09, 0.0)):
        check(given(PoseSource(path, axes="rdf", point_flu_m=point)), truth)
    with pytest.raises(AssertionError):
        check(given(PoseSource(path, axes="rdf", point_flu_m=(1.0, 0.0, 0.0))), truth)


def test_a_camera_in_the_frame_of_its_first_image(truth: Truth, tmp_path: Path) -> None:
    """As KITTI and visual SLAM write it: the frame leans as the first camera did, and level is
    where the vehicle stood on average."""
    first = truth.R_enu_camera[0].inv()
    place_m = first.apply(truth.left_m - truth.left_m[0])
    path = kitti(tmp_path / "00.txt", place_m, first * truth.R_enu_camera)
    check(given(PoseSource(path, axes="rdf")), truth, most_m=0.6, most_deg=0.1)
    times = tmp_path / "times.txt"
    times.write_text("\n".join(f"{(t - truth.time_ns[0]) / 1e9:.6f}" for t in truth.time_ns))
    source = PoseSource(path, axes="rdf", times=times, offset_ns=int(truth.time_ns[0]))
    check(given(source), truth, most_m=0.6, most_deg=0.1)


@pytest.mark.parametrize(("axes", "flip"), [("flu", [1.0, 1.0, 1.0]), ("frd", [1.0, -1.0, -1.0])])
def test_a_body_of_the_vehicle(axes: str, flip: list[float], truth: Truth, tmp_path: Path) -> None:
    """Axes as ROS has them in a frame with z up, and as aircraft have them in one with z down."""
    tilt = Rotation.from_euler("x", -16.0, degrees=True)  # the camera looks down
    R_enu_flu = (truth.R_enu_camera * tilt.inv() * Rotation.from_matrix(R_FLU_CAMERA.T)).as_matrix()
    M = np.diag(flip)
    path = tum(
        tmp_path / "a.tum",
        truth.time_ns,
        truth.middle_m @ M,
        Rotation.from_matrix(M @ R_enu_flu @ M),
    )
    check(given(PoseSource(path, axes=axes, point_flu_m=(0.0, 0.0, 0.0))), truth)


@pytest.mark.parametrize("kind", ["Odometry", "PoseStamped", "Path"])
def test_topics(kind: str, truth: Truth, tmp_path: Path) -> None:
    ros = Maker("mcap")
    quaternions = truth.R_enu_camera.as_quat()

    def pose(k: int) -> object:
        x, y, z, w = quaternions[k].tolist()
        place = dict(zip("xyz", truth.left_m[k].tolist(), strict=True))
        return ros.of(
            "geometry_msgs/msg/Pose",
            position=ros.of("geometry_msgs/msg/Point", **place),
            orientation=ros.of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )

    def said(k: int, kind: str) -> object:
        header = ros.header(int(truth.time_ns[k]), "map")
        if kind == "PoseStamped":
            return ros.of("geometry_msgs/msg/PoseStamped", header=header, pose=pose(k))
        if kind == "Path":
            poses = [said(j, "PoseStamped") for j in range(k + 1)]
            return ros.of("nav_msgs/msg/Path", header=header, poses=poses)
        still = dict.fromkeys(("linear", "angular"), ros.vector(0, 0, 0))
        with_covariance = {
            part: ros.of(
                f"geometry_msgs/msg/{of}",
                **{part: value},
                covariance=np.diag([0.01, 0.04, 1e6, 1.0, 1.0, k * 1e-4]).ravel(),
            )
            for part, of, value in (
                ("pose", "PoseWithCovariance", pose(k)),
                ("twist", "TwistWithCovariance", ros.of("geometry_msgs/msg/Twist", **still)),
            )
        }
        return ros.of(
            "nav_msgs/msg/Odometry", header=header, child_frame_id="camera", **with_covariance
        )

    every = range(0, len(truth.time_ns), 1 if kind != "Path" else 49)
    messages = [Said(int(truth.time_ns[k]), "/slam", said(k, kind)) for k in every]
    bag = write_bag(tmp_path / "slam", "mcap", ros, messages)
    poses = given(PoseSource(bag, axes="rdf"))
    check(poses, truth)
    stated = [0.2, np.degrees(0.01)] if kind == "Odometry" else [np.nan, np.nan]
    assert [poses.sigma_m[1], poses.sigma_deg[1]] == pytest.approx(stated, nan_ok=True)
    assert np.isnan(poses.sigma_deg[0])  # a variance of 0 is none
    with pytest.raises(RecordingError, match=r"/other is not there; a topic of poses is one of"):
        given(PoseSource(bag, topic="/other", axes="rdf"))


@pytest.mark.parametrize("kind", ["nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"])
def test_topics_of_a_simulations_clock(kind: str, tmp_path: Path) -> None:
    """The stamps of the poses and of their messages count from the start of the simulation."""
    ros, epoch_ns, times_ns = Maker("mcap"), 1_750_000_000 * 10**9, [5 * 10**9, 7 * 10**9]
    pose = ros.of(
        "geometry_msgs/msg/Pose",
        position=ros.of("geometry_msgs/msg/Point", x=1.0, y=2.0, z=0.0),
        orientation=ros.of("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    stamped = [
        ros.of("geometry_msgs/msg/PoseStamped", header=ros.header(time_ns, "map"), pose=pose)
        for time_ns in times_ns
    ]
    said = [Said(time_ns, "/slam", one) for time_ns, one in zip(times_ns, stamped, strict=True)]
    if kind == "nav_msgs/msg/Path":
        path = ros.of(kind, header=ros.header(times_ns[-1], "map"), poses=stamped)
        said = [Said(times_ns[-1], "/slam", path)]
    fixes = [Said(time_ns, "/fix", ros.fix(time_ns, 41.65, -4.72, 700.0)) for time_ns in times_ns]
    bag = write_bag(tmp_path / "slam", "mcap", ros, [*said, *fixes])
    options = DriveOptions(poses=PoseSource(topic="/slam"), unmounted=True, epoch_ns=epoch_ns)
    with open_drive(bag, options) as drive:
        poses = drive.motion().poses
        assert poses is not None
        assert poses.time_ns.tolist() == [epoch_ns + time_ns for time_ns in times_ns]
        assert drive.fixes().time_ns.tolist() == poses.time_ns.tolist()


def test_recording_toml_names_them(truth: Truth, tmp_path: Path) -> None:
    """Options outrank it one by one."""
    folder = tmp_path / "june"
    for name in ("gnss", "calibration"):
        shutil.copytree(TWO_LANES / name, folder / name)
    tum(folder / "slam.tum", truth.time_ns, truth.left_m, truth.R_enu_camera)
    (folder / "recording.toml").write_text(
        '[poses]\nfile = "slam.tum"\naxes = "flu"\ntime_offset_s = 0.5\n'
    )
    poses = given(PoseSource(axes="rdf"), folder)
    assert poses.time_ns.tolist() == (truth.time_ns + 500_000_000).tolist()
    (folder / "recording.toml").write_text('[poses]\nfile = "../slam.tum"\n')
    with pytest.raises(RecordingError, match="leads out of the recording"):
        open_drive(folder, DriveOptions(RTK))


# --- files


def test_numbers_are_those_of_another_reader(truth: Truth, tmp_path: Path) -> None:
    path = tum(tmp_path / "a.tum", truth.time_ns, truth.left_m, truth.R_enu_camera)
    read, table = read_pose_file(path), np.loadtxt(path)
    assert np.abs(Rotation.from_quat(table[:, 4:]).as_matrix() - read.R).max() < 1e-9
    assert read.position_m == pytest.approx(table[:, 1:4])
    assert read.time_ns is not None
    assert read.time_ns.tolist() == truth.time_ns.tolist()  # to the nanosecond
    path = kitti(tmp_path / "a.txt", truth.left_m, truth.R_enu_camera)
    read, matrices = read_pose_file(path), np.loadtxt(path).reshape(-1, 3, 4)
    assert read.time_ns is None
    assert np.array_equal(read.R, matrices[:, :, :3])
    assert np.array_equal(read.position_m, matrices[:, :, 3])


def test_units_of_time(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    for text in ("1308133815.469000001", "1308133815469000001"):
        path.write_text(f"{text}\n")
        assert read_time_file(path, 0).tolist() == [1308133815469000001]
    path.write_text("0\n1.5e0\n")
    start_ns = 1308133815 * 10**9 + 5
    assert read_time_file(path, start_ns).tolist() == [start_ns, start_ns + 1_500_000_000]


GOOD = "1308133815.0 0 0 0 0 0 0 1\n1308133816.0 1 0 0 0 0 0 1\n1308133817.0 2 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty; give a trajectory of TUM"),
        ("1 2 3\n", "has 3 numbers a line; give a trajectory of TUM"),
        (GOOD + "1308133818.0 2 0 0 0 0 0\n", "line 4: 7 numbers, and the first line has 8"),
        (GOOD + "1308133818.0 2 0 0 0 0 0 x\n", "no number: 'x'"),
        (GOOD + "1308133818.0 nan 0 0 0 0 0 1\n", r"line 4: it holds NaN"),
        (GOOD + "1308133818.0 9e9 0 0 0 0 0 1\n", "line 4: .*, or a number beyond"),
        (GOOD + "1308133818.0 2 0 0 0 0 0 2\n", "line 4: its quaternion has not the length 1"),
        (GOOD.replace("13081338", "0"), "'015.0' is no UTC time since 1970; if the times count"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 1: its first three columns are no rotation"),
        ("1 0 0 0 0 2 0 0 0 0 1 0\n", "line 1: its first three columns are no rotation"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", r"has 1 poses for 50 frames; give one for each"),
        (GOOD.splitlines()[0], "has 1 poses; give those of a drive"),
        (GOOD.replace("0 0 0 1\n", "1 0 0 0\n"), r"points along \(\+0.00, \+0.00, -1.00\)"),
        (GOOD.replace(" 0 0 0 0 0 1", " 0 0 0 0 0.7071 0.7071"), "mostly to its side"),
    ],
)
def test_what_is_no_trajectory(text: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "slam.txt"
    path.write_text(text)
    with pytest.raises(RecordingError, match=sentence) as error:
        given(PoseSource(path))
    assert str(error.value).count("\n") == 0


def test_poses_of_the_same_time_are_told(tmp_path: Path) -> None:
    path = tmp_path / "slam.tum"
    path.write_text(GOOD + GOOD.splitlines()[0])
    with open_drive(TWO_LANES, DriveOptions(RTK, poses=PoseSource(path))) as drive:
        assert any("1 pose without a time, or of the same time" in note for note in drive.notes)
    with pytest.raises(ConfigError, match="have their own times; leave --poses-times out"):
        given(PoseSource(path, times=path))
    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(RecordingError, match="no frames that they could be of; give their times"):
        open_drive(TWO_LANES / "gnss" / RTK, DriveOptions(poses=PoseSource(path)))


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        (PoseSource(axes="rdf"), "not where; give --poses FILE"),
        (PoseSource(Path("nowhere.tum")), "cannot be read: No such file"),
        (PoseSource(TWO_LANES), "is not a regular file"),
        (PoseSource(TWO_LANES / "frames.csv", axes="fru"), "the three axes of the body of poses"),
        (PoseSource(TWO_LANES / "frames.csv", topic="/a"), "is no bag and has no topics"),
        (PoseSource(topic="/slam"), "is no bag and has no topics"),
    ],
)
def test_what_cannot_be_meant(source: PoseSource, sentence: str) -> None:
    with pytest.raises(FieldgridError, match=sentence):
        given(source)
