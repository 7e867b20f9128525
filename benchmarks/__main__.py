"""`make bench`: speed as ratios to something known in the same run, and memory.

Run it on an otherwise idle machine; it takes some minutes, and 3 GB of disk for a map of 100 ha
(not with --no-hectares). The figures of docs/accuracy.md come from here.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numba
import numpy as np

from benchmarks import EXAMPLE
from benchmarks.exports import measure_exports
from benchmarks.lasting import Line, measure_map
from benchmarks.long_drive import write_long_drive
from benchmarks.timing import paired_ms
from fieldgrid import depth
from fieldgrid.binning import bin_pixels, bin_pixels_reference
from fieldgrid.build import SessionReport, build_map
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.ground import estimate_ground
from fieldgrid.lattice import Lattice
from fieldgrid.localgrid import (
    LocalGridder,
    local_ground,
)
from fieldgrid.recording import open_recording
from fieldgrid.settings import StereoSettings, resolve
from fieldgrid.stereo import make_matcher
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import MeanFold, footprint, universal_axes

FULL_DISPARITIES = 128
LONG_DRIVES = (100, 1000)


def main() -> None:
    """Measure and print everything."""
    print(
        f"{os.cpu_count()} cores, Python {sys.version.split()[0]}, NumPy {np.__version__}, "
        f"OpenCV {cv2.__version__}, Numba {numba.__version__}"
    )
    for title, lines in (
        ("chain", measure_chain()),
        ("kernels", measure_kernels()),
        ("memory", measure_memory()),
        ("map file", measure_map(large="--no-hectares" not in sys.argv[1:])),
        ("exports", measure_exports()),
    ):
        print(f"\n{title}")
        for line in lines:
            print(f"  {line.what:<58} {line.value:>16}  {line.asked}", flush=True)


def measure_chain() -> Iterator[Line]:
    """`build` beside the bare matcher on the same pairs, alternating, and each stage's share."""
    with open_recording(EXAMPLE, "gnss_rtk.nmea") as recording:
        pairs = [frame.images() for frame in recording.frames()]
    matcher = make_matcher(StereoSettings(), FULL_DISPARITIES)
    reports, without, bare_s = [], [], []
    _build()
    for _ in range(5):
        start = time.perf_counter()
        for left, right in pairs:
            matcher.compute(left, right)
        bare_s.append(time.perf_counter() - start)
        reports.append(_build())
        without.append(_build(visual_odometry=False))
    bare = len(pairs) / float(np.median(bare_s))
    chain = float(np.median([report.frames / report.wall_s for report in reports]))
    report = sorted(reports, key=lambda one: one.wall_s)[len(reports) // 2]
    yield Line(
        f"bare SGBM_3WAY, {FULL_DISPARITIES} disparities, full image", f"{bare:.1f} frames/s"
    )
    yield Line("build: decoded, matched, mapped, committed", f"{chain:.1f} frames/s")
    yield Line("  beside the bare matcher", f"{chain / bare:.2f} x", "asked >= 1.0")
    plain = float(np.median([one.frames_per_s for one in without]))
    yield Line("  the same without visual odometry", f"{plain / bare:.2f} x", "asked >= 1.0")
    stages = report.stages
    work_s = stages.decode_s + stages.match_s + stages.odometry_s + stages.grid_s + stages.map_s
    for name, seconds in (
        ("decode", stages.decode_s),
        ("match", stages.match_s),
        ("visual odometry", stages.odometry_s),
        ("disparity to grid", stages.grid_s),
        ("map, commit included", stages.map_s),
    ):
        yield Line(f"  share of {name}", f"{100 * seconds / work_s:.1f} %")
    rest = (stages.grid_s + stages.map_s) / work_s
    yield Line("  all that is not stereo or decoding", f"{100 * rest:.1f} %", "asked <= 10 %")


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
    yield from _transfer(LocalGrid(paper, full, full >= 0), "133 x 280, every cell")


def _fused_kernel(gridder: LocalGridder, values: np.ndarray, row_start: int) -> Iterator[Line]:
    spec, rig = gridder.spec, gridder.rig
    depth_m = depth.depth_table(rig, gridder.region.num_disparities, 16)
    coded = depth.CodedDepth(values, row_start, depth_m)
    plane, patches = estimate_ground(coded, rig, spec.width_m / 2, spec.length_m)
    arguments = (
        *coded,
        *depth.rays(rig, plane.R_level_camera, plane.height_m),
        local_ground(patches, spec.n_x, spec.n_y, spec.cell_m, 0.0, gridder.max_range_m),
        spec.cell_m,
        np.float32(0.2),
        np.float32(2.2),
    )
    ours, theirs = paired_ms(
        lambda: bin_pixels(*arguments), lambda: bin_pixels_reference(*arguments), runs=10
    )
    same = bool((bin_pixels(*arguments) == bin_pixels_reference(*arguments)).all())
    yield Line("fused kernel, disparity to counts", f"{ours:.2f} ms")
    yield Line("  NumPy chain with histogram2d", f"{theirs:.2f} ms")
    yield Line(f"  ratio (counts identical: {same})", f"{theirs / ours:.1f} x", "asked >= 8")


def _transfer(grid: LocalGrid, label: str) -> Iterator[Line]:
    """One local grid into a window: our kernel, and NumPy with bincount, both from the pose."""
    lattice = Lattice(grid.spec.cell_m)
    pose = Pose(0, 12.34, -45.67, 0.0, 37.0, 0.02, 0.3, 1.0)
    window = footprint(grid.spec, pose, lattice)
    fold = MeanFold(lattice, window)
    totals = np.zeros((2, window.width * window.height))

    def ours() -> None:
        fold.add(grid, pose)

    def bincount() -> None:
        column_i, column_j, row_i, row_j = universal_axes(grid.spec, pose, lattice)
        rows, columns = np.nonzero(grid.observed)
        i = np.floor(column_i[columns] + row_i[rows]).astype(np.int64) - window.i0
        j = np.floor(column_j[columns] + row_j[rows]).astype(np.int64) - window.j0
        cells = j * window.width + i
        values = grid.density[rows, columns]
        size = window.width * window.height
        totals[0] += np.bincount(cells, minlength=size)
        totals[1] += np.bincount(cells, weights=values, minlength=size)

    ours_ms, bincount_ms = paired_ms(ours, bincount, runs=100)
    fold = MeanFold(lattice, window)
    totals[:] = 0
    ours()
    bincount()
    same = bool((16 * totals == fold.sums.reshape(2, -1)).all())
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


def _build(*, visual_odometry: bool = True) -> SessionReport:
    settings = resolve(None, {"pose": {"visual_odometry": visual_odometry}})
    with tempfile.TemporaryDirectory() as folder:
        reports = build_map([EXAMPLE], Path(folder) / "map.gpkg", settings, gnss="gnss_rtk.nmea")
    return reports[0]


if __name__ == "__main__":
    main()
