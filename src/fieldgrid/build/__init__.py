"""The main job, and the only wiring: recordings to a map, or to more sessions of one."""

from fieldgrid.build.drives import build_map
from fieldgrid.build.perception import Perception, local_grid, perceive, visual_odometry
from fieldgrid.build.poses import cell_budget, check_poses, estimate_drive, estimate_trajectory
from fieldgrid.build.report import (
    BadFrame,
    PartlyBuiltError,
    Progress,
    SessionReport,
    StageTimes,
)
from fieldgrid.build.session import add_recording, check_output, session_config

__all__ = [
    "BadFrame",
    "PartlyBuiltError",
    "Perception",
    "Progress",
    "SessionReport",
    "StageTimes",
    "add_recording",
    "build_map",
    "cell_budget",
    "check_output",
    "check_poses",
    "estimate_drive",
    "estimate_trajectory",
    "local_grid",
    "perceive",
    "session_config",
    "visual_odometry",
]
