"""A GNSS log as it comes out of a file: fixes, what moves the vehicle, and remarks."""

from __future__ import annotations

from typing import NamedTuple

from fieldgrid.fixes import FixColumns
from fieldgrid.motion import Motion


class FixLog(NamedTuple):
    """The fixes of a log in its order, remarks on it, and the motion that it also holds."""

    fixes: FixColumns
    notes: tuple[str, ...] = ()
    motion: Motion = Motion()
