"""How an instant is written for a reader."""

from __future__ import annotations

import numpy as np


def utc_text(time_ns: int) -> str:
    """Nanoseconds since 1970, UTC, as ISO 8601 to the millisecond."""
    return str(np.datetime_as_string(np.datetime64(int(time_ns), "ns"), unit="ms")) + "Z"
