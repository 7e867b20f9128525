"""Roads across rows: where all rows of a block have a hole side by side, they end and others begin.

Rows on both sides of a road often stand in line, and a hole in one row says nothing: plants are
missing. A hole in every row from the first to the last is a way through, unless rows lack that many
plants that some of their holes lie side by side by chance.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import Float64
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.measuring.extent import Extent, Span
from fieldgrid.field.rows.measuring.measure import MeasuredRow
from fieldgrid.field.rows.measuring.neighbours import Pair, linked_parts, neighbour_pairs
from fieldgrid.geometry import lengths, part, project

_ROAD_M = 2.5
"""A way across rows is no narrower."""

_LEAST_ROWS = 4
"""In fewer rows plants may be missing side by side by chance."""

_SHARED = 0.25
"""Holes lie side by side when they share this part of the shorter one: a road may be oblique."""

_PIECE = 0.6
"""A piece of a row is a row when it has this share of the shortest one."""


_BY_CHANCE = 0.01
"""The expected number of sets of holes, of holes that lie anywhere, that are as well in line as
those of a road; a road has fewer."""

_IN_LINE_M = 0.5
"""The best alignment that the holes of a road can have: rows end where plants do."""

_RAGGED_M = 0.6
"""The edges of a road are straighter than this, root mean square: half a vine's place."""

_SURE_ROWS = 8
"""The number of rows from which on the edges of a road may be ragged."""


class DoubtfulRoad(NamedTuple):
    """Holes side by side, a line each, that may be a road or lack plants, and which it was taken
    for."""

    holes: tuple[shapely.LineString, ...]
    is_road: bool


class _Hole(NamedTuple):
    """A hole of a row, by its number, from and to along it, and whether its ground was seen."""

    row: int
    span_m: Span
    is_seen: bool


def split_at_roads(
    rows: list[MeasuredRow], crop: Crop
) -> tuple[list[MeasuredRow], list[DoubtfulRoad]]:
    """The rows, those that a road crosses as one on each side of it, and the roads in doubt."""
    holes = [
        _Hole(k, span, is_seen)
        for k, row in enumerate(rows)
        for spans, is_seen in ((row.extent.gaps_m, True), (row.extent.unseen_m, False))
        for span in spans
        if span[1] - span[0] >= _ROAD_M
    ]
    if sum(hole.is_seen for hole in holes) < _LEAST_ROWS:
        return rows, []
    pairs, _ = neighbour_pairs([row.line for row in rows], crop)
    cuts: dict[int, list[Span]] = {}
    doubtful = []
    # The one in most rows first: holes of a road are no missing plants.
    missing = set(holes)
    for road in sorted(_roads(rows, holes, pairs), key=lambda one: -_row_count(one)):
        others = missing - set(road)
        first = rows[road[0].row].line
        along = (first[-1] - first[0]) / np.hypot(*(first[-1] - first[0]))
        left = np.array([-along[1], along[0]])
        ends = np.array([part(rows[hole.row].line, *hole.span_m)[[0, -1]] for hole in road])
        s, across = (ends - first[0]) @ along, (ends - first[0]) @ left
        s.sort(axis=1)
        edges_m: Float64 = np.empty(s.shape)
        for edge in (0, 1):
            design = np.column_stack([np.ones(len(s)), across[:, edge]])
            edges_m[:, edge] = (
                s[:, edge] - design @ np.linalg.lstsq(design, s[:, edge], rcond=None)[0]
            )
        is_road = _chance(rows, road, edges_m, others) <= _BY_CHANCE
        if is_road:
            missing = others
            for hole in road:
                cuts.setdefault(hole.row, []).append(hole.span_m)
        # Of each edge two numbers were fitted.
        off_m = np.sqrt((edges_m**2).sum(axis=0) / max(len(edges_m) - 2, 1)).min()
        if not is_road or (_row_count(road) < _SURE_ROWS and off_m > _RAGGED_M):
            lines = tuple(
                shapely.LineString(part(rows[hole.row].line, *hole.span_m)) for hole in road
            )
            doubtful.append(DoubtfulRoad(lines, is_road))
    pieces = [_pieces(row, sorted(cuts.get(k, [])), crop) for k, row in enumerate(rows)]
    return list(itertools.chain.from_iterable(pieces)), doubtful


def _row_count(road: list[_Hole]) -> int:
    return len({hole.row for hole in road})


def _chance(
    rows: list[MeasuredRow], road: list[_Hole], edges_m: Float64, others: set[_Hole]
) -> float:
    """How many sets of holes are expected by chance to be in line as those of a road, where the
    other holes of its rows lie wherever they like: some begin one, the second row gives it any
    direction, and those of each further one have to lie on its line."""
    own = {hole.row for hole in road}
    total_m = sum(rows[k].extent.stop_m for k in own)
    sizes = [hole.span_m[1] - hole.span_m[0] for hole in others if hole.row in own]
    if not sizes:
        return 0.0
    per_m = len(sizes) / total_m
    road_m = float(np.mean([hole.span_m[1] - hole.span_m[0] for hole in road]))
    off_m = max(
        float(np.sqrt((edges_m.mean(axis=1) ** 2).sum() / max(len(road) - 2, 1))), _IN_LINE_M
    )
    any_way = min(per_m * (road_m + float(np.mean(sizes))), 1.0)
    return len(sizes) / len(own) * any_way * min(per_m * 4.0 * off_m, 1.0) ** (len(own) - 2)


def _roads(rows: list[MeasuredRow], holes: list[_Hole], pairs: list[Pair]) -> list[list[_Hole]]:
    """Holes side by side that no row beside them closes."""
    of_row: dict[int, list[int]] = {}
    for place, hole in enumerate(holes):
        of_row.setdefault(hole.row, []).append(place)
    links, closed = [], np.zeros(len(holes), dtype=np.bool_)
    both = [(pair.left, pair.right) for pair in pairs if pair.is_lane]
    for row, other in both + [pair[::-1] for pair in both]:
        for place in of_row.get(row, []):
            # Along the other row, which runs the same way or against this one.
            ends_m = part(rows[row].line, *holes[place].span_m)[[0, -1]]
            along_m = project(ends_m, rows[other].line)[0]
            low, high = float(along_m.min()), float(along_m.max())
            size = rows[other].extent.stop_m
            shares = [
                (min(high, span[1]) - max(low, span[0])) / min(high - low, span[1] - span[0])
                for span in (holes[at].span_m for at in of_row.get(other, []))
            ]
            met = [at for at, share in zip(of_row.get(other, []), shares, strict=True)
                   if share >= _SHARED]  # fmt: skip
            links += [(place, at) for at in met]
            # A row that ends before the hole, or begins after it, leaves it open.
            closed[place] |= not met and low > 0.0 and high < size
    label = linked_parts(np.array(links).reshape(-1, 2), len(holes))
    found = []
    for number in range(int(label.max()) + 1):
        places = np.flatnonzero(label == number)
        road = [holes[place] for place in places]
        if not closed[places].any() and len({h.row for h in road if h.is_seen}) >= _LEAST_ROWS:
            found.append(road)
    return found


def _pieces(row: MeasuredRow, cuts: list[Span], crop: Crop) -> list[MeasuredRow]:
    """A row without some stretches; all of it when a piece would be no row."""
    starts = [0.0, *(cut[1] for cut in cuts)]
    spans = list(zip(starts, [*(cut[0] for cut in cuts), row.extent.stop_m], strict=True))
    if len(spans) < 2 or min(b - a for a, b in spans) < _PIECE * crop.min_row_m:
        return [row]
    along, whole, found = lengths(row.line), sum(b - a for a, b in spans), []
    for start, stop in spans:
        line = part(row.line, start, stop)
        gaps, unseen = (
            tuple((a - start, b - start) for a, b in holes if start <= a and b <= stop)
            for holes in (row.extent.gaps_m, row.extent.unseen_m)
        )
        first_seen, last_seen = row.extent.ends_seen
        ends_seen = start > 0.0 or first_seen, stop < row.extent.stop_m or last_seen
        found.append(
            row._replace(
                line=line,
                sigma_m=np.interp(start + lengths(line), along, row.sigma_m),
                extent=Extent(0.0, stop - start, gaps, unseen, ends_seen),
                cells=round(row.cells * (stop - start) / whole),
            )
        )
    return found
