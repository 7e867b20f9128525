"""Frames that repeat an old image while the vehicle drives are rejected, and only those."""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from fieldgrid.geometry import Pose, Status
from fieldgrid.maps import open_map
from fieldgrid.pipeline import REPEATED, StuckCamera, repose_map
from tests.pipeline.drives.making import MakeDrive, build

POSE = Pose(1_000_000_000, 0.0, 0.0, 0.0, 0.0, 0.02, 0.3, 1.0)


def at(east_m: float, heading_deg: float = 0.0) -> Pose:
    return replace(POSE, east_m=east_m, heading_deg=heading_deg)


@pytest.mark.parametrize(
    ("frames", "rejected"),
    [
        ([(("a", "b"), at(0.0)), (("c", "d"), at(2.0))], []),
        ([(("a", "b"), at(0.0)), (("a", "b"), at(2.0)), (("c", "d"), at(4.0))], [1]),
        ([(("a", "b"), at(0.0)), (("a", "c"), at(2.0)), (("d", "e"), at(4.0))], [1]),
        ([(("a", "b"), at(0.0)), (("c", "b"), at(2.0))], [1]),
        # Little by little it gets far.
        ([(("a", "b"), at(0.1 * k)) for k in range(5)], [3, 4]),
        ([(("a", "b"), at(0.0, 2.0 * k)) for k in range(4)], [2, 3]),
        # Who stands sees the same; a simulator's camera has no noise.
        ([(("a", "b"), at(0.001 * k)) for k in range(5)], []),
        # What was seen before is no repetition: a sensor may see the same twice.
        ([(("a",), at(0.0)), (("b",), at(2.0)), (("a",), at(4.0))], []),
        ([((), at(0.0)), ((), at(2.0))], []),
        ([(("",), at(0.0)), (("",), at(2.0))], []),
    ],
)
def test_an_image_that_came_before_is_of_another_place(
    frames: list[tuple[tuple[str, ...], Pose]], rejected: list[int]
) -> None:
    camera, judged = StuckCamera(), []
    for images, pose in frames:
        camera, found = camera.judged(images, pose)
        judged.append(found)
    assert [k for k, pose in enumerate(judged) if pose.status is Status.REJECTED] == rejected
    assert {judged[k].reason for k in rejected} <= {REPEATED}


def test_a_build_and_its_new_poses_leave_them_out(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(4, 10))
    for number, side in product((6, 7), ("left", "right")):
        image = drive / side / f"{number:06d}.jpg"
        image.unlink()  # a link to that of the example
        shutil.copy(drive / side / "000005.jpg", image)
    out = tmp_path / "m.gpkg"
    (report,) = build([drive], out)
    assert report.reasons == {REPEATED: 2}
    (again,) = repose_map(out)
    assert again.reasons == {REPEATED: 2}
    with open_map(out) as universal:
        rejected = [f.frame_id for f in universal.frames() if f.pose.status is Status.REJECTED]
    assert rejected == ["000006", "000007"]
