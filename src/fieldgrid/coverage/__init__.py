"""Routes that work the lanes of a planting, or parallel tracks, one after the other."""

from fieldgrid.coverage.area import Tracks
from fieldgrid.coverage.plan import (
    Coverage,
    OmittedLane,
    Swaths,
    WorkedLane,
    coverage_in_view,
    plan_coverage,
)

__all__ = [
    "Coverage", "OmittedLane", "Swaths", "Tracks", "WorkedLane", "coverage_in_view",
    "plan_coverage",
]  # fmt: skip
