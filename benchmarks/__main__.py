"""`make bench`: speed as ratios to something known in the same run, and memory.

Run it on an otherwise idle machine; it takes some minutes, and 3 GB of disk for a map of 100 ha
(not with --no-hectares). The figures of docs/accuracy.md come from here.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import reduce
from pathlib import Path

import cv2
import numba
import numpy as np

from benchmarks import EXAMPLE
from benchmarks.exports import measure_exports
from benchmarks.lasting import Line, measure_map
from benchmarks.long_drive import write_long_drive
from benchmarks.synthetic import rows
from benchmarks.timing import paired_ms, timed_s
from fieldgrid.core import StereoSettings, resolve
from fieldgrid.geometry import GridSpec, Lattice, LocalGrid, Pose, Window
from fieldgrid.maps import footprint
from fieldgrid.maps.transfer import MeanFold, universal_axes
from fieldgrid.perception import LocalGridder, depth
from fieldgrid.perception.binning import bin_pixels, bin_points
from fieldgrid.perception.ground import estimate_ground
from fieldgrid.perception.localgrid import local_ground
from fieldgrid.perception.stereo import make_matcher
from fieldgrid.pipeline import SessionReport, build_map
from fieldgrid.recordings import DriveOptions, open_recording
from tests.counting import bin_pixels_reference, bin_points_reference

FULL_DISPARITIES = 128
CHAIN_RUNS = 7
CLOUD_POINTS = 200_000
FIELD_GRIDS, GRIDS_A_TURN = 2000, 100
STAGES_BEFORE_MS = {
    "decode": 3.0,
    "match": 34.0,
    "odometry": 17.6,
    "grid": 2.8,
    "pose": 6.7,
    "map": 2.2,
}
"""Milliseconds of processor time a frame of each stage before the rebuild."""

LONG_DRIVES = (100, 1000)


def main() -> None:
    """Measure and print everything."""
    print(
        f"{os.cpu_count()} cores, Python {sys.version.split()[0]}, NumPy {np.__version__}, "
        f"OpenCV {cv2.__version__}, Numba {numba.__version__}"
    )
    for title, lines in (
        ("chain", measure_chain()),
        ("start", measure_start()),
        ("kernels", measure_kernels()),
        ("memory", measure_memory()),
        ("map file", measure_map(large="--no-hectares" not in sys.argv[1:])),
        ("exports", measure_exports()),
    ):
        print(f"\n{title}")
        for line in lines:
            print(f"  {line.what:<58} {line.value:>16}  {line.asked}", flush=True)


def measure_chain() -> Iterator[Line]:
    """`build` beside the bare matcher on the same pairs, alternating, and where its time goes."""
    with open_recording(EXAMPLE, "gnss_rtk.nmea") as recording:
        pairs = [frame.images() for frame in recording.frames()]
    matcher = make_matcher(StereoSettings(), FULL_DISPARITIES)

    def bare() -> None:
        for left, right in pairs:
            matcher.compute(left, right)

    _build()
    _build(row_step=2)
    reports, bare_s, build_s, plain_s, pairs_s = [], [], [], [], []
    for _ in range(CHAIN_RUNS):
        bare_s.append(timed_s(bare))
        build_s.append(timed_s(lambda: reports.append(_build())))
        plain_s.append(timed_s(lambda: _build(visual_odometry=False)))
        pairs_s.append(timed_s(lambda: _build(row_step=2)))
    bare_wall_s, bare_cpu_s = np.median(bare_s, axis=0)
    wall_s, cpu_s = np.median(build_s, axis=0)
    plain_wall_s, _ = np.median(plain_s, axis=0)
    pairs_wall_s, pairs_cpu_s = np.median(pairs_s, axis=0)
    frames = len(pairs)
    yield Line(
        f"bare SGBM_3WAY, {FULL_DISPARITIES} disparities, full image",
        f"{frames / bare_wall_s:.1f} frames/s",
        f"{1e3 * bare_cpu_s / frames:.1f} ms of processor time a frame",
    )
    yield Line(
        "build: decoded, matched, followed, mapped, committed",
        f"{frames / wall_s:.1f} frames/s",
        f"{1e3 * cpu_s / frames:.1f} ms of processor time a frame",
    )
    yield Line(
        "  beside the bare matcher", f"{bare_wall_s / wall_s:.2f} x", "was 0.71, asked >= 1.1"
    )
    yield Line("  by processor time", f"{bare_cpu_s / cpu_s:.2f} x", "the same on a busy machine")
    yield Line("  cores busy", f"{cpu_s / wall_s:.2f}", f"of {os.cpu_count()}; was 1.4 of 2")
    yield Line("  without visual odometry", f"{bare_wall_s / plain_wall_s:.2f} x", "asked >= 1.0")
    yield Line(
        "  with --row-step 2",
        f"{bare_wall_s / pairs_wall_s:.2f} x",
        f"{bare_cpu_s / pairs_cpu_s:.2f} x by processor time",
    )
    report = sorted(reports, key=lambda one: one.wall_s)[len(reports) // 2]
    for stage, before_ms in STAGES_BEFORE_MS.items():
        stage_ms = 1e3 * getattr(report.stages, f"{stage}_s") / frames
        yield Line(f"  {stage}", f"{stage_ms:.1f} ms a frame", f"was {before_ms}")


def measure_start() -> Iterator[Line]:
    """What a build costs before its first frame, and on a machine that has compiled nothing."""
    with tempfile.TemporaryDirectory() as cache:
        first_s = _two_frames_s({"NUMBA_CACHE_DIR": cache})
        later_s = np.median([_two_frames_s({"NUMBA_CACHE_DIR": cache}) for _ in range(3)], axis=0)
    compiling_s = first_s - later_s
    yield Line(
        "first run on a fresh machine: compiling",
        f"{compiling_s[0]:.1f} s",
        f"{compiling_s[1]:.1f} s of processor time; was 25 s, asked <= 10 s",
    )
    yield Line(
        "fieldgrid build of two frames, all of it",
        f"{later_s[0]:.2f} s",
        f"{later_s[1]:.2f} s of processor time; asked <= 1 s",
    )


def _two_frames_s(environment: dict[str, str]) -> np.ndarray:
    """Seconds of wall and of processor time of a build of its own process."""
    program = "from fieldgrid.cli import main; main()"
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", program, "build", str(EXAMPLE), "-o", f"{folder}/map.gpkg"]
        command += ["--gnss", "gnss_rtk.nmea", "--every", "25"]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, **environment})
        wall_s, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return np.array([wall_s, cpu_s])


def measure_kernels() -> Iterator[Line]:
    """The kernels beside the NumPy calls that do the same, on one core."""
    cv2.setNumThreads(1)
    with open_recording(EXAMPLE, "gnss_rtk.nmea") as recording:
        rig = recording.rig
        frame = next(frame for k, frame in enumerate(recording.frames()) if k == 10)
    left, right = frame.images()
    gridder = LocalGridder(rig)
    disparity = gridder.matcher.disparity(left, right)
    matcher = make_matcher(StereoSettings(), FULL_DISPARITIES)
    grid_ms, match_ms = paired_ms(
        lambda: gridder.from_disparity(disparity), lambda: matcher.compute(left, right)
    )
    yield Line("bare SGBM_3WAY on one core", f"{match_ms:.2f} ms")
    yield Line("disparity to grid, all of it", f"{grid_ms:.2f} ms")
    yield Line("  share of the matcher's time", f"{100 * grid_ms / match_ms:.1f} %", "asked <= 2 %")
    yield from _fused_kernel(gridder, disparity.values, disparity.row_start)
    grid, _ = gridder.from_disparity(disparity)
    yield from _transfer(
        LocalGrid(grid.spec, grid.density, np.ones_like(grid.observed)), "every cell"
    )
    yield from _transfer(grid, "one real frame")
    paper = GridSpec(6.65, 14.0)
    full = np.arange(paper.n_x * paper.n_y, dtype=np.uint8).reshape(paper.shape)
    grid = LocalGrid(paper, full, full >= 0)
    yield from _transfer(grid, "133 x 280, every cell")
    for cell_m, asked in ((0.05, "was 7.1, asked >= 9"), (0.25, "was 11.5, asked >= 15")):
        yield from _transfer_many(grid, cell_m, asked)


def _fused_kernel(gridder: LocalGridder, values: np.ndarray, row_start: int) -> Iterator[Line]:
    spec, rig = gridder.spec, gridder.rig
    depth_m = depth.depth_table(rig, gridder.region.num_disparities, 16)
    coded = depth.CodedDepth(values, row_start, depth_m)
    plane, patches, _ = estimate_ground(coded, rig, spec.width_m / 2, spec.length_m)
    within = np.ones(spec.shape, dtype=np.bool_)
    above = local_ground(patches, spec, within), spec.cell_m, np.float32(0.2), np.float32(2.2)
    geometry = depth.rays(rig, plane.A_grid_sensor, plane.height_m)
    yield from _beside_numpy(
        "disparity to counts",
        lambda: bin_pixels(*coded, *geometry, *above),
        lambda: bin_pixels_reference(*coded, *geometry, *above),
        "asked >= 8",
    )
    # The same pixels as a cloud, in the order of no sensor: each column of the image by itself.
    rows, columns = np.nonzero(values.T > 0)[::-1]
    z = depth_m[values[rows, columns]]
    camera = rig.camera
    x = (columns - camera.cx_px) / camera.focal_px * z
    y = (rows + row_start - camera.cy_px) / camera.focal_px * z
    points = np.column_stack([x, y, z]).astype(np.float32)[:CLOUD_POINTS]
    pose = plane.A_grid_sensor.astype(np.float32), plane.height_m
    yield from _beside_numpy(
        f"cloud of {len(points):,} points to counts",
        lambda: bin_points(points, *pose, *above),
        lambda: bin_points_reference(points, *pose, *above),
        "was 4.1, asked >= 9",
    )


def _beside_numpy(
    what: str, ours: Callable[[], np.ndarray], theirs: Callable[[], np.ndarray], asked: str
) -> Iterator[Line]:
    """A kernel and the NumPy chain with histogram2d that counts the same."""
    ours_ms, theirs_ms = paired_ms(ours, theirs, runs=20)
    same = bool((ours() == theirs()).all())
    yield Line(f"fused kernel, {what}", f"{ours_ms:.2f} ms")
    yield Line("  NumPy chain with histogram2d", f"{theirs_ms:.2f} ms")
    yield Line(f"  ratio (counts identical: {same})", f"{theirs_ms / ours_ms:.1f} x", asked)


def _transfer_many(grid: LocalGrid, cell_m: float, asked: str) -> Iterator[Line]:
    """A field's local grids into one window, by turns of some with NumPy's."""
    lattice = Lattice(cell_m)
    poses = list(rows(FIELD_GRIDS, 100.0, 1.5, 3.0, 0.0, 0.0))
    parts = [footprint(grid.spec, pose, lattice) for pose in poses]
    whole = reduce(Window.union, parts)
    fold, totals = MeanFold(lattice, whole), np.zeros((2, *whole.shape))
    fold.add(grid, poses[0])  # compiled
    fold = MeanFold(lattice, whole)
    ours_s, bincount_s = [], []
    for first in range(0, FIELD_GRIDS, GRIDS_A_TURN):
        turn = slice(first, first + GRIDS_A_TURN)
        start = time.process_time()
        for pose in poses[turn]:
            fold.add(grid, pose)
        middle = time.process_time()
        for pose, part in zip(poses[turn], parts[turn], strict=True):
            _bincount(grid, pose, lattice, part, totals[(slice(None), *whole.slices_of(part))])
        ours_s.append(middle - start)
        bincount_s.append(time.process_time() - middle)
    same = bool((16 * totals == fold.sums).all())
    what = f"{FIELD_GRIDS} grids 133 x 280 into one window, cells of {100 * cell_m:.0f} cm"
    yield Line(what, f"{1e3 * sum(ours_s) / FIELD_GRIDS:.3f} ms", "each")
    ratio = np.median(np.divide(bincount_s, ours_s))
    yield Line(f"  beside NumPy with bincount (identical: {same})", f"{ratio:.1f} x", asked)


def _bincount(
    grid: LocalGrid, pose: Pose, lattice: Lattice, window: Window, totals: np.ndarray
) -> None:
    """Add the counts and densities of a grid to `totals`, [2, rows, columns] of a window."""
    column_i, column_j, row_i, row_j = universal_axes(grid.spec, pose, lattice)
    seen_rows, columns = np.nonzero(grid.observed)
    i = np.floor(column_i[columns] + row_i[seen_rows]).astype(np.int64) - window.i0
    j = np.floor(column_j[columns] + row_j[seen_rows]).astype(np.int64) - window.j0
    cells, size = j * window.width + i, window.width * window.height
    values = grid.density[seen_rows, columns]
    totals[0] += np.bincount(cells, minlength=size).reshape(window.shape)
    totals[1] += np.bincount(cells, weights=values, minlength=size).reshape(window.shape)


def _transfer(grid: LocalGrid, label: str) -> Iterator[Line]:
    """One local grid into a window: our kernel, and NumPy with bincount, both from the pose."""
    lattice = Lattice(grid.spec.cell_m)
    pose = Pose(0, 12.34, -45.67, 0.0, 37.0, 0.02, 0.3, 1.0)
    window = footprint(grid.spec, pose, lattice)
    fold = MeanFold(lattice, window)
    totals = np.zeros((2, *window.shape))

    def ours() -> None:
        fold.add(grid, pose)

    def bincount() -> None:
        _bincount(grid, pose, lattice, window, totals)

    ours_ms, bincount_ms = paired_ms(ours, bincount, runs=100)
    fold = MeanFold(lattice, window)
    totals[:] = 0
    ours()
    bincount()
    same = bool((16 * totals == fold.sums).all())
    yield Line(f"transfer, {label}", f"{ours_ms:.3f} ms")
    yield Line("  NumPy with bincount", f"{bincount_ms:.3f} ms")
    yield Line(
        f"  ratio (counts identical: {same})", f"{bincount_ms / ours_ms:.1f} x", "asked >= 10"
    )


def measure_memory() -> Iterator[Line]:
    """Peak memory of `fieldgrid build` in a process of its own, by length of the drive."""
    for frames in LONG_DRIVES:
        with tempfile.TemporaryDirectory() as folder:
            drive = Path(folder) / "drive"
            drive.mkdir()
            write_long_drive(drive, frames)
            command = [sys.executable, "-m", "benchmarks.rss", str(drive), f"{folder}/map.gpkg"]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            rss_mb, seconds = (float(value) for value in done.stdout.split()[-2:])
            size_mb = (Path(folder) / "map.gpkg").stat().st_size / 1e6
        what = f"peak RSS of build, {frames} frames, {frames * 2} m"
        yield Line(what, f"{rss_mb:.0f} MB", "asked <= 500 MB")
        yield Line("  map file, rate", f"{size_mb:.1f} MB, {frames / seconds:.0f}/s")


def _build(*, visual_odometry: bool = True, row_step: int = 1) -> SessionReport:
    settings = resolve(
        None, {"pose": {"visual_odometry": visual_odometry}, "stereo": {"row_step": row_step}}
    )
    with tempfile.TemporaryDirectory() as folder:
        reports = build_map(
            [EXAMPLE], Path(folder) / "map.gpkg", settings, DriveOptions("gnss_rtk.nmea")
        )
    return reports[0]


if __name__ == "__main__":
    main()
