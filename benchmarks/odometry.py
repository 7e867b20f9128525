"""`python -m benchmarks.odometry`: stereo odometry against truth, and its time beside the matcher.

The road is KITTI's drive 0020, beside the repository in ../shared/data; its line is left out
where it is absent.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks import EXAMPLE
from benchmarks.timing import paired_ms
from fieldgrid.core import StereoSettings
from fieldgrid.geometry import Rig, wrap_deg
from fieldgrid.perception import CameraStep, Features, Refusal, features, step
from fieldgrid.perception.stereo import make_matcher
from fieldgrid.recordings import Image, open_recording

ROAD = EXAMPLE.parents[2] / "shared" / "data" / "kitti_2011_09_30_drive_0020"
ROAD_FIRST = 13
"""The positions of the frames before are interpolated, not measured."""

FULL_DISPARITIES = 128
UNRELATED_FRAMES = 12

_Float64 = npt.NDArray[np.float64]


class Drive(NamedTuple):
    """A drive in memory; `truth` [frames, 3] is east and north in metres and heading."""

    name: str
    rig: Rig
    pairs: list[tuple[Image, Image]]
    truth: _Float64


def main() -> None:
    """Measure and print both drives."""
    cv2.setNumThreads(1)
    drives = [vineyard(), *([road()] if ROAD.exists() else [])]
    print("asked: turn 0.2 / 0.6°, displacement 5 cm, 90 % solved, 97 % within 3 sigma, half the")
    print("matcher's time; errors are median / 95 % / largest")
    print(
        f"{'':<10}{'solved':>8}{'displacement, cm':>22}{'turn, °':>26}{'sigma':>16}"
        f"{'< 3 sigma':>15}{'gear':>8}{'false':>10}"
    )
    found = [[features(d.rig.camera, *pair) for pair in d.pairs] for d in drives]
    for drive, frames in zip(drives, found, strict=True):
        print(accuracy(drive, frames))
    print(f"\n{'ms a frame, one core':<24}{'features':>10}{'step':>8}{'matcher':>10}{'share':>9}")
    for drive, frames in zip(drives, found, strict=True):
        print(speed(drive, frames))


def vineyard() -> Drive:
    """The example, with its exact truth."""
    with open_recording(EXAMPLE, "gnss_rtk.nmea") as drive:
        rig, pairs = drive.rig, [frame.images() for frame in drive.frames()]
    with (EXAMPLE / "truth" / "poses_frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    columns = ("cam_mid_E", "cam_mid_N", "heading_deg")
    return Drive("vineyard", rig, pairs, np.array([[float(r[c]) for c in columns] for r in rows]))


def road(folder: Path = ROAD) -> Drive:
    """KITTI's drive with its own poses, of the left camera, seen from above."""
    with open_recording(folder) as drive:
        rig, pairs = drive.rig, [frame.images() for frame in drive.frames()]
    poses = np.loadtxt(folder / "native_poses.txt").reshape(-1, 3, 4)
    R_vehicle_camera = rig.mount.rotation()
    middle = np.array([rig.camera.baseline_m / 2.0, 0.0, 0.0])
    places = (poses[:, :, :3] @ middle + poses[:, :, 3]) @ R_vehicle_camera.T
    forward = (R_vehicle_camera @ poses[:, :, :3] @ R_vehicle_camera.T)[:, :, 1]
    heading = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]))
    truth = np.column_stack([places[:, :2], heading])
    return Drive("KITTI 0020", rig, pairs[ROAD_FIRST:], truth[ROAD_FIRST:])


def accuracy(drive: Drive, frames: Sequence[Features]) -> str:
    """A line of the table of errors."""
    results = [step(a, b, drive.rig) for a, b in pairwise(frames)]
    rows = [k for k, one in enumerate(results) if isinstance(one, CameraStep)]
    steps = np.array([one for one in results if isinstance(one, CameraStep)])
    truth = true_steps(drive.truth)[rows]
    off = steps[:, :2] - truth[:, :2]
    off_m, off_deg = np.hypot(*off.T), np.abs(wrap_deg(steps[:, 2] - truth[:, 2]))
    within_m = (np.abs(off).max(axis=1) < 3.0 * steps[:, 3]).mean()
    within_deg = (off_deg < 3.0 * steps[:, 4]).mean()
    gear = (np.sign(steps[:, 0]) == np.sign(truth[:, 0])).mean()
    sigmas = f"{100 * np.median(steps[:, 3]):.1f} cm {np.median(steps[:, 4]):.3f}°"
    return (
        f"{drive.name:<10}{f'{len(rows)}/{len(results)}':>8}{_spread(100 * off_m, 1):>22}"
        f"{_spread(off_deg, 3):>26}{sigmas:>16}"
        f"{f'{100 * within_m:.0f} % {100 * within_deg:.0f} %':>15}{f'{100 * gear:.0f} %':>8}"
        f"{false_steps(drive, frames):>10}"
    )


def true_steps(truth: _Float64) -> _Float64:
    """Forward, right, turn from each row to the next."""
    phi = np.radians(truth[:-1, 2])
    east, north = np.diff(truth[:, :2], axis=0).T
    sine, cosine = np.sin(phi), np.cos(phi)
    forward, right = east * sine + north * cosine, east * cosine - north * sine
    return np.column_stack([forward, right, wrap_deg(np.diff(truth[:, 2]))])


def false_steps(drive: Drive, frames: Sequence[Features]) -> str:
    """How many of the pairs that show different places get a wrong step, of how many."""
    wrong, tried = 0, 0
    for i in range(0, len(frames), 3):
        for j in range(len(frames)):
            if abs(i - j) < UNRELATED_FRAMES:
                continue
            tried += 1
            result = step(frames[i], frames[j], drive.rig)
            if isinstance(result, Refusal):
                continue
            truth = true_steps(drive.truth[[i, j]])[0]
            wrong += bool(np.hypot(*(np.array(result[:2]) - truth[:2])) > 0.5)
    return f"{wrong}/{tried}"


def speed(drive: Drive, frames: Sequence[Features]) -> str:
    """A line of the table of times: medians over frames, both taking turns."""
    matcher = make_matcher(StereoSettings(), FULL_DISPARITIES)
    times = []
    for k in range(0, len(frames) - 1, 5):
        pair, before, after = drive.pairs[k], frames[k], frames[k + 1]
        features_ms, matcher_ms = paired_ms(
            lambda pair=pair: features(drive.rig.camera, *pair),
            lambda pair=pair: matcher.compute(*pair),
            runs=7,
        )
        step_ms, _ = paired_ms(
            lambda a=before, b=after: step(a, b, drive.rig), lambda: None, runs=7
        )
        times.append((features_ms, step_ms, matcher_ms))
    features_ms, step_ms, matcher_ms = np.median(times, axis=0)
    share = (features_ms + step_ms) / matcher_ms
    return (
        f"{drive.name:<24}{features_ms:>10.1f}{step_ms:>8.1f}{matcher_ms:>10.1f}"
        f"{f'{100 * share:.0f} %':>9}"
    )


def _spread(errors: _Float64, decimals: int) -> str:
    values = (np.median(errors), np.percentile(errors, 95), errors.max())
    return " / ".join(f"{value:.{decimals}f}" for value in values)


if __name__ == "__main__":
    main()
