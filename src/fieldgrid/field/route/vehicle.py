"""The vehicle that a route is for: what it covers, how it turns, how near it may come.

Its reference point is the middle of the axle that does not steer; a route is the way of that point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fieldgrid.core import ConfigError, Float64, parse_toml, quoted, shortened
from fieldgrid.maps import LEAST_DROP_M

MAX_FILE_BYTES = 100_000


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Distances in metres from the reference point.

    `front_m` and `rear_m` are how far the vehicle with its implement reaches ahead and behind,
    `width_m` is its width, `implement_width_m` that of a wider implement behind the axle (0 for
    none). `turning_radius_m` is the least radius of the reference point. `reverse` says whether it
    may drive backwards. `clearance_m` is kept to every obstacle and every unseen place.
    `slope_along_deg` and `slope_across_deg` are the steepest ground that it stands on, along its
    way and across it; a drop of `step_m` or more is an obstacle to it.
    """

    front_m: float = 1.2
    rear_m: float = 0.6
    width_m: float = 1.0
    implement_width_m: float = 0.0
    turning_radius_m: float = 2.0
    reverse: bool = True
    clearance_m: float = 0.1
    slope_along_deg: float = 20.0
    slope_across_deg: float = 15.0
    step_m: float = LEAST_DROP_M

    def __post_init__(self) -> None:
        limits = {
            "front_m": (0.05, 50.0), "rear_m": (0.0, 50.0), "width_m": (0.05, 30.0),
            "implement_width_m": (0.0, 60.0), "turning_radius_m": (0.1, 100.0),
            "clearance_m": (0.0, 10.0), "slope_along_deg": (0.1, 80.0),
            "slope_across_deg": (0.1, 80.0), "step_m": (0.01, 2.5),
        }  # fmt: skip
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            unit = "degrees" if name.endswith("_deg") else "metres"
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigError(
                    f"A vehicle's {name} is a number of {unit}, not {shortened(repr(value), 60)}."
                )
            if not (math.isfinite(value) and low <= value <= high):
                raise ConfigError(f"A vehicle's {name} of {value} is outside {low}..{high} {unit}.")
        if not isinstance(self.reverse, bool):
            raise ConfigError(
                f"A vehicle's reverse is true or false, not {shortened(repr(self.reverse), 60)}."
            )

    @property
    def curvature_1pm(self) -> float:
        """The highest curvature that it drives, 1/m."""
        return 1.0 / self.turning_radius_m

    @property
    def work_width_m(self) -> float:
        """What it works in one pass: the implement, or the vehicle itself."""
        return max(self.width_m, self.implement_width_m)

    def footprint(self) -> Float64:
        """The corners [n, 2] of what it covers, (forward, left) metres, counter-clockwise and
        convex: the vehicle, with an implement as wide as it is behind the axle."""
        half, wide = 0.5 * self.width_m, 0.5 * self.work_width_m
        corners = [(self.front_m, -half), (self.front_m, half), (-self.rear_m, wide)]
        if wide > half:
            # Hull of the body and of an implement from the axle to the rear.
            corners.insert(2, (0.0, wide))
            corners += [(-self.rear_m, -wide), (0.0, -wide)]
        else:
            corners.append((-self.rear_m, -half))
        return np.array(corners)

    @property
    def most_rises(self) -> tuple[float, float]:
        """Metres by which the ground may rise in a metre along the way, and in one across it."""
        along, across = self.slope_along_deg, self.slope_across_deg
        return math.tan(math.radians(along)), math.tan(math.radians(across))

    @property
    def middle_m(self) -> float:
        """How far the middle of what it covers lies ahead."""
        return 0.5 * (self.front_m - self.rear_m)

    @property
    def reach_m(self) -> float:
        """From the reference point to the farthest corner."""
        return float(np.hypot(*self.footprint().T).max())


def read_vehicle(path: str | Path) -> Vehicle:
    """A vehicle from a TOML file whose keys are the fields of :class:`Vehicle`, at the top or in
    a table `[vehicle]`. Raises ConfigError for a file that cannot be read, and for unknown keys."""
    path = Path(path)
    try:
        if not path.is_file():
            raise ConfigError(f"There is no vehicle file {path}; check the name.")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ConfigError(f"{path} is over {MAX_FILE_BYTES // 1000} kB; no vehicle is.")
        content = parse_toml(path.read_text(encoding="utf-8"))
    except ConfigError:
        raise
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be read as TOML ({error}); mend it.") from error
    table = content.get("vehicle", content)
    if not isinstance(table, dict):
        raise ConfigError(f"{path} has no table [vehicle]; write one.")
    known = [field.name for field in fields(Vehicle)]
    for key in table:
        if key not in known:
            raise ConfigError(
                f"{path} has an unknown key {quoted(key)}; known are {', '.join(known)}."
            )
    try:
        return Vehicle(**table)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
