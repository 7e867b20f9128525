"""The viewer on a large map: first picture, tiles, evidence, memory, also while a drive is added.

python -m benchmarks.view MAP.gpkg [--append]

A map of 100 ha is made by `python -m benchmarks.hectares build MAP.gpkg`. The server is a process
of its own, asked over HTTP as the page asks it. `--append` writes to the map: it adds a session of
some frames while the tiles are asked for, and takes it out again.
"""

from __future__ import annotations

import argparse
import http.client
import json
import random
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from fieldgrid.maps import open_map

TILES, CLICKS, FIRST_TILES = 200, 40, 20
SEED = 17


class EstimateInputs:
    """A running viewer, how long its answers take, and what it uses."""

    def __init__(self, process: subprocess.Popen[str], address: str) -> None:
        self.process = process
        self._host = urlsplit(address).netloc

    def get(self, path: str) -> bytes:
        connection = http.client.HTTPConnection(self._host, timeout=120)
        connection.request("GET", path)
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
        if answer.status not in (200, 204):
            raise SystemExit(f"{path}: {answer.status} {body[:200]!r}")
        return body

    def ms(self, path: str) -> float:
        start = time.perf_counter()
        self.get(path)
        return (time.perf_counter() - start) * 1e3

    def cpu_ms(self) -> float:
        """Processor time that the server has used."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) * 10.0

    def peak_mb(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024.0


@contextmanager
def running(path: Path) -> Iterator[EstimateInputs]:
    command = "from fieldgrid.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", command, "view", str(path), "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield EstimateInputs(process, process.stdout.readline().split()[1])
    finally:
        process.terminate()
        process.wait(30)


def tile_paths(about: dict[str, Any], layer: str, count: int) -> list[str]:
    """Tiles at random places and levels, most of them near, as somebody looks at a map."""
    chosen = random.Random(SEED)
    west, south, east, north = about["bounds"]
    found = []
    for _ in range(count):
        level = min(chosen.choice((0, 0, 0, 1, 2, 3, 4)), about["levels"])
        side_m = 256 * about["cell_m"] * 2**level
        tx, ty = chosen.uniform(west, east) // side_m, chosen.uniform(south, north) // side_m
        found.append(f"/api/maps/0/tiles/{layer}/{level}/{ty:.0f}/{tx:.0f}")
    return found


def told(name: str, asked: EstimateInputs, paths: list[str]) -> None:
    """Ask, and print the median, the worst, and the processor time of the median's kind."""
    before = asked.cpu_ms()
    times = sorted(asked.ms(path) for path in paths)
    cpu = (asked.cpu_ms() - before) / len(paths)
    print(
        f"{name:34} median {statistics.median(times):7.1f} ms  95 % "
        f"{times[int(0.95 * len(times))]:7.1f}  worst {times[-1]:7.1f}  processor {cpu:6.1f}"
    )


def first_picture(asked: EstimateInputs) -> None:
    """What the page asks for before it draws: itself, the map, the tiles of the whole field."""
    before, start = asked.cpu_ms(), time.perf_counter()
    for name in ("/", "/viewer.js", "/viewer.css"):
        asked.get(name)
    about = json.loads(asked.get("/api/maps"))["maps"][0]
    level = about["levels"]
    side_m = 256 * about["cell_m"] * 2**level
    west, south, east, north = (int(edge // side_m) for edge in about["bounds"])
    for ty in range(south, north + 1):
        for tx in range(west, east + 1):
            asked.get(f"/api/maps/0/tiles/density/{level}/{ty}/{tx}")
    took = (time.perf_counter() - start) * 1e3
    print(f"{'first picture':34} {took:.0f} ms, processor {asked.cpu_ms() - before:.0f} ms")


def clicks(path: Path) -> list[str]:
    """Cells that were seen, at random."""
    chosen = random.Random(SEED)
    with open_map(path) as universal:
        poses = [frame.pose for frame in universal.frames()]
    picked = chosen.sample(poses, min(CLICKS, len(poses)))
    return [
        f"/api/maps/0/cell?east={pose.east_m:.3f}&north={pose.north_m + 3.0:.3f}" for pose in picked
    ]


def while_appending(path: Path, ask: Callable[[], None]) -> None:
    """Ask while another process adds a session, then take it out."""
    program = (
        "import sys\nfrom dataclasses import replace\nfrom fieldgrid.maps import open_map\n"
        "with open_map(sys.argv[1], writable=True) as m:\n"
        "    frames = [f for f, _ in zip(m.frames(with_grid=True), range(300))]\n"
        "    with m.add_session(sys.argv[2]) as s:\n"
        "        for k, f in enumerate(frames): s.add(f.grid(), f.pose, frame_id=str(k))\n"
    )
    name = f"benchmark {time.time_ns()}"  # a removed session keeps its name
    writer = subprocess.Popen([sys.executable, "-c", program, str(path), name])
    while writer.poll() is None:
        ask()
    if writer.wait():
        raise SystemExit("the session was not added")
    with open_map(path, writable=True) as universal:
        universal.remove_session(name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map", type=Path)
    parser.add_argument("--append", action="store_true")
    arguments = parser.parse_args()
    path = arguments.map
    print(f"{path.name}: {path.stat().st_size / 1e9:.2f} GB")
    places = clicks(path)
    with running(path) as asked:
        first_picture(asked)
        about = json.loads(asked.get("/api/maps"))["maps"][0]
        density = tile_paths(about, "density", TILES)
        told("tile of density", asked, density)
        asked.get("/api/maps/0/scales/count")
        told("tile of count", asked, tile_paths(about, "count", TILES // 4))
        one = [f"{place}?sessions=0" for place in tile_paths(about, "density", TILES // 4)]
        told("tile of one session", asked, one)
        told("click to evidence", asked, places)
        if arguments.append:
            while_appending(path, lambda: told("tiles while a drive is added", asked, density))
        print(f"{'peak memory of the server':34} {asked.peak_mb():.0f} MB")


if __name__ == "__main__":
    main()
