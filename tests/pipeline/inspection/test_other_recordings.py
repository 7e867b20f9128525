"""Bags, clouds and depths: what applies to them, and no more."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import Severity
from fieldgrid.pipeline import inspect_recording
from fieldgrid.pipeline.inspection import drive as sampling
from fieldgrid.recordings import DriveOptions, open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.inspection.broken import FEW, RTK
from tests.pipeline.inspection.conftest import codes, serious
from tests.recordings import bags, test_sensors
from tests.recordings.bags import Maker, Said

MOUNTING = TWO_LANES / "calibration" / "mounting.json"


def said_of_the_example(maker: Maker) -> list[Said]:
    """Some pairs of the example, its log and its gyro, as messages."""
    with open_recording(TWO_LANES, RTK) as recording:
        times = recording.frame_times_ns()
        camera = recording.rig.camera
    with (TWO_LANES / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    pairs = [(int(times[k]), rows[k]["left"], rows[k]["right"]) for k in FEW]
    left = np.array(
        [
            [camera.focal_px, 0.0, camera.cx_px, 0.0],
            [0.0, camera.focal_px, camera.cy_px, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    right = left.copy()
    right[0, 3] = -camera.focal_baseline_px_m
    imu = next((TWO_LANES / "imu").iterdir())
    return [
        *bags.images_said(maker, TWO_LANES, pairs, (left, right), compressed=True),
        *bags.sentences_said(maker, TWO_LANES / "gnss" / RTK, int(times[0]) - 5_000_000_000),
        *bags.gyro_said(maker, imu),
    ]


def bag_of(tmp_path: Path, said: list[Said], maker: Maker) -> Path:
    return bags.write_bag(tmp_path / "drive", "mcap", maker, said)


def test_a_bag_tells_when_its_messages_were_received(tmp_path: Path) -> None:
    maker = Maker("mcap")
    path = bag_of(tmp_path, said_of_the_example(maker), maker)
    found = inspect_recording(path, options=DriveOptions(mounting=MOUNTING))
    assert found.builds
    assert found.kind == "ROS bag"
    assert not serious(found) - {"stamp-delays"}
    (left,) = (stream for stream in found.streams if stream.role == "left")
    assert left.messages == len(FEW)
    assert left.delay_s == pytest.approx(0.02)


def test_a_bag_without_a_topic_that_is_needed(tmp_path: Path) -> None:
    maker = Maker("mcap")
    said = [one for one in said_of_the_example(maker) if "right/image" not in one.topic]
    path = bag_of(tmp_path, said, maker)
    found = inspect_recording(path, options=DriveOptions(mounting=MOUNTING))
    assert not found.builds
    assert {stream.name for stream in found.streams} == {one.topic for one in said}
    assert "no-images" in codes(found)
    assert found.fixes is not None
    assert found.fixes.log.accepted == 437


def test_a_bag_without_a_mounting(tmp_path: Path) -> None:
    maker = Maker("mcap")
    found = inspect_recording(bag_of(tmp_path, said_of_the_example(maker), maker))
    assert not found.builds
    (error,) = (one for one in found.findings if one.severity is Severity.ERROR)
    assert error.code == "calibration"
    assert "fieldgrid mount" in error.remedy


def test_a_truncated_bag(tmp_path: Path) -> None:
    maker = Maker("mcap")
    path = bag_of(tmp_path, said_of_the_example(maker), maker)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.9 * len(data))])
    found = inspect_recording(path, options=DriveOptions(mounting=MOUNTING))
    assert "losses" in codes(found) or not found.builds
    path.write_bytes(data[:10])
    found = inspect_recording(path, options=DriveOptions(mounting=MOUNTING))
    assert not found.builds
    path.write_bytes(b"")
    assert not inspect_recording(path, options=DriveOptions(mounting=MOUNTING)).builds


@pytest.mark.parametrize("kind", ["clouds", "depth"])
def test_frames_of_other_sensors(tmp_path: Path, kind: str) -> None:
    files = {"depth_camera_info.yaml": test_sensors.info()} if kind == "depth" else {}
    found = inspect_recording(test_sensors.folder(tmp_path, (kind,), files))
    assert found.rig is not None
    assert found.looks == ()
    assert found.misalignment is None
    assert found.scale is None
    assert found.followed == 0
    assert "clock-unknown" not in codes(found)
    assert not {code for code in codes(found) if code.startswith("images-dark")}
    assert found.as_dict()["rig"]["sensor_kind"] in {"Lidar", "DepthCamera"}


def test_of_a_long_drive_stretches_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "MOST_FOLLOWED", 24)
    monkeypatch.setattr(sampling, "STRETCHES", 3)
    monkeypatch.setattr(sampling, "MOST_SAMPLES", 6)
    found = inspect_recording(TWO_LANES, options=DriveOptions(RTK))
    assert (found.followed, found.camera_pairs, found.looked) == (24, 21, 6)
    assert serious(found) == set()
    assert found.clock is not None
    assert abs(found.clock.offset_s) < 3.0 * found.clock.sigma_s
    assert found.scale is not None
    assert found.scale.ratio == pytest.approx(1.0, abs=0.01)


def test_a_log_that_is_written_more_often_than_the_receiver_solves(tmp_path: Path) -> None:
    """Repeats are no faults of the fixes."""
    path = tmp_path / "log.csv"
    rows = ["time_ns,lat_deg,lon_deg,height_m,quality"]
    for k in range(200):
        place = k // 2
        lat_deg = 41.65 + place * 2.1e-6 + 3e-8 * np.sin(1.7 * place)
        rows.append(f"{1_308_133_815_000_000_000 + k * 100_000_000},{lat_deg},-4.72,700.0,4")
    path.write_text("\n".join(rows))
    found = codes(inspect_recording(path))
    assert "fix-repeats" in found
    assert "fixes-rejected" not in found
