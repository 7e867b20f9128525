"""An inspection counts what a build uses, and advises what it has tried."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from fieldgrid.core import resolve
from fieldgrid.pipeline import build_map, inspect_recording
from fieldgrid.poses import estimate_poses
from fieldgrid.recordings import open_recording
from tests.told import codes

SharedData = Callable[[str], Path]


def test_the_counts_are_those_of_a_build(shared_data: SharedData, tmp_path: Path) -> None:
    """Of a drive some of whose fixes have no usable pose."""
    drive = shared_data("kitti_2011_09_26_drive_0013_part")
    strict = {"max_heading_sigma_deg": 0.4}
    found = inspect_recording(drive, resolve(None, {"pose": strict}))
    assert found.fixes is not None
    (built,) = build_map([drive], tmp_path / "a.gpkg", resolve(None, {"pose": strict}))
    assert (found.fixes.accepted, found.fixes.log.accepted) == (built.fixes_accepted, built.fixes)
    assert built.fixes_accepted < built.fixes
    assert found.fixes.as_dict()["accepted"] == built.fixes_accepted
    assert found.frames_usable == built.used
    (lost,) = (one for one in found.findings if one.code == "frames-unusable")
    advised = re.match(r"With --heading (\w+) (\d+) have one\.", lost.remedy)
    assert advised is not None
    settings = resolve(None, {"pose": {"heading": advised[1], **strict}})
    (better,) = build_map([drive], tmp_path / "b.gpkg", settings)
    assert better.used == int(advised[2]) > built.used


def test_headings_are_tried_for_a_drive_without_a_pose(shared_data: SharedData) -> None:
    drive = shared_data("kitti_2011_09_26_drive_0013_part")
    found = inspect_recording(drive, resolve(None, {"pose": {"max_heading_sigma_deg": 0.31}}))
    assert found.frames_usable == 0
    assert "no-pose" in {one.code for one in found.findings}
    (lost,) = (one for one in found.findings if one.code == "frames-unusable")
    assert lost.remedy.startswith("With --heading recorded 78 have one.")


def test_fixes_that_wander_have_no_wrong_stamps_in_the_unit_of_their_gyro(
    shared_data: SharedData,
) -> None:
    """Without its images, which would show the way, a road drive is tracked all the same."""
    drive = shared_data("kitti_2011_09_26_drive_0013_part")
    with open_recording(drive) as recording:
        found = estimate_poses(recording.fixes(), recording.rig, motion=recording.motion())
    assert found.trajectory.accepted.all()
    assert codes(found.report) == []
