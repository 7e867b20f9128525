"""`fieldgrid mount` at the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from fieldgrid.recordings import open_recording
from tests.cli.conftest import Run

MakeDrive = Callable[..., Path]
FRAMES = range(3, 16)
VALUES = {
    "camera_height_above_ground_m": (2.65, 0.04),
    "camera_tilt_down_deg": (16.0, 0.5),
    "camera_roll_deg": (0.0, 0.7),
    "camera_yaw_deg": (0.0, 0.3),
}


def place(drive: Path) -> Path:
    return drive / "calibration" / "mounting.json"


def test_the_table_compares_with_what_is_stated(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive("june", FRAMES)
    before = place(drive).read_bytes()
    stated = {**json.loads(before), "camera_tilt_down_deg": 12.0}
    place(drive).write_text(json.dumps(stated))
    text = fieldgrid("mount", drive, "--figure", tmp_path / "mount.png").output()
    assert text.startswith("mount june")
    (tilt,) = (line for line in text.splitlines() if line.startswith("tilt, down"))
    assert "12.00 °" in tilt
    assert "sigma)" in tilt
    assert "disagrees: tilt, down is stated as 12.00 °, which is" in text
    assert text.count("disagrees:") == 1
    assert json.loads(place(drive).read_bytes()) == stated  # only --write writes
    picture = cv2.imread(str(tmp_path / "mount.png"))
    assert picture is not None
    assert picture.shape[1] > picture.shape[0] > 500


def test_a_recording_without_mounting_gets_one(fieldgrid: Run, make_drive: MakeDrive) -> None:
    """As the error of a missing mounting says."""
    drive = make_drive("june", FRAMES)
    place(drive).unlink()
    sentence = fieldgrid("build", drive, "-o", drive / "map.gpkg").sentence()
    assert f"fieldgrid mount {drive} --write" in sentence

    refused = fieldgrid("mount", drive, "--write")
    assert refused.status == 1
    assert "tilt, down" in refused.out  # what was measured is told all the same
    assert refused.err.count("\n") == 1
    assert "--antenna FORWARD LEFT UP" in refused.err
    assert not place(drive).exists()

    arm = ("--antenna", "-0.45", "0.12", "0.35")
    text = fieldgrid("mount", drive, "--write", *arm, "--json").output()
    document = json.loads(text)
    assert document["mounting"] == str(place(drive))
    assert document["stated"] is None
    written = json.loads(place(drive).read_text())
    assert written["gnss_antenna_from_camera_mid_flu_m"] == [-0.45, 0.12, 0.35]
    for key, (truth, most) in VALUES.items():
        assert written[key] == pytest.approx(truth, abs=most)
        assert written[key] == pytest.approx(document[key]["value"], abs=0.01)
        assert abs(document[key]["value"] - truth) < 3.0 * document[key]["sigma"]
    ahead = document["camera_ahead_of_rear_axle_m"]
    if ahead is not None:
        axle = written["camera_mid_from_rear_axle_ground_flu_m"]
        assert axle[0] == pytest.approx(ahead["value"], abs=0.01)
        assert axle[2] == written["camera_height_above_ground_m"]
    with open_recording(drive) as recording:  # which was what the build lacked
        assert recording.rig.mount.tilt_deg == written["camera_tilt_down_deg"]
        assert recording.rig.antenna.forward_m == -0.45


def test_what_is_used_wrongly(fieldgrid: Run, make_drive: MakeDrive) -> None:
    drive = make_drive()
    assert "--write" in fieldgrid("mount", drive, "--antenna", "1", "2", "3").usage()
    assert ".png" in fieldgrid("mount", drive, "--figure", "mount.txt").usage()
    assert "nowhere" in fieldgrid("mount", "nowhere").sentence()


def test_too_few_frames(fieldgrid: Run, make_drive: MakeDrive) -> None:
    sentence = fieldgrid("mount", make_drive("june", range(3, 5))).sentence()
    assert "in 2 of 2 frames, and 3 are needed" in sentence
