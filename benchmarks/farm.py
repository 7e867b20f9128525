"""A farm of 50 maps: what listing, a window of one map and a window across all of them cost.

python -m benchmarks.farm
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.lasting import Line
from benchmarks.synthetic import DATUM, real_grids, rows
from benchmarks.timing import timed_s
from fieldgrid.geometry import Bounds, Datum
from fieldgrid.maps import Farm, create_map

MAPS, PER_ROW, SIDE_M, PITCH_M = 50, 10, 30.0, 40.0
FRAMES, SESSIONS = 48, 2
_RUNS = 9


def write_farm(folder: Path) -> None:
    """Fields of 30 x 30 m, 40 m from one to the next: neighbours see each other's edges."""
    grids = real_grids()
    for k in range(MAPS):
        south, west = (PITCH_M * value for value in divmod(k, PER_ROW))
        with create_map(folder / f"field{k:02d}.gpkg", DATUM) as universal:
            for drive in range(SESSIONS):
                with universal.add_session(f"drive {drive}") as session:
                    poses = rows(FRAMES, SIDE_M, 4.0, 5.0, west + 1.3 * drive, south)
                    for n, pose in enumerate(poses):
                        session.add(grids[(7 * n + k + drive) % len(grids)], pose)


def measure_farm() -> Iterator[Line]:
    """Each of it with maps that are not open yet, and with maps that are."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_farm(folder)
        listed_ms, _ = _median_ms(lambda: Farm(folder))
        yield Line(f"{MAPS} maps listed", f"{listed_ms:.0f} ms")
        whole = Farm(folder)
        middle = Bounds(185.0, 70.0, 205.0, 90.0)  # where four fields meet
        for what, bounds, cell_m, asked in (
            ("20 x 20 m where four maps meet, 5 cm", middle, None, "asked <= 50 ms"),
            ("  with five layers", middle, None, "asked <= 50 ms"),
            (f"across {MAPS} maps, cells of 0.8 m", None, 0.8, "asked <= 200 ms"),
            (f"across {MAPS} maps, cells of 0.4 m", None, 0.4, "asked <= 200 ms"),
            (f"across {MAPS} maps, a strip of 400 x 2 m at 5 cm",
             Bounds(0.0, 29.0, 400.0, 31.0), None, ""),
        ):  # fmt: skip
            layers = ("count", "max", "sessions", "variance") if "layers" in what else ()

            def read(farm: Farm = whole) -> None:
                farm.read(bounds, cell_m, layers=layers)  # noqa: B023 - it is called at once

            def read_cold() -> None:
                whole.close()
                read()

            cold_ms, cold_cpu_ms = _median_ms(read_cold)
            warm_ms, warm_cpu_ms = _median_ms(read)
            yield Line(what, f"{warm_ms:.0f} ms", asked)
            yield Line("  maps opened for it", f"{cold_ms:.0f} ms", asked)
            yield Line(
                "  processor time", f"{warm_cpu_ms:.0f}, {cold_cpu_ms:.0f} ms", "warm, opened"
            )
        elsewhere = Datum(DATUM.lat_deg + 0.001, DATUM.lon_deg, DATUM.height_m)
        with Farm(folder, datum=elsewhere) as moved:
            middle = Bounds(185.0, -41.0, 205.0, -21.0)
            ms, cpu_ms = _median_ms(lambda: moved.read(middle))
            yield Line("20 x 20 m where four maps of another datum meet", f"{ms:.0f} ms")
            yield Line("  processor time", f"{cpu_ms:.0f} ms")


def _median_ms(work: Callable[[], object]) -> tuple[float, float]:
    work()
    seconds = [timed_s(work) for _ in range(_RUNS)]
    wall, cpu = (1e3 * statistics.median(one) for one in zip(*seconds, strict=True))
    return wall, cpu


if __name__ == "__main__":
    for line in measure_farm():
        print(f"  {line.what:<58} {line.value:>16}  {line.asked}", flush=True)
