"""One map in metres east and north from a stereo camera and a GNSS receiver.

The names below are the whole public surface for a script; each is imported when it is first
used, so that `import fieldgrid` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fieldgrid import figures
    from fieldgrid.align import align_map, undo_alignment
    from fieldgrid.build import (
        add_recording,
        estimate_drive,
        estimate_trajectory,
        local_grid,
        visual_odometry,
    )
    from fieldgrid.changes import find_changes
    from fieldgrid.convert import convert_recording
    from fieldgrid.cost import CostCurve
    from fieldgrid.costmap import Costmap
    from fieldgrid.coverage import Coverage, Tracks, plan_coverage
    from fieldgrid.errors import FieldgridError
    from fieldgrid.evaluation import evaluate, read_truth
    from fieldgrid.export import Selection, export_map
    from fieldgrid.farm import Farm
    from fieldgrid.geodesy import Datum
    from fieldgrid.grids import GridSpec, LocalGrid
    from fieldgrid.inspection import inspect_recording
    from fieldgrid.lattice import Bounds
    from fieldgrid.live import Live
    from fieldgrid.mapfile import Mark, MarkKind, merge_maps, open_map
    from fieldgrid.mounting import estimate_mount
    from fieldgrid.quadtree import Near, Quadtree
    from fieldgrid.recording import DriveOptions, PoseBody, open_drive, open_recording
    from fieldgrid.route import Route, Vehicle, plan_route, read_vehicle
    from fieldgrid.rows import Crop, Planting, find_rows
    from fieldgrid.settings import BuildSettings
    from fieldgrid.trajectory import Pose, Trajectory
    from fieldgrid.transfer import Averaging, Transfer

_HOMES = {
    "Averaging": "transfer",
    "Bounds": "lattice",
    "BuildSettings": "settings",
    "CostCurve": "cost",
    "Costmap": "costmap",
    "Coverage": "coverage",
    "Crop": "rows",
    "Datum": "geodesy",
    "DriveOptions": "recording",
    "Farm": "farm",
    "FieldgridError": "errors",
    "GridSpec": "grids",
    "Live": "live",
    "LocalGrid": "grids",
    "Mark": "mapfile",
    "MarkKind": "mapfile",
    "Near": "quadtree",
    "Planting": "rows",
    "Pose": "trajectory",
    "PoseBody": "recording",
    "Quadtree": "quadtree",
    "Route": "route",
    "Selection": "export",
    "Tracks": "coverage",
    "Trajectory": "trajectory",
    "Transfer": "transfer",
    "Vehicle": "route",
    "add_recording": "build",
    "align_map": "align",
    "convert_recording": "convert",
    "estimate_drive": "build",
    "estimate_mount": "mounting",
    "estimate_trajectory": "build",
    "evaluate": "evaluation",
    "export_map": "export",
    "figures": "",
    "find_changes": "changes",
    "find_rows": "rows",
    "inspect_recording": "inspection",
    "local_grid": "build",
    "merge_maps": "mapfile",
    "open_drive": "recording",
    "open_map": "mapfile",
    "open_recording": "recording",
    "plan_coverage": "coverage",
    "plan_route": "route",
    "read_truth": "evaluation",
    "read_vehicle": "route",
    "undo_alignment": "align",
    "visual_odometry": "build",
}

__all__ = [
    "Averaging",
    "Bounds",
    "BuildSettings",
    "CostCurve",
    "Costmap",
    "Coverage",
    "Crop",
    "Datum",
    "DriveOptions",
    "Farm",
    "FieldgridError",
    "GridSpec",
    "Live",
    "LocalGrid",
    "Mark",
    "MarkKind",
    "Near",
    "Planting",
    "Pose",
    "PoseBody",
    "Quadtree",
    "Route",
    "Selection",
    "Tracks",
    "Trajectory",
    "Transfer",
    "Vehicle",
    "add_recording",
    "align_map",
    "convert_recording",
    "estimate_drive",
    "estimate_mount",
    "estimate_trajectory",
    "evaluate",
    "export_map",
    "figures",
    "find_changes",
    "find_rows",
    "inspect_recording",
    "local_grid",
    "merge_maps",
    "open_drive",
    "open_map",
    "open_recording",
    "plan_coverage",
    "plan_route",
    "read_truth",
    "read_vehicle",
    "undo_alignment",
    "visual_odometry",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # 60 ms, which no command has to wait for

        return version("fieldgrid")
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'fieldgrid' has no attribute {name!r}")
    if not home:
        return importlib.import_module(f"fieldgrid.{name}")
    return getattr(importlib.import_module(f"fieldgrid.{home}"), name)


def __dir__() -> list[str]:
    return __all__
