"""Exports of large maps as cloud-optimised GeoTIFF, beside rasterio's writing of the same array.

python -m benchmarks.exports export|plain|tiled MAP.gpkg OUT.tif

does one of it and prints the seconds and the peak memory in MB.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import rasterio

from benchmarks.lasting import Line
from benchmarks.peak import peak_mb
from benchmarks.synthetic import DATUM, full_grid, pose_at
from fieldgrid.core import UInt64
from fieldgrid.export import export_map
from fieldgrid.geometry import TILE_CELLS, GridSpec, TileIndex
from fieldgrid.maps import Cells, connect, create_map, open_map
from fieldgrid.maps.file.database import writing
from fieldgrid.maps.file.header import read_header
from fieldgrid.maps.file.root import seal
from fieldgrid.maps.layers.window import empty_cells
from fieldgrid.maps.tiles.pyramid import Pyramid, encoded_tile
from fieldgrid.maps.writing.derived import tables_of

_CELL_M = 0.05
_SMALL_TILES, _LARGE_TILES = 40, 78
"""Sides in tiles: 1.0e8 and 4.0e8 cells of 5 cm."""

_RUNS = 3


def measure_exports() -> Iterator[Line]:
    """Cells a second and peak memory, each in a process of its own."""
    yield Line("load of the machine before, 1 min", f"{os.getloadavg()[0]:.2f}")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.tif"
        small = write_tiles(Path(folder) / "small.gpkg", _SMALL_TILES, share=1.0)
        cells = (_SMALL_TILES * TILE_CELLS) ** 2
        ours = min(_timed("export", small, out)[0] for _ in range(_RUNS))
        tiled = min(_timed("tiled", small, out)[0] for _ in range(_RUNS))
        plain = min(_timed("plain", small, out)[0] for _ in range(_RUNS))
        small.unlink()
        yield Line("COG of 1.0e8 cells, all seen, from the map", _rate(cells, ours), "asked >= 50")
        yield Line("  rasterio, array to COG (its own overviews)", _rate(cells, plain))
        yield Line("  rasterio, array to tiled GeoTIFF, no overviews", _rate(cells, tiled))
        cells = (_LARGE_TILES * TILE_CELLS) ** 2
        for what, share in (("all seen", 1.0), ("an eighth seen", 0.125)):
            large = write_tiles(Path(folder) / "large.gpkg", _LARGE_TILES, share)
            seconds, peak_mb = _timed("export", large, out)
            large.unlink()
            yield Line(f"COG of 4.0e8 cells, {what}", _rate(cells, seconds))
            yield Line("  peak RSS", f"{peak_mb:.0f} MB", "asked <= 1000 MB")


def write_tiles(path: Path, side: int, share: float, sessions: Sequence[str] = ("s",)) -> Path:
    """A map of `side` x `side` tiles, some of them seen, in every cell: noise of one in ten. Each
    of the sessions saw the same.

    Its tiles are put in as a session would, but without the 100,000 frames that it would take.
    """
    random = np.random.default_rng(0)
    kinds = [_noise(random) for _ in range(7)]
    tiles = {
        TileIndex(ty, tx)
        for ty in range(-side // 2, side - side // 2)
        for tx in range(-side // 2, side - side // 2)
        # In lanes, as a field is driven, and the corners, so that all of it is the extent.
        if (tx * 0.125) % 1.0 < share or abs(2 * ty + 1) == abs(2 * tx + 1) == side - 1
    }

    with create_map(path, DATUM, cell_m=_CELL_M) as universal:
        for name in sessions:
            with universal.add_session(name) as one:
                one.add(full_grid(GridSpec(10.0, 12.0), 1), pose_at(1.0, 1.0, 10.0, 0))
    with closing(connect(path, path, writable=True)) as connection, writing(connection, path):
        header = read_header(connection, path)
        tables = tables_of(connection, header, path)
        for table in ("fieldgrid_tile", "density"):
            connection.execute(f"DELETE FROM {table}")
        made = []
        for tile in sorted(tiles):
            roll, axis = (31 * tile.ty + 57 * tile.tx) % TILE_CELLS, tile.ty % 2
            weight, total = kinds[(3 * tile.ty + tile.tx) % len(kinds)]
            block = tables.block(0)
            cells = dict(empty_cells(tables.groups, weight.shape, block))
            cells["weight"], cells["sum"] = np.roll(weight, roll, axis), np.roll(total, roll, axis)
            made.append(encoded_tile(tile, Cells(cells, block=block), tables.groups))
        Pyramid(tables).fill(made)
        seal(connection)
    return path


def _noise(random: np.random.Generator) -> tuple[UInt64, UInt64]:
    """Weights and sums of a tile."""
    shape = (TILE_CELLS, TILE_CELLS)
    weight = 16 * random.integers(1, 20, shape)
    density = np.where(random.random(shape) < 0.1, random.integers(1, 256, shape), 0)
    return weight.astype(np.uint64), (weight * density).astype(np.uint64)


def _timed(what: str, source: Path, out: Path) -> tuple[float, float]:
    out.unlink(missing_ok=True)  # what another program has written is not replaced
    command = [sys.executable, "-m", "benchmarks.exports", what, str(source), str(out)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds, peak_mb = (float(value) for value in done.stdout.split()[-2:])
    return seconds, peak_mb


def _rate(cells: int, seconds: float) -> str:
    return f"{cells / seconds / 1e6:.0f} Mcells/s"


def _export(source: Path, out: Path) -> float:
    with open_map(source) as universal:
        export_map(universal, out, overwrite=True)  # kernels are loaded
        start = time.perf_counter()
        export_map(universal, out, overwrite=True)
    return time.perf_counter() - start


def _write(source: Path, out: Path, driver: str) -> float:
    """Writing of an array that is in memory already, and in the right order."""
    with open_map(source) as universal:
        view = universal.read()
    pixels = np.stack([view.density[::-1], view.observed[::-1] * np.uint8(255)])
    place = {"count": 2, "width": pixels.shape[2], "height": pixels.shape[1], "dtype": "uint8"}
    options = {"compress": "DEFLATE", "num_threads": "ALL_CPUS", "crs": view.crs_wkt}
    if driver == "GTiff":
        options |= {"tiled": "YES", "blockxsize": "512", "blockysize": "512", "zlevel": "1"}
    else:
        options |= {"level": "1"}
    transform = rasterio.Affine(
        _CELL_M, 0.0, view.bounds.west_m, 0.0, -_CELL_M, view.bounds.north_m
    )
    start = time.perf_counter()
    with rasterio.open(out, "w", driver=driver, transform=transform, **place, **options) as dataset:
        dataset.write(pixels)
    return time.perf_counter() - start


if __name__ == "__main__":
    wanted, source, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    if wanted == "export":
        seconds = _export(source, out)
    else:
        seconds = _write(source, out, "COG" if wanted == "plain" else "GTiff")
    print(seconds, peak_mb())
