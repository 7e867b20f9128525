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
from fieldgrid.poses.attitude.axes import axes_of_tilt
from fieldgrid.poses.attitude.estimate import estimate_attitude
from fieldgrid.poses.attitude.track import AntennaTrack
from fieldgrid.recordings import (
    ORIENTATION,
    DriveOptions,
    decode,
    lean_of,
    open_drive,
    orientation_of,
)
from fieldgrid.recordings.ros.bag import open_bag
from fieldgrid.recordings.ros.gnss_messages import tilt_messages
from tests.hilly import hike, hills
from tests.poses.attitude.test_attitude import ANTENNA_M, FIELD, FRAMES, score, track_of
from tests.recordings import bags
from tests.recordings.bags import CONTAINERS, Container, Maker, Said

R_FLU_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
UP, FRD, NED = np.eye(3), np.diag([1.0, -1.0, -1.0]), np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
LEFTWARD = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SIDEWAYS = R_level_vehicle(90.0, 0.0)
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

    def imu(self, k_ns: int, variance: float = 0.0) -> Any:
        # Without an accelerometer, by the message's definition.
        return replace(
            self.maker.imu(START_NS + k_ns, (0.0, 0.0, 0.0)),
            orientation=self.turn(k_ns),
            orientation_covariance=np.array([variance, *[0.0] * 8]),
            linear_acceleration_covariance=np.array([-1.0, *[0.0] * 8]),
        )

    def pose(self, k_ns: int, variance: float = 0.0, **lean: float) -> Any:
        pose = self.maker.of("geometry_msgs/msg/Pose", orientation=self.turn(k_ns, **lean))
        covariance = np.zeros(36)
        covariance[21], covariance[28] = variance / 2.0, variance
        name = "geometry_msgs/msg/PoseWithCovariance"
        return self.maker.of(name, pose=pose, covariance=covariance)

    def odometry(self, k_ns: int, variance: float = 0.0, **lean: float) -> Any:
        message = self.maker.odometry(START_NS + k_ns, 1.0)
        return replace(message, pose=self.pose(k_ns, variance, **lean), child_frame_id="imu_link")

    def stamped(self, k_ns: int) -> Any:
        header, pose = self.maker.header(START_NS + k_ns, "map"), self.pose(k_ns).pose
        return self.maker.of("geometry_msgs/msg/PoseStamped", header=header, pose=pose)

    def sure(self, k_ns: int) -> Any:
        header, pose = self.maker.header(START_NS + k_ns, "map"), self.pose(k_ns)
        name = "geometry_msgs/msg/PoseWithCovarianceStamped"
        return self.maker.of(name, header=header, pose=pose)

    def felt(self, k_ns: int, R_up: np.ndarray = UP) -> Any:
        """An IMU that feels gravity, whose orientation is in a frame that `R_up` turns."""
        R = leans(k_ns)
        forces = tuple((self.R_body.T @ R.T @ np.array([0.0, 0.0, 9.81])).tolist())
        message = self.maker.imu(START_NS + k_ns, (0.1, 0.05, 0.2), forces=forces)
        turn = self.maker.quaternion(*quaternion(R_up @ R @ self.R_body))
        return replace(message, orientation=turn)


def said(make: Callable[[int], Any], topic: str = "/leans") -> Iterator[Said]:
    for k_ns in STAMPS:
        yield Said(START_NS + k_ns, topic, make(k_ns))


Messages = Callable[[Maker], Iterator[Said]]


def motion_of(
    folder: Path, messages: Messages, container: Container = "mcap", **topics: str
) -> tuple[Motion, tuple[str, ...]]:
    maker = Maker(container)
    fixes = said(lambda k: maker.fix(START_NS + k, 39.5, -1.1 + k * 1e-15, 700.0), "/fix")
    path = bags.write_bag(folder / "bag", container, maker, [*fixes, *messages(maker)])
    with open_drive(path, DriveOptions(topics=topics)) as drive:
        return drive.motion(), drive.notes


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("kind", ["imu", "odometry", "stamped", "sure"])
def test_roll_and_pitch_come_out_of_every_container(
    kind: str, container: Container, tmp_path: Path
) -> None:
    given = {"attitude": "/leans"} if kind in ("stamped", "sure") else {}
    motion, notes = motion_of(
        tmp_path, lambda maker: said(getattr(Told(maker), kind)), container, **given
    )
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
    [
        (math.radians(1.5) ** 2, 1.5),
        (math.radians(0.01) ** 2, 0.5),
        (0.0, 1.0),
        (math.inf, 1.0),  # nonsense is no statement
        (1e6, None),
    ],
)
def test_a_stated_error_counts_with_a_floor(
    variance: float, sigma_deg: float | None, tmp_path: Path
) -> None:
    motion, _ = motion_of(tmp_path, lambda maker: said(lambda k: Told(maker).odometry(k, variance)))
    assert (motion.orientation is None) == (sigma_deg is None)
    if motion.orientation is not None:
        assert motion.orientation.sigma_deg == pytest.approx(sigma_deg, rel=1e-4)


@pytest.mark.parametrize("kind", ["imu", "odometry"])
def test_a_static_transform_tells_how_a_body_sits(kind: str, tmp_path: Path) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        yield from said(getattr(Told(maker, LEFTWARD), kind))
        tree = maker.transform("base_link", "imu_link", (0, 0, 0), quaternion(LEFTWARD))
        yield Said(START_NS, "/tf_static", maker.transforms(tree))

    found = motion_of(tmp_path, messages)[0].orientation
    assert found is not None
    assert np.stack([found.roll_deg, found.pitch_deg]) == pytest.approx(
        expected(found.time_ns), abs=1e-4
    )


LEVEL, BY_IMU = {"roll": 0.0, "pitch": 0.0}, "say how it sits by imu_axes in mounting.json"


@pytest.mark.parametrize(
    ("make", "given", "note"),
    [
        # An IMU that has no orientation, by its definition.
        (lambda m: said(lambda k: Told(m).imu(k, -1.0)), False, ""),
        # Odometry in the plane does not say that the ground is level.
        (lambda m: said(lambda k: Told(m).odometry(k, **LEVEL)), False, ""),
        (lambda m: said(lambda k: Told(m).odometry(k, **LEVEL)), True, ": its orientation never"),
        # An accelerometer tells it better.
        (lambda m: said(Told(m).felt), False, ""),
        # Of a body forward, right, down the vertical looks upright in a frame north, east, down,
        # and its pitch is inverted; without an accelerometer a vertical downward says nothing.
        *(
            (lambda m, up=up: said(lambda k: Told(m, FRD).felt(k, up)), given, BY_IMU)
            for up in (NED, UP)
            for given in (False, True)
        ),
        (lambda m: said(Told(m, FRD).imu), False, BY_IMU),
        (lambda m: said(Told(m, FRD).odometry), False, "say how it sits by a static transform."),
        # Lying on its side.
        (lambda m: said(Told(m, SIDEWAYS).imu), False, "lies on its side; " + BY_IMU),
    ],
)
def test_what_tells_no_roll_and_pitch(
    make: Messages, given: bool, note: str, tmp_path: Path
) -> None:
    motion, notes = motion_of(tmp_path, make, **({"attitude": "/leans"} if given else {}))
    assert motion.orientation is None
    assert motion.wheels is not None or motion.gyro is not None
    told = [one for one in notes if one.startswith("/leans: tells no roll and pitch")]
    assert len(told) == bool(note)
    assert note in "".join(told)


def test_an_orientation_that_is_asked_for_counts_beside_an_accelerometer(tmp_path: Path) -> None:
    motion, _ = motion_of(tmp_path, lambda m: said(Told(m).felt), attitude="/leans")
    assert motion.orientation is not None
    assert motion.inertial is not None


def test_a_topic_that_is_given_counts_before_what_a_conversion_kept(tmp_path: Path) -> None:
    def messages(maker: Maker) -> Iterator[Said]:
        yield from said(Told(maker).stamped)
        kept = Orientation(START_NS + np.array([0, 1]) * 1_000_000_000, *np.ones((4, 2)))
        for time_ns, message in tilt_messages(kept):
            yield Said(time_ns, ORIENTATION, maker.of("std_msgs/msg/String", data=message.data))

    for given, count in (({}, 2), ({"attitude": "/leans"}, len(STAMPS))):
        motion, _ = motion_of(tmp_path, messages, **given)
        assert motion.orientation is not None
        assert len(motion.orientation.time_ns) == count


# --- the orientation alone


def of_turns(turns: list[Any], step_ns: int, R_flu_body: np.ndarray | None = None) -> Any:
    """The orientation by rotations or quaternions, whose axes are known where they are said."""
    maker = Maker("mcap")
    imu = maker.imu(1, (0, 0, 0))
    xyzw = [turn if isinstance(turn, tuple) else quaternion(turn) for turn in turns]
    told = [lean_of(replace(imu, orientation=maker.quaternion(*one))) for one in xyzw]
    times = np.arange(1, len(turns) + 1) * step_ns
    R = np.eye(3) if R_flu_body is None else R_flu_body
    return orientation_of(times, np.array(told), R, 0.0, axes_known=R_flu_body is not None)


@pytest.mark.parametrize("R_frame", [UP, FRD])  # the latter with north, east, down as its frame
def test_a_body_whose_axes_are_known_may_point_down(R_frame: np.ndarray) -> None:
    found = of_turns([R_frame @ leans(k) @ FRD for k in STAMPS], 100_000_000, FRD)
    assert found.pitch_deg[0] == pytest.approx(PITCH_DEG, abs=1e-4)
    assert found.roll_deg[0] == pytest.approx(ROLL_DEG, abs=1e-4)


def test_quaternions_of_nothing_are_skipped_and_near_ones_thinned() -> None:
    turns = [(0.0, 0.0, 0.0, 0.0), *(leans(k) for k in STAMPS)]
    assert len(of_turns(turns, 100_000_000).time_ns) == len(STAMPS)
    assert "fewer than two" in of_turns(turns[:2], 100_000_000).why
    thin = of_turns([leans(k * 5_000_000) for k in range(200)], 5_000_000)
    assert np.diff(thin.time_ns).min() == 40_000_000


def test_an_orientation_makes_the_attitude_of_a_drive_without_accelerometer() -> None:
    way = hike(hills(10.0, 45.0), FIELD)
    seen = way.at(np.arange(0.0, way.drive.time_s[-1], 0.05))
    track: AntennaTrack = track_of(way)
    found = of_turns([R @ R_FLU_VEHICLE.T for R in seen.R], 50_000_000)
    found = found._replace(time_ns=found.time_ns - 50_000_000 + track.time_ns[0])
    arm = np.array(ANTENNA_M)
    without = estimate_attitude(track, arm, wanted_ns=FRAMES)
    with_it = estimate_attitude(track, arm, wanted_ns=FRAMES, axes=axes_of_tilt(found))
    assert score(way, without, FRAMES).percentile(95) > 3.0
    assert score(way, with_it, FRAMES).percentile(95) < 1.5
    assert score(way, with_it, FRAMES).within_3_sigma() == 1.0


def test_a_real_imu_s_orientation_is_where_it_feels_gravity(
    shared_data: Callable[[str], Path],
) -> None:
    """The Husky's IMU stands on its edge: y is up, and it sees no vehicle axes."""
    with open_bag(shared_data("husky_gps_rosbag") / "test1.bag") as bag:
        imus = [decode(message) for message in bag.messages({"/imu/data"})]
    up, sigma = np.split(np.array([lean_of(imu) for imu in imus]), [3], axis=1)
    forces = [imu.linear_acceleration for imu in imus]
    usual, felt = up.mean(axis=0), np.mean([(f.x, f.y, f.z) for f in forces], axis=0)
    apart = np.cross(usual, felt) / (np.linalg.norm(usual) * np.linalg.norm(felt))
    assert np.degrees(np.linalg.norm(apart)) < 0.3
    assert usual @ felt > 0.0
    assert set(sigma.ravel().round(2)) == {2.01}
