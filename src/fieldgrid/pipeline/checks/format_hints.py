"""Units and axes with which depths or clouds would show the ground, if the declared ones do not.

Files do not state their unit or axes. So some frames are read with other usual units and axes;
those that put the ground where the mounting says are reported.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import permutations

import numpy as np

from fieldgrid.core import FieldgridError
from fieldgrid.geometry import FREE_UP_TO
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline.checks.doubt import probes
from fieldgrid.pipeline.staging.perception import perceive_frame
from fieldgrid.recordings import (
    CloudFile,
    CloudFrame,
    DepthFile,
    DepthFrame,
    Frame,
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


def format_hints(recording: Recording, gridder: LocalGridder, every: int) -> list[str]:
    """What recording.toml could say for the ground to be found in nearly all frames that are tried;
    nothing where no reading helps, or where frames are neither depth images nor clouds of a
    folder."""
    found = defaultdict[str, list[int]](list)
    tried = 0
    for frame in probes(recording, every):
        tried += 1
        for says, other in _hints(frame):
            with suppress(FieldgridError):  # nothing is found in what cannot be read so
                seen = perceive_frame(other, gridder)
                free = seen.grid.observed & (seen.grid.density <= FREE_UP_TO)
                found[says].append(int(np.count_nonzero(free)) if seen.ground.refined else 0)
    enough = max(MOST * tried, 1.0)
    shown = {says: sum(cells) for says, cells in found.items() if np.count_nonzero(cells) >= enough}
    return [says for says, cells in shown.items() if cells >= LIKE_THE_BEST * max(shown.values())]


def hint_sentence(readings: Sequence[str]) -> str:
    """The remedy as a sentence."""
    listed = " or ".join(filter(None, (", ".join(readings[:-1]), readings[-1])))
    which = "it" if len(readings) == 1 else "the right one"
    return f"With {listed} in recording.toml it is where the mounting says; set {which} there."


def _hints(frame: Frame) -> Iterator[tuple[str, Frame]]:
    """Settings of recording.toml, and the frame as it is read with each."""
    if isinstance(frame, DepthFrame) and isinstance(frame.source, DepthFile):
        is_depth = frame.source.format.role == "depth"
        key = "[depth] scale_m" if is_depth else "[disparity] scale_px"
        for unit in DEPTH_SCALES_M if is_depth else DISPARITY_SCALES_PX:
            kind = replace(frame.source.format, unit=unit)
            yield f"{key} = {unit:g}", replace(frame, source=replace(frame.source, format=kind))
    elif isinstance(frame, CloudFrame) and isinstance(frame.source, CloudFile):
        cloud = frame.source.kind
        kinds = {f"scale_m = {one:g}": replace(cloud, scale_m=one) for one in CLOUD_SCALES_M}
        kinds |= {f'axes = "{axes}"': replace(cloud, axes=axes) for axes in _AXES}
        for says, other in kinds.items():
            yield f"[cloud] {says}", replace(frame, source=replace(frame.source, kind=other))


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
