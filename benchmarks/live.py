"""`python -m benchmarks.live`: a live session on the example, and poses of a fixed lag beside the
batch.

Times of the wall say something on an otherwise idle machine only; processor time always does.
KITTI's drive 0020 is beside the repository in ../shared/data; its lines are left out where it is
absent.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.live_cropped import cropped
from benchmarks.peak import peak_mb
from fieldgrid.core import BuildSettings, FieldgridError, Float64, resolve
from fieldgrid.field import read_truth
from fieldgrid.geometry import GridSpec, Pose, Status, Steps, Tilt, wrap_deg
from fieldgrid.live import Live, LiveGrid, LiveOptions, LiveResult, LiveWindow, replay
from fieldgrid.live.kept.points import packed, unpacked
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.live.pose.fixed_lag import FixedLagSmoother, pose_at, unknown_pose
from fieldgrid.live.pose.running_tilt import RunningTilt
from fieldgrid.live.pose.sensor_rows import KEPT_NS, PARTS, RecentRows, Rows
from fieldgrid.perception import CameraStep, CodedDepth, LocalGridder
from fieldgrid.pipeline import convert_recording, estimate_drive, visual_odometry
from fieldgrid.poses import Attitude, Estimate
from fieldgrid.recordings import DriveOptions, Recording, StereoFrame, open_recording

SHARED = EXAMPLE.parents[2] / "shared" / "data"
KITTI = SHARED / "kitti_2011_09_30_drive_0020" / "2011_09_30" / "2011_09_30_drive_0020_sync"
LATER = SHARED / "vineyard_two_lanes_later"
DRIVES = (
    ("example, RTK", EXAMPLE, "gnss_rtk.nmea"),
    ("example, decimetres, jumps", EXAMPLE, "gnss_sf1.nmea"),
    ("two months later, RTK", LATER, "gnss_rtk.nmea"),
    ("two months later, decimetres", LATER, "gnss_sf1.nmea"),
)
SLOPES = tuple(
    (f"slope, {quality}", SHARED / "vineyard_slope", log)
    for quality, log in (("RTK", "gnss_rtk.nmea"), ("decimetres", "gnss_sf1.nmea"))
)
ALL_S = 1e6
TEN_HZ = 16.0
"""The example has a pair each 1.6 s: its sensors come as many times faster, too."""
CROPPED = "KITTI, pixels of 640 x 480"


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--poses", action="store_true", help="only the poses of a fixed lag")
    options.add_argument("--sessions", action="store_true", help="only latency, drops and load")
    options.add_argument("--tilts", action="store_true", help="only level grids and their points")
    options.add_argument("--lags", action="store_true", help="only what longer lags would give")
    chosen = options.parse_args()
    if chosen.lags:
        longer_lags()
        return
    if chosen.tilts:
        tilts()
        points()
        return
    if not chosen.sessions:
        fixed_lags()
    if not chosen.poses:
        sessions()


def fixed_lags() -> None:
    """Poses of the last 2 s beside those of the whole drive, against truth. Between them the best
    that the same model can do with 2 s of future: by all of the drive before."""
    lag_s = LiveOptions().lag_s
    print(f"poses {lag_s:g} s after their time beside the batch; asked: 1.5 times, and 98 %")
    print(
        f"{'':<30}{'used':>10}{'heading 95 %, °':>25}{'< 3 sigma':>16}{'apart 95 %, m':>16}"
        f"{'< 3 sigma':>11}{'ms an estimate':>16}"
    )
    for name, folder, log in DRIVES:
        if not (folder / "gnss" / log).exists():
            continue
        with open_recording(folder, gnss=log) as recording:
            steps = visual_odometry(recording)
            batch = estimate_drive(recording, steps=steps).trajectory
            times_ns = recording.frame_times_ns() + recording.rig.image_time_offset_ns
            of_batch = [batch.at(time_ns) for time_ns in times_ns.tolist()]
            of_lag, spent_s = fixed_lag(recording, steps, lag_s, LiveOptions().window_s)
            of_best, _ = fixed_lag(recording, steps, lag_s, ALL_S)
            headings = {
                pose.time_ns: pose.heading_deg for pose in read_truth(folder / "truth").poses
            }
            true_deg = [headings[time_ns] for time_ns in recording.frame_times_ns().tolist()]
        lag, whole = Compared.of(of_lag, true_deg), Compared.of(of_batch, true_deg)
        best = Compared.of(of_best, true_deg)
        apart_m, within = apart(of_lag, of_batch)
        print(
            f"{name:<30}{lag.used:>4} / {whole.used:<3}"
            f"{lag.error_deg:>9.2f} / {best.error_deg:.2f} / {whole.error_deg:<8.2f}"
            f"{100.0 * lag.within:>6.0f} / {100.0 * whole.within:<4.0f}%"
            f"{apart_m:>9.3f}{100.0 * within:>8.0f} %"
            f"{1e3 * spent_s:>13.0f}"
        )


class Compared(NamedTuple):
    """Of poses that can be used: how many, 95 % of the heading's error in degrees, and the share
    within three sigma."""

    used: int
    error_deg: float
    within: float

    @classmethod
    def of(cls, poses: list[Pose], true_deg: list[float]) -> Compared:
        """Poses against true headings."""
        pairs = [(p, t) for p, t in zip(poses, true_deg, strict=True) if is_used(p)]
        turned = np.array([abs(float(wrap_deg(pose.heading_deg - true))) for pose, true in pairs])
        sigma = np.array([pose.heading_sigma_deg for pose, _ in pairs])
        return cls(
            len(pairs), float(np.percentile(turned, 95.0)), float((turned <= 3.0 * sigma).mean())
        )


def is_used(pose: Pose) -> bool:
    """Whether a pose is good enough for a map."""
    return pose.status is not Status.REJECTED


def apart(poses: list[Pose], others: list[Pose]) -> tuple[float, float]:
    """How far poses lie from others, 95 %, metres, and the share within three of their sigmas: of
    two axes, where a sigma is that of one."""
    pairs = [(a, b) for a, b in zip(poses, others, strict=True) if is_used(a) and is_used(b)]
    moved = np.array([np.hypot(a.east_m - b.east_m, a.north_m - b.north_m) for a, b in pairs])
    sigma = np.array([a.position_sigma_m for a, _ in pairs])
    within = float((moved <= 3.0 * np.sqrt(2.0) * sigma).mean())
    return float(np.percentile(moved, 95.0)), within


def tilts() -> None:
    """Roll and pitch by which grids are level while driving, beside those of the whole drive."""
    ages_s = (0.2, 0.5, 1.0, 2.0)
    print(
        "roll and pitch of frames by an estimate so old, beside the batch: off 95 %, °, < 3 sigma"
    )
    print(f"{'':<30}{'steepest, °':>12}" + "".join(f"{f'{age:g} s':>16}" for age in ages_s))
    for name, folder, log in (*DRIVES, *SLOPES):
        if not (folder / "gnss" / log).exists():
            continue
        with open_recording(folder, gnss=log) as recording:
            steps = visual_odometry(recording)
            attitude = estimate_drive(recording, steps=steps).report.attitude
            if attitude is None:
                continue
            shown = []
            for age_s in ages_s:
                off_deg, sigma_deg = carried_tilts(recording, steps, attitude, age_s)
                within = 100.0 * float((off_deg <= 3.0 * sigma_deg).mean())
                shown.append(f"{np.percentile(off_deg, 95.0):.2f}, {within:.0f} %")
        steepest = max(attitude.as_dict()[f"steepest_{axis}_deg"] for axis in ("roll", "pitch"))
        print(f"{name:<30}{steepest:>12.1f}" + "".join(f"{one:>16}" for one in shown), flush=True)


def carried_tilts(
    recording: Recording, steps: Steps, attitude: Attitude, age_s: float
) -> tuple[Float64, Float64]:
    """How far roll or pitch of each frame are off those of the batch, and their sigma, degrees, by
    the estimate of what was pushed until `age_s` before the frame."""
    rows, off_deg, sigma_deg = RecentRows(), list[float](), list[float]()
    running = RunningTilt(rows)
    values = {part: getattr(recording.motion(), part) for part in PARTS}

    def told(time_ns: int, found: Estimate) -> None:
        for part, columns in values.items():
            if columns is not None:  # those of so long as it keeps
                first, stop = np.searchsorted(columns[0], [time_ns - KEPT_NS, time_ns])
                rows.forget({part}, 0)
                piece = tuple(column[first:stop] for column in columns)
                rows.add(part, Rows(piece[0], piece[1:]))
        running.know(found.report.attitude)
        tilt = running.at(time_ns)
        if tilt is not None:
            true = attitude.tilt_at(time_ns)
            off_deg.append(max(abs(a - b) for a, b in zip(tilt[:2], true[:2], strict=True)))
            sigma_deg.append(math.hypot(tilt.sigma_deg, true.sigma_deg))

    fixed_lag(recording, steps, -age_s, LiveOptions().window_s, told)
    return np.array(off_deg), np.array(sigma_deg)


def points() -> None:
    """What it takes to keep the points of frames, and to make their grids again."""
    print(f"{'points of a frame':<30}{'kB':>8}{'to keep, ms':>14}{'to grid again, ms':>20}")
    settings = BuildSettings()
    for name, folder in (("example", EXAMPLE), ("slope", SLOPES[0][1]), ("KITTI", KITTI)):
        if not folder.exists():
            continue
        log = None if folder == KITTI else "gnss_rtk.nmea"
        spent: list[tuple[float, float, float]] = []
        with open_recording(folder, gnss=log) as recording:
            gridder = LocalGridder(recording.rig, GridSpec.of(settings.grid))
            reach_m = GridSpec.of(settings.grid).reach_m
            for frame in recording.frames():
                assert isinstance(frame, StereoFrame)
                seen = gridder.coded(*gridder.matcher.disparity(*frame.images()))
                start = time.process_time()
                record = packed(seen, reach_m)
                kept = time.process_time()
                again = unpacked(record, gridder)
                assert isinstance(again, CodedDepth)
                gridder.from_coded(again, Tilt(1.0, 1.0, 0.2))
                spent.append(
                    (len(record) / 1e3, 1e3 * (kept - start), 1e3 * (time.process_time() - kept))
                )
        size, keeping, gridding = np.median(np.array(spent), axis=0)
        print(f"{name:<30}{size:>8.0f}{keeping:>14.1f}{gridding:>20.1f}", flush=True)


def longer_lags() -> None:
    """How much of the heading's error is owed to what comes after the lag, and to what lies before
    the window."""
    ways = [(2.0, 20.0), (2.0, 50.0), (2.0, ALL_S), (5.0, 20.0), (5.0, ALL_S), (10.0, 20.0)]
    ways += [(10.0, 50.0), (10.0, ALL_S)]
    print("heading error 95 % beside that of the batch, by lag and window")
    print(
        f"{'':<30}"
        + "".join(
            f"{f'{lag:g} s, {window:g} s' if window < ALL_S else f'{lag:g} s, all':>14}"
            for lag, window in ways
        )
    )
    for name, folder, log in DRIVES:
        if not (folder / "gnss" / log).exists():
            continue
        with open_recording(folder, gnss=log) as recording:
            steps = visual_odometry(recording)
            batch = estimate_drive(recording, steps=steps).trajectory
            frame_ns = recording.frame_times_ns()
            whole = [batch.at(t) for t in (frame_ns + recording.rig.image_time_offset_ns).tolist()]
            headings = {p.time_ns: p.heading_deg for p in read_truth(folder / "truth").poses}
            true_deg = [headings[time_ns] for time_ns in frame_ns.tolist()]
            of_batch = Compared.of(whole, true_deg).error_deg
            times = []
            for lag_s, window_s in ways:
                poses, _ = fixed_lag(recording, steps, lag_s, window_s)
                times.append(Compared.of(poses, true_deg).error_deg / of_batch)
        print(f"{name:<30}" + "".join(f"{one:>14.2f}" for one in times), flush=True)


def fixed_lag(
    recording: Recording,
    steps: Steps,
    lag_s: float,
    window_s: float,
    tell: Callable[[int, Estimate], None] = lambda _time_ns, _estimate: None,
) -> tuple[list[Pose], float]:
    """The pose of each frame by what was pushed until `lag_s` after it, and the median processor
    time of an estimate, of which it can `tell`."""
    trailing = FixedLagSmoother(recording.rig, BuildSettings(), recording.datum_hint, window_s)
    fixes = sorted(recording.fixes(), key=lambda fix: fix.time_ns)
    values = {part: getattr(recording.motion(), part) for part in PARTS}
    rows = {part: one for part, one in values.items() if one is not None}
    step_to = {
        int(stop_ns): CameraStep(*(float(column[k]) for column in steps[2:]), 0)
        for k, stop_ns in enumerate(steps.stop_ns)
    }
    times_ns = (recording.frame_times_ns() + recording.rig.image_time_offset_ns).tolist()
    poses: list[Pose] = []
    spent: list[float] = []
    fixed = frames = 0
    pushed = dict.fromkeys(rows, 0)
    for time_ns in times_ns:
        until_ns = time_ns + round(1e9 * lag_s)
        while fixed < len(fixes) and fixes[fixed].time_ns <= until_ns:
            trailing.add_fix(fixes[fixed])
            fixed += 1
        for part, columns in rows.items():
            stop = int(np.searchsorted(columns[0], until_ns, side="right"))
            piece = slice(pushed[part], stop)
            trailing.rows.add(part, Rows(columns[0][piece], tuple(c[piece] for c in columns[1:])))
            pushed[part] = stop
        while frames < len(times_ns) and times_ns[frames] <= until_ns:
            trailing.add_frame(times_ns[frames], step_to.get(times_ns[frames]))
            frames += 1
        start = time.process_time()
        try:
            found = trailing.asked(time_ns).estimate()
            trailing.datum = found.trajectory.datum
        except FieldgridError as error:  # there is too little yet
            poses.append(unknown_pose(time_ns, str(error)))
            continue
        poses.append(pose_at(found.trajectory, time_ns)[0])
        spent.append(time.process_time() - start)
        tell(time_ns, found)
    return poses, float(np.median(spent))


def sessions() -> None:
    """Latency, drops, processor time and memory of replays. A frame has waited when a window
    without it was told after it was perceived."""
    print(
        "\nasked: no frame dropped at 10 Hz of 640 x 480, 60 ms to the grid, 150 ms to the costmap"
    )
    print(
        f"{'':<30}{'kept':>6}{'dropped':>9}{'to the grid, ms':>18}{'to the costmap, ms':>20}"
        f"{'waited':>8}"
        f"{'processor':>16}{'memory':>9}{'of it for a grid':>23}"
    )
    drives = [
        ("example, its own pace", EXAMPLE, "gnss_rtk.nmea", 1.0, 1),
        ("example, 10 pairs a second", EXAMPLE, "gnss_rtk.nmea", TEN_HZ, 1),
        ("the same, --row-step 2", EXAMPLE, "gnss_rtk.nmea", TEN_HZ, 2),
        ("example, no frame dropped", EXAMPLE, "gnss_rtk.nmea", None, 1),
    ]
    if KITTI.exists():
        drives.append(("KITTI 0020, its own pace", KITTI, None, 1.0, 1))
        drives.append(("the same, --row-step 2", KITTI, None, 1.0, 2))
        drives.append((CROPPED, KITTI, None, 1.0, 1))
    with tempfile.TemporaryDirectory() as place:
        bag = Path(place) / "example.mcap"
        convert_recording(EXAMPLE, bag, DriveOptions(gnss="gnss_rtk.nmea"))
        drives.append(("a bag of the example", bag, None, 1.0, 1))
        spawn = multiprocessing.get_context("spawn")
        for drive in drives:  # a process each, so that memory is its own
            process = spawn.Process(target=measure, args=drive)
            process.start()
            process.join()


def measure(name: str, folder: Path, log: str | None, rate: float | None, row_step: int) -> None:
    """Replay a drive and print what it took; medians and 99 %."""
    to_grid: list[float] = []
    to_map: dict[str, float] = {}
    waited: set[str] = set()
    lacks = False

    def take(result: LiveResult) -> None:
        nonlocal lacks
        if isinstance(result, LiveGrid):
            to_grid.append(1e3 * result.latency_s)
        elif isinstance(result, LiveWindow):
            if result.latency_s is not None:
                to_map.setdefault(result.frame_id, 1e3 * result.latency_s)
                if lacks:
                    waited.add(result.frame_id)
            lacks = result.latency_s is None  # the newest frame is not in it

    with tempfile.TemporaryDirectory() as place, open_recording(folder, gnss=log) as recording:
        if name == CROPPED:
            recording = cropped(recording)
        live = Live(
            Path(place) / "map.gpkg",
            recording.rig,
            resolve(None, {"stereo": {"row_step": row_step}}),
            name=recording.name,
            datum_hint=recording.datum_hint,
            on_result=take,
        )
        spent_s, began_s = time.process_time(), time.monotonic()
        replay(live, recording, rate=rate)
        spent_s, took_s = time.process_time() - spent_s, time.monotonic() - began_s
        counts = live.counts
        live.stop()
        with SessionFolder(Path(place) / "map.gpkg", None) as kept:
            times = kept.drive.times
    frame_ms = 1e3 * (times.decode_s + times.match_s + times.grid_s + times.odometry_s)
    print(
        f"{name:<30}{counts.frames:>6}{counts.dropped:>9}{shown(to_grid):>18}"
        f"{shown(list(to_map.values())):>20}{len(waited):>8}{spent_s / took_s:>9.2f} cores"
        f"{peak_mb():>6.0f} MB{frame_ms / max(counts.frames, 1):>20.0f} ms"
    )


def shown(values: list[float]) -> str:
    """The median and 99 % of some milliseconds."""
    if not values:
        return "-"
    median, most = np.percentile(values, [50.0, 99.0])
    return f"{median:.0f} / {most:.0f}"


if __name__ == "__main__":
    main()
