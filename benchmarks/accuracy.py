"""`make accuracy`: maps of the example drive against its exact truth, a line a variant."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import EXAMPLE
from fieldgrid.core import BuildSettings, resolve
from fieldgrid.field import Evaluation, GroupScores, evaluate, read_truth
from fieldgrid.geometry import Pose
from fieldgrid.maps import create_map, open_map
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline import build_map
from fieldgrid.pipeline.session import session_config
from fieldgrid.pipeline.staging.perception import perceive_frame, side_by_side
from fieldgrid.recordings import DriveOptions, open_recording

SLOW_S = 10.0
"""An error that lasts longer than twice this is slow."""


class Variant(NamedTuple):
    """A way to build the map of the example."""

    name: str
    gnss: str
    settings: BuildSettings


def variants() -> Iterator[Variant]:
    """What is compared: GNSS, matcher, search, grid, transfer."""
    rtk, sf1 = "gnss_rtk.nmea", "gnss_sf1.nmea"
    yield Variant("RTK, as built by default", rtk, resolve(None, {}))
    yield Variant(
        "RTK, all 128 disparities searched", rtk, resolve(None, {"stereo": {"min_range_m": 1.3}})
    )
    yield Variant("RTK, matcher sgbm", rtk, resolve(None, {"stereo": {"matcher": "sgbm"}}))
    yield Variant("RTK, means of two rows matched", rtk, resolve(None, {"stereo": {"row_step": 2}}))
    yield Variant("RTK, matcher bm", rtk, resolve(None, {"stereo": {"matcher": "bm"}}))
    yield Variant("RTK, area transfer", rtk, resolve(None, {"map": {"transfer": "area"}}))
    yield Variant(
        "RTK, the paper's grid 6.65 x 14",
        rtk,
        resolve(None, {"grid": {"width_m": 6.65, "length_m": 14.0}}),
    )
    yield Variant(
        "RTK, without the camera's motion",
        rtk,
        resolve(None, {"pose": {"visual_odometry": False}}),
    )
    yield Variant("RTK, the paper's heading", rtk, resolve(None, {"pose": {"heading": "course"}}))
    yield Variant("SF1 (decimetres, jumps, hole)", sf1, resolve(None, {}))
    yield Variant("SF1, the paper's heading", sf1, resolve(None, {"pose": {"heading": "course"}}))


def main() -> None:
    """Build, evaluate and print every variant."""
    print(
        "forward on the rows; asked of RTK: precision >= 94 %, recall >= 95 % within 10 cm, "
        "free with an obstacle <= 0.5 %"
    )
    print(
        f"{'':<36}{'frames':>8}{'prec 10cm':>11}{'25cm':>8}{'rec 10cm':>10}{'25cm':>8}"
        f"{'free!':>8}{'|heading| med, 95 %':>21}{'|pos| med':>11}"
    )
    print(_line("true poses", with_true_poses().groups[0]))
    honesty = []
    for variant in variants():
        scores = _measure(variant)
        print(_line(variant.name, scores.groups[0]))
        if variant.settings == BuildSettings():
            honesty.append(f"  {variant.name}: {_honesty(scores)}")
    print(_line("SF1, its slow error taken out", without_slow_error("gnss_sf1.nmea").groups[0]))
    print("stated heading error of all accepted frames")
    print("\n".join(honesty))


def with_true_poses() -> Evaluation:
    """What the local grids are worth by themselves: carried by the truth's own poses."""
    truth = read_truth(EXAMPLE / "truth")
    assert truth.datum is not None
    with tempfile.TemporaryDirectory() as folder, open_recording(EXAMPLE, "gnss_rtk.nmea") as drive:
        out, gridder = Path(folder) / "map.gpkg", LocalGridder(drive.rig)
        config = session_config(BuildSettings(), drive.rig, gridder, every=1)
        with (
            create_map(out, truth.datum) as universal,
            universal.add_session("truth", config=config) as session,
        ):
            for perceived, true in zip(
                side_by_side(
                    partial(perceive_frame, gridder=gridder), drive.frames(), os.cpu_count() or 1
                ),
                truth.poses,
                strict=True,
            ):
                pose = Pose(
                    true.time_ns, true.east_m, true.north_m, 0.0, true.heading_deg, 0.0, 0.0, 0.0
                )
                session.add(perceived.grid, pose, frame_id=perceived.frame.frame_id)
        with open_map(out) as universal:
            return evaluate(universal, truth)


def without_slow_error(gnss: str) -> Evaluation:
    """The map by default, each frame shifted by what the truth says of the receiver's slow
    error: the median error of the poses within `SLOW_S` of it, which no receiver can know."""
    truth = read_truth(EXAMPLE / "truth")
    true_m = {pose.time_ns: (pose.east_m, pose.north_m) for pose in truth.poses}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "map.gpkg"
        (report,) = build_map([EXAMPLE], out, BuildSettings(), DriveOptions(gnss))
        with open_map(out, writable=True) as universal:
            poses = {f.frame_id: f.pose for f in universal.frames(report.session)}
            time_s = np.array([pose.time_ns for pose in poses.values()]) / 1e9
            off_m = np.array(
                [
                    np.subtract((pose.east_m, pose.north_m), true_m[pose.time_ns])
                    for pose in poses.values()
                ]
            )
            shifted = {}
            for key, pose in poses.items():
                near = np.abs(time_s - pose.time_ns / 1e9) <= SLOW_S
                east_m, north_m = np.median(off_m[near], axis=0)
                shifted[key] = replace(
                    pose, east_m=pose.east_m - east_m, north_m=pose.north_m - north_m
                )
            universal.repose(report.session, shifted)
        with open_map(out) as universal:
            return evaluate(universal, truth)


def _measure(variant: Variant) -> Evaluation:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "map.gpkg"
        build_map([EXAMPLE], out, variant.settings, DriveOptions(variant.gnss))
        with open_map(out) as universal:
            return evaluate(universal, read_truth(EXAMPLE / "truth"))


def _honesty(scores: Evaluation) -> str:
    used = [frame for frame in scores.frames if frame.status == "ok"]
    errors = np.abs([frame.heading_error_deg for frame in used])
    sigmas = np.array([frame.heading_sigma_deg for frame in used])
    return (
        f"{100 * np.mean(errors <= 3 * sigmas):.1f} % of {len(used)} within 3 sigma, median sigma "
        f"{np.median(sigmas):.2f}° for a median error of {np.median(errors):.2f}°"
    )


def _line(name: str, group: GroupScores) -> str:
    obstacles, poses = group.obstacles, group.poses
    shares = [
        obstacles.precision["0.10"],
        obstacles.precision["0.25"],
        obstacles.recall["0.10"],
        obstacles.recall["0.25"],
        obstacles.free_with_obstacle,
    ]
    if None in shares or poses.heading_median_deg is None or poses.heading_p95_deg is None:
        return f"{name:<36} no frame was used"
    p10, p25, r10, r25, _ = (f"{100 * (share or 0.0):.1f} %" for share in shares)
    heading = f"{poses.heading_median_deg:.2f}°, {poses.heading_p95_deg:.2f}°"
    position = f"{poses.position_median_m or 0.0:.3f} m"
    return (
        f"{name:<36}{poses.frames:>5}/{poses.frames + poses.rejected:<2}{p10:>11}{p25:>8}{r10:>10}"
        f"{r25:>8}{f'{100 * (shares[4] or 0.0):.2f} %':>8}{heading:>21}{position:>11}"
    )


if __name__ == "__main__":
    main()
