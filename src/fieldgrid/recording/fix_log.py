"""A GNSS log as it comes out of a file: fixes, what moves the vehicle, and remarks."""

from __future__ import annotations

from typing import NamedTuple

from fieldgrid.gnss import Fix
from fieldgrid.motion import Motion


class FixLog(NamedTuple):
    """The fixes of a log in its order, remarks on it, and the motion that it also holds."""

    fixes: tuple[Fix, ...]
    notes: tuple[str, ...] = ()
    motion: Motion = Motion()
