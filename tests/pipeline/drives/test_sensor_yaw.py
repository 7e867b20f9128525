"""Where a sensor looks is told by its frames alone, and whether they are mirrored."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import RecordingError, Severity, error
from fieldgrid.geometry import GridSpec, LocalGrid, Pose
from fieldgrid.maps import StagedFrame, stage, to_universal
from fieldgrid.pipeline import sensor_yaw
from fieldgrid.pipeline.checks.sensor_yaw import SensorYaw, sensor_yaw_findings
from tests.pipeline.drives.making import WITHOUT_CAMERA, MakeDrive, build
from tests.scenes import depth_rig, lidar_rig

SPEC = GridSpec(8.0, 12.0, 0.1)
EVERYWHERE, RIGHT_ONLY, LEFT_ONLY = (-2.0, 2.4), (2.4,), (-2.0,)


def frames_between_walls(
    looks_deg: float = 0.0,
    heading_deg: float = 30.0,
    walls_m: tuple[float, ...] = EVERYWHERE,
    count: int = 40,
    apart_m: float = 1.0,
    mirrored: bool = False,
    hides: bool = True,
) -> tuple[list[StagedFrame], list[tuple[int, Pose]]]:
    """A vehicle weaves along walls 0.4 m thick, `walls_m` right of its way, looking so far to the
    right of what its poses say; what walls hide is not seen."""
    frames, placed = [], []
    phi = math.radians(heading_deg)
    right_m, ahead_m = np.meshgrid(*SPEC.centres_m())
    for k in range(count):
        along_m, aside_m = k * apart_m, 0.3 * math.sin(0.5 * k)
        pose = Pose(
            k * 10**9,
            along_m * math.sin(phi) + aside_m * math.cos(phi),
            along_m * math.cos(phi) - aside_m * math.sin(phi),
            *(0.0, heading_deg + 4.0 * math.cos(0.5 * k), 0.02, 0.3, 1.0),
        )
        true = replace(pose, heading_deg=pose.heading_deg + looks_deg)
        east, north = to_universal(right_m, ahead_m, true)
        across_m = east * math.cos(phi) - north * math.sin(phi)
        wall = np.zeros(SPEC.shape, dtype=np.bool_)
        hidden = np.zeros(SPEC.shape, dtype=np.bool_)
        for at_m in walls_m:
            wall |= np.abs(across_m - at_m) < 0.2
            hidden |= (across_m - at_m) * np.sign(at_m) > 0.2
        density = np.where(wall, 200, 0).astype(np.uint8)
        observed = ~(hidden & hides)
        if mirrored:
            density, observed = density[:, ::-1], observed[:, ::-1]
        grid = LocalGrid(SPEC, np.ascontiguousarray(density), np.ascontiguousarray(observed))
        frames.append(stage(grid, f"{k}", 0))
        placed.append((k, pose))
    return frames, placed


@pytest.mark.parametrize("walls_m", [EVERYWHERE, RIGHT_ONLY, LEFT_ONLY])
@pytest.mark.parametrize(
    ("looks_deg", "heading_deg"), [(0.0, 0.0), (0.0, 200.0), (3.0, 30.0), (-4.0, 355.0)]
)
def test_the_yaw_is_told_with_its_sign(
    looks_deg: float, heading_deg: float, walls_m: tuple[float, ...]
) -> None:
    found = sensor_yaw(*frames_between_walls(looks_deg, heading_deg, walls_m, hides=False))
    assert found is not None
    assert not found.is_mirrored
    assert found.off_deg == pytest.approx(looks_deg, abs=0.4)
    assert found.is_off == (looks_deg != 0.0)


def test_of_walls_that_hide_what_is_behind_the_yaw_is_told_from_both_sides() -> None:
    found = sensor_yaw(*frames_between_walls(3.0))
    assert found is not None
    assert found.off_deg == pytest.approx(3.0, abs=0.4)


@pytest.mark.parametrize("walls_m", [RIGHT_ONLY, LEFT_ONLY])
def test_of_one_side_alone_nothing_false_is_told(walls_m: tuple[float, ...]) -> None:
    """A wall denies what lies before it, and hides what lies in it."""
    found = sensor_yaw(*frames_between_walls(0.0, walls_m=walls_m))
    assert found is None or not found.is_off


def test_what_agrees_only_in_a_mirror_is_told() -> None:
    found = sensor_yaw(*frames_between_walls(mirrored=True))
    assert found is not None
    assert found.is_mirrored
    (told,) = sensor_yaw_findings(found, lidar_rig(1000.0))
    assert told == error("mirrored", told.message, told.remedy)
    as_it_is = sensor_yaw(*frames_between_walls())
    assert as_it_is is not None
    assert not as_it_is.is_mirrored


@pytest.mark.parametrize(("count", "apart_m"), [(8, 1.0), (40, 0.05), (40, 10.0), (1, 1.0)])
def test_too_few_pairs_say_nothing(count: int, apart_m: float) -> None:
    assert sensor_yaw(*frames_between_walls(3.0, count=count, apart_m=apart_m)) is None


def test_without_obstacles_nothing_is_told() -> None:
    assert sensor_yaw(*frames_between_walls(3.0, walls_m=())) is None


def test_frames_that_look_back_are_not_compared() -> None:
    """As on the next lane: they see the other side of what stands between."""
    frames, placed = frames_between_walls(3.0)
    turned = [
        (k, replace(pose, heading_deg=pose.heading_deg + 180.0 * (k % 2))) for k, pose in placed
    ]
    found = sensor_yaw(frames, [one for one in turned if one[0] % 10 in (0, 5)])
    assert found is None


def test_a_yaw_is_told_by_its_size() -> None:
    camera, lidar = depth_rig(), lidar_rig(1000.0)
    for found in (None, SensorYaw(0.9, 0.1), SensorYaw(1.9, 0.6)):
        assert not list(sensor_yaw_findings(found, camera))
    (told,) = sensor_yaw_findings(SensorYaw(-1.5, 0.1), camera)
    assert (told.code, told.severity) == ("camera-yaw", Severity.WARNING)
    assert "the camera points 1.5° ± 0.1° farther left than declared" in told.message
    (told,) = sensor_yaw_findings(SensorYaw(2.5, 0.1), lidar)
    assert (told.code, told.severity) == ("camera-yaw", Severity.ERROR)
    assert "the lidar points 2.5° ± 0.1° farther right" in told.message


def test_a_build_without_the_cameras_steps_is_stopped(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(44))
    mounting = drive / "calibration" / "mounting.json"
    said = json.loads(mounting.read_text())
    mounting.write_text(json.dumps(said | {"camera_yaw_deg": 3.0}))
    out = tmp_path / "askew.gpkg"
    with pytest.raises(RecordingError, match=r"points [23]\.\d° ± .* farther left.*--accept"):
        build([drive], out, settings=WITHOUT_CAMERA)
    assert not out.exists()
