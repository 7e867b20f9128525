"""`python -m benchmarks.align [TRIALS]`: how well drives of one field coincide after alignment.

Drives are displaced by random shifts, turns and wanders, and the displacement that is left against
the poses that are known is measured; where drives are displaced by one row, a doubt is right and
a confident answer is counted as wrong. Data beside the repository in ../shared/data are left out
where they are absent.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.peak import peak_mb
from fieldgrid.core import BuildSettings
from fieldgrid.field import MapAlignment, align_map, evaluate, read_truth
from fieldgrid.field.align import pairs, score
from fieldgrid.field.align.submaps import cut, draw
from fieldgrid.geometry import Datum, Lattice, Pose
from fieldgrid.maps import FrameRecord, MapFile, Transform, Wander, create_map, open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

SHARED = Path(__file__).resolve().parents[1] / "../shared/data"
LATER, SLOPE = SHARED / "vineyard_two_lanes_later", SHARED / "vineyard_slope"
ROAD = SHARED / "kitti_2011_09_30_drive_0020"

SF1_SIGMA_M = 0.35
"""What displaced drives state."""

AHEAD_M = 7.5
"""What a frame sees lies about this far ahead of the vehicle."""

ROW_M, ROW_DEG = 3.0, {"two_lanes": 37.0, "later": 37.0, "slope": 128.0}
"""From row to row of the rendered vineyards, and the heading of their rows."""

ROW_REACHES_M = 2.5, 5.0
"""Drives that are off by a row are aligned with the usual reach, and with one beyond it."""

MOST_LEFT_M, MOST_LEFT_DEG = 0.05, 0.1
"""What may be left between two drives."""

Placed = Sequence[tuple[FrameRecord, Pose]]


def built(path: Path, drives: Mapping[str, tuple[Path, str | None]]) -> Path:
    """A map of drives, by name: the recording and its log."""
    for name, (recording, log) in drives.items():
        options = DriveOptions(gnss=None if log is None else recording / "gnss" / log)
        build_map([recording], path, BuildSettings(), options, append=path.exists(), name=name)
    return path


def frames_of(universal: MapFile, name: str) -> list[FrameRecord]:
    """The accepted frames of a session."""
    return [f for f in universal.frames(name, with_grid=True) if f.accepted]


def map_of(path: Path, datum: Datum, sessions: Mapping[str, Placed]) -> MapFile:
    """A map of frames at poses. Its cells are large: alignment does not read them."""
    path.unlink(missing_ok=True)
    with create_map(path, datum, cell_m=0.5) as universal:
        for name, frames in sessions.items():
            with universal.add_session(name) as session:
                for frame, pose in frames:
                    session.add_staged(frame.staged(), pose)
    return open_map(path)


def displaced(frames: Sequence[FrameRecord], by: Transform, sigma_m: float) -> Placed:
    """Frames whose poses are off by a transform and state a sigma."""
    return [(f, replace(by.pose(f.driven), position_sigma_m=sigma_m)) for f in frames]


def at_poses(frames: Sequence[FrameRecord], sigma_m: float) -> Placed:
    """Frames where they were."""
    return displaced(frames, Transform(), sigma_m)


class Left(NamedTuple):
    """What lies between two drives after alignment: metres, degrees, and the sigmas that were said;
    a doubt has none."""

    off_m: float
    turn_deg: float
    sigma_m: float
    turn_sigma_deg: float

    @property
    def is_doubt(self) -> bool:
        """Whether nothing was moved."""
        return np.isnan(self.off_m)

    @property
    def is_false(self) -> bool:
        """Whether more is left than is allowed, and than the sigmas say."""
        off = self.off_m > max(MOST_LEFT_M, 3.0 * self.sigma_m)
        return off or abs(self.turn_deg) > max(MOST_LEFT_DEG, 3.0 * self.turn_sigma_deg)


DOUBT = Left(np.nan, np.nan, np.nan, np.nan)


def left_between(
    found: MapAlignment, sessions: Mapping[str, Placed], names: tuple[str, str]
) -> Left:
    """What alignment left of a displacement of the second drive against the first."""
    pair = found.pairs[0] if found.pairs else None
    if pair is None or pair.doubt is not None:
        return DOUBT
    after = {drive.name: drive.after for drive in found.drives}
    turn_sigma = max(drive.turn_sigma_deg for drive in found.drives)
    off, turn = {}, {}
    for name in names:
        moved = [(f.driven, after[name].pose(pose)) for f, pose in sessions[name]]
        off[name] = np.mean(
            [(p.east_m - q.east_m, p.north_m - q.north_m) for q, p in moved], axis=0
        )
        away = np.array([p.heading_deg - q.heading_deg for q, p in moved])
        turn[name] = np.mean((away + 180.0) % 360.0 - 180.0)
    a, b = names
    away = float(np.hypot(*(off[b] - off[a])))
    return Left(away, float(turn[b] - turn[a]), pair.sigma_m, turn_sigma)


def random_transform(random: np.random.Generator, frames: Sequence[FrameRecord]) -> Transform:
    """A shift of up to 2 m, a turn of up to 1°, a wander of 0.3 m over a minute or two."""
    east, north = (np.array([getattr(f.driven, n) for f in frames]) for n in ("east_m", "north_m"))
    way = random.uniform(0.0, 2.0 * np.pi)
    size = random.uniform(0.0, 2.0)
    start, stop = frames[0].driven.time_ns, frames[-1].driven.time_ns
    times = np.linspace(start, stop, 25).astype(np.int64)
    period_s = random.uniform(120.0, 300.0)
    phases = random.uniform(0.0, 2.0 * np.pi, 2)
    swing = [
        0.3 / np.sqrt(2.0) * np.sin(2.0 * np.pi * (times - start) / 1e9 / period_s + phase)
        for phase in phases
    ]
    swing = [one - one.mean() for one in swing]
    return Transform(
        size * np.sin(way), size * np.cos(way), random.uniform(-1.0, 1.0),
        float(east.mean()), float(north.mean()),
        Wander(tuple(times.tolist()), tuple(swing[0].tolist()), tuple(swing[1].tolist())),
    )  # fmt: skip


def report(name: str, results: Sequence[Left], *, spoilt: bool = False) -> None:
    """A line of the table of trials."""
    told = [one for one in results if not one.is_doubt]
    line = f"{name:44s} {len(results):4d} {len(results) - len(told):6d}"
    if told:
        off = np.array([one.off_m for one in told])
        turn = np.abs([one.turn_deg for one in told])
        within = np.mean([one.off_m <= 3.0 * one.sigma_m for one in told])
        middle, most = 100.0 * np.percentile(off, [50, 95])
        line += f"   {middle:5.1f} {most:5.1f} {100 * off.max():6.1f}   "
        line += f"{np.median(turn):5.2f} {turn.max():5.2f}   {100 * within:5.1f}"
        beyond = sum(one.off_m > MOST_LEFT_M or abs(one.turn_deg) > MOST_LEFT_DEG for one in told)
        line += f"   {beyond:4d} {sum(one.is_false for one in told):4d}"
        wrong = int((off > 0.5).sum())
        line += f"   {wrong} wrong" if spoilt or wrong else ""
    print(line, flush=True)


def trials(folder: Path, count: int, seed: int, only: str) -> None:
    """Random displacements of one drive against another, of pairs whose names contain `only`. Those
    that leave more than they may and than they say are told one by one; each has its own seed."""
    sets: dict[str, tuple[Datum, list[FrameRecord], list[FrameRecord]]] = {}
    sources = {"two_lanes": (EXAMPLE, "gnss_rtk.nmea")}
    if LATER.exists():
        sources["later"] = (LATER, "gnss_rtk.nmea")
    if SLOPE.exists():
        sources["slope"] = (SLOPE, "gnss_rtk.nmea")
    if ROAD.exists():
        sources["road"] = (ROAD, None)
    frames: dict[str, list[FrameRecord]] = {}
    maps = []
    for name, source in sources.items():
        universal = open_map(built(folder / f"{name}.gpkg", {name: source}))
        maps.append(universal)  # frames load from it
        frames[name] = frames_of(universal, name)
        datum = universal.datum
        own = frames[name]
        cut = [own[: int(0.65 * len(own))], own[int(0.35 * len(own)) :]]
        sets[f"{name}: every other frame"] = (datum, own[::2], own[1::2])
        sets[f"{name}: two overlapping parts"] = (datum, cut[0], cut[1])
    if LATER.exists():
        both = open_map(
            built(folder / "both.gpkg", {"june": sources["two_lanes"], "august": sources["later"]})
        )
        maps.append(both)
        sets["two_lanes: June and August"] = (
            both.datum, frames_of(both, "june"), frames_of(both, "august"),
        )  # fmt: skip
    print(f"{'':44s} {'runs':>4s} {'doubts':>6s}   left: median, 95 %, worst cm; turn: median, "
          "worst °; within 3 sigma %; beyond 5 cm or 0.1°, and beyond the sigmas, too")  # fmt: skip
    for at, (name, (datum, first, second)) in enumerate(sets.items()):
        if only not in name:
            continue
        share = -(-count // len(sets))
        for sigma_m, receiver in ((SF1_SIGMA_M, "says 0.35 m"), (0.02, "says 0.02 m")):
            results = []
            for n in range(share if sigma_m == SF1_SIGMA_M else share // 4):
                by = random_transform(np.random.default_rng([seed, at, n]), second)
                sessions = {"a": at_poses(first, 0.02), "b": displaced(second, by, sigma_m)}
                with map_of(folder / "trial.gpkg", datum, sessions) as trial:
                    results.append(left_between(align_map(trial), sessions, ("a", "b")))
                if results[-1].is_false:
                    print(f"  trial {n}: {by.to_text()[:90]}", *map("{:.3f}".format, results[-1]))
            if results:
                report(f"{name}, {receiver}", results)
        for one, row_deg in ROW_DEG.items():
            if name.startswith(one):
                slips(folder, name, (datum, first, second), np.radians(row_deg))
    for one in maps:
        one.close()


def slips(folder: Path, name: str, drives: tuple[Datum, Placed, Placed], row_rad: float) -> None:
    """Drives that are off by one row either way, told apart from those that are not."""
    datum, first, second = drives
    for reach_m in ROW_REACHES_M:
        results = []
        for step_m in (ROW_M, -ROW_M):
            by = Transform(step_m * float(np.cos(row_rad)), -step_m * float(np.sin(row_rad)))
            sessions = {"a": at_poses(first, 0.02), "b": displaced(second, by, SF1_SIGMA_M)}
            with map_of(folder / "trial.gpkg", datum, sessions) as trial:
                found = align_map(trial, reach_m=reach_m)
                results.append(left_between(found, sessions, ("a", "b")))
        report(f"{name}, off by one row, reach {reach_m} m", results, spoilt=True)


def appended(folder: Path, count: int, seed: int) -> None:
    """What `build --append` says of how a drive lies, without fine comparison."""
    random = np.random.default_rng(seed)
    universal = open_map(built(folder / "appended.gpkg", {"a": (EXAMPLE, "gnss_rtk.nmea")}))
    own = frames_of(universal, "a")
    sigmas, off = [], []
    for _ in range(count):
        by = random_transform(random, own)
        sessions = {"a": at_poses(own[::2], 0.02), "b": displaced(own[1::2], by, SF1_SIGMA_M)}
        with map_of(folder / "trial.gpkg", universal.datum, sessions) as trial:
            (pair,) = align_map(trial, ["b"], rounds=0).pairs
        if pair.doubt is None:
            away = []
            for frame in own[1::2]:
                heading = np.radians(frame.driven.heading_deg)
                east = frame.driven.east_m + AHEAD_M * np.sin(heading)
                north = frame.driven.north_m + AHEAD_M * np.cos(heading)
                placed = by.points(east, north, frame.driven.time_ns)
                away.append((placed[0] - east, placed[1] - north))
            off.append(float(np.hypot(*(pair.before_m - np.mean(away, axis=0)))))
            sigmas.append(pair.sigma_m)
    within = np.mean(np.array(off) <= 3.0 * np.array(sigmas))
    print(
        f"\nappended, without fine comparison: {len(off)} of {count} told, wrong by "
        f"{100 * np.median(off):.0f} cm at the median, {100 * max(off):.0f} at worst, said "
        f"{100 * np.median(sigmas):.0f}; within 3 sigma {100 * within:.0f} %"
    )
    universal.close()


def pose_errors(universal: MapFile, name: str, drive: Path) -> np.ndarray:
    """East, north (m) and heading (°) of placed frames less the truth [n, 3]."""
    origin = json.loads((drive / "session.json").read_text())["ltp_origin"]
    plane = Datum(origin["lat_deg"], origin["lon_deg"], origin["ellipsoid_height_m"])
    with (drive / "truth" / "poses_frames.csv").open() as file:
        truth = {row["id"]: row for row in csv.DictReader(file)}
    errors = []
    for frame in universal.frames(name):
        if frame.accepted:
            row = truth[frame.frame_id]
            place = (float(row[key]) for key in ("cam_mid_E", "cam_mid_N", "ref_U"))
            east, north, _ = universal.datum.to_enu(*plane.to_geodetic(*place))
            turn = (frame.pose.heading_deg - float(row["heading_deg"]) + 180.0) % 360.0 - 180.0
            errors.append((frame.pose.east_m - east, frame.pose.north_m - north, turn))
    return np.array(errors, dtype=np.float64)


def real(folder: Path) -> None:
    """The logs of two rendered drives as they are, before and after alignment."""
    logs = {
        "june-sf1": (EXAMPLE, "gnss_sf1.nmea"), "august-sf1": (LATER, "gnss_sf1.nmea"),
        "june-rtk": (EXAMPLE, "gnss_rtk.nmea"), "august-rtk": (LATER, "gnss_rtk.nmea"),
    }  # fmt: skip
    logs = {name: source for name, source in logs.items() if source[0].exists()}
    sets = [
        ["june-sf1"], ["june-sf1", "august-sf1"], ["june-sf1", "june-rtk"],
        ["august-sf1", "june-rtk"], ["june-rtk", "august-rtk"], list(logs),
    ]  # fmt: skip
    for names in sets:
        if not set(names) <= set(logs):
            continue
        path = built(folder / f"{'-'.join(names)}.gpkg", {name: logs[name] for name in names})
        with open_map(path, writable=True) as universal:
            before = {n: pose_errors(universal, n, logs[n][0]) for n in names}
            start = time.process_time()
            found = align_map(universal)
            spent_s = time.process_time() - start
            universal.set_transforms(found.transforms)
            after = {n: pose_errors(universal, n, logs[n][0]) for n in names}
            print(f"\n{' + '.join(names)} ({spent_s:.1f} s of processor time)")
            for drive in found.drives:
                b, a = before[drive.name], after[drive.name]
                print(
                    f"  {drive.name:12s} off by {_metres(b)} m, after {_metres(a)} m; scatter "
                    f"{100 * np.hypot(*b[:, :2].std(axis=0)):.1f} cm, after "
                    f"{100 * np.hypot(*a[:, :2].std(axis=0)):.1f} cm; said {drive.sigma_m:.3f} m"
                )
            for pair in found.pairs:
                apart = [e[pair.b].mean(axis=0) - e[pair.a].mean(axis=0) for e in (before, after)]
                print(
                    f"  {pair.b} against {pair.a}: {100 * np.hypot(*apart[0][:2]):.1f} cm apart, "
                    f"after {100 * np.hypot(*apart[1][:2]):.1f} cm and {apart[1][2]:+.2f}°; said "
                    f"{100 * pair.sigma_m:.1f} cm{'; ' + pair.doubt if pair.doubt else ''}"
                )
            _scores(universal, names, logs)


def _metres(errors: np.ndarray) -> str:
    east, north = errors[:, :2].mean(axis=0)
    return f"{east:+.3f} {north:+.3f}"


def _scores(universal: MapFile, names: Sequence[str], logs: Mapping[str, tuple[Path, str]]) -> None:
    """The cells of poor drives after alignment, each alone, against the truth."""
    for name in names if len(names) > 1 else ():
        if not name.endswith("sf1"):
            continue
        others = [other for other in names if other != name]
        for other in others:
            universal.remove_session(other)
        found = evaluate(universal, read_truth(logs[name][0] / "truth")).groups[0].obstacles
        print(
            f"  {name} alone: precision {found.precision['0.10']:.3f}, recall "
            f"{found.recall['0.10']:.3f} within 10 cm"
        )
        for other in others:
            universal.restore_session(other)


def lanes(folder: Path) -> None:
    """What neighbouring lanes of one drive say of each other where they share less than they must
    to be compared: drives with RTK, which lie within a centimetre of the truth, so that it should
    be nothing but what lies between the faces of a row."""
    print("\nlane against lane: share of the ground, rho², shift across (sigma), rho² as they lie")
    for path in (EXAMPLE, LATER, SLOPE):
        if not path.exists():
            continue
        made = built(folder / f"{path.name}-lanes.gpkg", {"a": (path, "gnss_rtk.nmea")})
        least = patch.object(pairs, "LEAST_SHARE", 0.08), patch.object(score, "LEAST_SHARE", 0.02)
        with open_map(made) as universal, least[0], least[1]:
            drawn = [
                draw(part, Transform(), Lattice(0.1))[0]
                for part in cut("a", frames_of(universal, "a"))
            ]
            for overlap in pairs.overlapping([drawn], lambda a, b: True):
                pair = pairs.placed(overlap, [drawn])
                found = score.SubmapCorrelator(drawn[pair.k], 1.5).scores(drawn[pair.l])
                if found is None or not pair.across.any():
                    continue
                shift_m, information = score.peak(found, np.zeros(2))
                at = found.reach + np.array([-1, 2])
                here = found.by_cell[at[0] : at[1], at[0] : at[1]].max()
                across_m = 100.0 * float(shift_m @ pair.across)
                sigma_m = 100.0 * float(pair.across @ information @ pair.across) ** -0.5
                print(
                    f"  {path.name:24s} {pair.k:2d} {pair.l:2d}  {100 * pair.share:3.0f} %   "
                    f"{-np.expm1(-2.0 * found.by_cell.max()):.2f}   {across_m:+6.1f} cm "
                    f"({sigma_m:5.1f})   {-np.expm1(-2.0 * here):.2f}"
                )


def many(folder: Path, sessions: int, frames: int) -> None:
    """The time and memory of many drives over one field: the example's frames, displaced."""
    universal = open_map(built(folder / "many.gpkg", {"a": (EXAMPLE, "gnss_rtk.nmea")}))
    own = frames_of(universal, "a")
    random = np.random.default_rng(3)
    made: dict[str, Placed] = {}
    for n in range(sessions):
        repeated = []
        for k in range(frames):
            frame = own[k % len(own)]
            late_ns = (k // len(own)) * 600_000_000_000
            pose = replace(frame.driven, time_ns=frame.driven.time_ns + late_ns)
            repeated.append(replace(frame, frame_id=f"{k:06d}", pose=pose, driven=pose))
        shift = random.normal(0.0, 0.3, 2)
        made[f"{n:02d}"] = displaced(repeated, Transform(*map(float, shift)), SF1_SIGMA_M)
    with map_of(folder / "trial.gpkg", universal.datum, made) as field:
        wall, start = time.perf_counter(), time.process_time()
        found = align_map(field)
        print(
            f"\n{sessions} sessions of {frames} frames: {time.perf_counter() - wall:.0f} s, "
            f"{time.process_time() - start:.0f} s of processor time, peak "
            f"{peak_mb():.0f} MB; "
            f"{sum(pair.doubt is None for pair in found.pairs)} of {len(found.pairs)} pairs agree"
        )
    universal.close()


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trials", nargs="?", type=int, default=200)
    parser.add_argument("--only", choices=("real", "trials", "appended", "lanes", "many"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pairs", default="", help="only trials of pairs with this in their names")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.only in (None, "real"):
            real(Path(folder))
        if given.only in (None, "trials"):
            trials(Path(folder), given.trials, given.seed, given.pairs)
        if given.only in (None, "appended"):
            appended(Path(folder), max(given.trials // 10, 2), given.seed)
        if given.only in (None, "lanes"):
            lanes(Path(folder))
        if given.only in (None, "many"):
            many(Path(folder), 20, 200)


if __name__ == "__main__":
    main()
