"""The vineyard's raw pairs, rectified here, beside the same frames rectified at their making."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest

from benchmarks.rectified import compare, raw_row_error_px
from fieldgrid.core import CalibrationError, RecordingError
from fieldgrid.recordings import open_recording
from tests.conftest import TWO_LANES

SharedData = Callable[[str], Path]


@pytest.mark.long
def test_maps_of_raw_pairs_are_as_good_as_of_rectified_ones(shared_data: SharedData) -> None:
    shared_data("vineyard_two_lanes/raw_left")
    reference, scores = islice(compare(), 2)  # the third is for reading
    wanted = reference.group.obstacles
    assert reference.group.poses.frames == 8
    assert wanted.precision["0.10"] is not None
    assert wanted.precision["0.10"] > 0.9
    found = scores.group.obstacles
    assert scores.group.poses.frames == 8
    for tolerance in ("0.10", "0.25"):
        assert found.precision[tolerance] == pytest.approx(wanted.precision[tolerance], abs=0.02)
        assert found.recall[tolerance] == pytest.approx(wanted.recall[tolerance], abs=0.02)
    assert scores.row_error_px < reference.row_error_px + 0.03
    assert raw_row_error_px() > 3 * reference.row_error_px


def test_a_table_and_a_calibration_can_be_named(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    shutil.copytree(TWO_LANES / "calibration", drive / "calibration")
    for name in ("left", "right"):
        (drive / f"raw_{name}").symlink_to(TWO_LANES / name)
    rows = (TWO_LANES / "frames.csv").read_text().replace("left/", "raw_left/")
    (drive / "raw.csv").write_text(rows.replace("right/", "raw_right/"))
    (drive / "calibration" / "stereo_opencv.yaml").rename(drive / "calibration" / "mine.yaml")
    for path in (drive / "calibration").glob("stereo_*"):
        path.unlink()
    (drive / "recording.toml").write_text('frames = "raw.csv"\ncalibration = "mine.yaml"\n')
    recording = open_recording(drive)
    assert recording.frame_count == 50
    frame = next(iter(recording.frames()))
    assert frame.sources[0].name.endswith("raw_left/000000.jpg")
    (drive / "recording.toml").write_text('frames = "raw.csv"\n')
    with pytest.raises(CalibrationError, match=r"has neither stereo_opencv\.yaml"):
        open_recording(drive)
    (drive / "recording.toml").write_text('frames = "none.csv"\ncalibration = "mine.yaml"\n')
    with pytest.raises(RecordingError, match=r"none\.csv cannot be read"):
        open_recording(drive)
