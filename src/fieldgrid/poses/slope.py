"""What a slope could do to a drive that does not tell how its vehicle leans.

Nothing here is corrected: the heights of the fixes tell how steep the ground is, and sigmas grow by
what that can do.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fieldgrid.core import Figure, Finding, warning
from fieldgrid.geometry import VehicleGeometry
from fieldgrid.poses.attitude.ground import ExpectedGround
from fieldgrid.poses.sigmas import AddedSigma

TOLD_DEG = 3.0
"""A steeper slope, of which nothing tells how the vehicle leans, is worth a word."""


def slope_doubt(ground: ExpectedGround, rig: VehicleGeometry, *, turns_seen: bool) -> AddedSigma:
    """What an unknown lean of the antenna above the ground does to poses. To their positions it is
    common to neighbours; a heading that gyro or camera saw turn does not hang on the antenna's
    track."""
    return AddedSigma(
        position_m=_off_m(ground, rig),
        heading_deg=0.0 if turns_seen else float(np.degrees(abs(rig.antenna.up_m) * ground.bent)),
    )


def _off_m(ground: ExpectedGround, rig: VehicleGeometry) -> float:
    """How far the lean moves the antenna, 1-sigma along one axis."""
    return float(abs(rig.antenna.up_m) * ground.slope / np.sqrt(2.0))


def slope_findings(ground: ExpectedGround, rig: VehicleGeometry) -> Iterator[Finding]:
    """A word on a slope that matters."""
    slope_deg, off_m = np.degrees(np.arctan(ground.slope)), _off_m(ground, rig)
    if not rig.antenna.up_m or slope_deg <= TOLD_DEG:
        return
    told = f"The ground has slopes of about {slope_deg:.0f}°"
    remedy = "Record an accelerometer with the gyro, or map with images."
    if ground.unseen > ground.slope / np.sqrt(2.0):
        told = "This drive does not show how steep the ground is across its way (8° are usual)"
        remedy = "Drive another row beside it, record an accelerometer, or map with images."
    yield warning(
        "lean-unknown",
        f"{told}, and nothing tells how the vehicle leans: its positions may be {off_m:.2f} m off.",
        remedy,
        Figure(off_m, "m"),
    )
