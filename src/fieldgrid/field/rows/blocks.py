"""Rows put in order: blocks, ids from left to right, lanes between neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import Float64
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.measuring.measure import MeasuredRow
from fieldgrid.field.rows.measuring.neighbours import Pair, linked_parts, neighbour_pairs
from fieldgrid.geometry import lengths, part, resampled

_INSET_SPACINGS = 0.25
"""The line of a lane begins this far inside its mouth, so that it lies between both rows."""


class OrderedRows(NamedTuple):
    """Rows of all blocks with their ids, and the pairs of neighbours by the places of rows."""

    rows: list[MeasuredRow]
    block_of: list[str]
    ids: list[str]
    pairs: list[Pair]
    spacing_m: float


class LaneLine(NamedTuple):
    """A lane before it is measured: left and right row, its middle line, its ground."""

    left: int
    right: int
    line: Float64
    area: shapely.Polygon
    distance_m: float


def order_rows(rows: list[MeasuredRow], crop: Crop) -> OrderedRows:
    """Rows by block and from left to right in each; blocks from the one with most rows."""
    if not rows:
        return OrderedRows([], [], [], [], np.nan)
    lines = [row.line for row in rows]
    pairs, spacing = neighbour_pairs(lines, crop)
    links = np.array([(p.left, p.right) for p in pairs]).reshape(-1, 2)
    block = linked_parts(links, len(rows))
    sizes = np.bincount(block, minlength=1)
    places: list[int] = []
    names: list[str] = []
    ids: list[str] = []
    for number, label in enumerate(np.argsort(-sizes, kind="stable"), 1):
        members = np.flatnonzero(block == label)
        along = np.mean([lines[k][-1] - lines[k][0] for k in members], axis=0)
        right = np.array([along[1], -along[0]]) / np.hypot(*along)
        members = members[np.argsort([lines[k].mean(axis=0) @ right for k in members])]
        places += members.tolist()
        names += [f"B{number}"] * len(members)
        ids += [f"B{number}-R{k}" for k in range(1, len(members) + 1)]
    new = {old: k for k, old in enumerate(places)}
    moved = [p._replace(left=new[p.left], right=new[p.right]) for p in pairs]
    moved.sort(key=lambda p: (p.left, p.right))
    return OrderedRows([rows[k] for k in places], names, ids, moved, spacing)


def lane_lines(ordered: OrderedRows) -> list[LaneLine]:
    """The lanes: a middle line and the ground from row to row, where both rows stand."""
    found = []
    for pair in ordered.pairs:
        if not pair.is_lane:
            continue
        middle = resampled(pair.middle, 1.0)
        along = middle[-1] - middle[0]
        along /= np.hypot(*along)
        inset = _INSET_SPACINGS * pair.distance_m
        left, right = ordered.rows[pair.left].line, ordered.rows[pair.right].line
        low = max(((row[0] - middle[0]) @ along) for row in (left, right)) + inset
        high = min(((row[-1] - middle[0]) @ along) for row in (left, right)) - inset
        # Rows of unlike lengths share a stretch; its samples end within a metre of it.
        low, high = max(low, -2.0), min(high, float(lengths(middle)[-1]) + 2.0)
        if high - low < 2.0:
            continue
        s = lengths(middle)
        first, last = middle[1] - middle[0], middle[-1] - middle[-2]
        head = middle[0] + first / np.hypot(*first) * min(low, 0.0)
        tail = middle[-1] + last / np.hypot(*last) * max(high - s[-1], 0.0)
        inner = part(middle, max(low, 0.0), min(high, float(s[-1])))
        before = [head] if low < 0.0 else []
        after = [tail] if high > s[-1] else []
        line = np.array([*before, *inner, *after])
        start, stop = line[0] - inset * along, line[-1] + inset * along
        sides = [_cut(row, start, stop, along) for row in (left, right)]
        area = shapely.Polygon(np.concatenate([sides[0], sides[1][::-1]]))
        if not area.is_valid:
            area = area.buffer(0)
        found.append(LaneLine(pair.left, pair.right, line, area, pair.distance_m))
    return found


def _cut(row: Float64, start: Float64, stop: Float64, along: Float64) -> Float64:
    """The stretch of a row beside a lane, by where its mouths are along it."""
    s, t = lengths(row), (row - row[0]) @ along
    a, b = ((point - row[0]) @ along for point in (start, stop))
    low, high = (float(np.interp(at, t, s)) for at in (a, b))
    return part(row, low, max(high, low + 0.1))


def block_area(
    lines: list[Float64], areas: list[shapely.Polygon], half_m: list[float]
) -> shapely.Polygon:
    """The ground of a block: its rows as wide as they are, and its lanes."""
    rows = [shapely.LineString(line).buffer(half) for line, half in zip(lines, half_m, strict=True)]
    whole = shapely.union_all([*rows, *(area.buffer(0.05) for area in areas)])
    if isinstance(whole, shapely.MultiPolygon):
        # Rows with an unseen one between them hang together by their hull.
        try:
            whole = shapely.concave_hull(whole, ratio=0.1)
        except shapely.GEOSException:  # its triangulation fails on some outlines of many rows
            whole = whole.convex_hull
    return shapely.Polygon(shapely.simplify(whole, 0.05).exterior)
