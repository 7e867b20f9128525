"""Peak memory of exports and other readers of a map beside the size of the map.

python -m benchmarks.memory [HECTARES ...]     1 4 16 when none is given
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.lasting import Line

_RUN = "import sys; from fieldgrid.cli import main; main()"
_COSTMAP = """
import sys, fieldgrid as fg
with fg.open_map(sys.argv[1]) as m: fg.Costmap.from_map(m)
"""

WHAT: dict[str, Sequence[str]] = {
    "nothing: the map is opened": ("sessions", "MAP"),
    **{
        f"export {name}": ("export", "MAP", f"out{ending}", "--format", name)
        for name, ending in (
            ("geotiff", ".tif"),
            ("png", ".png"),
            ("kmz", ".kmz"),
            ("geojson", ".geojson"),
            ("shapefile", ".zip"),
            ("taskdata", ""),
            ("nav2", ".yaml"),
            ("rosbag2", ""),
            ("mcap", ".mcap"),
            ("csv", ".csv"),
            ("parquet", ".parquet"),
            ("npz", ".npz"),
            ("zarr", ".zarr"),
            ("netcdf", ".nc"),
        )
    },
    "show": ("show", "MAP", "-o", "out.png"),
    "rows": ("rows", "MAP"),
    "diff": ("diff", "MAP", "--from", "strip 00", "--to", "LAST"),
    "verify": ("verify", "MAP"),
    "Costmap.from_map": (),
}


class Used(NamedTuple):
    """What a command took: peak memory, processor time, and how it ended."""

    rss_mb: float
    cpu_s: float
    said: str


def run(what: str, map_: Path, last: str, folder: Path) -> Used:
    """A command, in a process of its own."""
    words = [{"MAP": str(map_), "LAST": last}.get(word, word) for word in WHAT[what]]
    program = [_RUN, *words] if words else [_COSTMAP, str(map_)]
    with (folder / "said").open("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-c", *program],
            cwd=folder, stdout=subprocess.DEVNULL, stderr=said,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        words_said = "" if process.returncode == 0 else said.read().strip()[-300:]
    return Used(usage.ru_maxrss / 1024.0, usage.ru_utime + usage.ru_stime, words_said)


def measure_memory(hectares: Sequence[float]) -> Iterator[Line]:
    """Megabytes above those of opening the map, at every size."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        maps, lasts = [], []
        for size in hectares:
            side_m = math.sqrt(1e4 * size)
            maps.append(folder / f"{size:g}.gpkg")
            lasts.append(f"strip {max(1, round(side_m / 50.0)) - 1:02d}")
            command = [sys.executable, "-m", "benchmarks.hectares", "build"]
            subprocess.run([*command, str(maps[-1]), str(side_m)], check=True, capture_output=True)
        for what in WHAT:
            used = []
            for path, last in zip(maps, lasts, strict=True):
                with tempfile.TemporaryDirectory(dir=folder) as out:
                    used.append(run(what, path, last, Path(out)))
            peaks = ", ".join(f"{one.rss_mb:.0f}" for one in used)
            seconds = ", ".join(f"{one.cpu_s:.1f}" for one in used)
            said = next((one.said for one in used if one.said), "")
            yield Line(f"{what}, {', '.join(f'{size:g}' for size in hectares)} ha",
                       f"{peaks} MB", f"{seconds} s {said}")  # fmt: skip


if __name__ == "__main__":
    for line in measure_memory([float(word) for word in sys.argv[1:]] or [1.0, 4.0, 16.0]):
        print(f"  {line.what:<40} {line.value:>20}  {line.asked}", flush=True)
