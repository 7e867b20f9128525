"""Roll and pitch by orientations in bags: of an IMU's own estimate, odometry, poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldgrid.geometry import Motion, Orientation, R_enu_level, R_level_vehicle
from fieldgrid.poses.attitude.axes import axes_of_orientation
from fieldgrid.poses.attitude.estimate import estimate_attitude
from fieldgrid.poses.attitude.measurements import AntennaTrack
from fieldgrid.recordings import (
    ORIENTATION,
    DriveOptions,
    Message,
    decode,
    lean_of,
    open_drive,
    orientation_of,
)
from fieldgrid.recordings.ros.bag import Take, open_bag
from fieldgrid.recordings.ros.gnss_messages import tilt_messages
from tests.hilly import hike, hills
from tests.poses.attitude.test_attitude import ANTENNA_M, FIELD, FRAMES, score, track_of
from tests.recordings import bags
from tests.recordings.bags import CONTAINERS, Container, Maker, Said

R_FLU_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
START_NS = 1_700_000_000_000_000_000
STAMPS = range(0, 8_000_000_000, 100_000_000)
ROLL_DEG, PITCH_DEG = 3.0, 8.0
"""The right side down and the nose up; both grow by half over the drive."""


def quaternion(R: np.ndarray) -> tuple[float, ...]:
    """x, y, z, w."""
    return tuple(Rotation.from_matrix(R).as_quat().tolist())


def leans(k_ns: int, roll: float = ROLL_DEG, pitch: float = PITCH_DEG) -> np.ndarray:
    """The body's axes forward, left, up in east, north, up, of a vehicle that turns."""
    share = 1.0 + k_ns / 16e9
    level = R_enu_level(-20.0 - k_ns / 1e9)
    R_enu_vehicle = level @ R_level_vehicle(roll * share, pitch * share)
    return np.asarray(R_enu_vehicle @ R_FLU_VEHICLE.T)


def expected(stamps_ns: np.ndarray) -> np.ndarray:
    share = 1.0 + (stamps_ns - START_NS) / 16e9
    return np.stack([ROLL_DEG * share, PITCH_DEG * share])


class Told:
    """Messages of a lean by a maker, `R_body` the axes that they are of in forward, left, up."""

    def __init__(self, maker: Maker, R_body: np.ndarray | None = None) -> None:
        self.maker, self.R_body = maker, np.eye(3) if R_body is None else R_body

    def turn(self, k_ns: int, **lean: float) -> Any:
        return self.maker.quaternion(*quaternion(leans(k_ns, **lean) @ self.R_body))

    def imu(
        self, k_ns: int, variance: float = 0.0, *, frame: str = "imu_link", **lean: float
    ) -> Any:
        message = self.maker.imu(START_NS + k_ns, (0.0, 0.0, 0.0), frame)
        # Without an accelerometer, by the message's definition.
        none = np.array([-1.0, *[0.0] * 8])
        return replace(
            message,
            orientation=self.turn(k_ns, **lean),
            orientation_covariance=np.array([variance, *[0.0] * 8]),
            linear_acceleration_covariance=none,
        )

    def pose(self, k_ns: int, variance: float, **lean: float) -> Any:
        pose = self.maker.of(
            "geometry_msgs/msg/Pose",
            position=self.maker.of("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
            orientation=self.turn(k_ns, **lean),
        )
        covariance = np.zeros(36)
        covariance[21], covariance[28] = variance / 2.0, variance
        return self.maker.of(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance
        )

    def odometry(self, k_ns: int, variance: float = 0.0, **lean: float) -> Any:
        message = self.maker.odometry(START_NS + k_ns, 1.0)
        return replace(message, pose=self.pose(k_ns, variance, **lean))

    def stamped(self, k_ns: int, *, sure: bool) -> Any:
        header, pose = self.maker.header(START_NS + k_ns, "map"), self.pose(k_ns, 0.0)
        name = "PoseWithCovarianceStamped" if sure else "PoseStamped"
        held = pose if sure else pose.pose
        return self.maker.of(f"geometry_msgs/msg/{name}", header=header, pose=held)


def said(topic: str, make: Callable[[int], Any]) -> Iterator[Said]:
    for k_ns in STAMPS:
        yield Said(START_NS + k_ns, topic, make(k_ns))


def motion_of(
    folder: Path,
    messages: Callable[[Maker], Iterator[Said]],
    container: Container = "mcap",
    **topics: str,
) -> tuple[Motion, tuple[str, ...]]:
    maker = Maker(container)
    fixes = [
        Said(START_NS + k, "/fix", maker.fix(START_NS + k, 39.5, -1.1 + k * 1e-15, 700.0))
        for k in STAMPS
    ]
    path = bags.write_bag(folder / "bag", container, maker, [*fixes, *messages(maker)])
    with open_drive(path, DriveOptions(topics=topics)) as drive:
        return drive.motion(), drive.notes


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("kind", ["imu", "odometry", "pose", "sure pose"])
def test_roll_and_pitch_come_out_of_every_container(
    kind: str, container: Container, tmp_path: Path
) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        told = Told(maker)
        makes: dict[str, Callable[[int], Any]] = {
            "imu": told.imu,
            "odometry": told.odometry,
            "pose": lambda k: told.stamped(k, sure=False),
            "sure pose": lambda k: told.stamped(k, sure=True),
        }
        yield from said("/leans", makes[kind])

    given = {"attitude": "/leans"} if "pose" in kind else {}
    motion, notes = motion_of(tmp_path, messages, container, **given)
    found = motion.orientation
    assert found is not None
    assert "/leans: roll and pitch by its orientation." in notes
    assert found.time_ns.tolist() == [START_NS + k for k in STAMPS]
    assert np.stack([found.roll_deg, found.pitch_deg]) == pytest.approx(
        expected(found.time_ns), abs=1e-4
    )
    assert set(found.sigma_deg) == {1.0}  # zeros in a covariance are no error of nothing
    assert set(found.frame_sigma_deg) == {0.0 if kind == "imu" else 2.0}


@pytest.mark.parametrize(
    ("variance", "sigma_deg"),
    [(math.radians(1.5) ** 2, 1.5), (math.radians(0.01) ** 2, 0.5), (0.0, 1.0)],
)
def test_a_stated_error_counts_with_a_floor(
    variance: float, sigma_deg: float, tmp_path: Path
) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        yield from said("/odom", lambda k: Told(maker).odometry(k, variance))

    found = motion_of(tmp_path, messages)[0].orientation
    assert found is not None
    assert found.sigma_deg == pytest.approx(sigma_deg, rel=1e-4)


@pytest.mark.parametrize("variance", [-1.0, 1e6, math.inf])
def test_what_says_that_it_does_not_know_is_believed(variance: float, tmp_path: Path) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        if variance == -1.0:
            yield from said("/imu", lambda k: Told(maker).imu(k, -1.0))
        else:
            yield from said("/odom", lambda k: Told(maker).odometry(k, variance))

    motion, _ = motion_of(tmp_path, messages)
    if variance == math.inf:  # nonsense is no statement
        assert motion.orientation is not None
    else:
        assert motion.orientation is None


def test_odometry_in_the_plane_is_not_taken_for_level_ground(tmp_path: Path) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        yield from said("/odom", lambda k: Told(maker).odometry(k, roll=0.0, pitch=0.0))

    motion, notes = motion_of(tmp_path, messages)
    assert motion.orientation is None
    assert motion.wheels is not None
    given, notes = motion_of(tmp_path / "given", messages, attitude="/odom")
    assert given.orientation is None
    assert any(note.startswith("/odom: tells no roll and pitch: its orientation") for note in notes)


def test_a_static_transform_tells_how_the_imu_sits(tmp_path: Path) -> None:
    # x to the left, y backward, z up
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def messages(maker: Maker) -> Iterator[Said]:
        yield from said("/imu", Told(maker, R).imu)
        tree = maker.transform("base_link", "imu_link", (0, 0, 0), quaternion(R))
        yield Said(START_NS, "/tf_static", maker.transforms(tree))

    found = motion_of(tmp_path, messages)[0].orientation
    assert found is not None
    assert np.stack([found.roll_deg, found.pitch_deg]) == pytest.approx(
        expected(found.time_ns), abs=1e-4
    )


def test_a_static_transform_tells_how_the_body_of_odometry_sits(tmp_path: Path) -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def messages(maker: Maker) -> Iterator[Said]:
        told = Told(maker, R)
        yield from said("/odom", lambda k: replace(told.odometry(k), child_frame_id="sensor"))
        tree = maker.transform("base_link", "sensor", (0, 0, 0), quaternion(R))
        yield Said(START_NS, "/tf_static", maker.transforms(tree))

    found = motion_of(tmp_path, messages)[0].orientation
    assert found is not None
    assert found.pitch_deg == pytest.approx(expected(found.time_ns)[1], abs=1e-4)


def test_an_accelerometer_tells_it_better_unless_the_topic_is_given(tmp_path: Path) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        told = Told(maker)
        for k_ns in STAMPS:
            up = leans(k_ns)[2] * 9.81
            message = maker.imu(START_NS + k_ns, (0.1, 0.0, 0.2), forces=tuple(up.tolist()))
            yield Said(START_NS + k_ns, "/imu", replace(message, orientation=told.turn(k_ns)))

    assert motion_of(tmp_path, messages)[0].orientation is None
    motion, _ = motion_of(tmp_path / "given", messages, attitude="/imu")
    assert motion.orientation is not None
    assert motion.inertial is not None


NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.diag([1.0, -1.0, -1.0])


@pytest.mark.parametrize("given", [False, True], ids=["found", "given"])
@pytest.mark.parametrize("frame", ["ned", "enu"])
def test_an_imu_forward_right_down_needs_its_axes(frame: str, given: bool, tmp_path: Path) -> None:
    """In a frame north, east, down its vertical looks upright, and its pitch is inverted."""

    def messages(maker: Maker) -> Iterator[Said]:
        for k_ns in STAMPS:
            R = leans(k_ns)
            felt = FRD @ R.T @ np.array([0.0, 0.0, 9.81])
            message = maker.imu(START_NS + k_ns, (0.1, 0.05, 0.2), forces=tuple(felt.tolist()))
            turn = quaternion((NED if frame == "ned" else np.eye(3)) @ R @ FRD)
            yield Said(
                START_NS + k_ns, "/imu", replace(message, orientation=maker.quaternion(*turn))
            )

    motion, notes = motion_of(tmp_path, messages, **({"attitude": "/imu"} if given else {}))
    assert motion.orientation is None
    (note,) = (note for note in notes if "tells no roll and pitch" in note)
    assert "say how it sits by imu_axes in mounting.json" in note


def test_without_an_accelerometer_a_vertical_downward_needs_its_axes(tmp_path: Path) -> None:
    def imu(maker: Maker) -> Iterator[Said]:
        yield from said("/imu", Told(maker, FRD).imu)

    def odometry(maker: Maker) -> Iterator[Said]:
        yield from said("/odom", Told(maker, FRD).odometry)

    motion, notes = motion_of(tmp_path, imu)
    assert motion.orientation is None
    assert any("say how it sits by imu_axes" in note for note in notes)
    motion, notes = motion_of(tmp_path / "odometry", odometry)
    assert motion.orientation is None
    assert any("say how it sits by a static transform." in note for note in notes)


def test_a_topic_that_is_given_counts_before_what_a_conversion_kept(tmp_path: Path) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        yield from said("/leans", lambda k: Told(maker).stamped(k, sure=False))
        times = START_NS + np.array([0, 1]) * 1_000_000_000
        kept = Orientation(times, *np.ones((4, 2)))
        for time_ns, message in tilt_messages(kept):
            yield Said(time_ns, ORIENTATION, maker.of("std_msgs/msg/String", data=message.data))

    motion, _ = motion_of(tmp_path, messages)
    assert motion.orientation is not None
    assert len(motion.orientation.time_ns) == 2
    motion, _ = motion_of(tmp_path / "given", messages, attitude="/leans")
    assert motion.orientation is not None
    assert len(motion.orientation.time_ns) == len(STAMPS)


# --- the orientation alone


def of_quaternions(turns: list[tuple[float, ...]], R_flu_body: np.ndarray | None = None) -> Any:
    times = np.arange(1, len(turns) + 1) * 100_000_000
    R = np.eye(3) if R_flu_body is None else R_flu_body
    return orientation_of(times, told_by(turns), R, 0.0, axes_known=R_flu_body is not None)


def told_by(turns: list[tuple[float, ...]]) -> np.ndarray:
    maker = Maker("mcap")
    imu = maker.imu(1, (0, 0, 0))
    return np.array([lean_of(replace(imu, orientation=maker.quaternion(*turn))) for turn in turns])


def test_a_frame_that_points_down_with_a_body_that_does_is_upright() -> None:
    down = np.diag([1.0, -1.0, -1.0])  # north, east, down of a body forward, right, down
    turns = [quaternion(down @ leans(k) @ down) for k in STAMPS]
    found = of_quaternions(turns, down)
    assert found.pitch_deg[0] == pytest.approx(PITCH_DEG, abs=1e-4)
    assert found.roll_deg[0] == pytest.approx(ROLL_DEG, abs=1e-4)


def test_a_body_on_its_side_is_named() -> None:
    side = R_level_vehicle(90.0, 0.0)
    found = of_quaternions([quaternion(leans(k) @ side) for k in STAMPS])
    assert found.by_axes
    assert "lies on its side" in found.why


def test_a_vertical_downward_needs_known_axes() -> None:
    down = np.diag([1.0, -1.0, -1.0])
    turns = [quaternion(leans(k) @ down) for k in STAMPS]  # an IMU upside down
    assert of_quaternions(turns).by_axes
    found = of_quaternions(turns, down)
    assert found.pitch_deg[0] == pytest.approx(PITCH_DEG, abs=1e-4)


def test_quaternions_of_nothing_are_skipped_and_near_ones_thinned() -> None:
    turns = [(0.0, 0.0, 0.0, 0.0), *(quaternion(leans(k)) for k in STAMPS)]
    found = of_quaternions(turns)
    assert len(found.time_ns) == len(STAMPS)
    assert "fewer than two" in of_quaternions(turns[:2]).why
    near = told_by([quaternion(leans(k * 5_000_000)) for k in range(200)])
    times = np.arange(1, 201) * 5_000_000
    thin = orientation_of(times, near, np.eye(3), 0.0, axes_known=False)
    assert isinstance(thin, Orientation)
    assert np.diff(thin.time_ns).min() == 40_000_000


# --- what it is good for


def test_an_orientation_makes_the_attitude_of_a_drive_without_accelerometer() -> None:
    way = hike(hills(10.0, 45.0), FIELD)
    seen = way.at(np.arange(0.0, way.drive.time_s[-1], 0.05))
    turns = [quaternion(R @ R_FLU_VEHICLE.T) for R in seen.R]
    track: AntennaTrack = track_of(way)
    times = track.time_ns[0] + np.arange(len(turns)) * 50_000_000
    found = orientation_of(times, told_by(turns), np.eye(3), 0.0, axes_known=False)
    assert isinstance(found, Orientation)
    without = estimate_attitude(track, np.array(ANTENNA_M), wanted_ns=FRAMES)
    with_it = estimate_attitude(
        track, np.array(ANTENNA_M), wanted_ns=FRAMES, axes=axes_of_orientation(found)
    )
    assert score(way, without, FRAMES).percentile(95) > 3.0
    seen_score = score(way, with_it, FRAMES)
    assert seen_score.percentile(95) < 1.5
    assert seen_score.within_3_sigma() == 1.0


def test_a_real_imu_s_orientation_is_where_it_feels_gravity(
    shared_data: Callable[[str], Path],
) -> None:
    """The Husky's IMU stands on its edge: y is up, and it sees no vehicle axes."""
    told, forces = [], []

    def listen(name: str, _: str) -> Take | None:
        return take if name == "/imu/data" else None

    def take(message: Message, place: int) -> None:
        found = decode(message)
        told.append(lean_of(found))
        force = found.linear_acceleration
        forces.append((force.x, force.y, force.z))

    with open_bag(shared_data("husky_gps_rosbag") / "test1.bag", listen):
        pass
    up, sigma = np.split(np.array(told), [3], axis=1)
    usual, felt = up.mean(axis=0), np.mean(forces, axis=0)
    apart = np.cross(usual, felt) / (np.linalg.norm(usual) * np.linalg.norm(felt))
    assert np.degrees(np.linalg.norm(apart)) < 0.3
    assert usual @ felt > 0.0
    assert set(sigma.ravel().round(2)) == {2.01}
