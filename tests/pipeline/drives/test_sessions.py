"""The same drive gives the same bits; more than one drive."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, DatumError, RecordingError, resolve
from fieldgrid.geometry import Datum
from fieldgrid.maps import Transfer, open_map
from fieldgrid.pipeline import (
    PartlyBuiltError,
    Progress,
    estimate_drive,
    estimate_trajectory,
    local_grid,
)
from fieldgrid.pipeline.inputs import from_arrays
from fieldgrid.recordings import open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.drives.making import (
    WITHOUT_CAMERA,
    MakeDrive,
    build,
    content,
    damage,
)


@pytest.mark.usefixtures("worked_out_afresh")
def test_a_map_has_the_same_bits_whatever_the_number_of_threads(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(20, 28))  # the end of a row and the turn
    outs = [tmp_path / f"{jobs}.gpkg" for jobs in (1, 2, 3)]
    for jobs, out in zip((1, 2, 3), outs, strict=True):
        build([drive], out, jobs=jobs)
    first, *others = [content(out) for out in outs]
    assert len(first["fieldgrid_frame"]) == 8
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
    with open_map(two_lanes_map) as universal:
        record = list(universal.frames(with_grid=True))[7]
        datum = universal.datum
    with open_recording(TWO_LANES, "gnss_rtk.nmea") as drive:
        frame = list(drive.frames())[7]
        attitude = estimate_drive(drive, datum=datum).report.attitude
        assert attitude is not None  # the drive has an IMU
        tilt = attitude.tilt_at(frame.time_ns + drive.rig.image_time_offset_ns)
        grid = local_grid(frame, drive.rig, tilt=tilt)
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


@pytest.mark.usefixtures("worked_out_afresh")
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
        fixes = len(recording.fixes())
    assert inputs.motion.steps is None
    assert len(inputs.fixes) == report.fixes == fixes > 150
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
    near_m = 0.5 * same[0].pose.position_sigma_m
    assert same[0].pose.east_m == pytest.approx(same[1].pose.east_m, abs=near_m)
    assert same[0].pose.north_m == pytest.approx(same[1].pose.north_m, abs=near_m)


def test_a_drive_in_another_country_is_refused_for_that_and_nothing_else(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    """Its headings are off and its images are damaged, too, which does not matter there."""
    drive, out = make_drive(), tmp_path / "m.gpkg"
    for image in (drive / "left").iterdir():
        image.unlink()  # it is a link to that of the example
        image.write_bytes(b"x")
    mounting = drive / "calibration/mounting.json"
    said = json.loads(mounting.read_text())
    mounting.unlink()
    mounting.write_text(json.dumps({**said, "heading_offset_deg": 90.0}))
    with pytest.raises(DatumError, match=r"fixes of .* are 1\d\d\d km from the datum 49\.0"):
        build([drive], out, datum=Datum(49.0, 8.4, 110.0))
    assert not out.exists()


@pytest.mark.usefixtures("worked_out_afresh")
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
    with open_recording(first) as one, open_recording(second) as other:
        alone = estimate_trajectory(one).datum, estimate_trajectory(other).datum
    assert alone[0] != alone[1]
    build([first, second], tmp_path / "m.gpkg")
    with open_map(tmp_path / "m.gpkg") as universal:
        assert universal.datum == alone[0]
        assert len(universal.sessions()) == 2


def test_with_fail_fast_a_new_map_of_several_drives_needs_all_of_them(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    first, second = make_drive("first", range(3, 6)), make_drive("second", range(5, 8))
    damage(second / "left" / "000007.jpg")
    (tmp_path / "out").mkdir()
    with pytest.raises(RecordingError, match="truncated"):
        build([first, second], tmp_path / "out" / "m.gpkg", fail_fast=True)
    # What was staged of the whole drive is kept for --resume.
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["m.gpkg.work"]
    build([first, second], tmp_path / "out" / "m.gpkg", resume=True, skip_bad=1)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["m.gpkg"]


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
    with pytest.raises(
        PartlyBuiltError, match=r"1 of 2 .* in the map\. third: .*truncated"
    ) as told:
        build([second, third], out, append=True)
    assert [report.session for report in told.value.reports] == ["second"]
    assert sorted(tmp_path.glob("m.gpkg*")) == [out]
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
