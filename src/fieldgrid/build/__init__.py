"""The main job, and the only wiring: recordings to a map, or to more sessions of one."""

from fieldgrid.build.perception import Perceived, local_grid, perceive
from fieldgrid.build.report import Progress, SessionReport, StageTimes
from fieldgrid.build.session import (
    add_recording,
    build_map,
    check_output,
    check_poses,
    estimate_trajectory,
    session_config,
)

__all__ = [
    "Perceived",
    "Progress",
    "SessionReport",
    "StageTimes",
    "add_recording",
    "build_map",
    "check_output",
    "check_poses",
    "estimate_trajectory",
    "local_grid",
    "perceive",
    "session_config",
]
