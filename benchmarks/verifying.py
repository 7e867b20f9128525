"""What `verify` costs beside reading the file once: `python -m benchmarks.verifying`."""

from __future__ import annotations

import hashlib
import tempfile
import time
from pathlib import Path

from fieldgrid.mapfile import open_map
from tests.mapfile.maps import drive, write_map

FRAMES = 200
RUNS = 3


def main() -> None:
    """Print the seconds of both, and their ratio."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_map(Path(folder) / "map.gpkg", [drive(FRAMES), drive(FRAMES, start=7)])
        with open_map(path) as universal:
            universal.verify(deep=True)  # what is compiled is not its doing
        hashing_s = min(_seconds(lambda: hashlib.sha256(path.read_bytes())) for _ in range(RUNS))
        print(f"map of {2 * FRAMES} frames, {path.stat().st_size / 1e6:.1f} MB")
        print(f"read once, SHA-256                {hashing_s:8.3f} s")
        with open_map(path) as universal:
            decoding_s = min(_seconds(lambda: _decode(universal)) for _ in range(RUNS))
            print(f"read once, every frame decoded    {decoding_s:8.3f} s")
            for deep, jobs in ((False, 1), (False, 2), (True, 1), (True, 2)):
                taken_s = min(
                    _seconds(lambda jobs=jobs, deep=deep: universal.verify(jobs, deep=deep))
                    for _ in range(RUNS)
                )
                command = f"verify {'--deep ' if deep else ''}--jobs {jobs}"
                print(
                    f"{command:<34}{taken_s:8.3f} s, "
                    f"{taken_s / hashing_s:.1f} x the file, {taken_s / decoding_s:.1f} x its frames"
                )


def _decode(universal):  # type: ignore[no-untyped-def]
    for record in universal.frames(with_grid=True):
        record.cells()


def _seconds(work) -> float:  # type: ignore[no-untyped-def]
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
