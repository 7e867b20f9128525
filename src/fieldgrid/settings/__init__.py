"""The settings of a build: defaults, over them a TOML file, over that the flags."""

from fieldgrid.settings.declare import (
    DeclaredSetting,
    Flag,
    Settings,
    declared,
    first_problem,
    setting,
)
from fieldgrid.settings.models import (
    BuildSettings,
    CheckSettings,
    DensitySettings,
    GateLimits,
    GearSpan,
    GridSettings,
    MapSettings,
    PoseSettings,
    StereoSettings,
)
from fieldgrid.settings.resolve import Overrides, resolve

__all__ = [
    "BuildSettings",
    "CheckSettings",
    "DeclaredSetting",
    "DensitySettings",
    "Flag",
    "GateLimits",
    "GearSpan",
    "GridSettings",
    "MapSettings",
    "Overrides",
    "PoseSettings",
    "Settings",
    "StereoSettings",
    "declared",
    "first_problem",
    "resolve",
    "setting",
]
