"""Peak memory and processor time of exports and other readers of a map, beside its size.

    python -m benchmarks.hectares build 4.gpkg 200     # 4 ha; 16.gpkg 400 is 16 ha
    python -m benchmarks.memory 1.gpkg 4.gpkg 16.gpkg
    python -m benchmarks.memory --only rows,show 1.gpkg 4.gpkg 16.gpkg

Each is a process of its own. What takes more than five minutes is ended, and said so.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.lasting import Line
from benchmarks.peak import Used, used_by
from fieldgrid.maps import open_map

_RUN = "import sys; from fieldgrid.cli import main; main()"
_COSTMAP = """
import sys, fieldgrid as fg
with fg.open_map(sys.argv[1]) as m: fg.Costmap.from_map(m)
"""

_OUTLINES = """
import sys, fieldgrid as fg
from fieldgrid.export.shapes.obstacles import trace_obstacles
from fieldgrid.export.options import ShapeOptions
with fg.open_map(sys.argv[1]) as m, m.read_blocks(decide="density") as blocks:
    list(trace_obstacles(blocks.views, ShapeOptions(min_area_m2=1e8)))
"""

_LIMIT_S = 300

WHAT: dict[str, Sequence[str]] = {
    "nothing: the map is opened": ("sessions", "MAP"),
    **{
        f"export {name}": ("export", "MAP", f"out{ending}", "--format", name)
        for name, ending in (
            ("geotiff", ".tif"),
            ("png", ".png"),
            ("nav2", ".yaml"),
            ("rosbag2", ""),
            ("npz", ".npz"),
            ("zarr", ".zarr"),
            ("netcdf", ".nc"),
            ("kmz", ".kmz"),
            ("mbtiles", ".mbtiles"),
            ("las", ".las"),
            ("ply", ".ply"),
            ("csv", ".csv"),
            ("parquet", ".parquet"),
        )
    },
    "show": ("show", "MAP", "-o", "out.png"),
    "diff": ("diff", "MAP", "--from", "FIRST", "--to", "LAST"),
    "verify": ("verify", "MAP"),
    "verify --deep": ("verify", "MAP", "--deep"),
    "Costmap.from_map": (_COSTMAP, "MAP"),
    "outlines joined": (_OUTLINES, "MAP"),
    "rows": ("rows", "MAP"),
    **{
        f"export {ending}": ("export", "MAP", f"out.{ending}", "--min-area", "0.5")
        for ending in ("geojson", "gpkg", "fgb", "dxf", "shp.zip")
    },
}

_PROGRAMS = ("Costmap.from_map", "outlines joined")
"""Which are Python of their own, and no commands."""


def run(what: str, map_: Path, folder: Path) -> Used:
    """A command, in a process of its own."""
    with open_map(map_) as universal:
        names = [info.name for info in universal.sessions()]
    known = {"MAP": str(map_), "FIRST": names[max(0, len(names) - 2)], "LAST": names[-1]}
    words = [known.get(word, word) for word in WHAT[what]]
    program = words if what in _PROGRAMS else [_RUN, *words]
    return used_by(["-c", *program], folder=folder, limit_s=_LIMIT_S)


def measure_memory(maps: Sequence[Path], only: Sequence[str] = ()) -> Iterator[Line]:
    """Megabytes and seconds for each map, of all or of some."""
    for what in only or WHAT:
        used = []
        for path in maps:
            with tempfile.TemporaryDirectory() as out:
                used.append(run(what, path.absolute(), Path(out)))
        peaks = ", ".join(f"{one.peak_mb:.0f}" for one in used)
        seconds = ", ".join(f"{one.cpu_s:.1f}" for one in used)
        said = "; ".join(one.said for one in used if one.said)
        yield Line(what, f"{peaks} MB", f"{seconds} s {said}")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    words = sys.argv[1:]
    only: Sequence[str] = ()
    if words[0] == "--only":
        only, words = words[1].split(","), words[2:]
    for line in measure_memory([Path(word) for word in words], only):
        print(f"  {line.what:<40} {line.value:>20}  {line.asked}", flush=True)
