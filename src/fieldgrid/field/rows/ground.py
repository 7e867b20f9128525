"""Lanes and headlands on the cells: free width, what was seen, what stands in the way."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import shapely

from fieldgrid.core import Bool, Float64, Int32, Int64, UInt8
from fieldgrid.field.rows.blocks import LaneLine
from fieldgrid.field.rows.measuring.measure import MeasuredRow
from fieldgrid.geometry import part
from fieldgrid.maps import FREE, OBSTACLE, UNSEEN, Evidence, Strip

_PER_CELL = 1.5
"""Samples a cell along and across a lane: any more than √2 leave no cell out, however it lies."""

_SPECK_M2 = 0.02
"""Obstacle cells that stand alone on less ground are no thing to list; they narrow a lane."""

_CANOPY_MARGIN_M = 0.2
"""Shoots of a row reach this much beyond its face, on average."""

_THING_M2 = 0.04
_PROTRUSION_M = 0.3
_PROTRUSION_M2 = 0.12
"""Obstacle cells that touch a canopy are a thing of their own when they reach this far out of it
and have this area."""

_JOIN_M = 0.12
_OPEN_M = 0.6
_MIN_HEADLAND_M2 = 8.0
_BAND_CELLS = 4_000_000


_SECTION_SEEN = 0.8
"""A cross-section of a lane has a width when this share of it was seen, and a metre when this share
of its cross-sections have a width."""


_SHOOTS_M = 0.07
_WIDTH_SIGMA_M = 0.12
"""Shoots that no cell shows reach this far into a lane, from both sides together; and the standard
deviation of that from metre to metre. Both are of the rendered drives, by `python -m
benchmarks.rows drives`."""

_WHOLE = 0.5
"""A metre has a clear width when this share of its cross-sections do not end where ground was not
seen: such a width is a bound, and no width."""


class LaneGround(NamedTuple):
    """Of a lane: the least free width in every metre along its line, NaN in one that was not seen,
    the share of its ground that was, and how many cells these are.

    `clear_m` is the least width that is likely, NaN where too little was seen to tell, and
    `clear_sigma_m` its standard deviation.
    """

    widths_m: Float64
    known: float
    cells: int
    clear_m: float = math.nan
    clear_sigma_m: float = math.nan


def without_specks(evidence: Evidence, *, of_any_size: bool = False) -> Evidence:
    """The evidence with lone obstacle cells taken for free ground: on less than 0.02 m², or of any
    size. The evidence itself where no cells are that small."""
    # A hundredth of a square metre is not quite 0.1², of which there are two.
    few = int(_SPECK_M2 / evidence.cell_m**2 + 1e-9)
    if few < 2 and not of_any_size:
        return evidence
    few = max(few, 2)
    mask = (evidence.cells == OBSTACLE).astype(np.uint8)
    joined = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    small = stats[:, cv2.CC_STAT_AREA] < few
    small[0] = False
    cells = evidence.cells.copy()
    cells[small[labels] & (mask > 0)] = FREE
    return evidence._replace(cells=cells)


def measure_lane(
    evidence: Evidence,
    filled: Evidence,
    clean: Evidence,
    bare: Evidence,
    lane: LaneLine,
    half_m: tuple[float, float],
) -> LaneGround:
    """The widest free stretch across a lane, between the middles of its rows, all along it.

    Every obstacle cell narrows it. `filled` is the evidence with its pinholes taken for free; what
    is still unseen is not free, and pinholes were not seen. `clean` is the same without lone
    obstacle cells, for the width that is likely, and `bare` without those either that are large.
    """
    reach, step_m = 0.5 * lane.distance_m, evidence.cell_m / _PER_CELL
    strip = evidence.strip(lane.line, reach, reach, step_m, step_m)
    inner = (strip.across_m < reach - half_m[0]) & (strip.across_m > half_m[1] - reach)
    metre = strip.along_m.astype(np.int64)
    widths = np.full(int(metre[-1]) + 1, np.inf)
    if not inner.any():  # rows that nearly touch
        return LaneGround(np.full(len(widths), np.nan), 0.0, 0)
    widest, _ = _widest(filled.strip(lane.line, reach, reach, step_m, step_m).cells)
    is_known = strip.cells[:, inner] != UNSEEN
    cells = round(np.count_nonzero(is_known) / _PER_CELL**2)
    seen = is_known.mean(axis=1)
    is_seen = seen >= _SECTION_SEEN
    np.minimum.at(widths, metre[is_seen], widest[is_seen] * step_m)
    enough = np.bincount(metre, is_seen) >= _SECTION_SEEN * np.bincount(metre)
    told_m = [
        _clear(one.strip(lane.line, reach, reach, step_m, step_m), metre, is_seen)
        for one in (clean, bare)[: 1 if bare is clean else 2]
    ]
    # A lone cell is noise or a thing: where it narrows a lane, the width is one or the other, and
    # the narrower one, which is told, is off by nothing or by all that is between them.
    sigma_m = math.hypot(
        _WIDTH_SIGMA_M, evidence.cell_m / math.sqrt(6.0), math.sqrt(0.5) * (told_m[-1] - told_m[0])
    )
    is_clear = math.isfinite(sigma_m)
    return LaneGround(
        np.where(enough, widths, np.nan),
        float(seen.mean()),
        cells,
        *((max(told_m[0] - _SHOOTS_M, 0.0), sigma_m) if is_clear else ()),
    )


def _clear(strip: Strip, metre: Int64, is_seen: Bool) -> float:
    """The least width of cross-sections that were seen and end at something, metres, of the metres
    that have enough of them; NaN where none has. What was seen to stand in any other narrows the
    lane as well, whatever of its ground was not."""
    clear, is_whole = _widest(strip.cells)
    told = is_seen & is_whole
    least = np.full(int(metre[-1]) + 1, np.inf)
    step_m = float(strip.across_m[1] - strip.across_m[0])
    np.minimum.at(least, metre[told], clear[told] * step_m)
    least = least[np.bincount(metre, told) >= _WHOLE * np.bincount(metre)]
    if not len(least):
        return math.nan
    most, _ = _widest(np.where(strip.cells == UNSEEN, FREE, strip.cells))
    return min(float(least.min()), float(most.min()) * step_m)


def _widest(cells: UInt8) -> tuple[Float64, Bool]:
    """The most samples in a row that are free, of each cross-section of [n, m], and whether none of
    their ends is one of what was seen only."""
    run, longest, last = (np.zeros(len(cells), dtype=np.int64) for _ in range(3))
    for column, is_free in enumerate(np.ascontiguousarray((cells == FREE).T)):
        run += 1
        run *= is_free
        np.copyto(last, column, where=run > longest)
        np.maximum(longest, run, out=longest)
    # A border of free ground: in a gap what reaches the middle of a row ends at nothing unseen.
    framed = np.pad(cells, ((0, 0), (1, 1)), constant_values=FREE)
    at, first = np.arange(len(cells)), last - longest + 1
    is_whole: Bool = (framed[at, last + 2] != UNSEEN) & (framed[at, first] != UNSEEN)
    return longest.astype(np.float64), is_whole & (longest > 0)


def seen_cells(evidence: Evidence, line: shapely.LineString, reach_m: float) -> int:
    """How many cells were seen within `reach_m` of a line, to a sample of them."""
    step_m = evidence.cell_m / _PER_CELL
    strip = evidence.strip(np.asarray(line.coords), reach_m, reach_m, step_m, step_m)
    return round(np.count_nonzero(strip.cells != UNSEEN) / _PER_CELL**2)


def find_things(evidence: Evidence, canopy: UInt8) -> list[tuple[shapely.Polygon, float]]:
    """What stands in lanes, in gaps and beside the rows, whose canopies are a mask of the cells:
    the outline of its obstacle cells, and their area in square metres."""
    obstacle = (evidence.cells == OBSTACLE).astype(np.uint8)
    size = max(1, round(_JOIN_M / evidence.cell_m)) | 1
    beside = cv2.morphologyEx(
        obstacle & ~canopy & 1, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8)
    ) & (~canopy & 1)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(beside, connectivity=8)
    grown = cv2.dilate(canopy & obstacle, np.ones((3, 3), np.uint8))
    touching = np.bincount(labels[grown > 0], minlength=count) > 0
    cell_m2 = evidence.cell_m**2
    found = []
    for k in range(1, count):
        left, top, width, height = (int(v) for v in stats[k, :4])
        window = np.s_[top : top + height, left : left + width]
        mine = labels[window] == k
        area = float((obstacle[window] & mine).sum()) * cell_m2
        least = _PROTRUSION_M2 if touching[k] else _THING_M2
        if area < least or (touching[k] and not _sticks_out(evidence, canopy, window, mine)):
            continue
        j, i = np.nonzero(mine)
        west, south = evidence.origin_m
        corners = np.concatenate([np.column_stack([i + a, j + b]) for a in (0, 1) for b in (0, 1)])
        places = (corners + np.array([left, top])) * evidence.cell_m + (west, south)
        found.append((shapely.MultiPoint(places).convex_hull, area))
    return found


def stray_cells(
    evidence: Evidence, canopy: UInt8, blocks: list[shapely.Polygon]
) -> tuple[int, float]:
    """The number of obstacle cells of blocks beside the canopies of their rows, of which gaps are
    no part, and their share of all obstacle cells of blocks."""
    inside = np.zeros(evidence.cells.shape, dtype=np.uint8)
    for block in blocks:
        fill(inside, evidence, block)
    inside &= evidence.cells == OBSTACLE
    every = int(np.count_nonzero(inside))
    inside &= ~canopy
    stray = int(np.count_nonzero(inside))
    return stray, stray / max(every, 1)


def _sticks_out(evidence: Evidence, canopy: UInt8, window: tuple[slice, slice], mine: Bool) -> bool:
    """Whether some of these cells of a window are at least `_PROTRUSION_M` from the canopy."""
    reach = math.ceil(_PROTRUSION_M / evidence.cell_m) + 2  # beyond it nothing is near enough
    low = [max(part.start - reach, 0) for part in window]
    wide = tuple(slice(a, part.stop + reach) for a, part in zip(low, window, strict=True))
    depth = cv2.distanceTransform((~canopy[wide] & 1).astype(np.uint8), cv2.DIST_L2, 3)
    inside = tuple(
        slice(part.start - a, part.stop - a) for a, part in zip(low, window, strict=True)
    )
    return bool(depth[inside][mine].max() * evidence.cell_m >= _PROTRUSION_M)


def canopies(evidence: Evidence, rows: list[MeasuredRow]) -> UInt8:
    """A mask of the ground that rows cover, their gaps left out."""
    mask = np.zeros(evidence.cells.shape, dtype=np.uint8)
    for row in rows:
        stretches, start = [], -1.0
        for gap in row.extent.gaps_m:
            stretches.append((start, gap[0] + 0.2))
            start = gap[1] - 0.2
        stretches.append((start, row.extent.stop_m + 1.0))
        for low, high in stretches:
            line = part(row.line, max(low, 0.0), min(high, row.extent.stop_m))
            end = 0.5 if high > row.extent.stop_m or low < 0.0 else 0.0
            shape = shapely.LineString(line).buffer(
                row.half_width_m + _CANOPY_MARGIN_M, cap_style="round" if end else "flat"
            )
            fill(mask, evidence, shape)
    return mask


def fill(mask: UInt8 | Int32, evidence: Evidence, shape: shapely.Geometry, value: int = 1) -> None:
    """Set the cells that polygons touch, those in their holes included."""
    for one in shapely.get_parts(shape):
        ring = shapely.get_coordinates(one.exterior) - evidence.origin_m
        corners = np.floor(ring * evidence.lattice.cells_per_m).astype(np.int32)
        cv2.fillPoly(mask, [corners], value)


def find_headlands(
    evidence: Evidence, blocks: list[shapely.Polygon], reach_m: float
) -> list[shapely.Polygon]:
    """Seen free ground beside blocks, up to `reach_m` from them, without narrow strips."""
    beside = np.zeros(evidence.cells.shape, dtype=np.uint8)
    for block in blocks:
        fill(beside, evidence, shapely.Polygon(block.buffer(reach_m).exterior))
    for block in blocks:
        fill(beside, evidence, block, 0)
    beside &= evidence.cells == FREE
    size = max(1, round(_OPEN_M / evidence.cell_m)) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    cv2.morphologyEx(beside, cv2.MORPH_OPEN, kernel, dst=beside)
    return polygons_of(evidence, beside, _MIN_HEADLAND_M2)


def _part_corners(fine: UInt8, mask: UInt8) -> None:
    """Clear the pixels of a mask twice as fine at which two cells meet in a corner alone: an
    outline that leads over a corner twice makes no valid polygon, and mending it takes longest."""
    rows = max(1, _BAND_CELLS // mask.shape[1])
    for first in range(0, len(mask) - 1, rows):
        full = mask[first : first + rows + 1] > 0
        a, b, c, d = full[:-1, :-1], full[:-1, 1:], full[1:, :-1], full[1:, 1:]
        for meet, shifts in (
            (a & d & ~b & ~c, ((1, 1), (2, 2))),
            (b & c & ~a & ~d, ((1, 2), (2, 1))),
        ):
            j, i = np.nonzero(meet)
            for up, right in shifts:
                fine[2 * (j + first) + up, 2 * i + right] = 0


def polygons_of(evidence: Evidence, mask: UInt8, least_m2: float) -> list[shapely.Polygon]:
    """The areas of a mask as polygons with holes, along the outer edges of their cells."""
    # Twice as fine, so that an outline runs along cells' edges and not through their middles.
    fine = np.zeros((2 * mask.shape[0], 2 * mask.shape[1]), dtype=np.uint8)
    for up, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        fine[up::2, right::2] = mask
    _part_corners(fine, mask)
    contours, tree = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    west, south = evidence.origin_m
    half_m = 0.5 * evidence.cell_m

    def ring(contour: np.ndarray) -> Float64:
        return np.asarray((contour[:, 0].astype(np.float64) + 0.5) * half_m + (west, south))

    found = []
    for k, contour in enumerate(contours):
        if tree[0][k][3] >= 0 or len(contour) < 3:
            continue
        holes, child = [], tree[0][k][2]
        while child >= 0:
            if len(contours[child]) >= 3:
                holes.append(ring(contours[child]))
            child = tree[0][child][0]
        shape = shapely.Polygon(ring(contour), holes)
        shape = shapely.simplify(shape if shape.is_valid else shape.buffer(0), evidence.cell_m)
        parts = getattr(shape, "geoms", [shape])
        found += [p for p in parts if isinstance(p, shapely.Polygon) and p.area >= least_m2]
    return found
