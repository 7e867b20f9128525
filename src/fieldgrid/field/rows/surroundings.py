"""What lies about the rows: headlands at their ends, and obstacles off their canopies."""

from __future__ import annotations

import numpy as np
import shapely

from fieldgrid.field.rows.blocks import OrderedRows
from fieldgrid.field.rows.drives import Reach
from fieldgrid.field.rows.ground import find_headlands
from fieldgrid.field.rows.result import Headland, Lane, Obstacle
from fieldgrid.maps import Evidence


def headlands_of(
    evidence: Evidence,
    ordered: OrderedRows,
    areas: dict[str, shapely.Polygon],
    reach_m: float,
    reach: Reach,
) -> tuple[Headland, ...]:
    """The headlands at the ends of rows, of at most `reach_m`; `areas` are those of the blocks."""
    if not areas:
        return ()
    ends = [(row.line[0], row.line[-1]) for row in ordered.rows]
    found, counts = [], 0
    for area in find_headlands(evidence, list(areas.values()), reach_m):
        # Of the end of the rows that it is nearest to, over all of them.
        near = [[area.distance(shapely.Point(end)) for end in pair] for pair in ends]
        start, stop = (min(pair[k] for pair in near) for k in (0, 1))
        closest = int(np.argmin([min(pair) for pair in near]))
        if min(start, stop) > 3.0:
            continue
        counts += 1
        near_to = [k for k, at in enumerate(("start", "stop")) if min(p[k] for p in near) <= 3.0]
        end = "both" if len(near_to) == 2 else ("start", "stop")[near_to[0]]
        sessions, pose_sigma_m = reach.of(area)
        found.append(
            Headland(f"H{counts}", ordered.block_of[closest], end, area, float(area.area),
                     _of_cells(evidence, pose_sigma_m), round(area.area / evidence.cell_m**2),
                     sessions)
        )  # fmt: skip
    return tuple(found)


def obstacles_of(
    evidence: Evidence,
    things: list[tuple[shapely.Polygon, float]],
    ordered: OrderedRows,
    lanes: tuple[Lane, ...],
    reach: Reach,
) -> tuple[Obstacle, ...]:
    """Things that stand off the canopies, each with the lane and the row that it stands in."""
    rows = [shapely.LineString(row.line) for row in ordered.rows]
    found = []
    for number, (outline, area_m2) in enumerate(things, 1):
        shared = [lane.area.intersection(outline).area for lane in lanes]
        best = int(np.argmax(shared)) if shared and max(shared) > 0.0 else -1
        distance = [line.distance(outline.centroid) for line in rows]
        on = int(np.argmin(distance)) if distance else -1
        sessions, pose_sigma_m = reach.of(outline)
        is_on_row = on >= 0 and distance[on] < ordered.rows[on].half_width_m
        found.append(
            Obstacle(
                f"O{number}",
                lanes[best].id if best >= 0 else "",
                ordered.ids[on] if is_on_row else "",
                outline,
                area_m2,
                _of_cells(evidence, pose_sigma_m),
                round(area_m2 / evidence.cell_m**2),
                sessions,
            )
        )
    return tuple(found)


def _of_cells(evidence: Evidence, pose_sigma_m: float) -> float:
    """The standard deviation of an outline that runs along cells: theirs, and that of the poses."""
    return float(np.hypot(pose_sigma_m, evidence.cell_m / np.sqrt(12.0)))
