"""Routes that work the lanes of a planting, one after the other."""

from fieldgrid.coverage.plan import Coverage, LeftOut, Worked, coverage_in_view, plan_coverage

__all__ = ["Coverage", "LeftOut", "Worked", "coverage_in_view", "plan_coverage"]
