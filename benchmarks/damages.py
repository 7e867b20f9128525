"""A rendered drive, damaged as drives of users are: `python -m benchmarks.damages [LOG [DRIVE]]`.

Each damage is made in a copy, of which a map is built and compared with the truth. What matters is
not that the map is good, but that the drive is refused, or that its poses know and something is
said: a line a damage tells all of it.
"""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks import EXAMPLE
from benchmarks.sentences import checksum
from fieldgrid.core import BuildSettings, FieldgridError, TruthError
from fieldgrid.field import evaluate, read_truth
from fieldgrid.field.evaluation.truth import Truth, TruthPose
from fieldgrid.geometry import Status
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions
from tests.told import warnings

LOG = sys.argv[1] if len(sys.argv) > 1 else "gnss_rtk.nmea"
DRIVE = Path(sys.argv[2]) if len(sys.argv) > 2 else EXAMPLE
IMU, FRAMES, HALF = "imu/imu_100hz.csv", "frames.csv", slice(25, None)
Damage = Callable[[Path], None]


def without_images(folder: Path) -> Path:
    """The drive, but for its images."""
    (folder / "gnss").mkdir(parents=True)
    shutil.copy(DRIVE / "gnss" / LOG, folder / "gnss")
    for name in ("calibration", "imu"):
        shutil.copytree(DRIVE / name, folder / name)
    for name in ("frames.csv", "session.json"):
        shutil.copy(DRIVE / name, folder)
    return folder


def _copy(folder: Path) -> Path:
    """The drive; images are links."""
    without_images(folder)
    for side in ("left", "right"):
        (folder / side).mkdir()
        for image in (DRIVE / side).iterdir():
            (folder / side / image.name).symlink_to(image.resolve())
    return folder


def _rows(path: Path, change: Callable[[list[list[str]]], list[list[str]]]) -> None:
    head, *rows = path.read_text().splitlines()
    changed = change([row.split(",") for row in rows])
    path.write_text("\n".join([head, *map(",".join, changed)]) + "\n")


def later(what: str, by_s: float, from_middle: bool = False) -> Damage:
    """Rows of a table stamped later, all or those of the second half of the images."""
    column = 1 if what == FRAMES else 0

    def damage(folder: Path) -> None:
        with (DRIVE / FRAMES).open(newline="") as table:
            stamps = [float(row["timestamp_utc_s"]) for row in csv.DictReader(table)]
        since_s = stamps[len(stamps) // 2] - 0.005 if from_middle else -math.inf

        def change(rows: list[list[str]]) -> list[list[str]]:
            for row in rows:
                if float(row[column]) >= since_s:
                    row[column] = f"{float(row[column]) + by_s:.3f}"
            return rows

        _rows(folder / what, change)

    return damage


def cut_stamps(to_s: float) -> Damage:
    """Stamps of images without what is smaller than `to_s`."""

    def change(rows: list[list[str]]) -> list[list[str]]:
        for row in rows:
            row[1] = f"{math.floor(float(row[1]) / to_s) * to_s:.3f}"
        return rows

    return lambda folder: _rows(folder / FRAMES, change)


def images_of(order: Callable[[int], list[int]]) -> Damage:
    """The images of other frames at the stamps of these."""

    def change(rows: list[list[str]]) -> list[list[str]]:
        return [row[:3] + rows[k][3:] for row, k in zip(rows, order(len(rows)), strict=True)]

    return lambda folder: _rows(folder / "frames.csv", change)


def mounted(key: str, by: float | tuple[float, float, float]) -> Damage:
    """A key of mounting.json that is said wrong by as much."""

    def damage(folder: Path) -> None:
        path = folder / "calibration" / "mounting.json"
        mounting = json.loads(path.read_text())
        mounting[key] = np.add(mounting[key], by).tolist()
        path.write_text(json.dumps(mounting))

    return damage


def sensed(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Rates and accelerations [n, 6] of the IMU, other than they were."""

    def damage(folder: Path) -> None:
        path = folder / IMU
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        table[:, 1:] = change(table[:, 1:])
        head = path.read_text().partition("\n")[0]
        np.savetxt(
            path, table, fmt=["%.3f"] + ["%.6f"] * 6, delimiter=",", header=head, comments=""
        )

    return damage


def received(change: Callable[[float, int, list[str]], list[str] | None]) -> Damage:
    """Sentences of the receiver, their checksums right again: of each its share of the log, the
    number of its epoch and its fields; None leaves it out."""

    def damage(folder: Path) -> None:
        path = folder / "gnss" / LOG
        lines = path.read_text().splitlines()
        out, epoch = [], -1
        for k, line in enumerate(lines):
            body, _, told = line[1:].partition("*")
            if told != f"{checksum(body.encode()):02X}":
                out.append(line)  # damaged already
                continue
            fields = body.split(",")
            epoch += fields[0][2:] == "GGA"
            if (changed := change(k / len(lines), epoch, fields)) is not None:
                body = ",".join(changed)
                out.append(f"${body}*{checksum(body.encode()):02X}")
        path.write_text("\n".join(out) + "\n")

    return damage


def _clock_set(by_s: float) -> Damage:
    """A receiver whose clock is set in mid-drive."""

    def change(share: float, _: int, fields: list[str]) -> list[str]:
        if share > 0.5 and fields[0][2:] in ("GGA", "RMC", "GST"):
            at = fields[1]
            s = int(at[:2]) * 3600 + int(at[2:4]) * 60 + float(at[4:]) + by_s
            fields[1] = f"{int(s // 3600):02d}{int(s % 3600 // 60):02d}{s % 60:05.2f}"
        return fields

    return received(change)


def _multipath(share: float, epoch: int, fields: list[str]) -> list[str]:
    """For 8 s of every 30 s up to 1.5 m north of where it is."""
    where = {"GGA": 2, "RMC": 3}.get(fields[0][2:])
    if where is not None and fields[where] and epoch % 150 >= 110:
        away_m = 1.5 * math.sin(epoch // 150 * 2.4 + 1.0)
        fields[where] = f"{float(fields[where]) + away_m / 1852.0:012.7f}"
    return fields


def leapt(north_m: float, hole_share: float = 0.0) -> Damage:
    """From the middle on all positions lie north; around it there are none for a share of the
    log."""

    def change(share: float, epoch: int, fields: list[str]) -> list[str] | None:
        where = {"GGA": 2, "RMC": 3}.get(fields[0][2:])
        if where is not None and fields[where] and share > 0.5:
            fields[where] = f"{float(fields[where]) + north_m / 1852.0:012.7f}"
        return None if abs(share - 0.5) < hole_share / 2.0 else fields

    return received(change)


def drifted(north_m: Callable[[float], float]) -> Damage:
    """All positions lie north by what a share of the log is given."""

    def change(share: float, _: int, fields: list[str]) -> list[str]:
        where = {"GGA": 2, "RMC": 3}.get(fields[0][2:])
        if where is not None and fields[where]:
            fields[where] = f"{float(fields[where]) + north_m(share) / 1852.0:012.7f}"
        return fields

    return received(change)


def _coarse(share: float, epoch: int, fields: list[str]) -> list[str]:
    """Four digits of a minute: 19 cm."""
    where = {"GGA": 2, "RMC": 3}.get(fields[0][2:])
    if where is not None:
        fields[where], fields[where + 2] = fields[where][:9], fields[where + 2][:10]
    return fields


def seen(change: Callable[[np.ndarray], np.ndarray], sides: str, of: slice = slice(None)) -> Damage:
    """Images that are other than the camera saw them."""

    def damage(folder: Path) -> None:
        for side in sides.split():
            for path in sorted((folder / side).iterdir())[of]:
                image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
                path.unlink()
                if image is None or not cv2.imwrite(str(path), change(image)):
                    raise OSError(f"{path} cannot be changed")

    return damage


def _shifted(right_px: float, down_px: float) -> Callable[[np.ndarray], np.ndarray]:
    move = np.array([[1.0, 0.0, right_px], [0.0, 1.0, down_px]], dtype=np.float32)
    return lambda image: cv2.warpAffine(
        image, move, image.shape[::-1], borderMode=cv2.BORDER_REPLICATE
    )


def _grainy(image: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(int(image.sum()))
    return np.clip(image + rng.normal(0.0, 25.0, image.shape), 0, 255).astype(np.uint8)


def _pressed(quality: int) -> Callable[[np.ndarray], np.ndarray]:
    def press(image: np.ndarray) -> np.ndarray:
        _, pressed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return cv2.imdecode(pressed, cv2.IMREAD_GRAYSCALE)

    return press


def _longer_focal(folder: Path) -> None:
    """The calibration of 3 % more focal length, with the same baseline."""
    path = folder / "calibration" / "stereo_opencv.yaml"
    text = path.read_text()
    for number in ("905.4", "162.972"):
        text = text.replace(number, f"{1.03 * float(number):.6f}")
    path.write_text(text)


def _all(*damages: Damage) -> Damage:
    def damage(folder: Path) -> None:
        for one in damages:
            one(folder)

    return damage


def _pitched(by_deg: float) -> np.ndarray:
    """Turns rates and accelerations [6] about the vehicle's left."""
    sin, cos = math.sin(math.radians(by_deg)), math.cos(math.radians(by_deg))
    turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    return np.kron(np.eye(2), turn)


def _noisy(sensed: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(3).normal(0.0, 1.0, sensed.shape)
    return sensed + noise * ([0.02] * 3 + [0.5] * 3)


def _exchanged(folder: Path) -> None:
    for old, new in (("left", "other"), ("right", "left"), ("other", "right")):
        os.rename(folder / old, folder / new)


DAMAGES: dict[str, Damage] = {
    "none": lambda folder: None,
    "computer 2 s late": _all(later(IMU, 2.0), later(FRAMES, 2.0)),
    "computer 18 s early": _all(later(IMU, -18.0), later(FRAMES, -18.0)),
    "computer set ahead 0.7 s": _all(later(IMU, 0.7, True), later(FRAMES, 0.7, True)),
    "images 0.3 s late": later(FRAMES, 0.3),
    "images in whole seconds": cut_stamps(1.0),
    "images in tenths of a second": cut_stamps(0.1),
    "gyro 0.5 s late": later(IMU, 0.5),
    "frames sorted as text": images_of(lambda n: sorted(range(n), key=str)),
    "frames from last to first": images_of(lambda n: [*reversed(range(n))]),
    "every other image lost": images_of(lambda n: [min(2 * k, n - 1) for k in range(n)]),
    "images one late": images_of(lambda n: [0, *range(n - 1)]),
    "images one late from the middle": images_of(lambda n: [*range(25), *range(24, n - 1)]),
    "left and right exchanged": _exchanged,
    "right image one late": lambda folder: _rows(
        folder / FRAMES,
        lambda rows: [row[:4] + rows[max(k - 1, 0)][4:] for k, row in enumerate(rows)],
    ),
    "camera turned 3 deg": mounted("camera_yaw_deg", 3.0),
    "camera tilted 3 deg less": mounted("camera_tilt_down_deg", -3.0),
    "camera 0.3 m lower": mounted("camera_height_above_ground_m", -0.3),
    "antenna 0.9 m aside": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, -0.92, 0.0)),
    "antenna 0.4 m to the left": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, 0.4, 0.0)),
    "antenna 0.9 m ahead": mounted("gnss_antenna_from_camera_mid_flu_m", (0.9, 0.0, 0.0)),
    "antenna 1 m higher": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, 0.0, 1.0)),
    "receiver's clock set ahead 1 s": _clock_set(1.0),
    "receiver's clock set back 1 s": _clock_set(-1.0),
    "receiver 1.5 m off at times": received(_multipath),
    "receiver 0.2 m off from the middle": leapt(0.2),
    "receiver 0.6 m off after a hole": leapt(0.6, 0.1),
    "receiver 1.5 m off from the middle": leapt(1.5),
    "receiver drifts 2 m by the end": drifted(lambda share: 2.0 * share),
    "receiver drifts 1 m by the end": drifted(lambda share: share),
    "receiver drifts 1 m and back": drifted(
        lambda share: math.sin(math.pi * min(max(2.0 * share - 0.5, 0.0), 1.0)) ** 2
    ),
    "receiver of four digits": received(_coarse),
    "IMU turned by 90 deg": sensed(lambda s: s[:, [1, 0, 2, 4, 3, 5]] * [1, -1, 1, 1, -1, 1]),
    "IMU upside down": sensed(lambda s: s * [1, -1, -1, 1, -1, -1]),
    "IMU in degrees a second": sensed(lambda s: s * ([math.degrees(1)] * 3 + [1] * 3)),
    "IMU in g": sensed(lambda s: s / ([1.0] * 3 + [9.81] * 3)),
    "IMU tilted 5 deg": sensed(lambda s: s @ _pitched(5.0)),
    "IMU of twice the noise of a phone": sensed(_noisy),
    "camera pushed 2.5 deg aside": seen(_shifted(40.0, 0.0), "left right", HALF),
    "camera pushed 1.9 deg down": seen(_shifted(0.0, 30.0), "left right", HALF),
    "right camera pushed 2 px down": seen(_shifted(0.0, 2.0), "right", HALF),
    "right camera 1.5 px aside": seen(_shifted(1.5, 0.0), "right"),
    "right camera pushed 1.5 px aside": seen(_shifted(1.5, 0.0), "right", HALF),
    "images of an eighth of the light": seen(lambda i: (i / 8).astype(np.uint8), "left right"),
    "noise of 25 grey levels": seen(_grainy, "left right"),
    "stored as JPEG of quality 8": seen(_pressed(8), "left right"),
    "stored as JPEG of quality 20": seen(_pressed(20), "left right"),
    "right camera of 0.3 of the light": seen(lambda i: (0.3 * i).astype(np.uint8), "right"),
    "right camera darker, less contrast": seen(
        lambda i: np.clip(0.6 * i + 20.0, 0, 255).astype(np.uint8), "right"
    ),
    "right camera 1 px down": seen(_shifted(0.0, 1.0), "right"),
    "blur of 1.5 px": seen(lambda i: cv2.GaussianBlur(i, (0, 0), 1.5), "left right"),
    "focal length of 3 % more": _longer_focal,
    "antenna 0.15 m to the left": mounted("gnss_antenna_from_camera_mid_flu_m", (0.0, 0.15, 0.0)),
    "six black images": seen(lambda i: 0 * i, "left right", slice(20, 26)),
}


class Score(NamedTuple):
    """Of the frames that were used: how many of how many, how many positions are within three
    sigma, the largest error and the median sigma; and the share of obstacle cells that are within
    10 cm of an obstacle, NaN where the truth has no frame of these times."""

    used: int
    frames: int
    within: int
    most_m: float
    sigma_m: float
    precision: float


def _place_m(pose: TruthPose, left_m: float) -> np.ndarray:
    """East and north [2] of a point left of that of a true pose."""
    phi = math.radians(pose.heading_deg)
    return np.array([pose.east_m - left_m * math.cos(phi), pose.north_m + left_m * math.sin(phi)])


def _score(path: Path, session: str, true_m: dict[str, np.ndarray], truth: Truth) -> Score:
    """Positions [2] are compared frame by frame, whatever their stamps."""
    with open_map(path) as built:
        frames = list(built.frames(session))
        try:
            precision = evaluate(built, truth).groups[-1].obstacles.precision["0.10"] or math.nan
        except TruthError:
            precision = math.nan
    used = [frame for frame in frames if frame.status is Status.OK]
    off_m, sigma_m = np.array(
        [
            (
                math.dist((frame.pose.east_m, frame.pose.north_m), true_m[frame.frame_id]),
                frame.pose.position_sigma_m,
            )
            for frame in used
        ]
    ).T
    within = int((off_m <= 3.0 * np.maximum(sigma_m, 0.01)).sum())
    most_m, median_m = float(off_m.max()), float(np.median(sigma_m))
    return Score(len(used), len(frames), within, most_m, median_m, precision)


def report(
    damages: dict[str, Damage], copy: Callable[[Path], Path], left_m: float = 0.0
) -> Iterator[str]:
    """A line a damage of what `copy` makes in a folder; the poses of its map are of a point so far
    left of those of the truth."""
    truth = read_truth(DRIVE / "truth")
    with (DRIVE / "frames.csv").open(newline="") as table:
        ids = [row["frame_id"] for row in csv.DictReader(table)]
    true_m = {
        frame_id: _place_m(pose, left_m) for frame_id, pose in zip(ids, truth.poses, strict=True)
    }
    yield f"{'':36}{'used':>7}{'3 sigma':>9}{'off most':>10}{'sigma':>9}{'prec 10cm':>11}  said"
    for name, damage in damages.items():
        with tempfile.TemporaryDirectory() as place:
            folder, out = copy(Path(place) / "drive"), Path(place) / "map.gpkg"
            damage(folder)
            try:
                (built,) = build_map([folder], out, BuildSettings(), DriveOptions(LOG))
            except FieldgridError as problem:
                yield f"{name:36}{'refused':>7}  {problem}"
                continue
            score = _score(out, built.session, true_m, truth)
        yield (
            f"{name:36}{score.used:4d}/{score.frames}{score.within:6d}/{score.used}"
            f"{score.most_m:8.2f} m{score.sigma_m:7.3f} m{100 * score.precision:9.1f} %  "
            f"{' '.join(map(str, warnings(built)))}"
        )


if __name__ == "__main__":
    for line in report(DAMAGES, _copy):
        print(line, flush=True)
