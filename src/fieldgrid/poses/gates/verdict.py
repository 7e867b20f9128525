"""What conditioning may ask of a fix, and what it says of one."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from fieldgrid.core import Bool, GateLimits

REPEATS = "repeats the"
"""How the reasons of fixes begin that a receiver or logger has written again: they are no loss."""


class Gate(StrEnum):
    """Which gate a fix failed, for programs; the sentence beside it is for people.

    `SEAM` belongs to an accepted fix: the solution has moved there. `STRAY` is what the estimate
    of the whole drive denies. `NONE` is a fix without anything to say about it.
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
    STRAY = "stray"
    ACCELERATION = "acceleration"
    TURN_RATE = "turn_rate"
    ALONE = "alone"
    SEAM = "seam"


class Verdicts(NamedTuple):
    """What conditioning made of n fixes: `ok` marks the accepted ones. Of a rejected fix `gate`
    is what it failed and `reason` a clause for people; of an accepted one both are empty, but at
    a seam."""

    ok: Bool
    gate: tuple[Gate, ...]
    reason: tuple[str, ...]


DEFAULT_LIMITS = GateLimits()
