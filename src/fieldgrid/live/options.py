"""What a live session does beside the map, as values that are checked."""

from __future__ import annotations

from dataclasses import dataclass, field

from fieldgrid.core import ConfigError
from fieldgrid.maps import CostCurve, Inflation

POINTS_GB = 50.0
"""Some nine hours of ten pairs of 640 x 480 a second."""


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """What a live session does beside the map.

    `queue_frames` wait at most; of more the oldest is dropped. A pose is settled when there are
    fixes `lag_s` after it; those that come later count at the end only. An estimate takes the last
    `window_s` seconds before the newest fix. The map around the vehicle is at least `map_side_m`
    wide; `curve` and `inflation` make costs of it. Of a drive that tells how its vehicle leans, the
    points of frames are kept until its end, so that its grids can be made level then; they take at
    most `points_gb` of the disk.
    """

    queue_frames: int = 2
    lag_s: float = 2.0
    window_s: float = 20.0
    map_side_m: float = 40.0
    points_gb: float = POINTS_GB
    curve: CostCurve = field(default_factory=CostCurve)
    inflation: Inflation = field(default_factory=Inflation)

    def __post_init__(self) -> None:
        if not 1 <= self.queue_frames <= 1000:
            raise ConfigError(
                f"A queue of {self.queue_frames} frames is outside 1..1000; 2 is usual."
            )
        for name, value, least, most, unit in (
            ("lag", self.lag_s, 0.0, 10.0, "s"),
            ("window", self.window_s, 5.0, 50.0, "s"),
            ("map around the vehicle", self.map_side_m, 4.0, 500.0, "m"),
            ("disk for points", self.points_gb, 0.0, 10_000.0, "GB"),
        ):
            if not least <= value <= most:
                raise ConfigError(
                    f"A {name} of {value} {unit} is outside {least:g}..{most:g} {unit}."
                )
