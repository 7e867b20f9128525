"""One step of the work on a map of 100 ha, or of a square of another side; prints what was done,
and the peak memory in MB.

    python -m benchmarks.hectares build|read|verify MAP.gpkg [SIDE_M [ROW_M STEP_M]]

Rows are 3 m apart with a frame every 4 m, as in a vineyard. Of rows of 6 m and a frame every 8 m
the frames of the example see two fifths of the ground. A build says after each strip how far it is.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from benchmarks.peak import peak_mb
from benchmarks.synthetic import DATUM, real_grids, rows
from fieldgrid.geometry import Bounds
from fieldgrid.maps import create_map, open_map

SIDE_M, ROW_M, STEP_M = 1000.0, 3.0, 4.0
STRIP_M = 50.0


def build(path: Path, side_m: float = SIDE_M, row_m: float = ROW_M, step_m: float = STEP_M) -> str:
    """Rows over a square, in strips of a session each."""
    grids = real_grids()
    per_strip = int(STRIP_M / row_m) * int(side_m / step_m)
    frames = 0
    with create_map(path, DATUM) as universal:
        for strip in range(max(1, round(side_m / STRIP_M))):
            with universal.add_session(f"strip {strip:02d}") as session:
                west_m = strip * STRIP_M
                for k, pose in enumerate(rows(per_strip, side_m, step_m, row_m, west_m, 0.0)):
                    session.add(grids[(7 * k + strip) % len(grids)], pose)
                    frames += 1
            hectares = (strip + 1) * STRIP_M * side_m / 1e4
            used = f"{time.process_time():.0f} s of processor time, peak {_peak_mb():.0f} MB"
            print(f"{hectares:.0f} ha, {used}", file=sys.stderr, flush=True)
    return f"{frames} frames, {path.stat().st_size / 1e9:.2f} GB"


def read(path: Path) -> str:
    """All of it at 5 cm window by window, at 10 cm and at 25 cm at once."""
    seen = 0
    with open_map(path) as universal:
        west_m, south_m, east_m, north_m = universal.bounds
        while south_m < north_m:
            strip = Bounds(west_m, south_m, east_m, min(south_m + 51.2, north_m))
            seen += int(universal.read(strip).observed.sum())
            south_m += 51.2
        universal.read(cell_m=0.1)
        universal.read(cell_m=0.25)
    return f"{seen / 1e6:.0f} M cells seen, {path.stat().st_size / seen:.2f} bytes a cell"


def verify(path: Path) -> str:
    """The whole map made anew and compared."""
    with open_map(path) as universal:
        health = universal.verify()
    return f"sound {health.sound}, {health.tiles} tiles"


def _peak_mb() -> float:
    return peak_mb()


if __name__ == "__main__":
    start = time.perf_counter()
    step, path, *side = sys.argv[1:]
    if step == "build":
        said = build(Path(path), *map(float, side))
    else:
        said = {"read": read, "verify": verify}[step](Path(path))
    print(f"{said}, {time.perf_counter() - start:.0f} s {_peak_mb():.0f}")
