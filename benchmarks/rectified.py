"""Raw pairs rectified here beside the same frames rectified at their making: the vineyard's.

`python -m benchmarks.rectified` prints maps of both against the exact truth, carried by the true
poses so that nothing else differs, and how far rows disagree before and after. The raw pairs are
beside the repository in ../shared/data; without them there is nothing to print.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.heading_scores import DATA
from fieldgrid.core import BuildSettings
from fieldgrid.field import GroupScores, evaluate, read_truth
from fieldgrid.geometry import Pose
from fieldgrid.maps import create_map, open_map
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline.session import session_config
from fieldgrid.pipeline.staging.perception import perceive_frame, side_by_side
from fieldgrid.recordings import Image, Recording, StereoFrame, open_recording

VINEYARD = DATA / "vineyard_two_lanes"
CALIBRATION = VINEYARD / "calibration" / "stereo_raw_opencv.yaml"
GIVEN = re.compile(r"^(?:[RP][12]|Q):.*\n(?: .*\n)*", re.MULTILINE)
"""Of a calibration what prescribes how to rectify; without it that follows from R and T."""
FEATURES = 1000
SETTINGS = """frames = "frames_raw.csv"
calibration = "raw.yaml"
[images]
rectified = false
"""


class Scores(NamedTuple):
    """What a set of pairs is worth: the map against the truth, and the rows."""

    name: str
    group: GroupScores
    row_error_px: float


@contextmanager
def raw_drive(*, prescribed: bool = True) -> Iterator[Path]:
    """The drive with its raw pairs as the frames, in a temporary folder of links; rectified as
    its calibration prescribes, or as follows from the places of the cameras."""
    with tempfile.TemporaryDirectory() as folder:
        for path in VINEYARD.iterdir():
            (Path(folder) / path.name).symlink_to(path.resolve())
        (Path(folder) / "recording.toml").write_text(SETTINGS)
        text = CALIBRATION.read_text()
        (Path(folder) / "raw.yaml").write_text(text if prescribed else GIVEN.sub("", text))
        yield Path(folder)


def compare() -> Iterator[Scores]:
    """The scores of the pairs rectified at their making, then of those rectified here: as
    prescribed, and by the places of the cameras alone."""
    for prescribed in (True, False):
        with raw_drive(prescribed=prescribed) as folder:
            raw = open_recording(folder, "gnss_rtk.nmea")
            if prescribed:
                times_ns = set(raw.frame_times_ns().tolist())
                rectified = open_recording(VINEYARD, "gnss_rtk.nmea")
                yield _score("rectified at their making", rectified, times_ns)
            how = "prescribed" if prescribed else "by R and T"
            yield _score(f"raw, rectified here, {how}", raw, times_ns)


def raw_row_error_px() -> float:
    """The median row error of the raw pairs as they are."""
    with raw_drive() as folder, open_recording(folder, "gnss_rtk.nmea") as raw:
        frames = [frame for frame in raw.frames() if isinstance(frame, StereoFrame)]
        return row_error_px([(frame.left.read(), frame.right.read()) for frame in frames])


def row_error_px(pairs: Sequence[tuple[Image, Image]]) -> float:
    """Median |dy| between features that are matched across every other pair."""
    detector, matcher = cv2.SIFT.create(FEATURES), cv2.BFMatcher(cv2.NORM_L2, crossCheck=True)
    off = []
    for pair in pairs[::2]:
        (points, described), (others, theirs) = (
            detector.detectAndCompute(image, None) for image in pair
        )
        for match in matcher.match(described, theirs):
            dx, dy = np.subtract(points[match.queryIdx].pt, others[match.trainIdx].pt)
            if -1.0 < dx < 100.0 and abs(dy) < 10.0:
                off.append(abs(dy))
    return float(np.median(off))


def _score(name: str, drive: Recording, times_ns: Collection[int]) -> Scores:
    """The map of the frames of some times, by the truth's own poses."""
    truth = read_truth(VINEYARD / "truth")
    assert truth.datum is not None
    true = {pose.time_ns: pose for pose in truth.poses}
    frames = [frame for frame in drive.frames() if frame.time_ns in times_ns]
    pairs = [frame.images() for frame in frames if isinstance(frame, StereoFrame)]
    with tempfile.TemporaryDirectory() as folder:
        out, gridder = Path(folder) / "map.gpkg", LocalGridder(drive.rig)
        config = session_config(BuildSettings(), drive.rig, gridder, every=1)
        with (
            create_map(out, truth.datum) as universal,
            universal.add_session("truth", config=config) as session,
        ):
            for perceived in side_by_side(
                partial(perceive_frame, gridder=gridder), frames, os.cpu_count() or 1
            ):
                at = true[perceived.frame.time_ns]
                pose = Pose(at.time_ns, at.east_m, at.north_m, 0.0, at.heading_deg, 0.0, 0.0, 0.0)
                session.add(perceived.grid, pose, frame_id=perceived.frame.frame_id)
        with open_map(out) as universal:
            return Scores(name, evaluate(universal, truth).groups[-1], row_error_px(pairs))


def main() -> None:
    """Print both."""
    if not VINEYARD.exists():
        print(f"{VINEYARD.name}: not at hand, left out")
        return
    print(
        f"{'':<34}{'frames':>8}{'prec 10cm':>11}{'25cm':>8}{'rec 10cm':>10}{'25cm':>8}{'|dy|':>10}"
    )
    for name, group, row_error in compare():
        obstacles = group.obstacles
        shares = [*obstacles.precision.values(), *obstacles.recall.values()]
        figures = "".join(
            f"{f'{100 * (share or 0.0):.1f} %':>{width}}"
            for share, width in zip(shares, (11, 8, 10, 8), strict=True)
        )
        print(f"{name:<34}{group.poses.frames:>8}{figures}{row_error:>7.3f} px")
    print(f"{'raw, as they are':<79}{raw_row_error_px():>7.3f} px")


if __name__ == "__main__":
    main()
