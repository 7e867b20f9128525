"""Which times can be UTC, and how an instant is written for a reader."""

from __future__ import annotations

from typing import Literal

import numpy as np

MIN_TIME_NS = 315_964_800_000_000_000
"""1980-01-06, when GPS time began: what is stamped earlier is not UTC in nanoseconds."""

MAX_TIME_NS = 1 << 62  # the year 2116


def utc_text(time_ns: int, unit: Literal["ms", "ns"] = "ms") -> str:
    """Nanoseconds since 1970, UTC, as ISO 8601 to the millisecond or the nanosecond."""
    return str(np.datetime_as_string(np.datetime64(int(time_ns), "ns"), unit=unit)) + "Z"
