"""`build` of many drives by two processes beside one, and by the two workers of a Dask cluster
beside those, interleaved; part of `make bench`.

    python -m benchmarks.drives [DRIVES] [ROUNDS]

The drives are the example's, again and again. Each build is a program of its own, and so are
scheduler and workers, which stay for all rounds. The ratio of
wall times says something on an idle machine with two cores only; that of processor times says
anywhere what the processes cost more than one does.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.cluster import cluster
from benchmarks.lasting import Line
from benchmarks.peak import peak_mb, peaks_of_children

DRIVES, ROUNDS = 20, 3
"""A thousand frames."""


def measure_drives(drives: int = DRIVES, rounds: int = ROUNDS) -> Iterator[Line]:
    """Two processes beside one, and the most memory that each process takes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"drive-{k:03d}" for k in range(drives)]
        for path in paths:
            _copy(path)
        with cluster(Path(folder)) as address:
            runs: dict[str, list[dict[str, float]]] = {"1": [], "2": [], address: []}
            for _ in range(rounds):
                for where, made in runs.items():
                    made.append(_run(where, paths, Path(folder) / "out.gpkg"))
    one, two, dask = (
        {key: float(np.median([run[key] for run in made])) for key in made[0]}
        for made in runs.values()
    )
    frames = 50 * drives
    yield Line(f"build of {drives} drives, {frames} frames, --jobs 1", f"{one['wall_s']:.1f} s")
    yield Line("  by two processes", f"{two['wall_s']:.1f} s")
    yield Line("  ratio", f"{one['wall_s'] / two['wall_s']:.2f} x", "asked >= 1.7")
    yield Line("  cores busy with one, with two", f"{_busy(one):.2f}, {_busy(two):.2f}")
    yield Line(
        "  processor time of two beside one",
        f"{_cpu_s(two) / _cpu_s(one):.2f} x",
        f"of it {100 * two['own_cpu_s'] / _cpu_s(two):.0f} % in the parent",
    )
    yield Line("  by two workers of a Dask cluster", f"{dask['wall_s']:.1f} s")
    yield Line(
        "  more than by two processes",
        f"{100 * (dask['wall_s'] / two['wall_s'] - 1.0):.0f} %",
        "asked <= 10 %",
    )
    yield Line("  peak memory of one", f"{one['own_mb']:.0f} MB")
    yield Line("  peak memory of the parent of two", f"{two['own_mb']:.0f} MB", "asked <= 1000 MB")
    yield Line("  and of the larger of the two", f"{two['worker_mb']:.0f} MB")


def _cpu_s(run: dict[str, float]) -> float:
    return run["own_cpu_s"] + run["worker_cpu_s"]


def _busy(run: dict[str, float]) -> float:
    return _cpu_s(run) / run["wall_s"]


def _copy(path: Path) -> None:
    """The example under another name; its images are links."""
    shutil.copytree(EXAMPLE, path, ignore=shutil.ignore_patterns("left", "right", "truth"))
    for side in ("left", "right"):
        (path / side).mkdir()
        for image in (EXAMPLE / side).iterdir():
            (path / side / image.name).symlink_to(image.resolve())


def _run(where: str, paths: list[Path], out: Path) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.drives", "--build", where, str(out)]
    done = subprocess.run(
        [*command, *map(str, paths)], check=True, stdout=subprocess.PIPE, text=True
    )
    out.unlink()
    found: dict[str, float] = json.loads(done.stdout)
    return found


def _build(where: str, out: Path, paths: list[Path]) -> None:
    """What `_run` runs: one build by so many processes, or on a cluster, and what it took."""
    from fieldgrid.core import BuildSettings
    from fieldgrid.pipeline import build_map
    from fieldgrid.recordings import DriveOptions

    start = time.perf_counter()
    drive, settings = DriveOptions("gnss_rtk.nmea"), BuildSettings()
    with peaks_of_children() as peaks:
        if where.isdigit():
            build_map(paths, out, settings, drive, jobs=int(where))
        else:
            build_map(paths, out, settings, drive, scheduler=where)
    wall_s = time.perf_counter() - start
    own, workers = (
        resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    taken = {
        "wall_s": wall_s,
        "own_cpu_s": own.ru_utime + own.ru_stime,
        "worker_cpu_s": workers.ru_utime + workers.ru_stime,
        "own_mb": peak_mb(),
        "worker_mb": max(peaks.values(), default=0.0),
    }
    print(json.dumps(taken))


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if sys.argv[1:2] == ["--build"]:
        _build(sys.argv[2], Path(sys.argv[3]), [Path(path) for path in sys.argv[4:]])
    else:
        for line in measure_drives(*map(int, sys.argv[1:])):
            print(f"{line.what:<58} {line.value:>16}  {line.asked}", flush=True)
