"""What the example's map weighs, and what making and using it costs: `python -m
benchmarks.example_map`.

The commands run as users run them, each in a process of its own, and take turns with the bare
matcher over the example's pairs. Their processor times are printed as ratios to the matcher's.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

import cv2

import fieldgrid as fg
from benchmarks import EXAMPLE
from benchmarks.timing import timed_s

RUNS = 5
DISPARITIES, BLOCK = 128, 5


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "two_lanes.gpkg"
        commands = {
            "start": ["--version"],
            "build": f"build {EXAMPLE} -o {path} --overwrite --gnss gnss_rtk.nmea".split(),
            "show": f"show {path} -o {folder / 'map.png'} --overwrite".split(),
            "verify": f"verify {path}".split(),
            "export tif": f"export {path} {folder / 'map.tif'} --overwrite".split(),
        }
        matcher_s: list[float] = []
        spent_s: dict[str, list[float]] = {what: [] for what in commands}
        for _ in range(RUNS):
            matcher_s.append(timed_s(match)[1])
            for what, arguments in commands.items():
                spent_s[what].append(run_s(arguments))
        print(f"bare matcher, {DISPARITIES} disparities: {median(matcher_s):.2f} s")
        for what, seconds in spent_s.items():
            print(f"{what}: {median(seconds) / median(matcher_s):.2f} x the bare matcher")
        size = path.stat().st_size
        cells = observed_cells(path)
        print(f"map: {size} bytes, {cells} cells, {size / cells:.2f} bytes a cell")


def match() -> None:
    """The bare matcher over the pairs of the example, decoded."""
    mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY
    matcher = cv2.StereoSGBM_create(0, DISPARITIES, BLOCK, mode=mode)
    for left in sorted((EXAMPLE / "left").iterdir()):
        pair = (left, EXAMPLE / "right" / left.name)
        matcher.compute(*(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pair))


def run_s(arguments: list[str]) -> float:
    """Seconds of processor time of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "fieldgrid", *arguments]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def observed_cells(path: Path) -> int:
    """The cells that any frame saw."""
    with fg.open_map(path) as universal:
        return int(universal.read().observed.sum())


if __name__ == "__main__":
    main()
