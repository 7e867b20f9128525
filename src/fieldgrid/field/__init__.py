"""Field: what a map tells of a field.

* `align`: `align_map` lays the drives of a map on each other by what they saw.
* `changes`: `find_changes`, objects that came or went between two times.
* `rows`: `find_rows`, a `Planting` of rows and lanes with their gaps (the width of a lane:
  `ground`), and doubts about them; `network_of` its lanes, headlands and turns; `find_worked`,
  what a drive worked of them.
* `route`: `plan_route` for a `Vehicle`; every `Route` passes an independent check.
* `coverage`: `plan_coverage`, one way along all lanes, or `Tracks` without rows; `plan_survey`,
  what the lanes of a map lack and a tour that sees it.
* `evaluation`: `evaluate`, a map against surveyed or simulated truth.

It changes nothing in a map but the transforms of its sessions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.field.align.alignment import (
        FINE_ROUNDS as FINE_ROUNDS,
        align_map as align_map,
        undo_alignment as undo_alignment,
    )
    from fieldgrid.field.align.report import (
        DriveAlignment as DriveAlignment,
        MapAlignment as MapAlignment,
        PairAlignment as PairAlignment,
    )
    from fieldgrid.field.changes.find import find_changes as find_changes
    from fieldgrid.field.changes.output import (
        change_features as change_features,
        write_changes as write_changes,
    )
    from fieldgrid.field.changes.result import ChangedObject as ChangedObject, Changes as Changes
    from fieldgrid.field.coverage.area import Tracks as Tracks
    from fieldgrid.field.coverage.plan import Coverage as Coverage, plan_coverage as plan_coverage
    from fieldgrid.field.coverage.survey import (
        SurveyPlan as SurveyPlan,
        need_features as need_features,
        plan_survey as plan_survey,
    )
    from fieldgrid.field.evaluation.against_survey import (
        WITHIN_M as WITHIN_M,
        evaluate_survey as evaluate_survey,
    )
    from fieldgrid.field.evaluation.results import (
        Evaluation as Evaluation,
        GroupScores as GroupScores,
    )
    from fieldgrid.field.evaluation.scores import (
        OBSERVABLE_PIXELS as OBSERVABLE_PIXELS,
        evaluate as evaluate,
    )
    from fieldgrid.field.evaluation.survey import read_survey as read_survey
    from fieldgrid.field.evaluation.truth import read_truth as read_truth
    from fieldgrid.field.route.output import (
        check_route_target as check_route_target,
        write_route as write_route,
    )
    from fieldgrid.field.route.plan import Route as Route, plan_route as plan_route
    from fieldgrid.field.route.vehicle import Vehicle as Vehicle, read_vehicle as read_vehicle
    from fieldgrid.field.rows.crops import Crop as Crop, crop_named as crop_named
    from fieldgrid.field.rows.find import find_rows as find_rows
    from fieldgrid.field.rows.formats.agopengps import write_agopengps as write_agopengps
    from fieldgrid.field.rows.formats.output import (
        check_rows_target as check_rows_target,
        planting_features as planting_features,
        write_planting as write_planting,
    )
    from fieldgrid.field.rows.network import LaneNetwork as LaneNetwork, network_of as network_of
    from fieldgrid.field.rows.report import (
        against_survey as against_survey,
        block_quality as block_quality,
        row_quality as row_quality,
    )
    from fieldgrid.field.rows.result import Lane as Lane, Planting as Planting
    from fieldgrid.field.rows.worked import (
        LaneWork as LaneWork,
        Worked as Worked,
        find_worked as find_worked,
        worked_features as worked_features,
    )
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
