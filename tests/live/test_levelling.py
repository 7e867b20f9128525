"""A drive that tells how its vehicle leans: level grids while it drives, and those of a build at
its end."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import BuildSettings, ConfigError, Float64, Int64
from fieldgrid.geometry import (
    GridSpec,
    Orientation,
    R_enu_level,
    R_level_vehicle,
    RecordedTilt,
    Tilt,
    from_vectors,
    roll_pitch_deg,
)
from fieldgrid.live import LiveGrid, LiveOptions, finish_from, finish_session, live_folder, replay
from fieldgrid.live.gridding_again import NO_POINTS
from fieldgrid.live.kept.kept_points import UNTOLD_NS, KeptPoints
from fieldgrid.live.kept.points import packed, unpacked
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.live.pose.running_tilt import CARRIED_S, RunningTilt, square_to_ground
from fieldgrid.live.pose.sensor_rows import RecentRows, rows_of
from fieldgrid.maps import create_map, open_map
from fieldgrid.perception import LocalGridder, Sweep
from fieldgrid.pipeline import (
    Progress,
    add_recording,
    build_map,
    convert_recording,
    estimate_drive,
    local_grid,
    read_journal,
)
from fieldgrid.poses import Attitude
from fieldgrid.recordings import DriveOptions, open_drive, open_recording
from tests.conftest import make_small_drive
from tests.live.making import Told, begin
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")


def points_bytes(out: Path) -> int:
    """How much the points of a session's frames take."""
    records = read_journal(live_folder(out) / "live")
    return sum(r.blobs[1].size for r in records if r.kind == "frame" and len(r.blobs) > 1)


def test_the_map_of_a_drive_with_an_imu_is_that_of_a_build(
    leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    assert points_bytes(out) > 6 * 50_000
    shown: list[Progress] = []
    report = finish_session(out, progress=shown.append)
    assert content(out) == content(built_level)
    assert not any("fieldgrid build" in note for note in report.notes)
    told = [(one.frames_done, one.frames_total) for one in shown]
    assert told == [(done, report.frames) for done in range(1, report.frames + 1)]
    assert not live_folder(out).exists()


@pytest.fixture(scope="module")
def depth_drive(leaning_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as depths in millimetres."""
    drive = tmp_path_factory.mktemp("depths") / "drive"
    shutil.copytree(leaning_drive, drive, symlinks=True, ignore=lambda *_: ["left", "right"])
    (drive / "depth").mkdir()
    with open_recording(leaning_drive) as recording:
        gridder, camera = LocalGridder(recording.rig), recording.rig.camera
        rows = ["frame_id,time_ns,depth\n"]
        for frame in recording.frames():
            values, row_start = gridder.matcher.disparity(*frame.images())
            depth_mm = np.zeros((camera.height_px, camera.width_px), np.uint16)
            seen = values > 48  # nearer than some fifty metres
            found_mm = 1000.0 * 16.0 * camera.focal_baseline_px_m / np.maximum(values, 1)
            depth_mm[row_start:][seen] = np.minimum(found_mm[seen], 60_000.0)
            cv2.imwrite(str(drive / "depth" / f"{frame.frame_id}.png"), depth_mm)
            rows.append(f"{frame.frame_id},{frame.time_ns},depth/{frame.frame_id}.png\n")
    (drive / "frames.csv").write_text("".join(rows))
    return drive


@pytest.mark.parametrize("part", ["imu", "tilt", "orientation"])
def test_pushed_depths_with_an_imu_or_angles_make_the_grids_of_a_build(
    part: str, depth_drive: Path, tmp_path: Path
) -> None:
    """Arrays, as a program of one's own pushes them."""
    drive = depth_drive
    angles = {"roll_deg": 3.0, "pitch_deg": -2.0, "sigma_deg": 0.3}
    with open_recording(drive) as recording:
        motion, fixes = recording.motion(), recording.fixes()
        at_ns = np.arange(fixes.time_ns[0], fixes.time_ns[-1], 100_000_000)
        tilt = RecordedTilt(at_ns, *(np.full(len(at_ns), value) for value in angles.values()))
        orientation = Orientation(*tilt, np.full(len(at_ns), 2.0))
        live = begin(recording, tmp_path / "live.gpkg")
        live.push_gyro(*motion.gyro)
        if part == "imu":
            live.push_imu(*motion.inertial)
        elif part == "tilt":
            live.push_tilt(*tilt)
        else:
            live.push_orientation(*orientation)
        for fix in fixes:
            live.push_fix(fix)
        for frame in recording.frames():
            live.push_depth(frame.source.read(), frame.time_ns, frame_id=frame.frame_id, wait=True)
        live.drain()
        live.finish()
        if part != "imu":
            kept = tilt if part == "tilt" else orientation
            said = motion._replace(inertial=None, **{part: kept})
            recording = replace(recording, log=recording.log._replace(motion=said))
        with create_map(tmp_path / "built.gpkg", estimate_drive(recording).trajectory.datum) as to:
            add_recording(to, recording, name="drive")
    with open_map(tmp_path / "live.gpkg") as ours, open_map(tmp_path / "built.gpkg") as theirs:
        assert ours.sessions()[0].config["level_grids"] is True
        made, expected = (
            {frame.frame_id: (frame.cells_sha256, frame.pose) for frame in one.frames("drive")}
            for one in (ours, theirs)
        )
    assert made == expected
    assert len(made) == 6


KITTI = "kitti_2011_09_30_drive_0020/2011_09_30/2011_09_30_drive_0020_sync"


@pytest.mark.long
@pytest.mark.parametrize("kind", ["slope", "bag", "kitti"])
def test_maps_of_slopes_bags_and_recorded_tilts_are_those_of_a_build(
    kind: str, shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    drive = shared_data(KITTI if kind == "kitti" else "vineyard_slope")
    options = DriveOptions(gnss=None if kind == "kitti" else "gnss_rtk.nmea")
    if kind == "bag":
        convert_recording(drive, tmp_path / "drive.mcap", options)
        drive, options = tmp_path / "drive.mcap", DriveOptions()
    build_map([drive], tmp_path / "built.gpkg", BuildSettings(), options)
    with (
        open_drive(drive, options) as opened,
        begin(opened.recording(), tmp_path / "live.gpkg") as live,
    ):
        replay(live, opened.recording(), rate=None)
    with open_map(tmp_path / "live.gpkg") as universal:
        assert universal.sessions()[0].config["level_grids"] is True
    assert content(tmp_path / "live.gpkg") == content(tmp_path / "built.gpkg")


def test_a_restart_goes_on_with_level_grids(
    leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        for part in ("gyro", "inertial"):
            values = getattr(recording.motion(), part)
            live.push_rows(part, rows_of(part, *values))
        for frame in recording.frames(0, 3):
            live.push_frame(frame, wait=True)
        live.drain()
        live.stop()
        with begin(recording, out) as live:
            assert live.counts.frames == 3
            replay(live, recording, rate=None)
    assert content(out) == content(built_level)


def test_without_room_for_points_the_grids_are_not_level(
    leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    out, options = tmp_path / "m.gpkg", LiveOptions(points_gb=0.0)
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out, options=options)
        replay(live, recording, rate=None)
        live.stop()
        again = begin(recording, tmp_path / "anew.gpkg", options=options)
        replay(again, recording, rate=None)
        again.stop()
    assert any("fieldgrid build" in note for note in finish_session(out).notes)
    with open_map(out) as ours, open_map(built_level) as theirs:
        assert ours.sessions()[0].config["level_grids"] is False
        # Its poses say so, too: they lie below the sensor along the vehicle's own axis.
        moved = [
            np.hypot(a.pose.east_m - b.pose.east_m, a.pose.north_m - b.pose.north_m)
            for a, b in zip(ours.frames("drive"), theirs.frames("drive"), strict=True)
        ]
        assert 0.0 < max(moved) < 0.3
    # A recording gives them all the same.
    other = make_small_drive(tmp_path / "other", range(30, 33))
    with pytest.raises(ConfigError, match="no frame of the time"):
        finish_from(tmp_path / "anew.gpkg", other)
    finish_from(tmp_path / "anew.gpkg", leaning_drive)
    assert content(tmp_path / "anew.gpkg") == content(built_level)


@pytest.mark.parametrize("tilt", [Tilt(0.5, 0.3, 0.2), None])
def test_frames_beyond_the_bound_are_as_level_as_they_were_while_driving(
    tilt: Tilt | None, leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RunningTilt, "at", lambda _self, _time_ns: tilt)
    out, told = tmp_path / "m.gpkg", Told()
    with open_recording(leaning_drive) as recording:
        # Of a frame some 150 kB: the points of two or three are kept.
        live = begin(recording, out, options=LiveOptions(points_gb=450e-6), on_result=told)
        replay(live, recording, rate=None)
        live.stop()
    assert 0 < points_bytes(out) <= 450_000
    (text,) = told.texts("disk")
    assert "take 0.00045 GB" in text
    report = finish_session(out)
    with open_map(out) as universal:
        assert universal.sessions()[0].config["level_grids"] is True
    as_driven = [note for note in report.notes if "were not kept to the end" in note]
    if tilt is not None:
        assert len(as_driven) == 1
        assert report.frames == 6
    else:  # those of which neither was known are left out, and named
        assert not as_driven
        assert 3 <= len(report.bad) == 6 - report.frames <= 4
        assert {one.reason for one in report.bad} == {NO_POINTS}


def test_points_of_a_drive_that_tells_no_lean_are_not_kept_for_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock_ns = [0]
    monkeypatch.setattr("fieldgrid.live.kept.kept_points.time.monotonic_ns", lambda: clock_ns[0])
    level, seen = points_of(tmp_path), Sweep(np.ones((50, 3), np.float32))
    assert level.packed(seen, 1_000)
    assert level.packed(seen, 1_000 + UNTOLD_NS)
    # Stamps alone do not say so.
    assert level.packed(seen, 1_001 + UNTOLD_NS)
    clock_ns[0] = 1 + UNTOLD_NS
    assert not level.packed(seen, 1_002 + UNTOLD_NS)
    assert not level.is_levelling
    # It is told when an IMU comes too late, once.
    level.note_rows("inertial", rows_of("inertial", 1, [0.0] * 3, [np.nan] * 3))
    assert not level.warnings
    for _ in range(2):
        level.note_rows("inertial", rows_of("inertial", 1, [0.0] * 3, [0.0, 0.0, 9.8]))
    (warning,) = level.warnings
    assert "--finish-from" in warning


def points_of(folder: Path, most_bytes: int = 1 << 30) -> KeptPoints:
    """What decides on the points of a session that begins."""
    return KeptPoints(folder, 15.0, most_bytes, None, held_bytes=0, is_levelling=True)


def test_a_restart_does_not_begin_to_keep_points(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.live.kept.kept_points.UNTOLD_NS", 0)
    out = tmp_path / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        for first in (0, 3):
            live = begin(recording, out)
            for frame in recording.frames(first, first + 3):
                live.push_frame(frame, wait=True)
            live.stop()
    assert points_bytes(out) < 200_000  # of the first frame alone
    with SessionFolder(out, None) as kept:
        assert not kept.points.is_levelling


@pytest.mark.parametrize("part", ["inertial", "tilt", "orientation", "sweep"])
def test_points_of_a_drive_that_tells_its_lean_are_kept(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock_ns = [0]
    monkeypatch.setattr("fieldgrid.live.kept.kept_points.time.monotonic_ns", lambda: clock_ns[0])
    level = points_of(tmp_path)
    after_s = np.zeros(50, np.float32) if part == "sweep" else None
    seen = Sweep(np.ones((50, 3), np.float32), after_s)
    if part == "inertial":
        level.note_rows(part, rows_of(part, 1, [0.0] * 3, [0.0, 0.0, 9.8]))
    elif part == "tilt":
        level.note_rows(part, rows_of(part, 1, 1.0, 2.0, 0.1))
    elif part == "orientation":
        level.note_rows(part, rows_of(part, 1, 1.0, 2.0, 0.1, 2.0))
    assert level.packed(seen, 1_000)
    clock_ns[0] = 5 * UNTOLD_NS
    assert level.packed(seen, 1_001 + 5 * UNTOLD_NS)


def test_points_come_back_as_they_were(leaning_drive: Path) -> None:
    random = np.random.default_rng(1)
    with open_recording(leaning_drive) as recording:
        gridder = LocalGridder(recording.rig, GridSpec.of(BuildSettings().grid))
    codes = random.integers(-16, 2048, (40, 64)).astype(np.int16)
    points = (20.0 * random.normal(size=(500, 3))).astype(np.float32)
    after = random.normal(size=500).astype(np.float32)
    far = np.linalg.norm(points, axis=1) > 40.0
    assert 0 < far.sum() < 400
    seen = [gridder.coded(codes, 7), Sweep(points), Sweep(np.asfortranarray(points), after)]
    coded, plain, timed = (unpacked(packed(one, 15.0), gridder) for one in seen)
    assert np.array_equal(coded.codes, codes)
    assert coded.codes.dtype == np.int16
    assert coded.row_start == 7
    # Points that no grid reaches are left out, and all others lie as they lay in memory.
    for one in (plain, timed):
        assert np.array_equal(one.points_m[~far], points[~far])
        assert np.isnan(one.points_m[far]).all()
    assert plain.points_m.flags.c_contiguous
    assert timed.points_m.flags.f_contiguous
    assert plain.after_s is None
    assert np.array_equal(timed.after_s, after)


def test_live_grids_are_level_by_the_tilt_known_then(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tilt, told = Tilt(3.0, -4.0, 0.1), Told()
    monkeypatch.setattr(RunningTilt, "at", lambda _self, _time_ns: tilt)
    with open_recording(leaning_drive) as recording:
        frame = next(iter(recording.frames()))
        live = begin(recording, tmp_path / "m.gpkg", on_result=told)
        live.push_frame(frame, wait=True)
        live.drain()
        live.stop()
        expected = local_grid(frame, recording.rig, tilt=tilt)
        other = local_grid(frame, recording.rig)
    (grid,) = told.of(LiveGrid)
    assert np.array_equal(grid.grid.density, expected.density)
    assert not np.array_equal(other.density, expected.density)


T0_NS = 1_700_000_000_000_000_000
BIAS = np.array([0.02, -0.015, 0.03])


def moving(until_s: float) -> tuple[Int64, Float64, Float64]:
    """A vehicle that sways while it turns: times each 10 ms, its axes, and the rates that an IMU
    with a bias states."""
    time_s = np.arange(0.0, until_s, 0.01)
    rate = np.stack(
        [0.10 * np.sin(1.3 * time_s), 0.15 * np.cos(0.9 * time_s), np.full(len(time_s), 0.2)],
        axis=1,
    )
    R = [R_enu_level(30.0) @ R_level_vehicle(4.0, -6.0)]
    for mean in (rate[1:] + rate[:-1]) / 2.0:
        R.append(R[-1] @ from_vectors(0.01 * mean))
    return T0_NS + np.rint(1e9 * time_s).astype(np.int64), np.stack(R), rate + BIAS


def estimated(time_ns: Int64, R: Float64) -> Attitude:
    """What an estimate says of some instants."""
    (roll, pitch), n = roll_pitch_deg(R), len(R)
    heading = np.degrees(np.unwrap(np.arctan2(R[:, 0, 1], R[:, 1, 1])))
    sigma = np.full(n, 0.2)
    about = time_ns, roll, pitch, sigma, sigma, heading, np.zeros(n), 5.0
    return Attitude(*about, gyro_bias_rad_s=BIAS)


@pytest.mark.parametrize("part", ["inertial", "tilt", "orientation"])
def test_the_tilt_is_carried_on_from_the_latest_estimate(part: str) -> None:
    time_ns, R, rate = moving(14.0)
    roll, pitch = roll_pitch_deg(R)
    rows, end = RecentRows(), 1200
    running = RunningTilt(rows)
    assert running.at(T0_NS) is None
    for k in range(0, len(time_ns), 20):
        at = slice(k, k + 20)
        if part == "inertial":
            columns = rate[at], np.zeros_like(rate[at])
        else:  # recorded angles that are off by a degree
            columns = roll[at] + 1.0, pitch[at] - 1.0, np.full(len(roll[at]), 0.5)
            if part == "orientation":
                columns = *columns, np.full(len(roll[at]), 2.0)
        rows.add(part, rows_of(part, time_ns[at], *columns))
    running.know(estimated(time_ns[:end:5], R[:end:5]))
    for late in (0, 50, 100, 190):
        found = running.at(int(time_ns[end + late]))
        # What is carried is the change: neither the bias nor the degree are in it.
        assert found.roll_deg == pytest.approx(roll[end + late], abs=0.2)
        assert found.pitch_deg == pytest.approx(pitch[end + late], abs=0.2)
        assert 0.2 <= found.sigma_deg < 0.6
    assert abs(roll[end + 190] - roll[end]) + abs(pitch[end + 190] - pitch[end]) > 5.0
    within = running.at(int(time_ns[end // 2]))
    assert within.pitch_deg == pytest.approx(pitch[end // 2], abs=0.01)
    assert running.at(int(time_ns[end] + (CARRIED_S + 1.0) * 1e9)) is None
    # Without rows it is as it was, and less sure.
    rows.forget({part}, 0)
    held = running.at(int(time_ns[end + 100]))
    assert held.roll_deg == pytest.approx(roll[end - 5], abs=1e-6)
    assert held.sigma_deg > 1.5
    running.know(None)
    assert running.at(int(time_ns[end])) is None


def test_the_origin_of_a_grid_that_is_not_level_lies_along_the_vehicles_axis(
    leaning_drive: Path,
) -> None:
    with open_recording(leaning_drive) as recording:
        level, square = (
            estimate_drive(recording, level_grids=is_level) for is_level in (True, False)
        )
        height_m = recording.rig.mount.height_m
    attitude = level.report.attitude
    assert attitude is not None
    for time_ns in level.trajectory.time_ns[::5].tolist():
        ours = level.trajectory.at(time_ns)
        moved = square_to_ground(ours, attitude.tilt_at(time_ns), height_m)
        theirs = square.trajectory.at(time_ns)
        assert moved.east_m == pytest.approx(theirs.east_m, abs=1e-3)
        assert moved.north_m == pytest.approx(theirs.north_m, abs=1e-3)
        assert abs(ours.east_m - theirs.east_m) + abs(ours.north_m - theirs.north_m) > 0.005
