"""`python -m benchmarks.row_step`: maps by `--row-step 2` beside those by every image row.

The rendered drives with RTK, as they are and with worse images, against their truth; and a street,
whose truth nobody knows, against the map by every row. Data beside the repository in ../shared/data
are left out where they are absent.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from benchmarks import EXAMPLE
from benchmarks.align import LATER, ROAD, SLOPE
from benchmarks.damages import seen
from fieldgrid.core import Bool, UInt8, resolve
from fieldgrid.field import evaluate, read_truth
from fieldgrid.maps import MapView, open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

OBSTACLE_ABOVE = 100
"""Densities above this are obstacles."""


def noisy(image: UInt8) -> UInt8:
    """With noise of 12 grey levels."""
    random = np.random.default_rng(int(image.sum()))
    return np.clip(image + random.normal(0.0, 12.0, image.shape), 0, 255).astype(np.uint8)


def pressed(image: UInt8) -> UInt8:
    """As a JPEG of quality 25."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 25])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def blurred(image: UInt8) -> UInt8:
    """Out of focus by a pixel and a half."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.5))


IMAGES: dict[str, Callable[[UInt8], UInt8] | None] = {
    "as they are": None,
    "noise of 12 grey levels": noisy,
    "JPEG of quality 25": pressed,
    "out of focus by 1.5 px": blurred,
    "an eighth of the light": lambda image: (image // 8).astype(np.uint8),
}


def truths() -> Iterator[str]:
    """Each rendered drive: precision and recall within 10 cm, free cells with an obstacle."""
    yield f"{'':<26}{'':<20}{'precision 10 cm':>20}{'recall 10 cm':>20}{'free!':>20}"
    for drive in (one for one in (EXAMPLE, LATER, SLOPE) if one.exists()):
        for name, change in IMAGES.items():
            with tempfile.TemporaryDirectory() as place:
                folder = Path(place) / "drive"
                shutil.copytree(drive, folder)
                if change is not None:
                    seen(change, "left right")(folder)
                every, pairs = (_scores(folder, row_step) for row_step in (1, 2))
            cells = "".join(
                f"{f'{one:.1%} -> {other:.1%}' if k < 2 else f'{one:.2%} -> {other:.2%}':>20}"
                for k, (one, other) in enumerate(zip(every, pairs, strict=True))
            )
            yield f"{drive.name:<26}{name:<20.20}{cells}"


def _scores(drive: Path, row_step: int) -> tuple[float, float, float]:
    settings = resolve(
        None,
        {"stereo": {"row_step": row_step}, "checks": {"accept": ["camera-yaw", "clock-offset"]}},
    )
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "map.gpkg"
        build_map([drive], out, settings, DriveOptions("gnss_rtk.nmea"))
        with open_map(out) as universal:
            all_frames = evaluate(universal, read_truth(drive / "truth")).groups[-1].obstacles
    scores = all_frames.precision["0.10"], all_frames.recall["0.10"], all_frames.free_with_obstacle
    return tuple(np.nan if one is None else one for one in scores)


def street() -> Iterator[str]:
    """Shares of the obstacle cells of a street that have one of the other map near by."""
    if not ROAD.exists():
        return
    every = _obstacles({})
    yield f"\n{'a street, obstacle cells':<26}{'within 10 cm':>20}{'within 25 cm':>20}"
    for name, stereo in (
        ("--row-step 2", {"row_step": 2}),
        ("--matcher sgbm", {"matcher": "sgbm"}),
    ):
        other = _obstacles(stereo)
        shares = _near(every, other), _near(other, every)
        yield f"{name:<26}" + "".join(
            f"{f'{there:.0%}, {back:.0%}':>20}" for there, back in zip(*shares, strict=True)
        )


def _obstacles(stereo: dict[str, object]) -> tuple[Bool, MapView]:
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "map.gpkg"
        grid = {"width_m": 20.0, "length_m": 15.0}
        build_map([ROAD], out, resolve(None, {"stereo": stereo, "grid": grid}))
        with open_map(out) as universal:
            view = universal.read()
    return view.observed & (view.density > OBSTACLE_ABOVE), view


def _near(one: tuple[Bool, MapView], other: tuple[Bool, MapView]) -> tuple[float, float]:
    """The shares of one map's obstacle cells with an obstacle of the other within 10 and 25 cm."""
    (cells, view), (others, beside) = one, other
    whole = view.window.union(beside.window)
    there = np.zeros(whole.shape, dtype=np.bool_)
    there[whole.slices_of(beside.window)] = others
    away_m = distance_transform_edt(~there)[whole.slices_of(view.window)][cells]
    away_m = away_m * view.lattice.cell_m
    return float((away_m <= 0.1).mean()), float((away_m <= 0.25).mean())


if __name__ == "__main__":
    for lines in (truths(), street()):
        for line in lines:
            print(line, flush=True)
