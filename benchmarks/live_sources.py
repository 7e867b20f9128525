"""`python -m benchmarks.live_sources`: what sources of a live session and the feed take of a core.

Processor time of one look at a folder that holds so many pairs, of the bytes of a receiver, and of
a window for controllers; the median of many, and the worst.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import EXAMPLE
from fieldgrid.geometry import Datum, FixColumns, Lattice, Window
from fieldgrid.live import LiveWindow, ReceiverStream, WindowDoubt
from fieldgrid.live.servers.feed import encode_window
from fieldgrid.maps import Costmap, MapView
from fieldgrid.recordings import open_growing

RUNS = 21
FIRST_NS, EVERY_NS = 1_308_133_815_000_000_000, 100_000_000


def main() -> None:
    """Measure and print."""
    print(f"{'processor time, ms':<46}{'median':>9}{'worst':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for pairs in (1_000, 36_000):
            _folders(Path(folder) / str(pairs), pairs)
    log = (EXAMPLE / "gnss" / "gnss_rtk.nmea").read_bytes()
    stream = ReceiverStream()
    parts = [log[k : k + 2_000] for k in range(0, len(log), 2_000)]
    _say("2000 bytes of NMEA to fixes", [_timed(lambda p=part: stream.feed(p)) for part in parts])
    window = _window(800)
    times_s = [_timed(lambda: encode_window(window, 1)) for _ in range(RUNS)]
    _say(f"a window of 800 x 800 cells, {len(encode_window(window, 1)) / 1e6:.1f} MB", times_s)


def _folders(folder: Path, pairs: int) -> None:
    """A look at a folder in which one pair is new, by names and by the table."""
    shutil.copytree(EXAMPLE / "calibration", folder / "calibration")
    names = [str(FIRST_NS + EVERY_NS * k) for k in range(pairs + 2 * RUNS)]
    for side in ("left", "right"):
        (folder / side).mkdir()
    for name in names[:pairs]:
        _touch(folder, name)
    growing = open_growing(folder)
    growing.new_shots()
    times_s = []
    for name in names[pairs : pairs + RUNS]:
        _touch(folder, name)
        times_s.append(_timed(growing.new_shots))
    _say(f"a look at {pairs} pairs, by names", times_s)
    table = folder / "frames.csv"
    table.write_text("frame_id,time_ns,left,right\n" + "".join(map(_row, names[:pairs])))
    growing = open_growing(folder)
    growing.new_shots()
    times_s = []
    for name in names[pairs + RUNS :]:
        with table.open("a") as file:
            file.write(_row(name))
        times_s.append(_timed(growing.new_shots))
    _say(f"a look at {pairs} pairs, by the table", times_s)


def _touch(folder: Path, name: str) -> None:
    for side in ("left", "right"):
        (folder / side / f"{name}.png").touch()


def _row(name: str) -> str:
    return f"{name},{name},left/{name}.png,right/{name}.png\n"


def _window(side: int) -> LiveWindow:
    random = np.random.default_rng(0)
    shape = (side, side)
    observed = random.random(shape) > 0.5
    density = random.integers(0, 256, shape, dtype=np.uint8)
    place = Window(0, 0, side, side)
    view = MapView(
        Lattice(0.05), place, density, observed, Datum(41.65, -4.72, 787.4), is_base=True
    )
    age_s = np.where(observed, random.uniform(0.0, 60.0, shape), np.nan).astype(np.float32)
    costmap = Costmap.from_view(view)
    return LiveWindow(
        *(FIRST_NS, costmap, view, age_s, age_s * 0.01, None, "", 1, "", None, WindowDoubt.NONE),
        *(0, FixColumns.of([]), np.zeros(0, dtype=np.bool_)),
    )


def _timed(run: Callable[[], Any]) -> float:
    start_s = time.process_time()
    run()
    return time.process_time() - start_s


def _say(what: str, times_s: list[float]) -> None:
    print(f"{what:<46}{1e3 * float(np.median(times_s)):>9.2f}{1e3 * max(times_s):>9.2f}")


if __name__ == "__main__":
    main()
