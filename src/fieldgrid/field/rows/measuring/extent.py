"""Where along its line a row stands: its ends, its gaps, and what of it was not seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from fieldgrid.core import Bool, Float64, UInt8
from fieldgrid.field.rows.crops import Crop
from fieldgrid.maps import OBSTACLE, UNSEEN, Evidence

_OCCUPIED = 0.15
"""A stretch with this share of the row's usual cells is a part of it."""

_HALF = 0.5
"""A gap begins where the share of obstacle cells has fallen to half: a blur of the evidence moves
that place to neither side."""

_END = 0.3
"""A row ends with its last shoots or its post, which are thinner than the row."""

_OVERHANG_M = 0.3
"""The line of a row ends a canopy's half width, or this, before its last cells do."""

_POST_M = 0.8
_POST_WIDTH = 0.6
_POST_HOLE_M = 0.2
"""An end post with its brace stands apart from the plants, is no longer, and is narrower than so
much of the canopy. The row ends on its inner side."""

_BEYOND_M = 0.5
_BEYOND_SEEN = 0.5
"""The end of a row was seen when this share of the ground within `_BEYOND_M` behind its last cells
was seen."""

_REACH = 1.5
_REACH_M = 2.0
"""How far beyond a hole plants are counted, in its lengths and at least."""

_FEW = 2.5
"""The number of bare places of single plants up to which the next plant still belongs to the row.
"""

_PLANT = 0.3
"""A piece with less than this share of the usual cells at its densest place is a speck."""

_STEP_M = 0.1
_CELLS = 8
"""Cells that a mean along the row is to have, where the evidence is thin."""

_LOCAL_M = 2.0
_GAP_SEEN = 0.6
"""A hole is a gap when this share of its ground was seen; else nobody knows."""

_THING_M = 1.05
_SMALL_THING_M = 0.6
_HOLE_M = (0.3, 0.8)
_CLEAR_HOLE_M = 1.0
"""A person or a pile of rocks in a gap is shorter than a plant, with some hole on one side and a
clear one on the other. Two clear holes with nearly a plant between them are two weak plants."""

_SPACE_M = 0.15
_PER_SPACE_M = 4.0
"""Plants of a row stand apart from each other when there is a small hole in every stretch of this
length."""

_EDGE_M = 1.0
"""Between a gap and the end of its row there is a plant; an end post is none."""

Span = tuple[float, float]


class Extent(NamedTuple):
    """Distances along a line, metres: where the row begins and ends, its gaps, and the stretches
    of which too little was seen to say. `ends_seen` tells of its beginning and its end whether the
    ground beyond was seen: else the row may go on."""

    start_m: float
    stop_m: float
    gaps_m: tuple[Span, ...]
    unseen_m: tuple[Span, ...]
    ends_seen: tuple[bool, bool] = (True, True)


def runs(flags: Bool) -> list[tuple[int, int]]:
    """The stretches [first, last + 1) in which flags are True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def connected_run(weight: Float64, step_m: float, crop: Crop) -> tuple[int, int] | None:
    """The stretch of a line that is one row: the longest run of cells, and runs beyond its holes.

    What lies beyond a hole belongs to the row if it is long for that hole, in one piece or, where
    plants are missing one by one, in several: a trailer that stands in line with a row does not
    lengthen it, and a speck in a hole does not end it. A single plant is as long as its place in
    the row, where few are missing. None when there is no run.
    """
    some = weight > 0.0
    if not some.any():
        return None
    pieces = runs(uniform_filter1d(weight, 3) > _OCCUPIED * float(np.median(weight[some])))
    if crop.are_single:
        pieces = plants_among(weight, pieces)
    parts = _closed(pieces, crop.plant_spacing_m / step_m)
    first = last = int(np.argmax([b - a for a, b in parts]))

    def is_more(k: int, hole: int, beyond: slice) -> bool:
        """Whether what is beyond a hole of this length is more of the row: plants over half of the
        hole's length, a metre at least, within one and a half times its length from part k on."""
        least = max(1.0 / step_m, 0.5 * hole)
        if hole * step_m > crop.max_bridge_m:
            return False
        place = crop.plant_spacing_m / step_m
        if (crop.are_single and hole <= _FEW * place) or parts[k][1] - parts[k][0] >= least:
            return True
        reach = max(_REACH * hole, _REACH_M / step_m)
        near = [min(b, parts[k][0] + reach) - max(a, parts[k][1] - reach) for a, b in parts[beyond]]
        return sum(max(plants, 0.0) for plants in near) >= least

    # A speck in a hole is passed over.
    for k in range(first - 1, -1, -1):
        is_row = is_more(k, parts[first][0] - parts[k][1], slice(0, k + 1))
        first = k if is_row else first
    for k in range(last + 1, len(parts)):
        is_row = is_more(k, parts[k][0] - parts[last][1], slice(k, len(parts)))
        last = k if is_row else last
    return parts[first][0], parts[last][1]


def plants_among(weight: Float64, pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The pieces that are as dense as plants: specks between and beyond single ones are not."""
    peaks = np.array([weight[a:b].max() for a, b in pieces])
    order = peaks.argsort()
    cells = np.array([weight[a:b].sum() for a, b in pieces])[order].cumsum()
    # Half of all cells are in pieces at least so dense.
    usual = peaks[order][np.searchsorted(cells, 0.5 * cells[-1])]
    return [piece for piece, peak in zip(pieces, peaks, strict=True) if peak >= _PLANT * usual]


def _closed(parts: list[tuple[int, int]], hole: float) -> list[tuple[int, int]]:
    joined = [parts[0]]
    for a, b in parts[1:]:
        if a - joined[-1][1] <= hole:
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    return joined


def find_extent(
    evidence: Evidence, line: Float64, faces_m: tuple[float, float], crop: Crop
) -> Extent | None:
    """Ends and gaps of a row along its fitted line, which reaches beyond them.

    `faces_m` is how far the canopy reaches to the left (positive) and the right (negative).
    """
    strip = evidence.strip(line, faces_m[0] + 0.1, 0.1 - faces_m[1], _STEP_M)
    obstacle = (strip.cells == OBSTACLE).sum(axis=1).astype(np.float64)
    if not obstacle.any():
        return None
    usual = float(np.median(obstacle[obstacle > 0.0]))
    window = int(np.clip(np.ceil(_CELLS / usual), 3, 15))
    dense = uniform_filter1d(obstacle, window, mode="constant")
    usual = float(np.median(dense[dense > 0.0]))
    span = connected_run(dense, _STEP_M, crop)
    if span is None:
        return None
    start, stop = _end(dense, span), len(dense) - _end(dense[::-1], span, mirrored=True)
    core = np.abs(strip.across_m - sum(faces_m) / 2.0) < 0.35 * (faces_m[0] - faces_m[1])
    seen = (strip.cells[:, core] != UNSEEN).mean(axis=1)
    gaps, unseen = _holes(dense > _HALF * usual, (start, stop), seen, crop)

    def metres(part: tuple[int, int]) -> Span:
        return part[0] * _STEP_M, part[1] * _STEP_M

    width_m = faces_m[0] - faces_m[1]
    strips = strip.cells[start:], strip.cells[:stop][::-1]
    before_m, after_m = (_overhang_m(cells, strip.across_m, width_m) for cells in strips)
    reach = round(_BEYOND_M / _STEP_M)
    beyond = seen[max(start - reach, 0) : start], seen[stop : stop + reach]
    return Extent(
        start * _STEP_M + before_m,
        stop * _STEP_M - after_m,
        tuple(map(metres, gaps)),
        tuple(map(metres, unseen)),
        (_is_seen(beyond[0]), _is_seen(beyond[1])),
    )


def _is_seen(seen: Float64) -> bool:
    return bool(len(seen) and seen.mean() >= _BEYOND_SEEN)


def _overhang_m(cells: UInt8, across_m: Float64, width_m: float) -> float:
    """How far the cells [n, m] of a row from one end on reach beyond the end of its line: half of
    a canopy of that width, or an end post."""
    usual_m = min(_OVERHANG_M, 0.5 * width_m)
    some = (cells == OBSTACLE)[: round((_POST_M + 2.0 * _POST_HOLE_M) / _STEP_M)]
    hole = round(_POST_HOLE_M / _STEP_M)
    bare = [a for a, b in runs(~some.any(axis=1)) if b - a >= hole and a > 0]
    if not bare or bare[0] * _STEP_M > _POST_M + _STEP_M:
        return usual_m
    columns = np.flatnonzero(some[: bare[0]].any(axis=0))
    if np.ptp(across_m[columns]) > _POST_WIDTH * width_m:
        return usual_m
    return max(usual_m, bare[0] * _STEP_M)


def _end(dense: Float64, span: tuple[int, int], *, mirrored: bool = False) -> int:
    """Where a row begins: the first place that has half of what the next metres have."""
    first = len(dense) - span[1] if mirrored else span[0]
    local = round(_LOCAL_M / _STEP_M)
    plateau = float(np.median(dense[first : first + local]))
    above = np.flatnonzero(dense[first : first + local] >= _END * plateau)
    return first + int(above[0]) if len(above) else first


def _holes(
    occupied: Bool, span: tuple[int, int], seen: Float64, crop: Crop
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Gaps, and stretches that were not seen.

    A person or a pile of rocks in a gap does not divide it.
    """
    start, stop = span
    holes = [(start + a, start + b) for a, b in runs(~occupied[start:stop])]
    small = sum(_SPACE_M <= (b - a) * _STEP_M <= _HOLE_M[1] for a, b in holes)
    # Where plants stand apart all along, one beside a gap has a small hole on its other side, too.
    is_apart = small * _PER_SPACE_M > (stop - start) * _STEP_M
    joined: list[tuple[int, int]] = []
    for a, b in holes:
        if joined and not is_apart and _is_thing(joined[-1], (a, b), crop):
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    least_m = crop.min_gap_m - 0.5 * _STEP_M
    edge = round(_EDGE_M / _STEP_M)
    gaps, unseen = [], []
    for hole in [(a, b) for a, b in joined if (b - a) * _STEP_M >= least_m]:
        bare = _bare(hole, seen, least_m)
        gaps += [(a, b) for a, b in bare if a - start >= edge and stop - b >= edge]
        edges = [hole[0], *(place for part in bare for place in part), hole[1]]
        between = zip(edges[::2], edges[1::2], strict=True)
        unseen += [(a, b) for a, b in between if (b - a) * _STEP_M >= least_m]
    return gaps, unseen


def _bare(hole: tuple[int, int], seen: Float64, least_m: float) -> list[tuple[int, int]]:
    """What is a gap of a hole: all of it where its ground was seen, else the stretches that were.
    Where few cells of a row show, or it is seen through others, a hole reaches beyond the gap."""
    if seen[slice(*hole)].mean() >= _GAP_SEEN:
        return [hole]
    is_seen = uniform_filter1d(seen, 5)[slice(*hole)] >= _GAP_SEEN
    return [(hole[0] + a, hole[0] + b) for a, b in runs(is_seen) if (b - a) * _STEP_M >= least_m]


def _is_thing(before: tuple[int, int], after: tuple[int, int], crop: Crop) -> bool:
    """Whether what lies between two holes is rather a thing in a gap than a plant."""
    if crop.plant_spacing_m > 2.0 * _THING_M:
        return False
    holes = sorted(round((b - a) * _STEP_M, 6) for a, b in (before, after))
    length = round((after[0] - before[1]) * _STEP_M, 6)
    most = crop.min_gap_m if length <= _SMALL_THING_M else _HOLE_M[1]
    return length <= _THING_M and _HOLE_M[0] <= holes[0] < most and holes[1] >= _CLEAR_HOLE_M
