"""What `verify` costs beside reading the file once: `python -m benchmarks.verifying [MAP...]`.

In processor time, which other programs on the machine change little.
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

from fieldgrid.maps import MapFile, open_map
from tests.maps.file.maps import drive, write_map

FRAMES, MANY = 200, 1000
RUNS = 5


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
            "verify": universal.verify,
        }
        print(f"{path.name}, {path.stat().st_size / 1e6:.1f} MB")
        _print(_costs(works))
    command = [sys.executable, "-m", "fieldgrid", "verify", str(path)]
    least_s = min(
        _cost_s(lambda: subprocess.run(command, check=True, capture_output=True))
        for _ in range(RUNS)
    )
    print(f"  {'the whole command':<32}{least_s:8.3f} s")


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


def _costs(works: dict[str, Callable[[], object]]) -> dict[str, float]:
    """The least of some runs of each, which take turns."""
    runs = [{name: _cost_s(work) for name, work in works.items()} for _ in range(RUNS)]
    return {name: min(run[name] for run in runs) for name in works}


def _print(costs: dict[str, float]) -> None:
    first_s = next(iter(costs.values()))
    for name, cost_s in costs.items():
        print(f"  {name:<32}{cost_s:8.3f} s, {cost_s / first_s:.1f} x")


def _decode(universal: MapFile) -> None:
    for record in universal.frames(with_grid=True):
        record.cells()


def _cost_s(work: Callable[[], object]) -> float:
    before_s = _used_s()
    work()
    return _used_s() - before_s


def _used_s() -> float:
    """Processor time of this process and of those that it started."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
