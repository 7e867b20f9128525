"""From a drive to a map: how good it is, that it is always the same, and all or nothing."""

from __future__ import annotations

import gc
import hashlib
import json
import re
import shutil
import sqlite3
import threading
import time
import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.build import (
    Progress,
    SessionReport,
    add_recording,
    build_map,
    estimate_trajectory,
    local_grid,
    perceive,
    visual_odometry,
)
from fieldgrid.build.inputs import from_arrays
from fieldgrid.errors import (
    CalibrationError,
    ConfigError,
    FieldgridError,
    GnssError,
    MapExistsError,
    RecordingError,
)
from fieldgrid.evaluation import Evaluation, evaluate, read_truth
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.grids import FREE_UP_TO, OBSTACLE_ABOVE
from fieldgrid.lattice import Bounds
from fieldgrid.localgrid import LocalGridder
from fieldgrid.mapfile import MapFile, open_map
from fieldgrid.motion import Motion
from fieldgrid.recording import (
    DriveOptions,
    Frame,
    Image,
    ImageSource,
    StereoFrame,
    Stream,
    open_recording,
)
from fieldgrid.settings import BuildSettings, resolve
from fieldgrid.trajectory import Status
from fieldgrid.transfer import Transfer
from tests.conftest import TWO_LANES

MakeDrive = Callable[..., Path]
SharedData = Callable[[str], Path]

DEFAULTS = BuildSettings()
COURSE = resolve(None, {"pose": {"heading": "course"}})
WITHOUT_CAMERA = resolve(None, {"pose": {"visual_odometry": False}})


def build(paths: list[Path], out: Path, **options: Any) -> list[SessionReport]:
    return build_map(paths, out, options.pop("settings", DEFAULTS), **options)


def content(path: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Every row of every table of a map, but for the times at which they were written, and the root
    digest, which covers those."""
    written = {"created", "last_change", "description"}
    connection = sqlite3.connect(path)
    try:
        names = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        rows = {}
        for (name,) in names.fetchall():
            info = connection.execute(f"PRAGMA table_info('{name}')").fetchall()
            columns = ", ".join(f'"{column[1]}"' for column in info if column[1] not in written)
            rows[name] = connection.execute(f'SELECT {columns} FROM "{name}"').fetchall()
        rows["fieldgrid_meta"] = [r for r in rows["fieldgrid_meta"] if r[0] != "root_sha256"]
        return rows
    finally:
        connection.close()


def damage(image: Path) -> None:
    """Cut an image of a small drive off in the middle."""
    data = image.read_bytes()
    image.unlink()
    image.write_bytes(data[: len(data) // 2])


def pipeline_threads() -> list[str]:
    return [t.name for t in threading.enumerate() if t.name.startswith("fieldgrid")]


# --- the example: how good the map is


@pytest.fixture(scope="module")
def scores(two_lanes_map: Path) -> Evaluation:
    with open_map(two_lanes_map) as universal:
        return evaluate(universal, read_truth(TWO_LANES / "truth"))


def test_obstacles_of_the_example_are_where_they_stand(scores: Evaluation) -> None:
    on_rows = scores.groups[0]
    assert on_rows.name == "forward on the rows"
    assert on_rows.poses.frames == 31
    assert on_rows.obstacles.observable_cells > 6000
    precision, recall = on_rows.obstacles.precision["0.10"], on_rows.obstacles.recall["0.10"]
    free_with_obstacle = on_rows.obstacles.free_with_obstacle
    assert precision is not None
    assert precision >= 0.94
    assert recall is not None
    assert recall >= 0.95
    assert free_with_obstacle is not None
    assert free_with_obstacle <= 0.005
    assert on_rows.obstacles.free_cells > 70_000


def test_poses_of_the_example_are_true(scores: Evaluation) -> None:
    for group in scores.groups:
        assert group.poses.heading_median_deg is not None
        assert group.poses.heading_median_deg <= 0.6
        assert group.poses.heading_max_deg is not None
        assert group.poses.heading_max_deg <= 3.0
        assert group.poses.position_max_m is not None
        assert group.poses.position_max_m <= 0.10


def test_every_frame_is_used_also_in_reverse_and_in_the_turn(
    built_two_lanes: tuple[Path, SessionReport], scores: Evaluation
) -> None:
    report = built_two_lanes[1]
    assert (report.frames, report.used, report.rejected) == (50, 50, 0)
    assert report.reasons == Counter()
    reverse = [frame for frame in scores.frames if frame.direction == "reverse"]
    assert [frame.frame_id for frame in reverse] == ["000025", "000026", "000027"]
    assert all(frame.status == "ok" for frame in reverse)
    assert max(abs(frame.heading_error_deg) for frame in reverse) <= 4.0
    on_rows = [frame for frame in scores.frames if frame.segment.startswith("lane")]
    assert all(frame.status == "ok" for frame in on_rows)


def test_the_report_of_the_example_adds_up(built_two_lanes: tuple[Path, SessionReport]) -> None:
    report = built_two_lanes[1]
    assert report.session == "two_lanes"
    assert report.heading_source == "smooth"
    assert (report.camera_steps, report.camera_refusals) == (49, 0)
    assert report.distance_m == pytest.approx(91.0, abs=4.0)
    assert report.fixes == 437
    assert 350 < report.fixes_accepted <= 437
    assert report.frames_per_s == pytest.approx(50 / report.wall_s)
    stages = report.stages
    assert min(asdict(stages).values()) > 0.0
    assert report.max_range_m < 12.0


def test_the_session_keeps_what_made_it(two_lanes_map: Path) -> None:
    with open_map(two_lanes_map) as universal, open_recording(TWO_LANES, "gnss_rtk.nmea") as drive:
        (info,) = universal.sessions()
        trajectory = universal.trajectory(info.name)
        inputs = from_arrays(universal.session_inputs(info.name))
        steps = visual_odometry(drive, jobs=2)
        expected = estimate_trajectory(drive, steps=steps)
        fixes, motion = drive.fixes(), drive.motion()
        frame_ns = drive.frame_times_ns() + drive.rig.image_time_offset_ns
        first = next(iter(universal.frames()))
    assert info.source == "gnss/gnss_rtk.nmea"
    assert BuildSettings.model_validate(info.config["settings"]) == DEFAULTS
    assert info.config["rig"]["camera"]["focal_px"] == 905.4
    assert info.config["every"] == 1
    assert universal.datum == Datum(41.65, -4.72, 787.4)
    np.testing.assert_array_equal(trajectory.east_m, expected.east_m)
    np.testing.assert_array_equal(trajectory.heading_deg, expected.heading_deg)
    assert len(trajectory) > len(fixes)  # it has the instants of the images, too
    assert inputs.fixes == fixes
    assert inputs.motion.wheels is motion.wheels is None
    for kept, seen in ((inputs.motion.gyro, motion.gyro), (inputs.motion.steps, steps)):
        assert kept is not None
        assert seen is not None
        for one, other in zip(kept, seen, strict=True):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(inputs.frame_ns, frame_ns)
    assert inputs.ground_found.all()
    assert [Path(name).parts[-2:] for name in first.images] == [
        ("left", "000000.jpg"),
        ("right", "000000.jpg"),
    ]
    log = TWO_LANES / "gnss" / "gnss_rtk.nmea"
    assert info.source_sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    assert first.images_sha256 == tuple(
        hashlib.sha256((TWO_LANES / side / "000000.jpg").read_bytes()).hexdigest()
        for side in ("left", "right")
    )


def test_the_quality_of_a_frame_is_that_of_a_fix(two_lanes_map: Path) -> None:
    with open_map(two_lanes_map) as universal:
        assert {record.quality for record in universal.frames()} == {4}


def test_with_the_rough_log_every_frame_is_mapped_where_it_was(tmp_path: Path) -> None:
    """Decimetres, jumps of 1 to 6 m, a hole of 6 s: camera and batch carry over all of it."""
    out = tmp_path / "rough.gpkg"
    (report,) = build([TWO_LANES], out, options=DriveOptions("gnss_sf1.nmea"))
    with open_map(out) as universal:
        scores = evaluate(universal, read_truth(TWO_LANES / "truth"))
    assert (report.frames, report.used, report.camera_steps) == (50, 50, 49)
    for frame in scores.frames:
        assert frame.status == "ok", frame
        assert np.hypot(frame.east_error_m, frame.north_error_m) <= 0.5, frame
        assert abs(frame.heading_error_deg) <= 1.0, frame
    assert any("damaged sentences" in note for note in report.notes)


def test_with_the_rough_log_and_the_paper_s_heading_no_pose_is_silently_wrong(
    tmp_path: Path,
) -> None:
    """What is off is rejected and says why."""
    out = tmp_path / "rough.gpkg"
    (report,) = build([TWO_LANES], out, options=DriveOptions("gnss_sf1.nmea"), settings=COURSE)
    with open_map(out) as universal:
        scores = evaluate(universal, read_truth(TWO_LANES / "truth"))
        records = {record.frame_id: record for record in universal.frames()}
    assert (report.frames, report.used + report.rejected) == (50, 50)
    assert report.used >= 30
    assert sum(report.reasons.values()) == report.rejected
    for frame in scores.frames:
        error_m = np.hypot(frame.east_error_m, frame.north_error_m)
        if frame.status == "ok":
            assert error_m <= 0.5, frame
            assert abs(frame.heading_error_deg) <= max(3.0, 3.0 * frame.heading_sigma_deg), frame
            assert frame.heading_sigma_deg <= DEFAULTS.pose.max_heading_sigma_deg
        else:
            assert len(records[frame.frame_id].reason) > 10
    assert {f.frame_id for f in scores.frames if f.status != "ok"} >= {"000037", "000038"}
    assert any("damaged sentences" in note for note in report.notes)


# --- a real road


def shares(universal: MapFile, *bounds: float) -> tuple[float, float, float]:
    """How much of an area was seen, and of that, how much is obstacle, and how much free."""
    view = universal.read(Bounds(*bounds))
    seen = view.density[view.observed]
    return (
        float(view.observed.mean()),
        float((seen > OBSTACLE_ABOVE).mean()),
        float((seen <= FREE_UP_TO).mean()),
    )


def test_a_real_drive_shows_the_parked_car_and_the_free_road(
    shared_data: SharedData, tmp_path: Path
) -> None:
    out = tmp_path / "road.gpkg"
    (report,) = build([shared_data("kitti_2011_09_30_drive_0020")], out)
    assert (report.frames, report.used) == (51, 51)
    assert (report.camera_steps, report.camera_refusals) == (50, 0)
    assert report.heading_source == "smooth"
    with open_map(out) as universal:
        records = list(universal.frames())
        # The vehicle drives to the west: the car is parked on its right, the verge is left.
        car = shares(universal, -26.0, 0.3, -22.0, 2.3)
        road_before_it = shares(universal, -21.5, -1.5, -9.0, 1.0)
        road_beside_it = shares(universal, -30.0, -2.0, -20.0, -0.2)
        verge = shares(universal, -25.0, -6.0, -16.0, -4.0)
        tree = shares(universal, -27.9, -6.0, -26.9, -5.2)
    assert [r.frame_id for r in records] == [f"{k:010d}" for k in range(51)]
    assert all(r.status is Status.OK for r in records)
    assert car[0] > 0.5
    assert car[1] > 0.5
    assert tree[1] > 0.5
    assert road_before_it[0] > 0.8
    assert road_before_it[1] < 0.01
    assert road_beside_it[1] < 0.01
    assert verge[0] > 0.6
    assert verge[2] > 0.95


# --- always the same


def test_a_map_has_the_same_bits_whatever_the_number_of_threads(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(18, 30))  # the end of a row and the turn
    outs = [tmp_path / f"{jobs}.gpkg" for jobs in (1, 2, 3)]
    for jobs, out in zip((1, 2, 3), outs, strict=True):
        build([drive], out, jobs=jobs)
    first, *others = [content(out) for out in outs]
    assert len(first["fieldgrid_frame"]) == 12
    assert len(first["fieldgrid_tile"]) > 3
    assert len(first["density"]) > 3
    for other in others:
        assert other.keys() == first.keys()
        for table, rows in first.items():
            assert other[table] == rows, table
    views = []
    for out in outs:
        with open_map(out) as universal:
            views.append(universal.read(cell_m=0.25))
    for view in views[1:]:
        np.testing.assert_array_equal(view.density, views[0].density)
        np.testing.assert_array_equal(view.observed, views[0].observed)


def test_a_grid_by_hand_is_the_one_in_the_map(two_lanes_map: Path) -> None:
    with open_recording(TWO_LANES, "gnss_rtk.nmea") as drive:
        frame = list(drive.frames())[7]
        grid = local_grid(frame, drive.rig)
    with open_map(two_lanes_map) as universal:
        record = list(universal.frames(with_grid=True))[7]
    assert record.frame_id == frame.frame_id
    np.testing.assert_array_equal(record.grid().density, grid.density)
    np.testing.assert_array_equal(record.grid().observed, grid.observed)


def test_every_nth_frame(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(3, 11))
    seen: list[Progress] = []
    (report,) = build([drive], tmp_path / "m.gpkg", every=3, progress=seen.append)
    with open_map(tmp_path / "m.gpkg") as universal:
        ids = [record.frame_id for record in universal.frames()]
        assert universal.sessions()[0].config["every"] == 3
    assert ids == ["000003", "000006", "000009"]
    assert report.frames == 3
    after_a_frame = [now for now in seen if now.frames_done > 0]
    assert [now.frames_done for now in after_a_frame] == [1, 2, 3]
    assert {(now.session, now.frames_total) for now in seen} == {("drive", 3)}
    assert after_a_frame[0].distance_m == 0.0  # so far the camera has not moved
    assert report.distance_m == pytest.approx(11.3, abs=1.0)


def test_the_distance_in_progress_is_that_of_the_camera(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(4, 8))
    seen: list[Progress] = []
    (report,) = build([drive], tmp_path / "m.gpkg", progress=seen.append)
    told = [now.distance_m for now in seen]
    assert None not in told
    assert told == sorted(told, key=float)
    assert told[-1] == pytest.approx(report.distance_m, rel=0.03)
    seen.clear()
    build([drive], tmp_path / "n.gpkg", progress=seen.append, settings=WITHOUT_CAMERA)
    assert [now.distance_m for now in seen] == [None] * 5


def test_without_visual_odometry(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(frames=range(4, 8)), tmp_path / "m.gpkg"
    (report,) = build([drive], out, settings=WITHOUT_CAMERA)
    assert (report.used, report.camera_steps, report.camera_refusals) == (4, 0, 0)
    assert report.stages.odometry_s < 0.1 * report.stages.match_s
    with open_map(out) as universal, open_recording(drive) as recording:
        inputs = from_arrays(universal.session_inputs("drive"))
        expected = estimate_trajectory(recording, WITHOUT_CAMERA)
        trajectory = universal.trajectory("drive")
    assert inputs.motion.steps is None
    assert len(inputs.fixes) == report.fixes == 437
    np.testing.assert_array_equal(trajectory.east_m, expected.east_m)
    np.testing.assert_array_equal(trajectory.heading_deg, expected.heading_deg)


def test_settings_reach_the_map(make_drive: MakeDrive, tmp_path: Path) -> None:
    settings = resolve(
        None,
        {
            "grid": {"width_m": 6.0, "length_m": 12.0, "cell_m": 0.1},
            "density": {"max_range_m": 8.0},
            "pose": {"heading": "constant:20"},
            "map": {"cell_m": 0.2, "transfer": "area"},
        },
    )
    out = tmp_path / "m.gpkg"
    (report,) = build([make_drive()], out, settings=settings)
    assert report.max_range_m == 8.0
    with open_map(out) as universal:
        assert (universal.cell_m, universal.transfer) == (0.2, Transfer.AREA)
        for record in universal.frames(with_grid=True):
            assert record.pose.heading_deg == 20.0
            assert record.grid().observed.shape == (120, 60)
            y_m = (np.flatnonzero(record.grid().observed.any(axis=1)) + 0.5) * 0.1
            assert 2.5 < y_m.min() < y_m.max() <= 8.1


# --- more than one drive


def test_a_second_drive_is_added_in_the_datum_of_the_map(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    first, second = make_drive("first", range(3, 6)), make_drive("second", range(5, 8))
    (second / "session.json").unlink()  # it would ask for no datum of its own
    out = tmp_path / "m.gpkg"
    datum = Datum(41.6502, -4.7203, 780.0)
    build([first], out, datum=datum)
    build([second], out, append=True)
    with open_map(out) as universal:
        assert universal.datum == datum
        assert [info.name for info in universal.sessions()] == ["first", "second"]
        same = [r for r in universal.frames() if r.frame_id == "000005"]
    # The same instant of the same log; the camera saw other frames of the way to it.
    assert same[0].pose.east_m == pytest.approx(same[1].pose.east_m, abs=0.05)
    assert same[0].pose.north_m == pytest.approx(same[1].pose.north_m, abs=0.05)


def test_two_drives_at_once_are_the_same_as_one_after_the_other(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drives = [make_drive("first", range(3, 6)), make_drive("second", range(40, 43))]
    reports = build(drives, tmp_path / "at_once.gpkg")
    build(drives[:1], tmp_path / "m.gpkg")
    build(drives[1:], tmp_path / "m.gpkg", append=True)
    assert [report.session for report in reports] == ["first", "second"]
    at_once, in_turn = content(tmp_path / "at_once.gpkg"), content(tmp_path / "m.gpkg")
    assert sorted(at_once["fieldgrid_tile"]) == sorted(in_turn["fieldgrid_tile"])
    assert at_once["fieldgrid_frame"] == in_turn["fieldgrid_frame"]


def test_drives_without_a_datum_share_that_of_the_first(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    first, second = make_drive("first", range(3, 6)), make_drive("second", range(40, 43))
    for drive in (first, second):
        (drive / "session.json").unlink()
    log = second / "gnss" / "gnss_rtk.nmea"  # which begins elsewhere than that of the first
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[len(lines) // 2 :]))
    with open_recording(first) as one, open_recording(second) as other:
        alone = estimate_trajectory(one).datum, estimate_trajectory(other).datum
    assert alone[0] != alone[1]
    build([first, second], tmp_path / "m.gpkg")
    with open_map(tmp_path / "m.gpkg") as universal:
        assert universal.datum == alone[0]
        assert len(universal.sessions()) == 2


def test_a_new_map_of_several_drives_needs_all_of_them(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    first, second = make_drive("first", range(3, 6)), make_drive("second", range(5, 8))
    damage(second / "left" / "000007.jpg")
    (tmp_path / "out").mkdir()
    with pytest.raises(RecordingError, match="truncated"):
        build([first, second], tmp_path / "out" / "m.gpkg")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_drive_that_fails_half_way_leaves_the_map_as_it_was(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    build([make_drive("first")], out)
    before, files = out.read_bytes(), sorted(tmp_path.iterdir())
    second = make_drive("second", range(5, 13))
    damage(second / "left" / "000009.jpg")
    done = [0]
    with pytest.raises(RecordingError, match=r"left/000009\.jpg is truncated or damaged"):
        build([second], out, append=True, jobs=1, progress=lambda p: done.append(p.frames_done))
    assert max(done) == 4  # it was in the middle of it
    assert out.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == sorted([*files, second])
    with open_map(out) as universal:
        assert [info.name for info in universal.sessions()] == ["first"]


def test_of_several_drives_appended_the_whole_ones_stay(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    build([make_drive("first")], out)
    second, third = make_drive("second", range(5, 8)), make_drive("third", range(8, 11))
    damage(third / "right" / "000010.jpg")
    with pytest.raises(RecordingError, match="truncated"):
        build([second, third], out, append=True)
    with open_map(out) as universal:
        assert [info.name for info in universal.sessions()] == ["first", "second"]


def test_a_name_that_is_taken_is_refused_before_any_image_is_read(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    drive = make_drive()
    build([drive], out)
    before = out.read_bytes()
    damage(drive / "left" / "000003.jpg")  # would be another error
    with pytest.raises(ConfigError, match=r"has a session 'drive' already; .* --name"):
        build([drive], out, append=True)
    assert out.read_bytes() == before


def test_two_drives_of_one_name_are_refused_before_any_image_is_read(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    (tmp_path / "june").mkdir()
    second = make_drive("june/front", range(5, 7))
    done: list[Progress] = []
    with pytest.raises(ConfigError, match="front"):
        build([make_drive("front"), second], tmp_path / "m.gpkg", progress=done.append)
    assert max((now.frames_done for now in done), default=0) == 0


def test_another_transfer_rule_is_refused_when_appending(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    build([make_drive("first")], out)
    area = resolve(None, {"map": {"transfer": "area"}})
    with pytest.raises(ConfigError, match="area"):
        build([make_drive("second")], out, append=True, settings=area)


# --- all or nothing


def test_a_drive_that_fails_half_way_leaves_no_file(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(3, 11))
    damage(drive / "right" / "000008.jpg")
    (tmp_path / "out").mkdir()
    done: list[Progress] = []
    with pytest.raises(RecordingError, match=r"right/000008\.jpg is truncated"):
        build([drive], tmp_path / "out" / "m.gpkg", progress=done.append)
    assert 0 < max(now.frames_done for now in done) < 6
    assert list((tmp_path / "out").iterdir()) == []
    assert pipeline_threads() == []


def test_an_existing_map_is_replaced_only_by_a_whole_one(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "out" / "m.gpkg"
    out.parent.mkdir()
    build([make_drive("first")], out)
    before = out.read_bytes()
    second = make_drive("second", range(5, 9))
    with pytest.raises(MapExistsError, match=r"exists already; .*--append.*--overwrite"):
        build([second], out)
    assert out.read_bytes() == before
    image = second / "left" / "000007.jpg"
    damage(image)
    with pytest.raises(RecordingError, match="truncated"):
        build([second], out, overwrite=True)
    assert out.read_bytes() == before
    image.unlink()
    image.symlink_to(TWO_LANES / "left" / "000007.jpg")
    build([second], out, overwrite=True)
    with open_map(out) as universal:
        assert [info.name for info in universal.sessions()] == ["second"]
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("append", [False, True])
def test_an_interrupt_leaves_nothing(append: bool, make_drive: MakeDrive, tmp_path: Path) -> None:
    out = tmp_path / "out" / "m.gpkg"
    out.parent.mkdir()
    if append:
        build([make_drive("first")], out)
    before = {path: path.read_bytes() for path in out.parent.iterdir()}

    def interrupt(now: Progress) -> None:
        if now.frames_done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build([make_drive(frames=range(3, 9))], out, append=append, progress=interrupt)
    assert {path: path.read_bytes() for path in out.parent.iterdir()} == before


@pytest.fixture
def opencv_threads() -> Iterator[int]:
    """How many threads OpenCV was told to use before the test."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    yield 2
    cv2.setNumThreads(before)


def test_after_an_interrupt_the_process_is_as_it_was(
    make_drive: MakeDrive, tmp_path: Path, opencv_threads: int
) -> None:
    def interrupt(now: Progress) -> None:
        if now.frames_done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        build([make_drive(frames=range(3, 9))], tmp_path / "m.gpkg", jobs=3, progress=interrupt)
    # `caught` keeps the traceback, as an interactive Python does.
    assert pipeline_threads() == []
    assert cv2.getNumThreads() == opencv_threads
    del caught


def test_after_a_build_the_process_is_as_it_was(
    make_drive: MakeDrive, tmp_path: Path, opencv_threads: int
) -> None:
    build([make_drive()], tmp_path / "m.gpkg", jobs=3)
    assert pipeline_threads() == []
    assert cv2.getNumThreads() == opencv_threads


# --- what can be checked is checked before the first image is read


def no_image_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Frame) -> NoReturn:
        raise AssertionError(f"the images of frame {self.frame_id} were read")

    monkeypatch.setattr(StereoFrame, "images", refuse)


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def a_day_later(table: str) -> str:
    return table.replace(",13081338", ",13082202")


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (
            lambda drive: rewrite(drive / "frames.csv", a_day_later),
            GnssError,
            r"Images \(2011-06-16T10:30:19\.840Z to .*\) and fixes \(2011-06-15T.*Z to .*Z\) do "
            r"not overlap in time; .* \(1 day: one of the two has a wrong date\): .* --time-offset "
            r"-86400 or image_time_offset_s = -86400, else choose .* --gnss",
        ),
        (
            lambda drive: (drive / "gnss" / "gnss_rtk.nmea").write_text(""),
            GnssError,
            "holds no position at all; record one, or choose another with --gnss",
        ),
        (
            lambda drive: (drive / "gnss" / "gnss_rtk.nmea").unlink(),
            GnssError,
            "holds no position at all",
        ),
        (
            lambda drive: (drive / "left" / "000004.jpg").unlink(),
            RecordingError,
            r"1 of 6 images are missing .*000004\.jpg",
        ),
    ],
)
def test_a_drive_without_a_place(
    spoil: Callable[[Path], object],
    error: type[FieldgridError],
    message: str,
    make_drive: MakeDrive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    no_image_is_read(monkeypatch)
    drive = make_drive()
    spoil(drive)
    with pytest.raises(error, match=message):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"append": True, "overwrite": True}, "--append and --overwrite exclude each other"),
        ({"append": True}, r"There is no map .*m\.gpkg to append to; leave out --append"),
        (
            {"settings": resolve(None, {"pose": {"heading": "north"}})},
            "Heading source 'north' is none of smooth, course, recorded, constant:DEG",
        ),
        (
            {"settings": resolve(None, {"pose": {"heading": "recorded"}})},
            "has a heading of its own; use --heading smooth",
        ),
    ],
)
def test_options_that_cannot_be(
    options: dict[str, Any],
    message: str,
    make_drive: MakeDrive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    no_image_is_read(monkeypatch)
    drive = make_drive()
    with pytest.raises(FieldgridError, match=message):
        build([drive], tmp_path / "m.gpkg", **options)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_cells_finer_than_the_local_ones_leave_no_file(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive()
    fine = resolve(None, {"map": {"cell_m": 0.02}})
    with pytest.raises(ConfigError, match=r"0\.02 m are smaller than the local cells of 0\.05 m"):
        build([drive], tmp_path / "m.gpkg", settings=fine)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_a_drive_of_which_no_frame_can_be_placed_leaves_no_file(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=[3, 4])

    def without_fixes_around_the_frames(text: str) -> str:
        lines = text.splitlines(keepends=True)
        return "".join(line for line in lines if not ",10301" < line[6:12] < ",10303")

    rewrite(drive / "gnss" / "gnss_rtk.nmea", without_fixes_around_the_frames)
    with pytest.raises(GnssError, match=r"None of the 2 frames of drive has a usable pose, mostly"):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


def edit_mounting(drive: Path, change: dict[str, float]) -> None:
    path = drive / "calibration" / "mounting.json"
    mounting = json.loads(path.read_text())
    assert change.keys() <= mounting.keys()
    path.write_text(json.dumps({**mounting, **change}))


def fog(drive: Path, *frames: str) -> None:
    """Pairs of a small drive in which there is nothing to see."""
    for frame_id in frames:
        for side in ("left", "right"):
            path = drive / side / f"{frame_id}.jpg"
            path.unlink()
            cv2.imwrite(str(path), np.full((480, 640), 128, dtype=np.uint8))


def test_a_frame_without_ground_is_rejected(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(frames=range(4, 8)), tmp_path / "m.gpkg"
    fog(drive, "000005")
    (report,) = build([drive], out)
    assert (report.used, report.rejected, report.ground_refined) == (3, 1, 3)
    (reason,) = report.reasons
    assert "no ground was found in the image" in reason
    with open_map(out) as universal:
        rejected = [r.frame_id for r in universal.frames() if r.status is not Status.OK]
    assert rejected == ["000005"]


def test_a_drive_without_ground_is_no_matter_of_gnss(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(4, 6))
    fog(drive, "000004", "000005")
    with pytest.raises(FieldgridError, match=r"no ground was found .* mounting") as caught:
        build([drive], tmp_path / "m.gpkg")
    assert "--gnss" not in str(caught.value)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_a_pose_that_was_rejected_keeps_its_reason(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(frames=[4, 5, 22]), tmp_path / "m.gpkg"
    shutil.copy(TWO_LANES / "gnss" / "gnss_sf1.nmea", drive / "gnss")
    fog(drive, "000022")
    build([drive], out, options=DriveOptions("gnss_sf1.nmea"), settings=COURSE)
    with open_map(out) as universal:
        reasons = {record.frame_id: record.reason for record in universal.frames()}
    assert "accepted fix" in reasons["000022"]


# --- cameras that are not those of the calibration


def swap_sides(drive: Path) -> None:
    left, right = drive / "left", drive / "right"
    left.rename(drive / "other")
    right.rename(left)
    (drive / "other").rename(right)


@pytest.mark.parametrize("settings", [DEFAULTS, COURSE])
@pytest.mark.parametrize("frames", [range(3, 6), range(20, 36)])
def test_swapped_sides_are_refused_and_named(
    settings: BuildSettings, frames: range, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=frames)
    swap_sides(drive)
    with pytest.raises(
        CalibrationError, match="only with left and right exchanged, so the two are swapped"
    ):
        build([drive], tmp_path / "m.gpkg", settings=settings)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_swapped_sides_of_a_kitti_drive_are_refused(
    shared_data: SharedData, tmp_path: Path
) -> None:
    drive = tmp_path / "kitti_2011_09_30_drive_0020"
    shutil.copytree(shared_data(drive.name), drive)
    for left in list(drive.rglob("image_00")):
        right = left.with_name("image_01")
        left.rename(left.with_name("other"))
        right.rename(left)
        left.with_name("other").rename(right)
    with pytest.raises(CalibrationError, match="the two are swapped"):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (30, "or the calibration is of other cameras"),
        (
            -40,
            r"no ground was found in the image, .*check the calibration, and the camera's height",
        ),
    ],
)
def test_a_calibration_of_other_cameras_is_refused(
    columns: int, message: str, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(5, 13))
    for image in (drive / "right").iterdir():
        pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None
        image.unlink()
        cv2.imwrite(str(image), np.roll(pixels, columns, axis=1))  # a principal point elsewhere
    with pytest.raises(FieldgridError, match=message):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


def test_pairs_that_are_not_rectified_are_refused_unless_accepted(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(5, 13))
    for image in (drive / "right").iterdir():
        pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None
        image.unlink()
        cv2.imwrite(str(image), np.roll(pixels, 4, axis=0))
    with pytest.raises(CalibrationError, match=r"4\.0 pixels lower .* --accept vertical-misalignm"):
        build([drive], tmp_path / "m.gpkg")
    settings = resolve(None, {"checks": {"accept": ["vertical-misalignment"]}})
    (report,) = build([drive], tmp_path / "m.gpkg", settings=settings)
    assert any(note.startswith("Accepted vertical-misalignment: ") for note in report.notes)
    assert any("of 7 steps of the camera could be told" in note for note in report.notes)


@pytest.mark.parametrize(
    "change", [{"camera_height_above_ground_m": 3.65}, {"camera_tilt_down_deg": 26.0}]
)
def test_a_wrong_mounting_is_hinted_at(
    change: dict[str, float], make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(5, 21))
    edit_mounting(drive, change)
    (report,) = build([drive], tmp_path / "m.gpkg")
    (hint,) = (note for note in report.notes if "No ground was found" in note)
    assert re.search(
        r"in \d+ of 16 frames\. The camera's own motion was told, so its calibration fits\. Check "
        r"the camera's height of .* m and tilt of .*° in the mounting\.$",
        hint,
    )


def test_a_drive_half_in_fog_is_none_of_these(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(4, 16))
    fog(drive, *(f"{k:06d}" for k in range(7, 16)))
    (report,) = build([drive], tmp_path / "m.gpkg")
    assert (report.used, report.rejected) == (3, 9)


def test_what_does_not_fit_the_map_is_refused_before_the_images(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    build([make_drive("first")], out)
    before = out.read_bytes()
    no_image_is_read(monkeypatch)
    coarse = resolve(None, {"grid": {"cell_m": 0.1}})
    with pytest.raises(ConfigError, match=r"smaller than the local cells of 0\.1 m"):
        build([make_drive("second")], out, append=True, settings=coarse)
    with (
        open_recording(make_drive("third")) as recording,
        open_map(out, writable=True) as universal,
        pytest.raises(ConfigError, match="has a session 'first' already"),
    ):
        add_recording(universal, recording, name="first")
    assert out.read_bytes() == before


# --- memory


class Alive:
    """Counts objects that are alive, and the most that ever were."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.now = self.most = self.ever = 0

    def watch(self, thing: object) -> None:
        weakref.finalize(thing, self._gone)
        with self._lock:
            self.now += 1
            self.ever += 1
            self.most = max(self.most, self.now)

    def _gone(self) -> None:
        with self._lock:
            self.now -= 1


@dataclass
class Watched:
    """An image of the example, counted as long as it is in memory."""

    image: ImageSource
    alive: Alive

    @property
    def name(self) -> str:
        return self.image.name

    def read(self) -> Image:
        image = self.image.read()
        self.alive.watch(image)
        return image

    def sha256(self) -> str:
        return self.image.sha256()


class LongDrive:
    """The example over and over: a drive of any length that counts what of it is in memory."""

    def __init__(self, frame_count: int) -> None:
        self._of = open_recording(TWO_LANES, "gnss_rtk.nmea")
        self._pairs = list(self._of.frames())[5:8]
        self._start_ns = self._pairs[0].time_ns
        self.name, self.rig, self.datum_hint = "long", self._of.rig, self._of.datum_hint
        self.gnss_source, self.notes, self.losses = self._of.gnss_source, (), ()
        self.frame_count = frame_count
        self.images = Alive()
        self.drawn = 0

    def frame_times_ns(self) -> npt.NDArray[np.int64]:
        return self._start_ns + np.arange(self.frame_count, dtype=np.int64) * 20_000_000

    def frames(self) -> Iterator[Frame]:
        for k, time_ns in enumerate(self.frame_times_ns().tolist()):
            self.drawn += 1
            pair = self._pairs[k % len(self._pairs)]
            left, right = Watched(pair.left, self.images), Watched(pair.right, self.images)
            yield StereoFrame(f"{k:06d}", time_ns, left, right, pair.size_px)

    def fixes(self) -> FixColumns:
        return self._of.fixes()

    def gnss_sha256(self) -> str:
        return self._of.gnss_sha256()

    def motion(self) -> Motion:
        return self._of.motion()

    def streams(self) -> Sequence[Stream]:
        return self._of.streams()

    def close(self) -> None:
        self._of.close()

    def __enter__(self) -> LongDrive:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.mark.parametrize("jobs", [1, 2, 4])
@pytest.mark.parametrize("odometry", [True, False])
def test_few_frames_are_in_memory_however_long_the_drive(
    jobs: int, odometry: bool, tmp_path: Path
) -> None:
    drive = LongDrive(24)
    trajectory = estimate_trajectory(drive)
    ahead: list[int] = []
    with open_map(tmp_path / "m.gpkg", datum=trajectory.datum) as universal:
        report = add_recording(
            universal,
            drive,
            None if odometry else trajectory,
            jobs=jobs,
            progress=lambda now: ahead.append(drive.drawn - now.frames_done),
        )
    # Each is read once, and five pairs before, for whether their rows match.
    assert (report.frames, drive.images.ever) == (24, 48 + 10)
    assert report.used > 0
    assert report.camera_steps + report.camera_refusals == (23 if odometry else 0)
    assert (report.fixes, 350 < report.fixes_accepted <= 437) == (437, True)
    assert max(ahead) <= jobs + 2
    assert drive.images.most <= 2 * jobs
    gc.collect()
    assert drive.images.now == 0


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_slow_reader_of_perceived_frames_is_waited_for(jobs: int) -> None:
    drive, grids = LongDrive(10), Alive()
    order = []
    for perceived in perceive(drive.frames(), LocalGridder(drive.rig), jobs):
        grids.watch(perceived.grid.density)
        time.sleep(0.05)
        order.append(perceived.frame.frame_id)
        assert drive.drawn - len(order) <= jobs + 2
        del perceived
    assert order == [f"{k:06d}" for k in range(10)]
    assert grids.most <= 2


def test_reasons_are_counted() -> None:
    report = SessionReport("x", frames=3, reasons=Counter({"b": 1, "a": 2}))
    assert report.frames_per_s == 0.0
    as_dict = report.as_dict()
    assert as_dict["reasons"] == {"a": 2, "b": 1}
    assert as_dict["notes"] == []
