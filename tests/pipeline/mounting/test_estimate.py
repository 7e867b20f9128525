"""Mounts found by drives: rendered ones with any mount, and real ones."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import CalibrationError, MeasuredValue, RecordingError
from fieldgrid.geometry import Mount
from fieldgrid.pipeline import MountEstimate, estimate_mount
from fieldgrid.pipeline.mounting.estimate import AHEAD, UNDER
from fieldgrid.recordings import DriveOptions, open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.drives import yard
from tests.pipeline.mounting.drives import AXLE_AHEAD_M, rendered, swept
from tests.remembered import worked_out_once

CASES = [
    (Mount(2.0, 18.0, 2.5, -3.0), {}),
    (Mount(1.2, 10.0, -1.5, 4.0), {}),
    (Mount(1.8, 14.0, -2.0, 3.0), {"walls": True}),
    (Mount(2.0, 18.0, 1.0, 3.0), {"step_m": -0.8}),
    (Mount(2.4, 25.0, 0.0, -1.0), {"sway_deg": 0.6, "walls": True}),
]


def check(estimate: MountEstimate, mount: Mount) -> None:
    """Close to the truth, and no surer than that."""
    assert estimate.yaw_deg is not None
    for measured, truth, most in (
        (estimate.height_m, mount.height_m, 0.03),
        (estimate.tilt_deg, mount.tilt_deg, 0.25),
        (estimate.roll_deg, mount.roll_deg, 0.25),
        (estimate.yaw_deg, mount.yaw_deg, 0.3),
    ):
        assert measured.value == pytest.approx(truth, abs=most)
        assert abs(measured.off(truth)) < 3.0
        assert measured.sigma < most


@pytest.mark.parametrize(
    ("mount", "drive"),
    [*CASES[:2], *(pytest.param(*case, marks=pytest.mark.long) for case in CASES[2:])],
)
def test_the_mount_of_a_rendered_drive_is_found(mount: Mount, drive: dict[str, float]) -> None:
    estimate = estimate_mount(rendered(mount, **drive))  # type: ignore[arg-type]
    check(estimate, mount)
    assert estimate.method == UNDER
    backwards = "step_m" in drive
    assert (estimate.reverse_m > 10.0) is backwards
    assert (estimate.forward_m > 10.0) is not backwards
    assert any("in reverse" in note for note in estimate.notes) is backwards
    assert any("No fixes" in note for note in estimate.notes)


def test_what_is_stated_of_the_mount_does_not_enter() -> None:
    drive = rendered(Mount(2.0, 18.0), frames=12)
    one, other = (
        estimate_mount(replace(drive, rig=replace(drive.rig, mount=stated)))
        for stated in (Mount(1.0, 0.0), Mount(3.0, 50.0, -15.0, 20.0))
    )
    assert one.measured() == other.measured()
    np.testing.assert_array_equal(one.mount_samples.roll_deg, other.mount_samples.roll_deg)


@pytest.mark.usefixtures("worked_out_afresh")
def test_nothing_depends_on_the_number_of_threads() -> None:
    drive = rendered(Mount(2.0, 18.0), frames=12)
    assert estimate_mount(drive, jobs=1).measured() == estimate_mount(drive, jobs=4).measured()


def test_a_drive_in_one_curve_needs_the_axle_for_its_yaw() -> None:
    drive = rendered(Mount(2.0, 18.0, 0.0, 2.0), frames=14, curvature_per_m=0.04)
    estimate = estimate_mount(drive)
    assert estimate.yaw_deg is None
    assert any("of one curve" in note for note in estimate.notes)
    assert estimate.as_dict()["camera_yaw_deg"] is None
    assert estimate.mount.yaw_deg == 0.0
    said = replace(drive, rig=replace(drive.rig, rear_axle_forward_m=-AXLE_AHEAD_M))
    estimate = estimate_mount(said)
    assert estimate.yaw_deg is not None
    assert estimate.yaw_deg.value == pytest.approx(2.0, abs=0.2)


def test_a_short_drive_has_only_the_ground_ahead_and_is_less_sure() -> None:
    mount = Mount(2.0, 18.0, 1.0, 2.0)
    estimate = estimate_mount(rendered(mount, frames=5))
    assert estimate.method == AHEAD
    assert estimate.tilt_deg.value == pytest.approx(18.0, abs=0.8)
    assert estimate.tilt_deg.sigma > 0.5
    assert any("ground ahead" in note for note in estimate.notes)


def test_a_lidar_tells_its_height_and_angles() -> None:
    estimate = estimate_mount(swept(Mount(1.9, 3.0, -2.0)))
    assert estimate.height_m.value == pytest.approx(1.9, abs=0.03)
    assert estimate.tilt_deg.value == pytest.approx(3.0, abs=0.1)
    assert estimate.roll_deg.value == pytest.approx(-2.0, abs=0.1)
    assert estimate.yaw_deg is None
    assert any("Lidar" in note for note in estimate.notes)


def test_a_drive_that_shows_no_ground() -> None:
    drive = rendered(Mount(2.0, 18.0), frames=3, textured=False)
    with pytest.raises(RecordingError, match=r"ground in 0 of 3 frames.*measure the mounting\.$"):
        estimate_mount(drive)


@pytest.fixture(scope="module")
def two_lanes() -> MountEstimate:
    with worked_out_once():
        return estimate_mount(TWO_LANES, DriveOptions("gnss_rtk.nmea"))


def test_the_vineyard_rig_is_recovered(two_lanes: MountEstimate) -> None:
    """Camera 2.65 m above ground, tilted by 16°, neither rolled nor turned, 1.4 m of the axle."""
    assert two_lanes.height_m.value == pytest.approx(2.65, abs=0.03)
    assert two_lanes.tilt_deg.value == pytest.approx(16.0, abs=0.2)
    assert two_lanes.roll_deg.value == pytest.approx(0.0, abs=0.2)
    assert two_lanes.yaw_deg is not None
    assert two_lanes.yaw_deg.value == pytest.approx(0.0, abs=0.3)
    assert two_lanes.axle_ahead_m is not None
    assert two_lanes.axle_ahead_m.value == pytest.approx(1.4, abs=0.15)
    assert two_lanes.reverse_m > 3.0
    compared = two_lanes.compared()
    assert len(compared) == 5
    assert not any(one.disagrees for one in compared)
    assert two_lanes.gnss is not None
    assert two_lanes.gnss.scale is not None
    assert two_lanes.gnss.scale.ratio == pytest.approx(1.0, abs=0.01)
    assert two_lanes.gnss.course_off_deg is None  # no heading was recorded


def test_a_wrong_statement_is_found(two_lanes: MountEstimate) -> None:
    assert two_lanes.stated is not None
    wrong = replace(two_lanes.stated, mount=Mount(2.65, 14.5, 0.0, 1.0))
    disagree = [one.key for one in replace(two_lanes, stated=wrong).compared() if one.disagrees]
    assert disagree == ["camera_tilt_down_deg", "camera_yaw_deg"]


def test_the_estimate_as_json(two_lanes: MountEstimate) -> None:
    document = json.loads(json.dumps(two_lanes.as_dict(), allow_nan=False))
    tilt = document["camera_tilt_down_deg"]
    assert tilt == {"value": two_lanes.tilt_deg.value, "sigma": two_lanes.tilt_deg.sigma}
    stated = document["stated"]["camera_tilt_down_deg"]
    assert stated["stated"] == 16.0
    assert stated["difference"] == pytest.approx(16.0 - tilt["value"])
    assert stated["disagrees"] is False


@pytest.mark.long
def test_kitti_above_the_road(shared_data: Callable[[str], Path]) -> None:
    """The INS of the drive leans forward by 0.56° of the road, and the camera by 0.49° of the INS.

    Both are told without images; what is measured is the camera against the road.
    """
    drive = shared_data("kitti_2011_09_30_drive_0020")
    with open_recording(drive) as recording:
        estimate = estimate_mount(recording, every=2)
    assert estimate.height_m.value == pytest.approx(1.65, abs=0.03)
    assert estimate.tilt_deg.value == pytest.approx(0.49 + 0.56, abs=0.2)
    assert estimate.gnss is not None
    assert estimate.gnss.scale is not None
    assert estimate.gnss.scale.ratio == pytest.approx(1.0, abs=0.01)
    assert estimate.gnss.course_off_deg is not None
    assert abs(estimate.gnss.course_off_deg.value) < 0.3


def test_a_broken_mounting_is_told_and_not_passed_over(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    (drive / "calibration" / "mounting.json").write_text("{}")
    with pytest.raises(CalibrationError, match="camera_height_above_ground_m"):
        estimate_mount(drive)


def test_another_fault_than_a_missing_mounting_is_told(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    for file in (drive / "calibration").iterdir():
        file.unlink()
    with pytest.raises(CalibrationError) as error:
        estimate_mount(drive)
    assert "fieldgrid mount" not in str(error.value)


def test_what_is_not_stated_is_not_compared(two_lanes: MountEstimate) -> None:
    assert replace(two_lanes, stated=None).compared() == []
    assert two_lanes.stated is not None
    axle = replace(two_lanes.stated, rear_axle_forward_m=None)
    assert len(replace(two_lanes, stated=axle).compared()) == 4
    assert math.isclose(MeasuredValue(1.0, 0.1).off(1.2), 2.0)


def test_the_motion_within_a_sweep_moves_no_ground(tmp_path: Path) -> None:
    # A vehicle that turns by 34°/s at 2.5 m/s: its lidar sees the same plane from everywhere.
    found = estimate_mount(yard.recorded(tmp_path / "drive"), every=1)
    assert found.height_m.value == pytest.approx(yard.HEIGHT_M, abs=0.003)
    assert found.tilt_deg.value == pytest.approx(0.0, abs=0.02)
    assert found.roll_deg.value == pytest.approx(0.0, abs=0.02)
