"""The transform of a session: where its drive is put in the map, apart from the poses as driven."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import overload

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Float64
from fieldgrid.errors import ConfigError, MapError
from fieldgrid.trajectory import Pose, Trajectory

_RIGID = "rigid"

MOST_M, MOST_DEG = 1000.0, 180.0


@dataclass(frozen=True, slots=True)
class Transform:
    """A turn about a pivot, then a shift: placed = pivot + R(turn) · (driven - pivot) + shift.

    Shifts are metres east and north. The turn is in degrees, clockwise seen from above like a
    heading, to which it is added. The pivot is in metres of the map, as driven.
    """

    shift_east_m: float = 0.0
    shift_north_m: float = 0.0
    turn_deg: float = 0.0
    pivot_east_m: float = 0.0
    pivot_north_m: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            most = MOST_DEG if name == "turn_deg" else math.inf
            most = MOST_M if name.startswith("shift") else most
            if not math.isfinite(value) or abs(value) > most:
                raise ConfigError(
                    f"A transform with {name} {value} cannot be; shifts are up to {MOST_M:.0f} m, "
                    f"turns up to {MOST_DEG:.0f} degrees."
                )

    @property
    def is_identity(self) -> bool:
        """Whether it leaves every pose as it is, bit for bit."""
        return self.shift_east_m == self.shift_north_m == self.turn_deg == 0.0

    def pose(self, driven: Pose) -> Pose:
        """A pose as it is placed in the map."""
        if self.is_identity:
            return driven
        east_m, north_m = self._point(driven.east_m, driven.north_m)
        heading_deg = driven.heading_deg
        if self.turn_deg:
            heading_deg = float(wrap_deg(heading_deg + self.turn_deg))
        return replace(driven, east_m=east_m, north_m=north_m, heading_deg=heading_deg)

    def trajectory(self, driven: Trajectory) -> Trajectory:
        """A trajectory as it is placed in the map."""
        if self.is_identity:
            return driven
        east_m, north_m = self._point(driven.east_m, driven.north_m)
        heading_deg = driven.heading_deg
        if self.turn_deg:
            heading_deg = wrap_deg(heading_deg + self.turn_deg)
        return replace(driven, east_m=east_m, north_m=north_m, heading_deg=heading_deg)

    @overload
    def _point(self, east_m: float, north_m: float) -> tuple[float, float]: ...
    @overload
    def _point(self, east_m: Float64, north_m: Float64) -> tuple[Float64, Float64]: ...
    def _point(
        self, east_m: float | Float64, north_m: float | Float64
    ) -> tuple[float | Float64, float | Float64]:
        turn = math.radians(self.turn_deg)
        x, y = east_m - self.pivot_east_m, north_m - self.pivot_north_m
        return (
            self.pivot_east_m + x * math.cos(turn) + y * math.sin(turn) + self.shift_east_m,
            self.pivot_north_m - x * math.sin(turn) + y * math.cos(turn) + self.shift_north_m,
        )

    def to_text(self) -> str | None:
        """As it is stored: None for the identity, else a JSON object by the kind of transform."""
        return None if self.is_identity else json.dumps({_RIGID: asdict(self)})


IDENTITY = Transform()


@lru_cache(maxsize=64)
def transform_of(text: str | None) -> Transform:
    """A transform as it was stored; MapError for one that this version does not know."""
    if text is None:
        return IDENTITY
    try:
        kinds = json.loads(text)
        if set(kinds) != {_RIGID}:
            raise MapError(
                f"A session's transform has {', '.join(sorted(kinds))}, and this fieldgrid knows "
                f"{_RIGID} only; update fieldgrid to read it."
            )
        values = kinds[_RIGID]
        known = {field.name for field in fields(Transform)}
        if set(values) != known or not all(isinstance(v, int | float) for v in values.values()):
            raise TypeError(f"it says {values}")
        return Transform(**values)
    except (TypeError, ValueError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(f"A session's transform is damaged: {error}.") from error
