"""Where to drive next in layouts of real vineyards: what is driven, and how long the tour is.

`python -m benchmarks.survey [NUMBER...]` (default 7 14 5 35 16) leaves a fifth of the lanes of each
layout unseen, plans a survey, and prints the lanes of which less than half is known and those that
the tour drives; of up to six lanes also its length beside that of the shortest one, found by
planning the way between every two of them.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.coverage import Task, best_of
from benchmarks.fields import layout, sides_of_lanes
from benchmarks.planting import Planting as Stand, Sight, seen_view
from fieldgrid.field import Planting, SurveyPlan, Vehicle
from fieldgrid.field.coverage.survey import survey_in_view, walled
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.maps import MapView

_UNSEEN = 0.2
_EXACT = 6
_CELL_M = 0.2


def shortest_m(view: MapView, planting: Planting, plan: SurveyPlan) -> float:
    """The length of the shortest tour over the lanes of a plan."""
    vehicle = plan.coverage.route.vehicle
    task = Task(walled(view, planting), plan.coverage.planting, vehicle, is_open=False)
    return best_of(task, allow_unknown=True).length_m


def main(numbers: list[int]) -> None:
    """Print what of each layout is surveyed."""
    vehicle = Vehicle(width_m=0.7, turning_radius_m=2.0)
    for number in numbers:
        known = layout(number)
        sides = sides_of_lanes(known.rows, _UNSEEN, np.random.default_rng(number))
        sight = Sight(sides=sides, noise_per_m2=0.0, hole_share=0.0, margin_m=12.0, headland_m=12.0)
        seen = seen_view(Stand(known.rows, 0.35, known.missing), sight, _CELL_M)
        count = np.where(seen.observed, 5, 0)
        view = replace(seen, is_base=True, layers={"count": count})
        planting = rows_of_view(view)
        began = time.process_time()
        plan = survey_in_view(view, planting, vehicle)
        unseen = [lane.id for lane in planting.lanes if lane.known < 0.5]
        driven = [lane.lane for lane in plan.coverage.lanes]
        ratio = ""
        if len(driven) <= _EXACT:
            length_m = plan.coverage.route.length_m
            ratio = f", {length_m / shortest_m(view, planting, plan):.3f} of the shortest"
        print(
            f"layout {number:2}: not seen {', '.join(unseen)}; driven {', '.join(driven)}; "
            f"{plan.share:.0%} of what is not known, {plan.coverage.route.length_m:.0f} m{ratio}, "
            f"{time.process_time() - began:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main([int(number) for number in sys.argv[1:]] or [7, 14, 5, 35, 16])
