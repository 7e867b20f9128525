"""What is known of a planting before it is looked at: distances that a crop keeps.

A preset is a prior in metres, not a model of a plant. Whatever a field says better, as the spacing
of its rows or the width of its canopy, is estimated from the evidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from fieldgrid.core import ConfigError, quoted

_APART = 4.0
"""Plants are single ones when their spacing is more than this number of half widths of a canopy, so
that there is room between them."""


_BENT_PATCH = 0.45
"""The factor by which patches are smaller where rows bend: an arc of 15 m radius leaves its chord
by 0.3 m."""


@dataclass(frozen=True, slots=True)
class Crop:
    """Distances of a planting, metres.

    `min_spacing_m`..`max_spacing_m` is the range of distances between neighbouring rows.
    `plant_spacing_m` is the largest usual distance between plants of a row: a hole that is longer
    than `min_gap_m` is a gap. Holes of up to `max_bridge_m` do not end a row. `half_width_m` with
    `half_width_sigma_m` is the half width of the canopy, where no row was seen from both sides.
    `min_row_m` is the shortest row. Rows that `bend` are straight over shorter stretches only;
    rows that look bent, or come in pieces, are looked for in such stretches without it, too.
    """

    min_spacing_m: float = 1.2
    max_spacing_m: float = 4.5
    plant_spacing_m: float = 1.2
    min_gap_m: float = 1.4
    max_bridge_m: float = 15.0
    half_width_m: float = 0.3
    half_width_sigma_m: float = 0.1
    min_row_m: float = 5.0
    bend: bool = False

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "bend" and not (math.isfinite(value) and 0.0 < value <= 1000.0):
                raise ConfigError(
                    f"A crop's {item.name} of {value} is outside 0..1000 m; the presets are "
                    f"{', '.join(CROPS)}."
                )
        if self.min_spacing_m >= self.max_spacing_m:
            raise ConfigError(
                f"A row spacing of {self.min_spacing_m}..{self.max_spacing_m} m is empty; give the "
                "smaller one first."
            )

    @property
    def patch_m(self) -> float:
        """Side of the patches in which rows are straight lines: some rows and some plants."""
        side = max(4.0 * self.min_spacing_m + 2.0 * self.max_spacing_m, 8.0 * self.plant_spacing_m)
        return _BENT_PATCH * side if self.bend else side

    @property
    def are_single(self) -> bool:
        """Whether there is room between plants, as between trees of an orchard."""
        return self.plant_spacing_m > _APART * self.half_width_m

    def changed(self, **given: float | None) -> Crop:
        """A copy with some distances given by hand; None leaves a distance as it is."""
        known: dict[str, Any] = {k: value for k, value in given.items() if value is not None}
        return replace(self, **known)


CROPS = {
    "vineyard": Crop(),
    "bushes": Crop(
        min_spacing_m=1.0, max_spacing_m=5.0, plant_spacing_m=1.5, min_gap_m=2.0, half_width_m=0.4,
        half_width_sigma_m=0.15,
    ),
    "orchard": Crop(
        min_spacing_m=2.5, max_spacing_m=9.0, plant_spacing_m=5.0, min_gap_m=6.5,
        max_bridge_m=25.0, half_width_m=0.4, half_width_sigma_m=0.3, min_row_m=12.0,
    ),
    "arable": Crop(
        min_spacing_m=0.3, max_spacing_m=1.0, plant_spacing_m=0.4, min_gap_m=0.8, max_bridge_m=6.0,
        half_width_m=0.1, half_width_sigma_m=0.05, min_row_m=4.0,
    ),
}  # fmt: skip
"""Presets: canopies on wires, hedges and berries, single trunks, and rows that are sown."""


def crop_named(name: str) -> Crop:
    """A preset by its name; ConfigError for another name."""
    if name not in CROPS:
        raise ConfigError(f"{quoted(name)} is no crop; known are {', '.join(CROPS)}.")
    return CROPS[name]
