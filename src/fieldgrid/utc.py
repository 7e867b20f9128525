"""How an instant is written for a reader."""

from __future__ import annotations

from typing import Literal

import numpy as np


def utc_text(time_ns: int, unit: Literal["ms", "ns"] = "ms") -> str:
    """Nanoseconds since 1970, UTC, as ISO 8601 to the millisecond or the nanosecond."""
    return str(np.datetime_as_string(np.datetime64(int(time_ns), "ns"), unit=unit)) + "Z"
