"""How the costs of a map grow with its sessions and its ground; the figures of docs/scale.md.

python -m benchmarks.scale                    1, 10, 100 and 1000 sessions on one place
python -m benchmarks.scale MAP.gpkg ...       of maps, such as those of `benchmarks.hectares`
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.lasting import Line
from benchmarks.synthetic import DATUM, pose_at, real_grids
from benchmarks.timing import timed_s
from fieldgrid.geometry import Bounds
from fieldgrid.maps import create_map, open_map

SESSIONS = (1, 10, 100, 1000)
_RUNS = 7
_FRAMES = 2


def measure_sessions() -> Iterator[Line]:
    """Maps of ever more drives over one place, each of two frames."""
    grids = real_grids()
    with tempfile.TemporaryDirectory() as name:
        for count in SESSIONS:
            path = Path(name) / f"{count}.gpkg"

            def build(path: Path = path, count: int = count) -> None:
                with create_map(path, DATUM) as universal:
                    for k in range(count):
                        with universal.add_session(f"drive {k}") as session:
                            for n in range(_FRAMES):
                                pose = pose_at(0.3 * (k % 37), 4.0 * n, 0.7 * k % 90.0, 10 * k + n)
                                session.add(grids[(7 * k + n) % len(grids)], pose)

            _, cpu_s = timed_s(build)
            yield Line(f"{count} sessions", f"{path.stat().st_size / 1e6:.1f} MB")
            yield Line("  built, processor time a session", f"{1e3 * cpu_s / count:.0f} ms")
            yield from measure(path)


def measure(path: Path) -> Iterator[Line]:
    """Opening a map, listing its sessions, and a window in the middle of it."""

    def opened() -> None:
        with open_map(path) as universal:
            universal.sessions()

    with open_map(path) as universal:
        bounds = universal.bounds
        east = (bounds.west_m + bounds.east_m) / 2.0
        north = (bounds.south_m + bounds.north_m) / 2.0
        window = Bounds(east - 10.0, north - 10.0, east + 10.0, north + 10.0)
        latest = universal.sessions()[-1].name
        frames = sum(info.frames for info in universal.sessions())
        with universal.content() as content:
            hectares = content.seen_cells() * universal.cell_m**2 / 1e4
        size = path.stat().st_size
        yield Line("  frames, ha seen", f"{frames}, {hectares:.2f}")
        yield Line("  bytes a frame", f"{size / frames / 1e3:.1f} kB")
        if hectares > 0.5:
            yield Line("  bytes a hectare", f"{size / hectares / 1e6:.0f} MB")
        yield Line("  opened and its sessions listed", _median_ms(opened), "asked <= 500 ms")
        for what, layers, at in (
            ("density", (), None),
            ("five layers", ("count", "max", "sessions", "variance"), None),
            ("density as of its last drive", (), latest),
            ("density of its last drive alone", (), f"{latest}..{latest}"),
        ):
            yield Line(
                f"  window of 20 x 20 m, {what}",
                _median_ms(lambda: universal.read(window, layers=layers, at=at)),  # noqa: B023
                "asked <= 50 ms",
            )


def _median_ms(work: Callable[[], object]) -> str:
    """Wall and processor time, the latter of all threads."""
    work()
    wall, cpu = zip(*(timed_s(work) for _ in range(_RUNS)), strict=True)
    return f"{1e3 * statistics.median(wall):.0f}, {1e3 * statistics.median(cpu):.0f} ms"


if __name__ == "__main__":
    lines = (line for word in sys.argv[1:] for line in (Line(word, ""), *measure(Path(word))))
    for line in lines if sys.argv[1:] else measure_sessions():
        print(f"  {line.what:<58} {line.value:>16}  {line.asked}", flush=True)
