"""How good the map of a drive is."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import BuildSettings
from fieldgrid.field import Evaluation, evaluate, read_truth
from fieldgrid.geometry import FREE_UP_TO, OBSTACLE_ABOVE, Bounds, Datum, Status
from fieldgrid.maps import MapFile, open_map
from fieldgrid.pipeline import SessionReport, estimate_trajectory, visual_odometry
from fieldgrid.pipeline.inputs import from_arrays
from fieldgrid.recordings import DriveOptions, open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.drives.making import (
    COURSE,
    DEFAULTS,
    SharedData,
    build,
)


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


@pytest.mark.long
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


@pytest.mark.long
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
