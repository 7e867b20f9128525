"""An estimate as a mounting.json: what it changes, what it keeps, what it does not invent."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import CalibrationError, ConfigError, MeasuredValue
from fieldgrid.geometry import Rig
from fieldgrid.pipeline import MountEstimate, write_estimate
from fieldgrid.pipeline.mounting.estimate import UNDER
from fieldgrid.pipeline.mounting.ground_under_vehicle import MountSamples
from fieldgrid.poses import Ways
from fieldgrid.recordings import mounting_path, open_recording

NOTHING = np.zeros(0)
YAW = MeasuredValue(0.4567, 0.1)


def estimate(stated: Rig | None, *, yaw: MeasuredValue | None = YAW) -> MountEstimate:
    return MountEstimate(
        name="drive",
        height_m=MeasuredValue(2.70049, 0.01),
        tilt_deg=MeasuredValue(15.4444, 0.1),
        roll_deg=MeasuredValue(-0.001, 0.1),
        yaw_deg=yaw,
        axle_ahead_m=None,
        method=UNDER,
        frames=9,
        looked=9,
        steps=8,
        forward_m=9.0,
        reverse_m=0.0,
        straight_m=9.0,
        time_ns=np.zeros(0, dtype=np.int64),
        mount_samples=MountSamples(np.zeros(0, dtype=np.int64), NOTHING, NOTHING, NOTHING),
        ways=Ways(np.zeros(0, dtype=np.int64), NOTHING, NOTHING, NOTHING, NOTHING),
        gnss=None,
        stated=stated,
        notes=(),
    )


def test_what_is_not_estimated_stays(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    before = json.loads((drive / "calibration" / "mounting.json").read_text())
    with open_recording(drive) as recording:
        place = write_estimate(estimate(recording.rig), drive)
    assert place == drive / "calibration" / "mounting.json"
    after = json.loads(place.read_text())
    changed = {
        "camera_height_above_ground_m": 2.7,
        "camera_tilt_down_deg": 15.44,
        "camera_roll_deg": 0.0,
        "camera_yaw_deg": 0.46,
        "camera_mid_from_rear_axle_ground_flu_m": [1.4, 0, 2.7],
    }
    assert after == {**before, **changed}
    assert list(after) == list(before)
    with open_recording(drive) as recording:
        assert recording.rig.mount.tilt_deg == 15.44
        # The antenna stays 35 cm above the camera, wherever that is.
        assert recording.rig.antenna.up_m == pytest.approx(2.7 + 0.35)


@pytest.mark.parametrize("is_new", [False, True])
def test_an_axle_that_was_measured_is_written(
    is_new: bool, make_drive: Callable[..., Path]
) -> None:
    drive = make_drive()
    with open_recording(drive) as recording:
        found = replace(estimate(recording.rig), axle_ahead_m=MeasuredValue(1.7234, 0.02))
    if is_new:
        (drive / "calibration" / "mounting.json").unlink()
    place = write_estimate(found, drive)
    axle = json.loads(place.read_text())["camera_mid_from_rear_axle_ground_flu_m"]
    assert axle == [1.72, 0.0, 2.7]
    with open_recording(drive) as recording:
        assert recording.rig.rear_axle_forward_m == -1.72


def test_a_yaw_that_was_not_told_stays_as_stated(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    path = drive / "calibration" / "mounting.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "camera_yaw_deg": 1.25}))
    with open_recording(drive) as recording:
        write_estimate(estimate(recording.rig, yaw=None), drive)
    assert json.loads(path.read_text())["camera_yaw_deg"] == 1.25


def test_no_antenna_is_invented(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    place = drive / "calibration" / "mounting.json"
    place.unlink()
    with pytest.raises(ConfigError, match=r"was not written.*--antenna FORWARD LEFT UP\.$"):
        write_estimate(estimate(None), drive)
    assert not place.exists()


def test_a_new_file_has_the_antenna_that_is_given(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    (drive / "calibration" / "mounting.json").unlink()
    place = write_estimate(estimate(None), drive, (-0.45, 0.12, 0.35))
    assert json.loads(place.read_text()) == {
        "camera_height_above_ground_m": 2.7,
        "camera_tilt_down_deg": 15.44,
        "camera_roll_deg": 0.0,
        "camera_yaw_deg": 0.46,
        "gnss_antenna_from_camera_mid_flu_m": [-0.45, 0.12, 0.35],
    }
    with open_recording(drive) as recording:
        antenna = recording.rig.antenna
        assert (antenna.right_m, antenna.forward_m) == (-0.12, -0.45)
        assert antenna.up_m == pytest.approx(3.05)


def test_an_antenna_that_is_given_replaces_the_stated_one(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    with open_recording(drive) as recording:
        place = write_estimate(estimate(recording.rig), drive, (1.0, 0.0, 0.5))
    assert json.loads(place.read_text())["gnss_antenna_from_camera_mid_flu_m"] == [1.0, 0.0, 0.5]


def test_what_a_recording_states_elsewhere_enters_a_new_file(
    make_drive: Callable[..., Path], tmp_path: Path
) -> None:
    """As of a KITTI drive or a bag with transforms: the antenna is known, and the axle."""
    with open_recording(make_drive()) as recording:
        rig = recording.rig
    bag = tmp_path / "june.mcap"
    bag.touch()
    place = write_estimate(estimate(rig), bag)
    assert place == tmp_path / "june.mounting.json"
    written = json.loads(place.read_text())
    assert written["gnss_antenna_from_camera_mid_flu_m"] == [-0.45, 0.12, 0.35]
    assert written["camera_mid_from_rear_axle_ground_flu_m"] == [1.4, 0.0, 2.7]


def test_a_file_that_is_no_mounting_is_not_replaced(make_drive: Callable[..., Path]) -> None:
    drive = make_drive()
    with open_recording(drive) as recording:
        rig = recording.rig
    place = drive / "calibration" / "mounting.json"
    place.write_text('{"camera_hight": 2}')
    with pytest.raises(CalibrationError, match="camera_hight"):
        write_estimate(estimate(rig), drive)
    assert place.read_text() == '{"camera_hight": 2}'


def test_the_places_of_mountings(make_drive: Callable[..., Path], tmp_path: Path) -> None:
    drive = make_drive()
    assert mounting_path(drive) == drive / "calibration" / "mounting.json"
    bag = tmp_path / "a.b.mcap"
    bag.touch()
    assert mounting_path(bag) == tmp_path / "a.b.mounting.json"
    (tmp_path / "mounting.json").touch()
    assert mounting_path(bag) == tmp_path / "mounting.json"  # what it is opened with
    (tmp_path / "a.b.mounting.json").touch()
    assert mounting_path(bag) == tmp_path / "a.b.mounting.json"
    folder = tmp_path / "bag"
    folder.mkdir()
    assert mounting_path(folder) == folder / "mounting.json"
    for camera in ("cam0", "cam1"):
        (folder / "mav0" / camera).mkdir(parents=True)
        (folder / "mav0" / camera / "data.csv").touch()
    assert mounting_path(folder) == folder / "mounting.json"
    assert mounting_path(folder / "mav0") == folder / "mounting.json"
    (folder / "mav0" / "mounting.json").touch()
    assert mounting_path(folder) == folder / "mav0" / "mounting.json"


def test_a_kitti_drive_is_opened_with_the_mounting_that_was_written(
    shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    date = shared_data("kitti_2011_09_30_drive_0020") / "2011_09_30"
    here = tmp_path / "2011_09_30"
    drive = here / "2011_09_30_drive_0020_sync"
    drive.mkdir(parents=True)
    for file in date.glob("*.txt"):
        (here / file.name).symlink_to(file)
    for part in (date / drive.name).iterdir():
        (drive / part.name).symlink_to(part)
    with open_recording(tmp_path) as recording:
        stated = recording.rig
        assert any("1.65 m" in note for note in recording.notes)
    assert write_estimate(estimate(stated), tmp_path) == drive / "mounting.json"
    with open_recording(tmp_path) as recording:
        assert recording.rig.mount.tilt_deg == 15.44
        assert recording.rig.antenna.forward_m == pytest.approx(stated.antenna.forward_m)
        assert not any("1.65 m" in note for note in recording.notes)
