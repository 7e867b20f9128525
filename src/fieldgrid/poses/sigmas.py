"""How unsure poses are beyond what their estimate says, summed up in one place."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.table import PoseTable


class AddedSigma(NamedTuple):
    """One reason why poses are less sure, 1-sigma, [n] or one number for all: their `position_m`
    along one axis, the same beside their neighbours, `relative_m`, and their `heading_deg`."""

    position_m: Float64 | float = 0.0
    relative_m: Float64 | float = 0.0
    heading_deg: Float64 | float = 0.0


def as_unsure(table: PoseTable, doubts: Iterable[AddedSigma]) -> PoseTable:
    """The poses with some reasons for doubt, which are independent of each other."""
    variances = [table.position_sigma_m**2, table.relative_sigma_m**2, table.heading_sigma_deg**2]
    for doubt in doubts:
        variances = [sum_ + np.square(one) for sum_, one in zip(variances, doubt, strict=True)]
    position_m, relative_m, heading_deg = (np.sqrt(variance) for variance in variances)
    return table._replace(
        position_sigma_m=position_m, relative_sigma_m=relative_m, heading_sigma_deg=heading_deg
    )
