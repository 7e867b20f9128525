"""What a map costs that lasts: appending, committing, folding anew, and its size on the disk.

python -m benchmarks.lasting         all but the hundred hectares
python -m benchmarks.lasting large   those too: about ten minutes, and 3 GB on the disk
"""

from __future__ import annotations

import shutil
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.synthetic import DATUM, real_grids, rows
from fieldgrid import Costmap
from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Lattice
from fieldgrid.maps import MapFile, create_map, footprint, open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

SIDE_M = 150.0
FRAMES = 200
SESSIONS = 200


class Line(NamedTuple):
    """One measured figure, and what was asked of it."""

    what: str
    value: str
    asked: str = ""


def measure_map(*, large: bool) -> Iterator[Line]:
    """Everything about the map file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield from measure_size(folder)
        yield from measure_fold(folder)
        yield from measure_commit(folder)
        yield from measure_health(folder)
        yield from measure_append(folder)
        yield from measure_costmap(folder)
    if large:
        yield from measure_hectares()


def measure_costmap(folder: Path) -> Iterator[Line]:
    """A million questions at once, beside looking up as many cells of an array."""
    with create_map(folder / "cost.gpkg", DATUM) as universal:
        add(universal, "a", 0.0, 0.0)
        costmap = Costmap.from_map(universal)
    random, cells = np.random.default_rng(1), costmap.costs
    east, north = random.uniform(0.0, SIDE_M, (2, 1_000_000))
    row, column = (random.integers(0, size, 1_000_000) for size in cells.shape)
    ours, plain = [], []
    for _ in range(5):
        for seconds, work in (
            (ours, lambda: costmap.at(east, north)),
            (plain, lambda: cells[row, column]),
        ):
            start = time.process_time()
            work()
            seconds.append(time.process_time() - start)
    ratio = float(np.median(ours) / np.median(plain))
    yield Line("costmap: 1e6 points: cost, clearance, unknown, known", f"{ratio:.1f} lookups")


def add(universal: MapFile, name: str, west_m: float, south_m: float) -> tuple[float, float]:
    """A session of 200 frames over a square of its own; seconds of all, and of its commit."""
    grids = real_grids()
    start = time.perf_counter()
    with universal.add_session(name) as session:
        for k, pose in enumerate(rows(FRAMES, SIDE_M, 2.0, 3.0, west_m, south_m)):
            session.add(grids[k % len(grids)], pose)
        folded = time.perf_counter()
    done = time.perf_counter()
    return done - start, done - folded


def measure_size(folder: Path) -> Iterator[Line]:
    """Bytes in the file for each cell that a session observed."""
    path = folder / "example.gpkg"
    build_map([EXAMPLE], path, BuildSettings(), DriveOptions("gnss_rtk.nmea"))
    yield Line("the example, all evidence included", _bytes_a_cell(path), "asked <= 8")
    path = folder / "four.gpkg"
    with create_map(path, DATUM) as universal:
        for k in range(4):
            add(universal, str(k), 3.7 * k, 2.9 * k)
    yield Line("four sessions of 200 frames on one field", _bytes_a_cell(path), "asked <= 8")


def _bytes_a_cell(path: Path) -> str:
    with open_map(path) as universal:
        sessions = [info.name for info in universal.sessions()]
        seen = sum(int(universal.read(sessions=[name]).observed.sum()) for name in sessions)
    return f"{path.stat().st_size / seen:.2f} bytes"


def measure_fold(folder: Path) -> Iterator[Line]:
    """2000 frames of the paper's 133 x 280 cells: folded anew to 0.26 m, read at 0.25 m."""
    grids, path = real_grids(6.65, 14.0), folder / "fold.gpkg"
    with create_map(path, DATUM) as universal, universal.add_session("a") as session:
        for k, pose in enumerate(rows(2000, 300.0, 2.0, 3.0, 0.0, 0.0)):
            session.add(grids[k % len(grids)], pose)
    with open_map(path) as universal:
        for what, cell_m, layers in (
            ("2000 grids 133 x 280 folded to 0.26 m", 0.26, ()),
            ("  with all layers", 0.26, ALL),
            ("  read at 0.25 m, with all layers", 0.25, ALL),
        ):
            _seconds_of_read(universal, cell_m, layers)
            seconds = [_seconds_of_read(universal, cell_m, layers) for _ in range(3)]
            asked = "" if layers else "asked <= 2 s"
            yield Line(what, f"{statistics.median(seconds):.2f} s", asked)


ALL = ("count", "variance", "max", "sessions", "persistence", "height")


def _seconds_of_read(universal: MapFile, cell_m: float, layers: tuple[str, ...]) -> float:
    start = time.perf_counter()
    universal.read(cell_m=cell_m, layers=layers)
    return time.perf_counter() - start


def measure_commit(folder: Path) -> Iterator[Line]:
    """Durable sessions of ten grids of 133 x 280 into one map, in turns with plain SQLite storing
    the tiles that they changed; processor time, because other programs may be at work."""
    path, grids = folder / "commit.gpkg", real_grids(6.65, 14.0)
    ours_ms, closing_ms, ratios = list[float](), list[float](), list[float]()
    for k in range(SESSIONS):
        with open_map(path, datum=DATUM) as universal:
            start = time.process_time()
            row, along = divmod(k, 5)
            with universal.add_session(f"{k:03d}") as session:
                for n, pose in enumerate(rows(10, 21.0, 2.0, 3.0, 3.0 * row, 20.0 * along)):
                    session.add(grids[(k + n) % len(grids)], pose)
            committed = time.process_time()
        ours_ms.append(1e3 * (committed - start))
        closing_ms.append(1e3 * (time.process_time() - committed))
        if k >= SESSIONS - 20:
            ratios.append(ours_ms[-1] / 1e3 / _store(folder, _tiles_of(path, f"{k:03d}")))
    first, last = (statistics.median(part) for part in (ours_ms[5:35], ours_ms[-30:]))
    yield Line("durable session of 10 grids 133 x 280, the first", f"{first:.0f} ms")
    yield Line(f"  the {SESSIONS}th", f"{last:.0f} ms", "asked <= 25, before 64")
    yield Line("  ratio", f"{last / first:.2f} x", "asked <= 1.1")
    closing = statistics.median(closing_ms[-30:])
    yield Line("  closing the map after it, with the levels above", f"{closing:.0f} ms")
    yield Line("  beside plain SQLite with its tiles in zlib", f"{statistics.median(ratios):.1f} x")


def _tiles_of(path: Path, name: str) -> list[bytes]:
    """The tiles of the map in the places of a session, not compressed."""
    with open_map(path) as universal:
        frames = list(universal.frames(name))
        lattice = Lattice(universal.cell_m)
    under = {tuple(t) for f in frames for t in footprint(f.spec, f.pose, lattice).tiles()}
    database = sqlite3.connect(path)
    rows_ = database.execute(
        "SELECT ty, tx, data FROM fieldgrid_tile "
        "WHERE zoom = (SELECT max(zoom) FROM fieldgrid_tile)"
    ).fetchall()
    database.close()
    return [zlib.decompress(blob[5 + 2 * blob[0] :]) for ty, tx, blob in rows_ if (ty, tx) in under]


def _store(folder: Path, tiles: list[bytes]) -> float:
    """Seconds of processor time of one durable transaction of plain SQLite."""
    path = folder / "plain.db"
    database = sqlite3.connect(path, isolation_level=None)
    database.execute("PRAGMA synchronous = FULL")
    database.execute("CREATE TABLE IF NOT EXISTS tile (id INTEGER PRIMARY KEY, data BLOB)")
    start = time.process_time()
    database.execute("BEGIN IMMEDIATE")
    database.executemany(
        "INSERT INTO tile (data) VALUES (?)", ((zlib.compress(tile, 1),) for tile in tiles)
    )
    database.execute("COMMIT")
    seconds = time.process_time() - start
    database.close()
    return seconds


def measure_health(folder: Path) -> Iterator[Line]:
    """Verify and repair on all cores beside one, in turns."""
    works: dict[str, Callable[[MapFile, int | None], object]] = {
        "verify": lambda universal, jobs: universal.verify(jobs),
        "verify --deep": lambda universal, jobs: universal.verify(jobs, deep=True),
        "repair": lambda universal, jobs: universal.repair(jobs),
    }
    taken: dict[tuple[str, int | None], list[float]] = defaultdict(list)
    with open_map(folder / "four.gpkg", writable=True) as universal:
        for _ in range(3):
            for jobs in (1, None):
                for what, work in works.items():
                    start = time.perf_counter()
                    work(universal, jobs)
                    taken[what, jobs].append(time.perf_counter() - start)
    for what in works:
        one, every = min(taken[what, 1]), min(taken[what, None])
        yield Line(f"{what} of four sessions of 200 frames", f"{every:.2f} s")
        asked = "one process reads a map of this size" if what == "verify" else "asked >= 1.7"
        yield Line("  all cores beside one", f"{one / every:.2f} x", asked)


def measure_append(folder: Path) -> Iterator[Line]:
    """A session of 200 frames added to a map of one like it, and to one of a hundred."""
    small, large = folder / "small.gpkg", folder / "large.gpkg"
    with create_map(small, DATUM) as universal:
        add(universal, "0", 0.0, 0.0)
    with create_map(large, DATUM) as universal:
        for k in range(100):
            add(universal, str(k), SIDE_M * (k // 10), SIDE_M * (k % 10))
    seconds: dict[Path, list[float]] = {small: [], large: []}
    for k in range(9):
        for path, taken in seconds.items():
            shutil.copy(path, folder / "copy.gpkg")
            with open_map(folder / "copy.gpkg", datum=DATUM) as universal:
                taken.append(add(universal, "more", -SIDE_M, 75.0 + k)[0])
    one, hundred = (statistics.median(taken) for taken in seconds.values())
    yield Line("200 frames appended to a map of 1x the area", f"{1e3 * one:.0f} ms")
    yield Line("  to a map of 100x the area", f"{1e3 * hundred:.0f} ms")
    yield Line("  ratio", f"{hundred / one:.2f} x", "asked <= 1.2")


def measure_hectares() -> Iterator[Line]:
    """100 ha at 5 cm: built, and read in windows and overviews, each by a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "large.gpkg"
        for step in ("build", "read", "verify"):
            command = [sys.executable, "-m", "benchmarks.hectares", step, str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            said, rss_mb = done.stdout.rsplit(maxsplit=1)
            yield Line(f"100 ha, {step}: {said.strip()}", f"{rss_mb} MB", "asked < 1000 MB")


if __name__ == "__main__":
    for line in measure_map(large=sys.argv[1:] == ["large"]):
        print(f"  {line.what:<58} {line.value:>16}  {line.asked}", flush=True)
