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
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.synthetic import DATUM, real_grids, rows
from fieldgrid.build import build_map
from fieldgrid.mapfile import MapFile, create_map, open_map
from fieldgrid.mapfile.codec import decode_moments
from fieldgrid.settings import BuildSettings

SIDE_M = 150.0
FRAMES = 200


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
        yield from measure_append(folder)
    if large:
        yield from measure_hectares()


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
    build_map([EXAMPLE], path, BuildSettings(), gnss="gnss_rtk.nmea")
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
    """2000 frames of the paper's 133 x 280 cells, folded anew to cells of 0.25 m."""
    grids, path = real_grids(6.65, 14.0), folder / "fold.gpkg"
    with create_map(path, DATUM) as universal, universal.add_session("a") as session:
        for k, pose in enumerate(rows(2000, 300.0, 2.0, 3.0, 0.0, 0.0)):
            session.add(grids[k % len(grids)], pose)
    with open_map(path) as universal:
        for what, layers in (("2000 grids 133 x 280 to 0.25 m", ()), ("  with all layers", ALL)):
            universal.read(cell_m=0.25, layers=layers)
            seconds = [_seconds_of_read(universal, layers) for _ in range(3)]
            asked = "" if layers else "asked <= 2 s"
            yield Line(what, f"{statistics.median(seconds):.2f} s", asked)


ALL = ("count", "variance", "max", "sessions", "persistence")


def _seconds_of_read(universal: MapFile, layers: tuple[str, ...]) -> float:
    start = time.perf_counter()
    universal.read(cell_m=0.25, layers=layers)
    return time.perf_counter() - start


def measure_commit(folder: Path) -> Iterator[Line]:
    """A durable commit of 200 frames beside SQLite storing the same tiles, in turns."""
    ours, raw, rows_only = [], [], []
    path = folder / "commit.gpkg"
    with create_map(path, DATUM) as universal:
        add(universal, "first", 0.0, 0.0)
    for k in range(7):
        with open_map(path, datum=DATUM) as universal:
            ours.append(add(universal, str(k), 0.0, 500.0 * (k + 1))[1])
        raw.append(_store(folder, _raw_tiles(path, str(k))))
        rows_only.append(_store(folder, _rows_of(path, str(k))))
    mine, theirs, bare = (1e3 * statistics.median(times) for times in (ours, raw, rows_only))
    yield Line("durable commit of 200 frames, all of it", f"{mine:.0f} ms")
    yield Line("  plain SQLite, the same tiles, five layers raw", f"{theirs:.0f} ms")
    yield Line("  ratio", f"{mine / theirs:.2f} x", "asked <= 1")
    yield Line("  plain SQLite, our rows as they are in the end", f"{bare:.0f} ms")


def _raw_tiles(path: Path, name: str) -> list[bytes]:
    """The session's tiles as a simple store has them: an array a layer, in its natural type."""
    database = sqlite3.connect(path)
    blobs = database.execute(
        "SELECT moments FROM fieldgrid_session_tile JOIN fieldgrid_session ON id = session_id "
        "WHERE name = ?",
        (name,),
    ).fetchall()
    database.close()
    types = ("u2", "u4", "u4", "u2", "u1")
    return [
        np.ascontiguousarray(moments[..., k]).astype(kind).tobytes()
        for (blob,) in blobs
        for moments in (decode_moments(blob, "tile"),)
        for k, kind in enumerate(types)
    ]


def _rows_of(path: Path, name: str) -> list[bytes]:
    """All blobs that the session put into the map: frames, its tiles, and about as many more
    as sums and pictures."""
    database = sqlite3.connect(path)
    blobs: list[bytes] = []
    for query in (
        "SELECT density FROM fieldgrid_frame AS f JOIN fieldgrid_session AS s "
        "ON s.id = session_id WHERE name = ?",
        "SELECT observed FROM fieldgrid_frame AS f JOIN fieldgrid_session AS s "
        "ON s.id = session_id WHERE name = ?",
        "SELECT moments FROM fieldgrid_session_tile JOIN fieldgrid_session ON id = session_id "
        "WHERE name = ?",
    ):
        blobs += [row[0] for row in database.execute(query, (name,))]
    (tiles,) = database.execute(
        "SELECT count(*) FROM fieldgrid_session_tile JOIN fieldgrid_session ON id = session_id "
        "WHERE name = ?",
        (name,),
    ).fetchone()
    for query in ("SELECT sums FROM fieldgrid_tile", "SELECT tile_data FROM density"):
        blobs += [row[0] for row in database.execute(f"{query} LIMIT {tiles * 4 // 3}")]
    database.close()
    return blobs


def _store(folder: Path, blobs: list[bytes]) -> float:
    """Seconds of one durable transaction of plain SQLite into a table that has rows already."""
    path = folder / "plain.db"
    database = sqlite3.connect(path, isolation_level=None)
    database.execute("PRAGMA synchronous = FULL")
    database.execute("CREATE TABLE IF NOT EXISTS tile (id INTEGER PRIMARY KEY, data BLOB)")
    start = time.perf_counter()
    database.execute("BEGIN IMMEDIATE")
    database.executemany("INSERT INTO tile (data) VALUES (?)", ((blob,) for blob in blobs))
    database.execute("COMMIT")
    seconds = time.perf_counter() - start
    database.close()
    return seconds


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
