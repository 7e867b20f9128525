"""Fixes of a GNSS receiver: the columns of a log, a row of it, and how sure each fix is."""

from fieldgrid.fixes.accuracy import (
    known_codes,
    least_sigma_m,
    position_sigma_m,
    quality_by_sigma,
)
from fieldgrid.fixes.columns import NOT_SAID, Fix, FixColumns

__all__ = [
    "NOT_SAID",
    "Fix",
    "FixColumns",
    "known_codes",
    "least_sigma_m",
    "position_sigma_m",
    "quality_by_sigma",
]
