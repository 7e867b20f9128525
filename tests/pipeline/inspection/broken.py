"""Copies of the example drive, and what can be broken in them."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.recordings.tables.logs import read_fix_log
from tests.conftest import TWO_LANES

Image = npt.NDArray[np.uint8]

RTK, SF1 = "gnss_rtk.nmea", "gnss_sf1.nmea"
FEW = range(0, 24, 3)
"""Frames for faults that each of them shows."""


def copy_of(
    folder: Path,
    frames: Iterable[int] = range(36),
    *,
    log: str = RTK,
    imu: bool = True,
    moved_s: float = 0.0,
) -> Path:
    """A drive of frames of the example, mostly the first lane and the turn; images are links, and
    their stamps are moved by `moved_s`."""
    (folder / "gnss").mkdir(parents=True)
    for side in ("left", "right"):
        (folder / side).mkdir()
    shutil.copytree(TWO_LANES / "calibration", folder / "calibration")
    shutil.copy(TWO_LANES / "gnss" / log, folder / "gnss")
    if imu:
        shutil.copytree(TWO_LANES / "imu", folder / "imu")
    with (TWO_LANES / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    kept = [rows[k] for k in frames]
    for row in kept:
        row["timestamp_utc_s"] = f"{float(row['timestamp_utc_s']) + moved_s:.3f}"
        for side in ("left", "right"):
            (folder / row[side]).symlink_to(TWO_LANES / row[side])
    with (folder / "frames.csv").open("w", newline="") as table:
        writer = csv.DictWriter(table, rows[0].keys())
        writer.writeheader()
        writer.writerows(kept)
    return folder


def rewrite_images(folder: Path, change: Callable[[Image], Image], *sides: str) -> None:
    """Replace every image of the sides."""
    for side in sides:
        for path in sorted((folder / side).iterdir()):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            assert image is not None
            path.unlink()
            assert cv2.imwrite(str(path), change(image.astype(np.uint8)))


def exchange(folder: Path) -> None:
    """The left images become the right ones."""
    (folder / "left").rename(folder / "other")
    (folder / "right").rename(folder / "left")
    (folder / "other").rename(folder / "right")


def turned_about_x(degrees: float) -> Callable[[Image], Image]:
    """What the right camera sees when it is turned about its own x axis."""
    angle = np.radians(degrees)
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, np.cos(angle), -np.sin(angle)],
            [0.0, np.sin(angle), np.cos(angle)],
        ]
    )
    lens = np.array([[905.4, 0.0, 316.2], [0.0, 905.4, 243.9], [0.0, 0.0, 1.0]])
    homography = lens @ turn @ np.linalg.inv(lens)

    def change(image: Image) -> Image:
        size = (image.shape[1], image.shape[0])
        return cv2.warpPerspective(image, homography, size).astype(np.uint8)

    return change


def change_mounting(folder: Path, **values: object) -> None:
    """Set keys of mounting.json; None takes one out."""
    path = folder / "calibration" / "mounting.json"
    mounting = {**json.loads(path.read_text()), **values}
    path.write_text(json.dumps({k: v for k, v in mounting.items() if v is not None}))


def change_calibration(folder: Path, change: Callable[[str], str]) -> None:
    """Rewrite the calibration's text."""
    path = folder / "calibration" / "stereo_opencv.yaml"
    path.write_text(change(path.read_text()))


def scaled_baseline(by: float) -> Callable[[str], str]:
    """A calibration whose P2 has its f·b times a factor."""

    def change(text: str) -> str:
        head, key, rest = text.partition("P2:")
        assert key
        found = re.search(r"data: *\[(.*?)\]", rest, re.DOTALL)
        assert found is not None
        values = [float(v) for v in found[1].split(",")]
        values[3] *= by
        data = f"data: [{', '.join(map(repr, values))}]"
        return head + key + rest[: found.start()] + data + rest[found.end() :]

    return change


def fixes_as_table(folder: Path, moved_s: float, *, backward: bool = False) -> None:
    """The log of the drive as a table of its own, its times moved; `backward` exchanges some."""
    (source,) = (folder / "gnss").iterdir()
    fixes = list(read_fix_log(source).fixes)
    source.unlink()
    times = [fix.time_ns + round(moved_s * 1e9) for fix in fixes]
    if backward:
        for k in range(50, 100, 10):
            times[k], times[k + 1] = times[k + 1], times[k]
    with (folder / "gnss" / "fixes.csv").open("w", newline="") as table:
        writer = csv.writer(table)
        writer.writerow(("time_ns", "lat", "lon", "height", "quality", "satellites", "hdop"))
        for time_ns, fix in zip(times, fixes, strict=True):
            writer.writerow(
                (
                    *(time_ns, f"{fix.lat_deg:.9f}", f"{fix.lon_deg:.9f}", f"{fix.height_m:.4f}"),
                    *(fix.quality, fix.satellites, fix.hdop),
                )
            )
