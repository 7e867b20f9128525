"""What conditioning may ask of a fix, and what it says of one."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from fieldgrid.settings import GateLimits
from fieldgrid.trajectory import Status


class Kind(StrEnum):
    """Which gate a fix failed, for programs; the sentence beside it is for people.

    `SEAM` belongs to an accepted fix: the solution has moved there. `NONE` is a fix without
    anything to say about it.
    """

    NONE = ""
    PLACE = "place"
    QUALITY = "quality"
    SATELLITES = "satellites"
    HDOP = "hdop"
    AGE = "age"
    TIME = "time"
    REPEAT = "repeat"
    JUMP = "jump"
    ACCELERATION = "acceleration"
    TURN_RATE = "turn_rate"
    CLIMB = "climb"
    ALONE = "alone"
    SEAM = "seam"


class Verdict(NamedTuple):
    """What conditioning made of a fix; a rejected one has its reason in words."""

    status: Status
    reason: str = ""
    kind: Kind = Kind.NONE


DEFAULT_LIMITS = GateLimits()
