"""What `verify` costs beside reading the file once: `python -m benchmarks.verifying [MAP...]`.

In processor time, which other programs on the machine change little: of this process, and of the
others that share its work. What takes longest of them is the time on idle cores.
"""

from __future__ import annotations

import hashlib
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from fieldgrid.maps import MapFile, open_map
from tests.maps.file.maps import drive, write_map

FRAMES, MANY = 200, 1000
RUNS = 5


class _Cost(NamedTuple):
    """Processor time of this process and of the others that it started, seconds."""

    here_s: float
    others_s: float


def main() -> None:
    """Print the seconds of both, and their ratio, for made maps or those that are named."""
    if sys.argv[1:]:
        for name in sys.argv[1:]:
            _verify(Path(name))
        return
    with tempfile.TemporaryDirectory() as folder:
        for frames in (FRAMES, MANY):
            path = Path(folder) / f"{frames}.gpkg"
            write_map(path, [drive(frames), drive(frames, start=7)])
            _verify(path)
        _verify_deep(Path(folder) / f"{FRAMES}.gpkg")


def _verify(path: Path) -> None:
    """By the map's sums, interleaved with reading the file."""
    with open_map(path) as universal:
        works: dict[str, Callable[[], object]] = {
            "read once, SHA-256": lambda: hashlib.sha256(path.read_bytes()),
            "verify --jobs 1": lambda: universal.verify(1),
            "verify --jobs 2": lambda: universal.verify(2),
        }
        print(f"{path.name}, {path.stat().st_size / 1e6:.1f} MB")
        _print(_costs(works))
    command = [sys.executable, "-m", "fieldgrid", "verify", str(path)]
    least = min(
        _cost(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(RUNS)
    )
    print(f"  {'the whole command':<32}{sum(least):8.3f} s")


def _verify_deep(path: Path) -> None:
    """From the frames, beside decoding each once."""
    with open_map(path) as universal:
        universal.verify(deep=True)  # what is compiled is not its doing
        print(f"{path.name}, everything made again")
        _print(
            _costs(
                {
                    "read once, every frame decoded": lambda: _decode(universal),
                    "verify --deep --jobs 1": lambda: universal.verify(1, deep=True),
                }
            )
        )


def _costs(works: dict[str, Callable[[], object]]) -> dict[str, _Cost]:
    """The least of some runs of each, which take turns."""
    runs = [{name: _cost(work) for name, work in works.items()} for _ in range(RUNS)]
    return {name: min((run[name] for run in runs), key=sum) for name in works}


def _print(costs: dict[str, _Cost]) -> None:
    first = sum(next(iter(costs.values())))
    for name, (here_s, others_s) in costs.items():
        others = f" and {others_s:.3f} s in others" if others_s > 0.001 else ""
        times = max(here_s, others_s) / first
        print(f"  {name:<32}{here_s:8.3f} s{others}, {times:.1f} x")


def _decode(universal: MapFile) -> None:
    for record in universal.frames(with_grid=True):
        record.cells()


def _cost(work: Callable[[], object]) -> _Cost:
    here_s, others_s = time.process_time(), _others_s()
    work()
    return _Cost(time.process_time() - here_s, _others_s() - others_s)


def _others_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
