"""What reads a map as a whole takes no more bytes of a cell than is said of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells it"),
]

BYTES_A_CELL = {"Costmap": 10.5, "show": 6.0, "rows": 16.0, "diff": 4.0}
"""As docs/scale.md says; the larger map has 8 million cells more."""

SLACK_BYTES = 4e6

# Pieces are made small, so that both maps have many of them and the maps can be small, too.
PROGRAM = """
import os, sys
from pathlib import Path
from fieldgrid import Costmap; from fieldgrid.maps import evidence
from fieldgrid.field import find_changes
from fieldgrid.cli import main
from fieldgrid.maps.views import blocks; from fieldgrid.maps import open_map
from fieldgrid.field.rows import ground, segments
blocks._ROWS, blocks._COLUMNS = 256, 1024
evidence._BAND_CELLS = ground._BAND_CELLS = segments._BAND_CELLS = 500_000
path = sys.argv[1]

def costmap():
    with open_map(path) as universal:
        Costmap.from_map(universal, robot_radius_m=0.3, inflation_m=1.0)

def run(*words):
    sys.argv = ["fieldgrid", *words]
    try:
        main()
    except SystemExit as end:
        assert not end.code, end.code

def diff():
    with open_map(path) as universal:
        for kind in (changes := find_changes(universal, "s", "t")).view.change.flat[:1]:
            changes.view.area_m2(kind)

picture = path + ".png"
what = {
    "Costmap": costmap,
    "show": lambda: run("show", path, "-o", picture, "--figure", "grid"),
    "rows": lambda: run("rows", path),
    "diff": diff,
}
out = os.dup(1)
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
for name, work in what.items():
    if (child := os.fork()):  # so that none uses what another has left in memory
        assert os.waitpid(child, 0)[1] == 0, name
        continue
    work()
    # Not ru_maxrss, which begins with that of the program that started this one.
    (line,) = (one for one in open("/proc/self/status") if one.startswith("VmHWM"))
    os.write(out, f"{name} {1024 * int(line.split()[1])}\\n".encode())
    os._exit(0)
"""


def test_peak_memory_grows_by_the_stated_bytes_a_cell(tmp_path: Path) -> None:
    from benchmarks.exports import write_tiles

    peaks, sides = [], (4, 12)
    for side in sides:
        path = write_tiles(tmp_path / f"{side}.gpkg", side, share=0.25, sessions=("s", "t"))
        command = [sys.executable, "-c", PROGRAM, str(path)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        peaks.append({line.split()[0]: int(line.split()[1]) for line in done.stdout.splitlines()})
        path.unlink()
    small, large = peaks
    assert small.keys() == large.keys() == BYTES_A_CELL.keys()
    cells = 256**2 * (sides[1] ** 2 - sides[0] ** 2)
    grown = {name: (large[name] - small[name] - SLACK_BYTES) / cells for name in BYTES_A_CELL}
    print({name: round(value, 1) for name, value in grown.items()})
    for name, most in BYTES_A_CELL.items():
        assert grown[name] <= most, (name, grown)
