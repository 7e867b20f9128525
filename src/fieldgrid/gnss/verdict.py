"""What conditioning may ask of a fix, and what it says of one."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field

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


class GateLimits(BaseModel):
    """What a fix must satisfy.

    `allowed_quality` are GGA codes. `max_age_s` is the age of the correction where the carrier
    phase is corrected (4, 5), `max_code_age_s` where it is the code, SBAS or PPP (2, 9).

    From fix to fix a vehicle may leave its even motion by `speed_margin_mps` and
    `max_acceleration_mps2`, along the track or across it; a stamp may be off by `timing_s`, for
    hosts buffer; and `sigmas` standard deviations of a displacement are noise. Where fixes are
    missing it drives at `max_speed_mps` at most, and up or down at `max_climb_mps`.

    Fixes that agree with each other but not with those before or after them are a solution that
    has moved, and are followed, when they are `moved_fixes` over `moved_s` seconds; fewer are
    rejected, and so is an excursion of less than twice that from which the solution returns.
    Of fixes worse than most of the log up to four times as many are asked.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    allowed_quality: frozenset[int] = Field(default=frozenset({1, 2, 3, 4, 5, 9}), min_length=1)
    min_satellites: int = Field(default=5, ge=0, le=50)
    max_hdop: float = Field(default=4.0, gt=0.0, le=100.0)
    # u-blox keeps a fixed solution for 60 s without corrections, NavCom for 15 s, and the error
    # then grows by a few cm a minute: after half a minute it is still that of RTK.
    max_age_s: float = Field(default=30.0, gt=0.0, le=3600.0)
    # PPP and SBAS send orbits and clocks every few minutes, and receivers use them for as long
    # (NovAtel 360 s): beside the decimetres that such a fix is good for, age says little.
    max_code_age_s: float = Field(default=300.0, gt=0.0, le=3600.0)
    speed_margin_mps: float = Field(default=1.0, ge=0.0, le=20.0)
    max_acceleration_mps2: float = Field(default=4.0, gt=0.0, le=50.0)
    max_speed_mps: float = Field(default=40.0, gt=0.0, le=500.0)
    max_climb_mps: float = Field(default=3.0, gt=0.0, le=100.0)
    timing_s: float = Field(default=0.1, ge=0.0, le=5.0)
    sigmas: float = Field(default=4.0, gt=0.0, le=20.0)
    moved_fixes: int = Field(default=10, ge=2, le=10_000)
    moved_s: float = Field(default=3.0, ge=0.0, le=600.0)


DEFAULT_LIMITS = GateLimits()
