"""Drives of depths and of clouds, damaged as drives of users are.

    python -m benchmarks.other_sensors [LOG [DRIVE]]

The disparities of a rendered drive become depth images or clouds in the place of its pairs, so
that nothing tells the sensor's own motion. Each damage is made in a copy, of which a map is built
and compared with the truth, as `benchmarks.damages` does.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmarks.damages import (
    DRIVE,
    FRAMES,
    LOG,
    Damage,
    later,
    leapt,
    mounted,
    report,
    without_images,
)
from fieldgrid.core import StereoSettings
from fieldgrid.perception import SUBPIXELS, StereoMatcher, whole_image
from fieldgrid.perception.depth import depth_table
from fieldgrid.recordings import open_recording

DISPARITIES, FARTHEST_M, STEP_PX = 128, 30.0, 2
"""What is searched, how far depths are stored, and every how many pixels of them are in a cloud."""

LEFT_OF_MIDDLE_M = 0.09
"""From the point that the mounting tells to the left camera."""


@functools.cache
def _depths_m() -> list[np.ndarray]:
    """Depths [row, column] of the drive's frames in metres, 0 where there is none."""
    with open_recording(DRIVE, LOG) as recording:
        camera = recording.rig.camera
        matcher = StereoMatcher(camera, StereoSettings(), whole_image(camera, DISPARITIES))
        table_m = depth_table(recording.rig, DISPARITIES, SUBPIXELS)
        table_m[table_m > FARTHEST_M] = 0.0
        return [
            table_m[np.maximum(matcher.disparity(*frame.images()).values, 0)]
            for frame in recording.frames()
        ]


def _points_m(depth_m: np.ndarray) -> np.ndarray:
    """Points [n, 3] forward, left and up of the sensor."""
    with open_recording(DRIVE, LOG) as recording:
        camera = recording.rig.camera
    v, u = np.nonzero(depth_m[::STEP_PX, ::STEP_PX])
    z = depth_m[::STEP_PX, ::STEP_PX][v, u].astype(np.float64)
    x = (u * STEP_PX - camera.cx_px) * z / camera.focal_px - LEFT_OF_MIDDLE_M
    y = (v * STEP_PX - camera.cy_px) * z / camera.focal_px
    return np.column_stack([z, -x, -y]).astype(np.float32)


def _table(folder: Path, kind: str, suffix: str) -> list[Path]:
    """The frames' table with one file of this kind a frame; where these go."""
    with (DRIVE / FRAMES).open(newline="") as table:
        rows = list(csv.DictReader(table))
    (folder / kind).mkdir()
    column = kind.removesuffix("s")
    lines = [f"frame_id,timestamp_utc_s,timestamp_iso,{column}"]
    names = [f"{kind}/{row['frame_id']}{suffix}" for row in rows]
    lines += [
        f"{row['frame_id']},{row['timestamp_utc_s']},{row['timestamp_iso']},{name}"
        for row, name in zip(rows, names, strict=True)
    ]
    (folder / FRAMES).write_text("\n".join(lines) + "\n")
    return [folder / name for name in names]


def of_depths(folder: Path) -> Path:
    """The drive with depth images in millimetres."""
    without_images(folder)
    for path, depth_m in zip(_table(folder, "depth", ".png"), _depths_m(), strict=True):
        cv2.imwrite(str(path), np.rint(1000.0 * depth_m).astype(np.uint16))
    return folder


def of_clouds(folder: Path) -> Path:
    """The drive with clouds: forward, left, up."""
    without_images(folder)
    for path, depth_m in zip(_table(folder, "clouds", ".npy"), _depths_m(), strict=True):
        np.save(path, _points_m(depth_m))
    return folder


def depths(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Other depths than were seen, in millimetres."""

    def damage(folder: Path) -> None:
        for path in sorted((folder / "depth").iterdir()):
            depth_mm = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64)
            changed = np.clip(change(depth_mm), 0.0, 65535.0)
            cv2.imwrite(str(path), np.rint(changed).astype(np.uint16))

    return damage


def clouds(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Other points than were seen."""

    def damage(folder: Path) -> None:
        for path in sorted((folder / "clouds").iterdir()):
            np.save(path, change(np.load(path)).astype(np.float32))

    return damage


def _scattered(points_m: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(len(points_m))
    return points_m + rng.normal(0.0, 0.15, points_m.shape)


SAME: dict[str, Damage] = {
    "none": lambda folder: None,
    "turned 3 deg": mounted("camera_yaw_deg", 3.0),
    "turned 2 deg the other way": mounted("camera_yaw_deg", -2.0),
    "tilted 3 deg less": mounted("camera_tilt_down_deg", -3.0),
    "0.3 m lower": mounted("camera_height_above_ground_m", -0.3),
    "frames 0.4 s late": later(FRAMES, 0.4),
    "antenna 0.9 m aside": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, -0.92, 0.0)),
    "antenna 0.4 m to the right": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, -0.4, 0.0)),
    "antenna 0.4 m to the left": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, 0.4, 0.0)),
    "antenna 0.9 m ahead": mounted("gnss_antenna_from_camera_mid_flu_m", (0.9, 0.0, 0.0)),
    "receiver 0.6 m off after a hole": leapt(0.6, 0.1),
    "receiver 1.5 m off from the middle": leapt(1.5),
}
OF_DEPTHS: dict[str, Damage] = {
    "10 % long": depths(lambda mm: 1.1 * mm),
    "5 % short": depths(lambda mm: 0.95 * mm),
    "centimetres": depths(lambda mm: mm / 10.0),
    "tenths of a millimetre": depths(lambda mm: 10.0 * mm),
    "mirrored": depths(lambda mm: mm[:, ::-1]),
}
OF_CLOUDS: dict[str, Damage] = {
    "mirrored": clouds(lambda flu: flu * (1, -1, 1)),
    "axes right, down, forward": clouds(lambda flu: flu[:, [1, 2, 0]] * (-1, -1, 1)),
    "axes right, forward, up": clouds(lambda flu: flu[:, [1, 0, 2]] * (-1, 1, 1)),
    "millimetres": clouds(lambda flu: 1000.0 * flu),
    "noise of 0.15 m": clouds(_scattered),
    "every 30th point": clouds(lambda flu: flu[::30]),
}


def lines() -> Iterator[str]:
    """A line a damage and kind of sensor."""
    yield "Depths"
    yield from report(SAME | OF_DEPTHS, of_depths, LEFT_OF_MIDDLE_M)
    yield "Clouds"
    yield from report(SAME | OF_CLOUDS, of_clouds)


if __name__ == "__main__":
    for line in lines():
        print(line, flush=True)
