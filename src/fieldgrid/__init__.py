"""One map in metres east and north from a stereo camera and a GNSS receiver.

The names below are the whole public surface for a script; each is imported when it is first
used, so that `import fieldgrid` costs nothing.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.core import BuildSettings as BuildSettings, FieldgridError as FieldgridError
    from fieldgrid.export import (
        Selection as Selection,
        export_map as export_map,
        figures as figures,
    )
    from fieldgrid.field import (
        Coverage as Coverage,
        Crop as Crop,
        Planting as Planting,
        Route as Route,
        Tracks as Tracks,
        Vehicle as Vehicle,
        align_map as align_map,
        evaluate as evaluate,
        find_changes as find_changes,
        find_rows as find_rows,
        plan_coverage as plan_coverage,
        plan_route as plan_route,
        plan_survey as plan_survey,
        read_truth as read_truth,
        read_vehicle as read_vehicle,
        undo_alignment as undo_alignment,
    )
    from fieldgrid.geometry import (
        Bounds as Bounds,
        Datum as Datum,
        GridSpec as GridSpec,
        LocalGrid as LocalGrid,
        Pose as Pose,
        Trajectory as Trajectory,
    )
    from fieldgrid.live import Live as Live
    from fieldgrid.maps import (
        Averaging as Averaging,
        CostCurve as CostCurve,
        Costmap as Costmap,
        Farm as Farm,
        Mark as Mark,
        MarkKind as MarkKind,
        Near as Near,
        Quadtree as Quadtree,
        Transfer as Transfer,
        merge_maps as merge_maps,
        open_map as open_map,
    )
    from fieldgrid.pipeline import (
        add_recording as add_recording,
        convert_recording as convert_recording,
        estimate_drive as estimate_drive,
        estimate_mount as estimate_mount,
        estimate_trajectory as estimate_trajectory,
        inspect_recording as inspect_recording,
        local_grid as local_grid,
        visual_odometry as visual_odometry,
    )
    from fieldgrid.recordings import (
        DriveOptions as DriveOptions,
        PoseBody as PoseBody,
        open_drive as open_drive,
        open_recording as open_recording,
    )
else:
    _get, __dir__, __all__ = door(__name__, __file__)

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version  # 60 ms, which no command has to wait for

            return version("fieldgrid")
        moved = sys.modules.get(f"{__name__}.{name}")  # after `import fieldgrid.layers`
        return _get(name) if moved is None else moved


_SHOWN = {
    "build": "pipeline",
    "build.repose": "pipeline",
    "evaluation": "field",
    "fixes": "geometry",
    "layers": "maps",
    "live_servers": "live",
    "publish": "core",
    "recording": "recordings",
    "recording.growing": "recordings",
    "rectify": "perception",
    "rig": "geometry",
    "ros.gnss": "recordings",
    "trajectory": "geometry",
    "transfer": "maps",
}
"""Modules that the documentation of version 0.1.0 imports from, and where their names are now."""


class _Moved(ModuleType):
    """A module whose names are those of another one, which is imported when one is asked for."""

    def __init__(self, name: str, home: str) -> None:
        super().__init__(name, f"Moved to `{home}`.")
        self._home = home

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self._home), name)


for _old, _home in _SHOWN.items():
    sys.modules[f"{__name__}.{_old}"] = _Moved(f"{__name__}.{_old}", f"{__name__}.{_home}")
