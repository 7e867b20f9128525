"""Roll and pitch of sessions against a truth."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import TruthError
from fieldgrid.field import evaluate, read_truth
from fieldgrid.field.evaluation.attitude import score_attitude
from fieldgrid.field.evaluation.truth import TruthPose
from fieldgrid.geometry import Status
from fieldgrid.maps import FrameRecord, open_map
from fieldgrid.pipeline import attitudes_of
from fieldgrid.poses import Attitude
from tests.conftest import TWO_LANES
from tests.maps.file.maps import drive, write_map

TRUE_ROLL_DEG, TRUE_PITCH_DEG = 2.0, -3.0


def records(path: Path) -> list[FrameRecord]:
    with open_map(write_map(path, [drive(4)])) as universal:
        return list(universal.frames())


def attitude_of(frames: list[FrameRecord], roll_off: float, pitch_off: float) -> Attitude:
    times = np.array([frame.driven.time_ns for frame in frames])
    n = np.ones(len(times))
    roll, pitch = (TRUE_ROLL_DEG + roll_off) * n, (TRUE_PITCH_DEG + pitch_off) * n
    return Attitude(times, roll, pitch, 0.1 * n, 0.2 * n, 0.0 * n, 0.0 * n, 5.0)


def truth_of(frame: FrameRecord, roll_deg: float = TRUE_ROLL_DEG) -> TruthPose:
    at = frame.pose
    place = (at.time_ns, at.east_m, at.north_m, at.heading_deg)
    return TruthPose(*place, "forward", "lane_1", roll_deg, TRUE_PITCH_DEG)


def test_errors_of_roll_and_pitch(tmp_path: Path) -> None:
    frames = records(tmp_path / "m.gpkg")
    (name,) = {frame.session for frame in frames}
    pairs = [(frame, truth_of(frame)) for frame in frames]
    scores = score_attitude({name: attitude_of(frames, -0.2, 0.5)}, pairs)
    assert scores is not None
    assert scores.frames == 4
    assert scores.median_deg == pytest.approx(0.35)
    assert scores.max_deg == pytest.approx(0.5)
    assert scores.within_3_sigma == 1.0
    # A roll 0.35° off is beyond three of its sigmas, a pitch is not: each has its own.
    worse = score_attitude({name: attitude_of(frames, 0.35, 0.35)}, pairs)
    assert worse is not None
    assert worse.within_3_sigma == 0.5


def test_frames_that_count(tmp_path: Path) -> None:
    frames = records(tmp_path / "m.gpkg")
    (name,) = {frame.session for frame in frames}
    attitudes = {name: attitude_of(frames, 0.1, 0.1)}
    assert score_attitude({}, [(frame, truth_of(frame)) for frame in frames]) is None
    assert (
        score_attitude(attitudes, [(frame, truth_of(frame, math.nan)) for frame in frames]) is None
    )
    rejected = replace(frames[0].pose, status=Status.REJECTED, reason="why")
    unused = replace(frames[0], pose=rejected, driven=rejected)
    scores = score_attitude(
        attitudes, [(unused, truth_of(unused)), (frames[1], truth_of(frames[1]))]
    )
    assert scores is not None
    assert scores.frames == 1


def test_the_example_drive(two_lanes_map: Path) -> None:
    truth = read_truth(TWO_LANES / "truth")
    with open_map(two_lanes_map) as universal:
        scores = evaluate(universal, truth, attitudes=attitudes_of(universal).by_session).attitude
        assert evaluate(universal, truth).attitude is None
    assert scores is not None
    assert scores.frames == 50
    assert scores.p95_deg < 0.3
    assert scores.within_3_sigma > 0.98


def test_a_session_without_fixes_has_no_attitude(tmp_path: Path) -> None:
    with open_map(write_map(tmp_path / "m.gpkg", [drive(2)])) as universal:
        assert attitudes_of(universal) == ({}, {})


def test_a_truth_with_one_of_both_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "truth"
    shutil.copytree(TWO_LANES / "truth", folder)
    table = folder / "poses_frames.csv"
    lines = table.read_text().splitlines()
    columns = lines[0].split(",")
    row = lines[1].split(",")
    row[columns.index("roll_deg")] = ""
    table.write_text("\n".join([lines[0], ",".join(row), *lines[2:]]) + "\n")
    with pytest.raises(TruthError, match="only one of roll and pitch"):
        read_truth(folder)
