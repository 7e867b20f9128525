"""Obstacles that other frames deny are counted, and a build of noisy images says so."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import Bool
from fieldgrid.geometry import GridSpec, LocalGrid, Pose
from fieldgrid.maps import StagedFrame, stage, to_universal
from fieldgrid.pipeline.checks.agreement import (
    PAIRS,
    agreement_findings,
    denied_share,
    opposed_findings,
    opposed_share,
)
from tests.pipeline.drives.making import WITHOUT_CAMERA, MakeDrive, build
from tests.scenes import depth_rig, lidar_rig

SPEC = GridSpec(8.0, 10.0, 0.1)


def frames_past_a_wall(
    false_share: float, apart_m: float = 1.0, count: int = 16, heading_deg: float = 30.0
) -> tuple[list[StagedFrame], list[tuple[int, Pose]]]:
    """A wall 2 to 3 m to the right of the way of frames, each with so many false cells for each of
    the wall, to the left of it."""
    rng, phi = np.random.default_rng(3), math.radians(heading_deg)
    frames, placed = [], []
    for k in range(count):
        east_m, north_m = k * apart_m * math.sin(phi), k * apart_m * math.cos(phi)
        pose = Pose(k * 10**9, east_m, north_m, 0.0, heading_deg, 0.02, 0.3, 1.0)
        right_m, ahead_m = np.meshgrid(*SPEC.centres_m())
        east, north = to_universal(right_m, ahead_m, pose)
        across_m = east * math.cos(phi) - north * math.sin(phi)
        wall: Bool = (across_m > 2.0) & (across_m < 3.0)
        left = np.flatnonzero(right_m < 1.0)
        density = np.where(wall, 200, 0).astype(np.uint8)
        false = rng.choice(left, round(false_share * int(wall.sum())), replace=False)
        density.flat[false] = 200
        frames.append(stage(LocalGrid(SPEC, density, np.ones(SPEC.shape, bool)), f"{k}", 0))
        placed.append((k, pose))
    return frames, placed


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 250.0])
def test_a_wall_that_all_see_is_denied_by_none(heading_deg: float) -> None:
    assert denied_share(*frames_past_a_wall(0.0, heading_deg=heading_deg)) == 0.0


def test_false_cells_are_denied() -> None:
    frames, placed = frames_past_a_wall(0.1)
    share = denied_share(frames, placed)
    # Of 1.1 cells 0.1 are false, and few of those lie beside another frame's.
    assert share is not None
    assert 0.06 < share < 0.1


def test_a_pose_that_leaps_is_in_few_pairs() -> None:
    frames, placed = frames_past_a_wall(0.0, count=24)
    k, pose = placed[9]
    placed[9] = k, replace(pose, east_m=pose.east_m + 1.5)
    assert denied_share(frames, placed) == 0.0


def frames_of_two_lanes(
    aside_m: float, thick_m: float = 0.4, count: int = 20
) -> tuple[list[StagedFrame], list[tuple[int, Pose]]]:
    """Up one side of a wall and down the other, 1.5 m from it, which hides what is behind; all
    poses lie so far to the right of the vehicle."""
    frames, placed = [], []
    right_m, ahead_m = np.meshgrid(*SPEC.centres_m())
    for k in range(2 * count):
        back = k >= count
        heading_deg, sign = (180.0, -1.0) if back else (0.0, 1.0)
        north_m = float(2 * count - k if back else k)
        true = Pose(k * 10**9, -1.5 * sign, north_m, 0.0, heading_deg, 0.02, 0.3, 1.0)
        east, _ = to_universal(right_m, ahead_m, true)
        wall = np.abs(east) < thick_m / 2.0
        density = np.where(wall, 200, 0).astype(np.uint8)
        seen: Bool = sign * east < thick_m / 2.0 - 0.1  # into the wall, not through it
        frames.append(stage(LocalGrid(SPEC, density, seen), f"{k}", 0))
        placed.append((k, replace(true, east_m=true.east_m + sign * aside_m)))
    return frames, placed


@pytest.mark.parametrize(("aside_m", "least", "most"), [(0.0, 0.0, 0.0), (0.1, 0.0, 0.1)])
def test_lanes_that_agree_deny_nothing_of_each_other(
    aside_m: float, least: float, most: float
) -> None:
    share = opposed_share(*frames_of_two_lanes(aside_m))
    assert share is not None
    assert least <= share <= most


def test_lanes_that_are_put_into_each_other_contradict() -> None:
    share = opposed_share(*frames_of_two_lanes(0.5))
    assert share is not None
    assert share > 0.9


def test_lanes_that_are_put_apart_tell_nothing() -> None:
    """Nobody saw what would be behind the wall then."""
    assert opposed_share(*frames_of_two_lanes(-0.5)) is None


@pytest.mark.parametrize("lanes", [slice(0, 20), slice(20, 40)])
def test_one_lane_has_no_other(lanes: slice) -> None:
    frames, placed = frames_of_two_lanes(0.5)
    assert opposed_share(frames, placed[lanes]) is None


def test_lanes_that_contradict_are_told_of_sure_poses() -> None:
    (told,) = opposed_findings(0.31, 0.02)
    assert told.message.startswith(
        "In lanes driven in opposite directions, frames of one lane call 31 % of the other's "
        "obstacle cells"
    )
    for share, sigma_m in ((None, 0.02), (0.07, 0.02), (0.31, 0.3), (0.31, None)):
        assert not list(opposed_findings(share, sigma_m))


def test_an_antenna_on_the_wrong_side_is_told(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(50))
    mounting = drive / "calibration" / "mounting.json"
    said = json.loads(mounting.read_text())
    said["gnss_antenna_from_camera_mid_flu_m"][1] += 0.4
    mounting.write_text(json.dumps(said))
    (report,) = build([drive], tmp_path / "aside.gpkg", settings=WITHOUT_CAMERA)
    assert report.opposed_share is not None
    assert report.opposed_share > 0.5
    assert any(
        "Check the lateral position of the antenna in the mounting" in note for note in report.notes
    )


def test_of_a_long_drive_pairs_are_taken_from_all_along_it() -> None:
    """However many frames there are, and where the vehicle stands for most of them, too."""
    frames, placed = frames_past_a_wall(0.0, count=4)
    asked = list[int]()

    class Recorded:
        def __getitem__(self, index: int) -> StagedFrame:
            asked.append(index)
            return frames[index % 4]

    pose = placed[0][1]
    long = [
        (k, replace(pose, east_m=0.0, north_m=1.5 * max(k - 2000, 0) if k < 3000 else 1500.0))
        for k in range(4000)
    ]
    denied_share(Recorded(), long)
    assert max(asked) - min(asked) > 900
    assert len(asked) == 2 * PAIRS


@pytest.mark.parametrize(("apart_m", "count"), [(0.01, 16), (4.5, 16), (1.0, 4)])
def test_frames_that_cannot_be_compared_say_nothing(apart_m: float, count: int) -> None:
    assert denied_share(*frames_past_a_wall(0.1, apart_m=apart_m, count=count)) is None


def test_noisy_images_are_told(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, rng = make_drive(frames=range(6, 22)), np.random.default_rng(1)
    (clean,) = build([drive], tmp_path / "clean.gpkg")
    for image in [*(drive / "left").iterdir(), *(drive / "right").iterdir()]:
        grey = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE).astype(float)
        image.unlink()  # a link to that of the example
        noisy = np.clip(grey + rng.normal(0.0, 25.0, grey.shape), 0, 255).astype(np.uint8)
        assert cv2.imwrite(str(image), noisy)
    (dirty,) = build([drive], tmp_path / "noisy.gpkg")
    assert clean.denied_share is not None
    assert dirty.denied_share is not None
    assert clean.denied_share < 0.006 < 0.012 < dirty.denied_share
    assert not any("free ground" in note for note in clean.notes)
    assert any("Check the images for noise" in note for note in dirty.notes)


def test_lidars_are_not_told_of_images() -> None:
    camera, lidar = depth_rig(), lidar_rig(1000.0)
    assert list(agreement_findings(0.02, camera))
    assert not list(agreement_findings(0.012, camera))
    assert not list(agreement_findings(None, camera))
    assert not list(agreement_findings(0.02, lidar))
