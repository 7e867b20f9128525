"""`python -m benchmarks.hills`: attitude, poses, map and terrain of drives that lean.

The hillside is beside the repository in ../shared/data, and left out where it is absent. Simulated
drives vary slope, crest, receiver and sensors. Each is compared with its exact truth.
"""

from __future__ import annotations

import argparse
import csv
import json
import sqlite3
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial, wraps
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import cv2
import numpy as np

from benchmarks import EXAMPLE
from benchmarks.timing import paired_ms
from fieldgrid.core import BuildSettings, StereoSettings
from fieldgrid.field import evaluate, read_truth
from fieldgrid.field.evaluation.terrain import TerrainScores
from fieldgrid.geometry import (
    BEYOND_DROP,
    DROP_CHANNEL,
    NO_DROP_TOLD,
    Bounds,
    Motion,
    Steps,
    roll_pitch_deg,
)
from fieldgrid.maps import GROUPS, MapFile, Transfer, WindowFold, open_map
from fieldgrid.perception import LocalGridder, ground as local_ground, localgrid
from fieldgrid.perception.stereo import make_matcher
from fieldgrid.pipeline import build_map, estimate_drive, visual_odometry
from fieldgrid.poses import Attitude, fused
from fieldgrid.poses.attitude.axes import AxisTilt, axes_of_tilt
from fieldgrid.poses.attitude.estimate import estimate_attitude
from fieldgrid.poses.attitude.track import AntennaTrack, KnownHeadings
from fieldgrid.recordings import DriveOptions, Recording, open_recording
from tests.hilly import (
    Ground,
    Hike,
    antenna_fixes,
    axis_rises,
    camera_steps,
    hike,
    hills,
    inertial,
    recorded_tilt,
    rows,
    slope,
    slowly,
)
from tests.perception.test_ground_steps import FIELD, SEEN, X, Y, strips, view
from tests.simulated import time_ns

SLOPE = Path(__file__).resolve().parents[1] / "../shared/data/vineyard_slope"
KITTI = SLOPE.parent / "kitti_2011_09_30_drive_0020"
DRIVES = (
    (EXAMPLE, "gnss_rtk.nmea"),
    (SLOPE.parent / "vineyard_two_lanes", "gnss_rtk.nmea"),
    (SLOPE, "gnss_rtk.nmea"),
    (KITTI, None),
)
ANTENNA_M = (-0.12, -0.45, 0.35)
RECEIVERS = {"RTK": (0.012, 0.01), "SF1": (0.03, 0.3)}
GROUNDS: dict[str, Ground] = {
    "level": slope(0.0),
    "3° across": slope(3.0, 120.0),
    "8° down": slope(8.0, 30.0),
    "15° across": slope(15.0, 120.0),
    "15° down": slope(15.0, 30.0),
    "crests of 8°": hills(8.0, 45.0),
    "crests of 14°": hills(14.0, 60.0, seed=5),
}


class Spread(NamedTuple):
    """Absolute errors: median, 95th percentile, largest, and how many are within 3 sigma."""

    median: float
    most: float
    worst: float
    within: float

    def line(self, unit: str) -> str:
        return (
            f"median {self.median:.3f}{unit}, 95 % {self.most:.3f}{unit}, worst {self.worst:.3f}"
            f"{unit}, within 3 sigma {100 * self.within:.1f} %"
        )


def spread(error: np.ndarray, sigma: np.ndarray) -> Spread:
    """The spread of errors with their sigmas."""
    away = np.abs(error)
    middle, most = np.percentile(away, [50, 95])
    return Spread(middle, most, away.max(), np.mean(away <= 3.0 * sigma))


def pooled(found: Attitude, roll_deg: np.ndarray, pitch_deg: np.ndarray) -> Spread:
    """Roll and pitch together."""
    error = np.concatenate([found.roll_deg - roll_deg, found.pitch_deg - pitch_deg])
    return spread(error, np.concatenate([found.roll_sigma_deg, found.pitch_sigma_deg]))


def main() -> None:
    """Print every figure beside what is asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", choices=("simulated", "drives", "folds", "drops", "bytes", "costs")
    )
    only = parser.parse_args().only
    if only in (None, "folds"):
        print("\n".join(folds()))
    if only in (None, "bytes"):
        print("\n".join(stored()))
    if only in (None, "costs"):
        print("\n".join(costs()))
    if only in (None, "drops"):
        print("\n".join(drops()))
    if only in (None, "simulated"):
        print("\n".join(simulated()))
    if only in (None, "drives"):
        for folder in (EXAMPLE, SLOPE):
            if folder.is_dir():
                print("\n".join(measured(folder)))


def folds() -> Iterator[str]:
    """What each channel group costs to fold, beside the density, over the example drive."""
    yield "folds, of the density's; asked: <= 1.5"
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "map.gpkg"
        build_map([EXAMPLE], out, BuildSettings(), DriveOptions("gnss_rtk.nmea"))
        with open_map(out) as universal:
            frames = [(frame.cells(), frame.pose) for frame in universal.frames(with_grid=True)]
            view = universal.read()

    def fold(*names: str) -> None:
        into = WindowFold(
            view.lattice, view.window, Transfer.CENTRE, [GROUPS[name] for name in names]
        )
        for cells, pose in frames:
            into.add(cells, pose)

    for name, group in GROUPS.items():
        if name != "density" and group.fold is not None:
            alone, both = paired_ms(lambda: fold("density"), partial(fold, "density", name), 9)
            yield f"  {name:<12}{(both - alone) / alone:5.2f}"


class Meter:
    """Processor time of calls of functions, by their names."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._stack = ExitStack()

    def __enter__(self) -> Meter:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def watch(self, owner: object, name: str) -> None:
        """Count the calls of a function of a module or a class."""
        called = getattr(owner, name)

        @wraps(called)
        def counted(*args: object, **named: object) -> object:
            began = time.process_time()
            try:
                return called(*args, **named)
            finally:
                self.seconds[name] += time.process_time() - began

        self._stack.enter_context(mock.patch.object(owner, name, counted))


TERRAIN = ("find_edges", "_standing", "steps_cm", "drops_cm", "ground_heights_cm")


def costs() -> Iterator[str]:
    """What attitude and terrain cost a frame of the example drive, beside its bare matching."""
    cv2.setNumThreads(1)
    with open_recording(EXAMPLE, "gnss_rtk.nmea") as drive:
        steps, rig = visual_odometry(drive), drive.rig
        gridder, matcher = LocalGridder(rig), make_matcher(StereoSettings(), 128)
        frames = list(drive.frames())
        estimate_drive(drive, None, None, steps)  # compiles
        attitude = estimate_drive(drive, None, None, steps).report.attitude
        assert attitude is not None
        left, right = frames[0].images()
        seen = gridder.matcher.disparity(left, right)
        gridder.from_coded(gridder.coded(*seen), attitude.tilt_at(frames[0].time_ns))
        matched_s, found = 0.0, []
        for _ in range(3):
            with Meter() as meter:
                meter.watch(fused, "find_lean")
                meter.watch(Attitude, "tilt_at")
                meter.watch(local_ground, "find_edges")
                meter.watch(LocalGridder, "_standing")
                for name in TERRAIN[2:]:
                    meter.watch(localgrid, name)
                estimate_drive(drive, None, None, steps)
                for frame in frames:
                    left, right = frame.images()
                    matched_s -= time.process_time()
                    matcher.compute(left, right)
                    matched_s += time.process_time()
                    tilt = attitude.tilt_at(frame.time_ns + rig.image_time_offset_ns)
                    seen = gridder.matcher.disparity(left, right)
                    gridder.from_coded(gridder.coded(*seen), tilt)
            found.append(meter.seconds)
    frame_ms = 1e3 / len(frames)
    match_ms = frame_ms * matched_s / 3
    took = {name: frame_ms * min(seconds[name] for seconds in found) for name in found[0]}
    yield f"costs a frame, of {match_ms:.1f} ms of bare matching; asked: together <= 5 %"
    told = {name: took[name] for name in TERRAIN}
    parts = (
        ("attitude", took["find_lean"] + took["tilt_at"]),
        ("terrain", sum(told.values())),
        ("together", took["find_lean"] + took["tilt_at"] + sum(told.values())),
    )
    for what, ms in parts:
        yield f"  {what:<10}{ms:5.2f} ms, {100 * ms / match_ms:.1f} %"
    yield "  " + ", ".join(f"{name} {ms:.2f}" for name, ms in told.items())


def stored() -> Iterator[str]:
    """Where the bytes of the map of the example drive are, a cell."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "map.gpkg"
        build_map([EXAMPLE], out, BuildSettings(), DriveOptions("gnss_rtk.nmea"))
        with open_map(out) as universal:
            cells = int(universal.read().observed.sum())
        yield f"bytes a cell, {cells} cells: {out.stat().st_size / cells:.1f}; asked: <= 10"
        database = sqlite3.connect(out)
        for table, column in (
            ("fieldgrid_grid", "channel"),
            ("fieldgrid_tile", "channels"),
            ("fieldgrid_tile", "zoom"),
            ("fieldgrid_array", "kind"),
        ):
            rows = database.execute(
                f"SELECT {column}, sum(length(data)) FROM {table} GROUP BY 1 ORDER BY 2 DESC"
            ).fetchall()
            parts = ", ".join(f"{name} {size / cells:.2f}" for name, size in rows)
            yield f"  {table}: {sum(size for _, size in rows) / cells:.2f} ({parts})"
        (pictures,) = database.execute("SELECT sum(length(tile_data)) FROM density").fetchone()
        database.close()
        yield f"  pictures: {pictures / cells:.2f}"
        before, again = out.stat().st_size, DriveOptions("gnss_sf1.nmea")
        build_map([EXAMPLE], out, BuildSettings(), again, append=True, name="again")
        yield f"  the file, with another session: {(out.stat().st_size - before) / cells:.1f} more"


def drops() -> Iterator[str]:
    """Drops where there are some, in scenes, and where there are none, in drives."""
    yield "drops: cells at the edge that a frame marks, and cells behind it that are no free ground"
    for name in ("down", "bank", "ditch", "terrace"):
        edges_m, heights_m = FIELD[name]
        for axis, first in (("y", np.arange(5.1, 7.7, 0.17)), ("x", np.arange(0.2, 1.4, 0.17))):
            at, behind = [], []
            for seed, at_m in enumerate(first.tolist()):
                scene = strips(axis, [at_m + edge for edge in edges_m], heights_m)
                grid, ground = view(scene, seed)
                cm = ground.channels()[DROP_CHANNEL]
                away = (Y if axis == "y" else X) - at_m + np.zeros(cm.shape)
                near = SEEN & (cm != NO_DROP_TOLD) & (np.abs(away) < 0.1)
                at.append(((cm > 0) & (cm < BEYOND_DROP))[near].mean())
                low = SEEN & (away > 0.6) & (away < (0.9 if name == "ditch" else 2.5))
                behind.append((~grid.observed | (cm > 0))[low].mean())
            yield f"  {name:<8} along {axis}: {np.mean(at):.2f}, {np.mean(behind):.2f}"
    yield "drops: where there are none"
    for folder, gnss in DRIVES:
        if folder.is_dir():
            yield f"  {folder.name}: {_false_drops(folder, gnss)}"


def _false_drops(folder: Path, gnss: str | None) -> str:
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "map.gpkg"
        build_map([folder], out, BuildSettings(), DriveOptions(gnss))
        with open_map(out) as universal:
            seen = falls = beyond = frames = 0
            for frame in universal.frames(with_grid=True):
                cells = frame.cells()
                if (cm := cells.channels.get(DROP_CHANNEL)) is not None:
                    told = cells.grid.observed & (cm != NO_DROP_TOLD)
                    mark = told & (cm > 0) & (cm < BEYOND_DROP)
                    frames += bool(mark.any())
                    seen, falls = seen + int(told.sum()), falls + int(mark.sum())
                    beyond += int((told & (cm == BEYOND_DROP)).sum())
            view = universal.read(layers=("drop", "sure_share"), decide="density")
        edge, lost = view.drop_m > 0.0, view.observed & (view.sure_share == 0.0)
        return (
            f"of frames {100 * falls / seen:.3f} % at drops and {100 * beyond / seen:.3f} % "
            f"beyond, in {frames} frames; of {view.observed.sum()} cells of the map {edge.sum()} "
            f"and {lost.sum()}"
        )


def simulated() -> Iterator[str]:
    """Roll and pitch of simulated drives, by what tells them."""
    yield "simulated drives: roll and pitch; asked: 0.3°, 0.8° with an IMU; 0.6°, 1.5° without"
    for name, ground in GROUNDS.items():
        way = hike(ground, rows(4, 40.0))
        frames = time_ns(np.arange(1.03, way.drive.time_s[-1] - 1.0, 1.0))
        evidence = {
            "IMU": {"sensed": inertial(way)},
            "IMU, 1.5 m/s² of noise": {
                "sensed": inertial(way, force_noise_mps2=1.5, gyro_noise_dps=1.5)
            },
            "camera": {"steps": camera_steps(way)},
            "recorded": {"axes": axes_of_tilt(recorded_tilt(way))},
            "fixes alone": {},
            "antennas fore and aft: pitch": {"axes": _antennas(way, 0.0)},
            "antennas across: roll": {"axes": _antennas(way, 90.0)},
            "own estimate of an IMU": {"axes": _own_estimate(way)},
        }
        for receiver, (noise_m, wander_m) in RECEIVERS.items():
            track = _track(way, noise_m, wander_m)
            for what, said in evidence.items():
                at = frames
                if "steps" in said:
                    at = np.union1d(said["steps"].start_ns, said["steps"].stop_ns)
                found = estimate_attitude(track, np.array(ANTENNA_M), wanted_ns=at, **said).at(at)
                true = roll_pitch_deg(way.at((at - time_ns(np.zeros(1))) / 1e9).R)
                errors = pooled(found, *true)
                if what.endswith(": roll"):
                    errors = spread(found.roll_deg - true[0], found.roll_sigma_deg)
                elif what.endswith(": pitch"):
                    errors = spread(found.pitch_deg - true[1], found.pitch_sigma_deg)
                yield f"  {name:<14}{receiver:<5}{what:<30}{errors.line('°')}"


def _antennas(way: Hike, toward_deg: float) -> list[AxisTilt]:
    """Two antennas that are not quite at one height: 0.7° off, 0.3° for half a minute, 0.2°."""
    times, rises = axis_rises(way, toward_deg, 0.2, noise_deg=0.2, mount_deg=0.7)
    off = rises + slowly(len(rises), 0.2, 30.0, 0.3)
    return [
        AxisTilt(times, off, np.full(len(off), 0.35), toward_deg, 1.0, 0.0, "pitch", "antennas")
    ]


def _own_estimate(way: Hike) -> list[AxisTilt]:
    """An IMU that is not mounted level, and takes pushes for gravity: 0.7° off, 0.7° for 2 s."""
    found = []
    for seed, toward_deg in enumerate((0.0, 90.0)):
        times, rises = axis_rises(way, toward_deg, 0.05, noise_deg=0.05, mount_deg=0.7)
        off = rises + slowly(len(rises), 0.05, 2.0, 0.7, seed)
        found.append(
            AxisTilt(times, off, np.ones(len(off)), toward_deg, 1.0, 0.0, "pitch", "orientation")
        )
    return found


def _track(way: Hike, noise_m: float, wander_m: float) -> AntennaTrack:
    times, enu = antenna_fixes(way, ANTENNA_M, 0.2, noise_m, wander_m)
    heading = np.degrees(way.at(np.arange(0.0, way.drive.time_s[-1], 0.2)).drive.heading_rad)
    n = len(times)
    noise = np.tile(np.array([1.0, 1.0, 2.0]) * noise_m, (n, 1))
    headings = KnownHeadings(times, heading + 0.2, np.full(n, 0.3))
    return AntennaTrack(times, enu, noise, np.full(n, wander_m), headings)


def measured(folder: Path) -> Iterator[str]:
    """A rendered drive: its attitude, poses, map and terrain."""
    yield folder.name
    with open_recording(folder, "gnss_rtk.nmea") as drive:
        steps = visual_odometry(drive)
    for gnss in ("gnss_rtk.nmea", "gnss_sf1.nmea"):
        with open_recording(folder, gnss) as drive:
            yield from _poses(folder, drive, steps)
        yield from _map(folder, gnss)


def _poses(folder: Path, drive: Recording, steps: Steps) -> Iterator[str]:
    with (folder / "truth" / "poses_frames.csv").open() as table:
        true = list(csv.DictReader(table))
    column = {key: np.array([float(row[key]) for row in true]) for key in _NUMBERS}
    datum = read_truth(folder / "truth").datum
    frame_ns = drive.frame_times_ns() + drive.rig.image_time_offset_ns
    blind = replace(drive, log=drive.log._replace(motion=Motion()))
    for what, source in (("IMU", drive), ("camera alone", blind)):
        began = time.process_time()
        estimate = estimate_drive(source, None, datum, steps)
        took_s = time.process_time() - began
        attitude = estimate.report.attitude
        assert attitude is not None
        leaning = pooled(attitude.at(frame_ns), column["roll_deg"], column["pitch_deg"])
        yield f"  {drive.gnss_source}, {what}: roll and pitch {leaning.line('°')}"
        if source is drive:
            poses = [estimate.trajectory.at(at) for at in frame_ns.tolist()]
            place = np.array([[pose.east_m, pose.north_m] for pose in poses])
            off = np.hypot(*(place - np.stack([column["cam_mid_E"], column["cam_mid_N"]], 1)).T)
            position = spread(off, np.array([pose.position_sigma_m for pose in poses]))
            yield f"    position {position.line(' m')} (poses and attitude: {took_s:.2f} s)"
            turned = np.array([pose.heading_deg for pose in poses]) - column["heading_deg"]
            turned = (turned + 180.0) % 360.0 - 180.0
            sigma = np.array([pose.heading_sigma_deg for pose in poses])
            yield f"    heading {spread(turned, sigma).line('°')}; asked: 95 % <= 0.2°"


_NUMBERS = ("roll_deg", "pitch_deg", "heading_deg", "cam_mid_E", "cam_mid_N")


def _map(folder: Path, gnss: str) -> Iterator[str]:
    truth = read_truth(folder / "truth")
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "map.gpkg"
        build_map([folder], out, BuildSettings(), DriveOptions(gnss), datum=truth.datum)
        with open_map(out) as universal:
            scores = evaluate(universal, truth)
            found = scores.groups[0].obstacles
            yield (
                f"    precision, recall within 10 cm {found.precision['0.10']:.3f}, "
                f"{found.recall['0.10']:.3f}; free with an obstacle "
                f"{100 * (found.free_with_obstacle or 0.0):.2f} %"
            )
            yield f"    {_terrain(scores.terrain)}"
            yield f"    {_standing(universal, folder)}"
        yield f"    bytes a cell of the terrain: {_bytes(out)}"


def _terrain(found: TerrainScores | None) -> str:
    if found is None:
        return "ground: none"
    return (
        f"ground: RMSE {100 * found.rmse_m:.1f} cm over {found.cells} cells of 25 cm, bias "
        f"{100 * found.bias_m:+.1f} cm, median {found.median_m:.3f} m, 95 % {found.p95_m:.3f} m, "
        f"worst {found.max_m:.3f} m, within 3 sigma {100 * found.within_3_sigma:.1f} %; asked: "
        "RMSE <= 5 cm"
    )


def _standing(universal: MapFile, folder: Path) -> str:
    """The heights of the objects of the truth, and how many cells have room below what hangs."""
    found = []
    with (folder / "truth" / "obstacles.json").open() as file:
        objects = json.load(file)["obstacles"]
    for one in objects:
        corners = np.array(one["footprint_EN"])
        bounds = Bounds(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
        view = universal.read(bounds, layers=("max_height",))
        if np.nanmax(view.layer("max_height"), initial=0.0) > 0.0:
            highest = np.nanmax(view.layer("max_height"))
            found.append(f"{one['id']} {highest:.1f} ({one['height_m']:.2f})")
    view = universal.read(layers=("max_height", "clearance"))
    stands = view.layer("max_height") > 0.0
    room = view.layer("clearance")[np.isfinite(view.layer("clearance"))]
    return (
        f"heights, found (true), m: {', '.join(found)}; of {stands.sum()} cells in which something "
        f"stands {room.size} have room below, {np.median(room) if room.size else 0.0:.1f} m in the "
        "middle"
    )


def _bytes(path: Path) -> str:
    with open_map(path) as universal:
        cells = int(universal.read().observed.sum())
    database = sqlite3.connect(path)
    sizes = [
        database.execute(f"SELECT sum(length(data)) FROM {table} WHERE {where}").fetchone()[0] or 0
        for table, where in (
            ("fieldgrid_grid", "channel IN ('ground_cm', 'step_cm')"),
            ("fieldgrid_tile", "channels IN ('terrain', 'surface')"),
        )
    ]
    database.close()
    own, tiles = (size / cells for size in sizes)
    whole = path.stat().st_size / cells
    return (
        f"evidence {own:.2f}, tiles of all levels {tiles:.2f}; "
        f"the whole file {whole:.1f} (asked: <= 10)"
    )


if __name__ == "__main__":
    main()
