"""Exports that go by pieces take no more memory for a map nine times as large."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rasterio")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells it"),
]

ENDINGS = (
    *(".tif", ".png", ".mbtiles", ".kmz", ".qgz", ".yaml", ".mcap", ".rosbag2", ".bag"),
    *(".csv", ".parquet", ".npz", ".zarr", ".nc", ".las", ".laz", ".ply"),
)
SHAPES = (".geojson", ".gpkg", ".fgb", ".dxf", ".shp.zip")
"""These hold the obstacles that they write, and are written without them here."""

MOST_MB = 40.0
"""Above the smaller map. The larger one has 8 million cells more, and none of these exports would
hold all of it with fewer than 8 bytes of each."""

# Pieces are made small, so that both maps have many of them and the maps can be small, too.
PROGRAM = """
import os, sys
from pathlib import Path
from fieldgrid.export.cells import arrays, kmz, raster, tiles
from fieldgrid.export.robots import bag_content, nav2
from fieldgrid.export import export_map
from fieldgrid.maps.views import blocks
from fieldgrid.maps import open_map
from fieldgrid.maps.tiles import overviews
blocks._ROWS, blocks._COLUMNS = 256, 1024
tiles.MESSAGE_CELLS, nav2.TILE_CELLS = 500_000, 512
bag_content.GRID_MAP_CELLS, bag_content.TILE_CELLS = 500_000, 512
raster.CACHE_MB, overviews.SQUARE_LEVELS = 16, 8
arrays.CHUNK_CELLS, kmz.PICTURE_PX = 512, 512
for ending in sys.argv[3:]:
    sys.stdout.flush()
    if (child := os.fork()):  # so that no export uses what another has left in memory
        assert os.waitpid(child, 0)[1] == 0, ending
        continue
    with open_map(sys.argv[1]) as universal:
        options = {"min_area_m2": 1e8} if ending in @SHAPES@ else {}
        export_map(universal, Path(sys.argv[2]) / f"out{ending}", options=options)
    # Not ru_maxrss, which begins with that of the program that started this one.
    (line,) = (one for one in open("/proc/self/status") if one.startswith("VmHWM"))
    print(ending, int(line.split()[1]) / 1024.0)
    sys.stdout.flush()
    os._exit(0)
""".replace("@SHAPES@", repr(SHAPES))


def test_peak_memory_does_not_grow_with_the_map(tmp_path: Path) -> None:
    from benchmarks.exports import write_tiles

    peaks = []
    for side in (4, 12):
        path = write_tiles(tmp_path / f"{side}.gpkg", side, share=0.25)
        (tmp_path / str(side)).mkdir()
        command = [sys.executable, "-c", PROGRAM, str(path), str(tmp_path / str(side))]
        command += (*ENDINGS, *SHAPES)
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        peaks.append({line.split()[0]: float(line.split()[1]) for line in done.stdout.splitlines()})
        path.unlink()
    small, large = peaks
    assert small.keys() == large.keys() == {*ENDINGS, *SHAPES}
    print({e: (round(small[e]), round(large[e] - small[e])) for e in small})
    for ending in small:
        assert large[ending] - small[ending] <= MOST_MB, (ending, small, large)
