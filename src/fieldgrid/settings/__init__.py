"""The settings of a build: defaults, over them a TOML file, over that the flags."""

from fieldgrid.settings.declare import Declared, Flag, declared
from fieldgrid.settings.models import (
    BuildSettings,
    DensitySettings,
    GateLimits,
    GridSettings,
    MapSettings,
    MatcherKind,
    PoseSettings,
    StereoSettings,
    Transfer,
)
from fieldgrid.settings.resolve import Overrides, resolve

__all__ = [
    "BuildSettings",
    "Declared",
    "DensitySettings",
    "Flag",
    "GateLimits",
    "GridSettings",
    "MapSettings",
    "MatcherKind",
    "Overrides",
    "PoseSettings",
    "StereoSettings",
    "Transfer",
    "declared",
    "resolve",
]
