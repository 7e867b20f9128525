"""What speaks against the rows that were found: doubts, told beside them.

A row is tested against noise on its own; whether all of them make a field is seen afterwards only.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.rows.crops import Crop
from fieldgrid.rows.ground import Stray
from fieldgrid.rows.result import Doubt, Planting, Row

_IN_LINE = np.cos(np.radians(20.0))
_UNEVEN = 0.25
"""Lanes of one block differ by less than this share of their median."""

_STRAY_SHARE = 0.35
"""At most this share of the obstacle cells in blocks lies on no row."""

_LEAST_STRAY = 100


def find_doubts(planting: Planting, stray: Stray, crop: Crop) -> tuple[Doubt, ...]:
    """The doubts of a planting, of which so many obstacle cells are on no row."""
    if not planting.rows:
        return ()
    return (*_in_pieces(planting, crop), *_uneven(planting), *_stray(planting, stray))


def _in_pieces(planting: Planting, crop: Crop) -> list[Doubt]:
    """Rows that end where another one of their block goes on in line."""
    found = []
    for block in planting.blocks:
        rows = [row for row in planting.rows if row.block == block.id]
        reach_m = min(0.35 * block.spacing_m, 1.5) if block.spacing_m > 0.0 else 0.5
        broken = sorted(
            {
                one.id
                for first in rows
                for second in rows
                if first is not second and _goes_on(first, second, reach_m, crop.max_bridge_m)
                for one in (first, second)
            }
        )
        if broken:
            found.append(
                Doubt(
                    "pieces",
                    tuple(broken),
                    f"{len(broken)} rows of {block.id} end where another begins in line: they may "
                    "be pieces of rows that bend, or lack many plants; --spacing with their "
                    "distance helps where rows are near to each other",
                )
            )
    return found


def _goes_on(first: Row, second: Row, reach_m: float, bridge_m: float) -> bool:
    """Whether the second row begins ahead of where the first one ends, within a lane's part of its
    line."""
    tip, before = _tip(np.asarray(first.line.coords))
    begin, after = _tip(np.asarray(second.line.coords)[::-1])
    ahead = before @ -after
    step = begin - tip
    way = float(step @ before)
    if ahead < _IN_LINE or not -2.0 < way < bridge_m:
        return False
    # Half-way, as far as the two directions lead towards each other.
    off = np.abs((tip + 0.5 * way * before) - (begin + 0.5 * way * after))
    return bool(np.hypot(*off) < reach_m)


def _tip(line: Float64) -> tuple[Float64, Float64]:
    """The last point of a line and the direction out of it, over some metres."""
    inner = line[max(0, len(line) - 5)]
    out = line[-1] - inner
    return line[-1], out / np.hypot(*out)


def _uneven(planting: Planting) -> list[Doubt]:
    """Blocks whose rows are not as far from each other as rows of a block are."""
    lines = {row.id: row.line for row in planting.rows}
    found = []
    for block in planting.blocks:
        lanes = [lane for lane in planting.lanes if lane.block == block.id]
        if len(lanes) < 3:
            continue
        apart = np.array(
            [
                sum(lines[name].distance(middle) for name in lane.rows)
                for lane in lanes
                for middle in [lane.line.interpolate(0.5, normalized=True)]
            ]
        )
        usual = float(np.median(apart))
        odd = [k for k in range(len(lanes)) if abs(apart[k] - usual) > _UNEVEN * usual]
        if odd:
            found.append(
                Doubt(
                    "uneven",
                    tuple(dict.fromkeys(name for k in odd for name in lanes[k].rows)),
                    f"{len(odd)} of {len(lanes)} lanes of {block.id} are {apart[odd].min():.2f} to "
                    f"{apart[odd].max():.2f} m wide from row to row and the others "
                    f"{usual:.2f} m: a row may be wrong, missed, or none",
                )
            )
    return found


def _stray(planting: Planting, stray: Stray) -> list[Doubt]:
    """Obstacle cells among the rows that belong to none of them."""
    if stray.share <= _STRAY_SHARE or stray.cells < _LEAST_STRAY:
        return []
    return [
        Doubt(
            "stray",
            tuple(row.id for row in planting.rows),
            f"{stray.share:.0%} of the obstacle cells in blocks are on no row: rows were missed, or "
            "there is noise, by which rows may be too long; --crop and --spacing say what to look "
            "for, --obstacle-above which cells are plants",
        )
    ]
