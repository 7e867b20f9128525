"""`python -m benchmarks.good_receivers [MAPS]`: what alignment does to three drives with RTK.

The logs of the two rendered vineyard drives with other slow errors of 1.5 cm for each drive, so
that nothing is gained by moving any. Data beside the repository in ../shared/data.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.align import pose_errors
from benchmarks.changes import EARLY, LATE, RTK, build, jittered
from benchmarks.heading_scores import DATA
from fieldgrid.field import align_map
from fieldgrid.maps import open_map


def three(folder: Path, number: int) -> tuple[list[float], list[float], list[float]]:
    """Of three drives: how far they lay from the truth and lie after alignment, and how far each
    was moved, on the mean over its poses, cm."""
    names = {"one": EARLY, "two": LATE, "three": LATE if number % 2 else EARLY}
    drives = [
        (
            name,
            drive,
            jittered(DATA / drive / "gnss" / RTK, folder / f"{name}.nmea", 3 * number + k),
        )
        for k, (name, drive) in enumerate(names.items(), 1)
    ]
    path = build(folder / f"{number}.gpkg", drives)
    with open_map(path, writable=True) as universal:
        errors = [
            pose_errors(universal, name, DATA / drive)[:, :2] for name, drive in names.items()
        ]
        universal.set_transforms(align_map(universal).transforms)
        after = [pose_errors(universal, name, DATA / drive)[:, :2] for name, drive in names.items()]
    means = [[e.mean(axis=0) for e in some] for some in (errors, after)]
    moved = np.subtract(means[1], means[0])
    was, now, by = ((100.0 * np.hypot(*np.transpose(some))).tolist() for some in (*means, moved))
    return was, now, by


def main() -> None:
    """Print a line for each map, and the median and the worst."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="?", type=int, default=5)
    given = parser.parse_args()
    if not (DATA / LATE).exists():
        print("../shared/data is not there; left out")
        return
    every = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(given.maps):
            found = three(Path(folder), number)
            every.append(found)
            lines = (" ".join(f"{cm:4.1f}" for cm in some) for some in found)
            print("three RTK drives off the truth {}, after {}, moved {} cm".format(*lines))
    for what, some in zip(
        ("off", "off after", "moved"), np.array(every).transpose(1, 0, 2), strict=True
    ):
        print(f"{what}: median {np.median(some):.1f}, worst {some.max():.1f} cm")


if __name__ == "__main__":
    main()
