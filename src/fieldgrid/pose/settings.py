"""Where headings come from, and how sure a pose must be to enter a map."""

from __future__ import annotations

import re
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from fieldgrid.angles import wrap_deg
from fieldgrid.errors import ConfigError
from fieldgrid.gnss import GateLimits


class PoseSettings(BaseModel):
    """How poses are found and judged. `docs/settings.md` tells each setting's meaning."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    heading: str = "smooth"
    baseline_m: float | None = Field(default=None, gt=0.1, le=100.0)
    max_heading_sigma_deg: float = Field(default=3.0, gt=0.0, le=90.0)
    max_position_sigma_m: float = Field(default=2.0, gt=0.0, le=100.0)
    max_gear_doubt: float = Field(default=0.02, gt=0.0, le=0.5)
    cell_budget_m: float | None = Field(default=None, gt=0.0, le=10.0)
    max_heading_offset_deg: float = Field(default=5.0, gt=0.0, le=45.0)
    min_turn_radius_m: float = Field(default=1.0, gt=0.0, le=50.0)
    visual_odometry: bool = True
    gnss: GateLimits = GateLimits()

    @property
    def uses_camera(self) -> bool:
        """Whether poses want the motion that the camera saw."""
        return self.visual_odometry and self.heading == "smooth"


class HeadingSource(NamedTuple):
    """`kind` is smooth, course, recorded or constant; `constant_deg` belongs to the last."""

    kind: str
    constant_deg: float = 0.0

    def __str__(self) -> str:
        return f"constant:{self.constant_deg:g}" if self.kind == "constant" else self.kind


def heading_source(text: str) -> HeadingSource:
    """Parse smooth | course | recorded | constant:DEG."""
    if text in ("smooth", "course", "recorded"):
        return HeadingSource(text)
    match = re.fullmatch(r"constant:([-+]?\d+(?:\.\d+)?)", text)
    if not match or not -360.0 <= float(match[1]) <= 360.0:
        raise ConfigError(
            f"Heading source {text!r} is none of smooth, course, recorded, constant:DEG "
            "(degrees clockwise from north, as in constant:-100)."
        )
    return HeadingSource("constant", float(wrap_deg(float(match[1]))))
