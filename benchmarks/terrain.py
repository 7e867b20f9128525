"""`python -m benchmarks.terrain`: what wrong frames and wrong drives do to the ground's height.

A hillside of 8° is driven along several times; frames and drives have errors of which the truth is
known. Beside the map's height stands the weighted mean over all frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import GROUND_CHANNEL, GridSpec, Lattice, LocalGrid, Pose, Window
from fieldgrid.maps import (
    GROUPS,
    LAYERS,
    Cells,
    FrameCells,
    Transfer,
    WindowFold,
    groups_of,
    to_universal,
)
from fieldgrid.maps.layers.blocks import COLUMN_BITS, block_points, block_side, blocks_under
from fieldgrid.maps.layers.built_in.ground import halvings
from fieldgrid.maps.layers.window import merge_sessions, with_overviews

SPEC = GridSpec(width_m=6.0, length_m=10.0, cell_m=0.1)
LATTICE, WINDOW = Lattice(0.1), Window(-60, 0, 120, 320)
RISE_EAST, RISE_NORTH = math.tan(math.radians(8.0)), 0.03
NOISE_M, TILT_DEG = 0.02, 0.1
SEEDS = 8

Frame = tuple[Pose, np.ndarray]


class Errors(NamedTuple):
    """What is wrong in a field: the 1-sigma error that each drive states and has, the offsets of
    wrong drives, and the share of frames that are off by an offset, all over or in a patch."""

    stated_m: float
    drives: int = 1
    wrong_drives_m: Sequence[float] = ()
    share: float = 0.0
    wrong_m: float = 0.0
    patch_m: float = math.inf


CASES = {
    "centimetre receiver": Errors(0.02),
    "canopy of 0.3 m for ground in a patch, 20 % of the frames": Errors(0.02, 1, (), 0.2, 0.3, 2.0),
    "canopy of 1.5 m, 30 %": Errors(0.02, 1, (), 0.3, 1.5, 2.0),
    "frames 0.5 m too low, 30 %": Errors(0.02, 1, (), 0.3, -0.5),
    "frames 4.1 m too high, 30 %": Errors(0.02, 1, (), 0.3, 4.1),
    "three drives, one 0.5 m too high": Errors(0.02, 3, (0.5,)),
    "four drives, one 1.8 m too low": Errors(0.02, 4, (-1.8,)),
    "five drives, one 4 m too high": Errors(0.02, 5, (4.0,)),
    "decimetre receiver": Errors(0.2),
    "two drives with it": Errors(0.2, 2),
    "six drives with it": Errors(0.2, 6),
    "six drives with it, one 1.5 m too high": Errors(0.2, 6, (1.5,)),
}


LEAST_FRAMES = 5
"""Places are scored that so many frames of each drive saw: elsewhere nothing may contradict what is
wrong."""


def main() -> None:
    """Print the errors of each case."""
    print("ground: RMSE, 95 %, worst, cm; within 3 sigma and without a height, %; RMSE of the mean")
    for name, errors in CASES.items():
        found = [measured(errors, seed) for seed in range(SEEDS)]
        error, sigma, mean = (np.concatenate(values) for values in zip(*found, strict=True))
        known = np.isfinite(error)
        away, within = np.abs(error[known]), np.abs(error[known]) <= 3.0 * sigma[known]
        print(
            f"  {name:<58}{100 * rms(away):6.1f}{100 * np.percentile(away, 95):6.1f}"
            f"{100 * away.max():6.1f}{100 * within.mean():7.1f}{100 * (~known).mean():6.1f}   mean"
            f" {100 * rms(mean):6.1f}"
        )


def rms(error: Float64) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def measured(errors: Errors, seed: int) -> tuple[Float64, Float64, Float64]:
    """Of the cells that were seen: the error of the height, its sigma, the error of the mean."""
    random = np.random.default_rng(seed)
    drives = []
    for k in range(errors.drives):
        wrong = errors.wrong_drives_m[k] if k < len(errors.wrong_drives_m) else 0.0
        # Receivers know heights half as well as places.
        off_m = wrong + random.normal(0.0, 2.0 * errors.stated_m)
        drives.append(list(drive(errors, off_m, random)))
    groups = [GROUPS[name] for name in groups_of(["ground"])]
    total: Cells | None = None
    for frames in drives:
        fold = WindowFold(LATTICE, WINDOW, Transfer.CENTRE, groups)
        for pose, heights_cm in frames:
            seen = np.ones(SPEC.shape, np.bool_)
            grid = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), seen)
            fold.add(FrameCells(grid, {GROUND_CHANNEL: heights_cm}), pose)
        total = fold.cells() if total is None else merge_sessions(groups, total, fold.cells())
    assert total is not None
    cells = with_overviews(groups, total)
    east, north = LATTICE.centres(WINDOW)
    side_m = block_side(LATTICE) * LATTICE.cell_m
    # A block has one height: that of its middle.
    true = height_m(*np.meshgrid(*((np.floor(v / side_m) + 0.5) * side_m for v in (east, north))))
    found, sigma = (LAYERS[name].values(cells) for name in ("ground", "ground_sigma"))
    sums = [sums_of(frames) for frames in drives]
    scored = np.min([frames for frames, _, _ in sums], axis=0) >= LEAST_FRAMES
    _, weight, weighted = np.sum(sums, axis=0)
    mean = weighted[scored] / weight[scored]
    return (found - true)[scored], sigma[scored], mean - true[scored]


def height_m(east: Float64, north: Float64) -> Float64:
    """The true ground."""
    return RISE_EAST * east + RISE_NORTH * north


def drive(errors: Errors, off_m: float, random: np.random.Generator) -> Iterator[Frame]:
    """Frames along a row, there and back."""
    x, y = SPEC.centres_m()
    for k in range(30):
        heading = 0.0 if k % 2 == 0 else 180.0
        place = (random.normal(0.0, 0.3), k if heading == 0.0 else k + 2.0)
        up_m = float(height_m(*map(np.asarray, place))) + off_m + random.normal(0.0, NOISE_M)
        pose = Pose(k + 1, *place, up_m, heading, errors.stated_m, 0.3, 1.0)
        east, north = to_universal(x[None], y[:, None], pose)
        tilt = np.tan(np.radians(random.normal(0.0, TILT_DEG, 2)))
        seen_m = height_m(east, north) - up_m + off_m + tilt[0] * x + tilt[1] * y[:, None]
        seen_m += random.normal(0.0, 0.01, SPEC.shape)
        if random.random() < errors.share:
            centre = (0.0, 5.0) if errors.patch_m < math.inf else (0.0, 0.0)
            away = np.maximum(np.abs(x - centre[0])[None], np.abs(y - centre[1])[:, None])
            seen_m = seen_m + np.where(away <= errors.patch_m, errors.wrong_m, 0.0)
        yield pose, np.rint(100.0 * seen_m).astype(np.int16)


def sums_of(frames: Sequence[Frame]) -> Float64:
    """How many frames saw the cells of the window, their weights, and weights times heights,
    [3, rows, columns]."""
    side = block_side(LATTICE)
    under = blocks_under(WINDOW, side)
    sums = np.zeros((3, under.height * under.width))
    for pose, heights_cm in frames:
        block, cell = block_points(SPEC, pose, LATTICE, WINDOW)
        row, column = cell[:, 0] >> COLUMN_BITS, cell[:, 0] & ((1 << COLUMN_BITS) - 1)
        weight = 2.0 ** halvings(SPEC, pose.up_sigma_m)[row]
        height = pose.up_m + heights_cm[row, column] / 100.0
        sums[:, block] += np.stack([np.ones(block.size), weight, weight * height])
    return np.repeat(np.repeat(sums.reshape(3, *under.shape), side, axis=1), side, axis=2)


if __name__ == "__main__":
    main()
