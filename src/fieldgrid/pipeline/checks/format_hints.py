"""Units and axes with which depths or clouds would show the ground, if the declared ones do not.

Files do not state their unit or axes. So some frames are read with other usual units and axes;
those that put the ground where the mounting says are reported.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from fieldgrid.core import FieldgridError, Float32
from fieldgrid.geometry import FREE_UP_TO, LocalGrid
from fieldgrid.perception import FrameGround, LocalGridder, Sweep
from fieldgrid.pipeline.checks.doubt import probes
from fieldgrid.recordings import (
    CloudFile,
    CloudFrame,
    DepthFile,
    DepthFrame,
    Frame,
    Image,
    Recording,
    check_axes,
)

DEPTH_SCALES_M = (1.0, 0.1, 0.01, 0.001, 0.0001, 0.0002)
"""Metres, tenths, centimetres, millimetres, tenths of these; and 5000 a metre, as of TUM's sets."""

DISPARITY_SCALES_PX = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 128, 1 / 256)
CLOUD_SCALES_M = (1.0, 0.1, 0.01, 0.001, 0.0001)

MOST = 0.8
"""The share of the frames tried in which the ground must be found."""

LIKE_THE_BEST = 0.5
"""The share of the free ground of the best reading that a reading must show: walls and crowns that
are taken for ground show a fifth of it."""


@dataclass(frozen=True, slots=True)
class _FreeGround:
    """How many cells of free ground a frame shows; 0 where the ground is not found."""

    gridder: LocalGridder

    def pair(self, left: Image, right: Image) -> int:
        return _free(*self.gridder(left, right))

    def depth(self, depth_m: Float32) -> int:
        return _free(*self.gridder.from_depth(depth_m))

    def cloud(self, sweep: Sweep) -> int:
        return _free(*self.gridder.from_cloud(sweep.points_m))


def _free(grid: LocalGrid, ground: FrameGround) -> int:
    free = grid.observed & (grid.density <= FREE_UP_TO)
    return int(np.count_nonzero(free)) if ground.refined else 0


def format_hints(recording: Recording, gridder: LocalGridder, every: int) -> list[str]:
    """What recording.toml could say for the ground to be found in nearly all frames that are tried;
    nothing where no reading helps, or where frames are neither depth images nor clouds of a
    folder."""
    reader = _FreeGround(gridder)
    found = defaultdict[str, list[int]](list)
    tried = 0
    for frame in probes(recording, every):
        tried += 1
        for says, other in _hints(frame):
            try:
                found[says].append(other.read(reader))
            except FieldgridError:  # so nothing is found in it
                continue
    enough = max(MOST * tried, 1.0)
    free = {says: sum(cells) for says, cells in found.items() if np.count_nonzero(cells) >= enough}
    return [says for says, cells in free.items() if cells >= LIKE_THE_BEST * max(free.values())]


def hint_sentence(readings: Sequence[str]) -> str:
    """The remedy as a sentence."""
    listed = " or ".join(filter(None, (", ".join(readings[:-1]), readings[-1])))
    which = "it" if len(readings) == 1 else "the right one"
    return f"With {listed} in recording.toml it is where the mounting says; set {which} there."


def _hints(frame: Frame) -> Iterator[tuple[str, Frame]]:
    """Settings of recording.toml, and the frame as it is read with each."""
    if isinstance(frame, DepthFrame) and isinstance(frame.source, DepthFile):
        is_depth = frame.source.format.role == "depth"
        for unit in DEPTH_SCALES_M if is_depth else DISPARITY_SCALES_PX:
            source = replace(frame.source, format=replace(frame.source.format, unit=unit))
            says = f"[depth] scale_m = {unit:g}" if is_depth else f"[disparity] scale_px = {unit:g}"
            yield says, replace(frame, source=source)
    elif isinstance(frame, CloudFrame) and isinstance(frame.source, CloudFile):
        cloud = frame.source
        for scale_m in CLOUD_SCALES_M:
            says = f"[cloud] scale_m = {scale_m:g}"
            yield (
                says,
                replace(frame, source=replace(cloud, kind=replace(cloud.kind, scale_m=scale_m))),
            )
        for axes in _AXES:
            says = f'[cloud] axes = "{axes}"'
            yield says, replace(frame, source=replace(cloud, kind=replace(cloud.kind, axes=axes)))


def _right_handed() -> Iterator[str]:
    """All 24."""
    for order in permutations("flu"):
        for signs in range(8):
            axes = "".join(
                axis if signs >> k & 1 else {"f": "b", "l": "r", "u": "d"}[axis]
                for k, axis in enumerate(order)
            )
            try:
                yield check_axes(axes)
            except ValueError:
                continue


_AXES = tuple(_right_handed())
