"""A camera that is stuck, while driving: what a build would reject is not in the window."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import pytest

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Status
from fieldgrid.live import LiveOptions, LivePose, LiveWindow, WindowDoubt
from fieldgrid.live.pose.poser import Poser
from fieldgrid.live.pose.sensor_rows import rows_of
from fieldgrid.maps import open_map
from fieldgrid.pipeline import REPEATED, build_map
from tests.conftest import make_small_drive
from tests.live.making import Told, cut_log, drive_live
from tests.live.test_poser import DATUM, RIG, SETTINGS, SPEED_MPS, START_NS, at_ns, fix, frame
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")

STUCK, AGAIN = "to the last bit", "something new again"


def image_of(seconds: float, stuck_s: tuple[float, float]) -> str:
    """What a camera shows; between two times what it showed at the first of them."""
    return str(stuck_s[0] if stuck_s[0] <= seconds < stuck_s[1] else seconds)


def driven(until_s: float, stuck_s: tuple[float, float], *, follows: bool = True) -> Told:
    """A drive at 5 Hz whose camera is stuck for a while, and told by its steps that it stands."""
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(round(5.0 * until_s) + 1):
        seconds = k / 5.0
        poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        seen = frame(seconds, 0.2 if follows else None)
        if stuck_s[0] < seconds <= stuck_s[1]:
            seen = seen._replace(step=None)
        image = image_of(seconds, stuck_s)
        poser.put(seen._replace(images_sha256=(f"left {image}", f"right {image}")))
    poser.close()
    return told


@pytest.mark.parametrize("stuck_s", [(10.0, 14.0), (10.0, 10.4)])
def test_frames_of_a_stuck_camera_are_left_out_and_told(stuck_s: tuple[float, float]) -> None:
    told = driven(20.0, stuck_s)
    settled = {float(one.frame_id): one.pose for one in told.of(LivePose) if one.is_settled}
    rejected = sorted(s for s, pose in settled.items() if pose.status is Status.REJECTED)
    # At 1 m/s the first repetition, 0.2 m on, is within what a grid may be off.
    assert rejected == [k / 5.0 for k in range(101) if stuck_s[0] + 0.3 < k / 5.0 < stuck_s[1]]
    assert {settled[seconds].reason for seconds in rejected} <= {REPEATED}
    texts = told.texts("input")
    assert [STUCK in text for text in texts] == ([True, False] if rejected else [])
    assert [AGAIN in text for text in texts] == ([False, True] if rejected else [])
    assert told.of(LiveWindow)[-1].is_trusted


def test_one_repeated_frame_is_left_out() -> None:
    told = driven(12.0, (6.0, 6.6))
    rejected = {
        float(one.frame_id) for one in told.of(LivePose) if one.pose.status is Status.REJECTED
    }
    assert rejected == {6.4}
    assert [STUCK in text for text in told.texts("input")] == [True, False]


def test_the_window_is_not_trusted_while_the_camera_is_stuck() -> None:
    told = driven(16.0, (10.0, 99.0))
    window = told.of(LiveWindow)[-1]
    assert window.doubt_code is WindowDoubt.NO_FRAMES
    assert window.doubt.startswith("no new image for 5.8 s")
    # Nothing of the way since is smeared over with what was seen then.
    north_m = window.view.window.j0 + window.view.observed.any(axis=1).nonzero()[0].max()
    assert north_m * window.view.lattice.cell_m < 10.2 * SPEED_MPS + 6.0 + 0.3


def test_the_pose_goes_on_while_the_camera_is_stuck() -> None:
    """By its steps the vehicle would stand; no pose is carried by them."""
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(76):
        seconds = k / 5.0
        if seconds <= 14.4:
            poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        poser.put(("wheels", rows_of("wheels", at_ns(seconds), SPEED_MPS)))
        seen = frame(seconds, 0.2)
        if seconds > 14.4:
            assert seen.step is not None
            seen = seen._replace(step=seen.step._replace(forward_m=0.0))
        poser.put(seen._replace(images_sha256=(str(min(seconds, 14.4)),)))
    poser.close()
    pose = told.of(LiveWindow)[-1].pose
    assert pose is not None
    off_m = abs(pose.north_m - SPEED_MPS * (pose.time_ns - START_NS) / 1e9)
    assert off_m < 3.0 * pose.position_sigma_m + 0.05


def test_who_stands_may_see_the_same_again() -> None:
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(81):
        seconds = k / 5.0
        stands = fix(min(seconds, 10.0))._replace(time_ns=at_ns(seconds))
        poser.put(stands)
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        seen = frame(seconds, 0.2)
        if seconds > 10.0:
            assert seen.step is not None
            seen = seen._replace(step=seen.step._replace(forward_m=0.0))
        poser.put(seen._replace(images_sha256=(str(min(seconds, 10.0)),)))
    poser.close()
    settled = [one.pose.status for one in told.of(LivePose) if one.is_settled]
    assert settled.count(Status.REJECTED) == 0
    assert told.texts("input") == []


def test_the_window_and_the_map_leave_out_what_a_build_does(tmp_path: Path) -> None:
    drive = make_small_drive(tmp_path / "drive", range(16, 26))
    cut_log(drive)
    for number, side in product((18, 19), ("left", "right")):
        image = drive / side / f"{number:06d}.jpg"
        image.unlink()  # a link to that of the example
        shutil.copy(drive / side / "000017.jpg", image)
    (report,) = build_map([drive], tmp_path / "built.gpkg", BuildSettings())
    assert report.reasons == {REPEATED: 2}
    out, told = tmp_path / "m.gpkg", Told()
    drive_live(drive, out, told)
    assert content(out) == content(tmp_path / "built.gpkg")
    with open_map(out) as universal:
        driven = {f.frame_id: f.pose for f in universal.frames()}
    settled = {one.frame_id: one.pose for one in told.of(LivePose) if one.is_settled}
    assert {k: pose.reason for k, pose in settled.items()} == {
        k: pose.reason for k, pose in driven.items()
    }
    assert [STUCK in text for text in told.texts("input")] == [True, False]
