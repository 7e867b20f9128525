"""Poses of another program, pushed or replayed: the map of a build by the same poses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldgrid.core import BuildSettings, ConfigError, GnssError
from fieldgrid.geometry import Status
from fieldgrid.live import Live, LivePose, LiveWindow, finish_from, finish_session, replay
from fieldgrid.live.given import check_order, pose_rows
from fieldgrid.maps import open_map
from fieldgrid.pipeline import add_recording, build_map
from fieldgrid.recordings import (
    DriveOptions,
    PoseBody,
    PoseSource,
    Recording,
    open_recording,
    with_body_poses,
)
from fieldgrid.recordings.poses.pose_files import read_pose_file
from tests.live.making import Told, begin, slam, with_poses
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")


@pytest.fixture(scope="module")
def tum(short_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return slam(short_drive, tmp_path_factory.mktemp("poses") / "slam.tum")


@pytest.fixture(scope="module")
def built_by_poses(short_drive: Path, tum: Path) -> Path:
    out = tum.parent / "built.gpkg"
    build_map([short_drive], out, BuildSettings(), DriveOptions(poses=PoseSource(tum)))
    return out


@pytest.fixture
def given(short_drive: Path, tum: Path) -> Iterator[Recording]:
    with with_poses(short_drive, tum) as recording:
        yield recording


def test_a_replay_with_poses_makes_the_map_of_a_build(
    given: Recording, built_by_poses: Path, tmp_path: Path
) -> None:
    out, told = tmp_path / "m.gpkg", Told()
    with begin(given, out, on_result=told, poses=given.pose_body) as live:
        replay(live, given, rate=None)
        pushed = live.counts.rows["poses"]
    assert given.body_poses is not None
    assert given.body_poses.time_ns is not None
    assert pushed == len(given.body_poses.time_ns)
    assert content(out) == content(built_by_poses)
    with open_map(out) as universal:
        (session,) = universal.sessions()
        assert session.config["poses"] == "slam.tum"
        assert session.accepted == 6
    settled = [one.pose for one in told.of(LivePose) if one.is_settled]
    assert len(settled) == 6
    assert all(pose.status is Status.OK for pose in settled)
    assert max(window.view.observed.sum() for window in told.of(LiveWindow)) > 10_000
    # What the session was begun with says so, and the map has no step of a camera.
    assert not any("camera" in note for note in told.texts("pose"))


def test_pushed_poses_come_in_any_order_and_after_a_restart(
    short_drive: Path, tum: Path, built_by_poses: Path, tmp_path: Path
) -> None:
    out, body = tmp_path / "m.gpkg", PoseBody("slam.tum")
    written = np.loadtxt(tum)
    time_ns = read_pose_file(tum).time_ns
    assert time_ns is not None
    order = np.argsort(
        np.arange(len(time_ns)) + np.random.default_rng(3).uniform(0, 30, len(time_ns))
    )
    half = len(order) // 2
    with open_recording(short_drive) as recording:
        frames = list(recording.frames())
        live = begin(recording, out, poses=body)
        for fix in recording.fixes():
            live.push_fix(fix)
        for k in order[:half].tolist():
            live.push_pose(int(time_ns[k]), written[k, 1:4], written[k, 4:])
        for frame in frames[:3]:
            live.push_frame(frame, wait=True)
        live.drain()
        live.stop()
        # Another body is another session.
        with pytest.raises(ConfigError, match="holds the session 'drive'"):
            begin(recording, out, poses=PoseBody("slam.tum", "frd"))
        live = begin(recording, out, poses=body)
        rest = order[half:]
        live.push_pose(time_ns[rest], written[rest, 1:4], written[rest, 4:])
        for frame in frames[3:]:
            live.push_frame(frame, wait=True)
        live.close()
    assert content(out) == content(built_by_poses)


def test_poses_that_cannot_be_are_refused_and_not_kept(
    short_drive: Path, tum: Path, tmp_path: Path
) -> None:
    upright = [0.0, 0.0, 0.0, 1.0]
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "without.gpkg")
        with pytest.raises(ConfigError, match=r"begun without poses.*PoseBody"):
            live.push_pose(1, [0.0, 0.0, 0.0], upright)
        live.close()
        with pytest.raises(ConfigError, match="the body of poses"):
            begin(recording, tmp_path / "m.gpkg", poses=PoseBody(axes="fly"))
        live = begin(recording, tmp_path / "m.gpkg", poses=PoseBody())
        now_ns = int(recording.frame_times_ns()[0])
        live.push_pose(now_ns, [0.0, 0.0, 0.0], upright)
        live.push_pose(now_ns - 1_900_000_000, [0.0, 0.0, 0.0], upright)
        for position, quaternion, time_ns, why in (
            ([math.nan, 0.0, 0.0], upright, now_ns, "not finite"),
            ([0.0, 1e9, 0.0], upright, now_ns, "farther from its origin"),
            ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5], now_ns, r"\(0, 0, 0, 0.5\).*length 1"),
            ([0.0, 0.0, 0.0], [0.0, 0.0, math.nan, 1.0], now_ns, "nan.*length 1"),
            ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], now_ns, "x, y, z, w of each"),
            ([0.0, 0.0, 0.0], upright, now_ns - 2_100_000_000, "came 2.1 s after a newer one"),
        ):
            with pytest.raises(ConfigError, match=why):
                live.push_pose(time_ns, position, quaternion)
        assert live.counts.rows["poses"] == 2
        for frame in recording.frames(0, 2):
            live.push_frame(frame, wait=True)
        with pytest.raises(GnssError, match="The drive is kept in"):
            live.close()
        with pytest.raises(ConfigError, match="was driven by poses of poses"):
            finish_from(tmp_path / "m.gpkg", short_drive)


def test_lateness_goes_by_the_newest_before() -> None:
    rows = pose_rows([10, 30, 20, 31], np.zeros((4, 3)), [[0.0, 0.0, 0.0, 1.0]] * 4)
    assert check_order(rows, 0, 10) == 31
    with pytest.raises(ConfigError, match="after a newer one"):
        check_order(rows, 0, 9)
    assert check_order(rows, 40, 30) == 40


def test_poses_in_a_declared_frame_need_no_receiver(
    short_drive: Path, tum: Path, tmp_path: Path
) -> None:
    """A greenhouse: nothing but poses tells where the vehicle is."""
    pose = {
        "frame_origin": {"lat_deg": 41.65, "lon_deg": -4.72, "height_m": 787.4},
        "frame_heading_deg": 55.0,
        "accuracy_m": 0.05,
    }
    settings, told = BuildSettings(pose=pose), Told()
    with with_poses(short_drive, tum) as recording:
        body, written = recording.pose_body, recording.body_poses
        assert body is not None
        assert written is not None
        live = Live(
            tmp_path / "m.gpkg",
            recording.rig,
            settings,
            name="house",
            poses=body,
            on_result=told,
        )
        quaternions = Rotation.from_matrix(written.R).as_quat()
        frames = list(recording.frames())
        for k, time_ns in enumerate(written.time_ns if written.time_ns is not None else ()):
            live.push_pose(int(time_ns), written.position_m[k], quaternions[k])
            while frames and frames[0].time_ns <= time_ns:
                live.push_frame(frames.pop(0), wait=True)
        live.close()
    settled = [one for one in told.of(LivePose) if one.is_settled]
    assert len(settled) == 6
    assert any(window.is_trusted for window in told.of(LiveWindow))
    with open_map(tmp_path / "m.gpkg") as universal:
        assert universal.sessions()[0].accepted == 6


def test_poses_that_tell_how_the_vehicle_leans_make_level_grids(
    short_drive: Path, tmp_path: Path
) -> None:
    tum = slam(short_drive, tmp_path / "leaning.tum", roll_deg=2.0)
    options, out = DriveOptions(poses=PoseSource(tum)), tmp_path / "m.gpkg"
    build_map([short_drive], tmp_path / "built.gpkg", BuildSettings(), options)
    with with_poses(short_drive, tum) as recording:
        live = begin(recording, out, poses=recording.pose_body)
        replay(live, recording, rate=None)
        live.stop()
    report = finish_session(out)
    assert not any("fieldgrid build" in note for note in report.notes)
    with open_map(out) as ours:
        assert ours.sessions()[0].config["level_grids"]
    assert content(out) == content(tmp_path / "built.gpkg")


def test_what_poses_state_of_their_error_counts_as_in_a_build(
    given: Recording, built_by_poses: Path, tmp_path: Path
) -> None:
    body, poses = given.pose_body, given.body_poses
    assert body is not None
    assert poses is not None
    grows = np.arange(1.0, len(poses.R) + 1.0)[:, None] * [0.04, 0.01, 1e-3]
    stated = with_body_poses(given, poses._replace(variance=grows), body).recording()
    out, other = tmp_path / "m.gpkg", tmp_path / "other.gpkg"
    with begin(stated, out, poses=body) as live:
        replay(live, stated, rate=None)
    with open_map(out) as made, open_map(other, datum=made.datum) as universal:
        add_recording(universal, stated, BuildSettings(), name=stated.name)
    assert content(out) == content(other) != content(built_by_poses)
