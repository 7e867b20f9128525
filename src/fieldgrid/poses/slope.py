"""What a slope could do to a drive that does not tell how its vehicle leans.

On a slope the antenna leans downhill by its height times the slope, and where the slope changes its
track turns otherwise than the vehicle. Nothing here is corrected: the heights of the fixes tell how
steep the ground is, and sigmas grow by what that can do.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import VehicleGeometry, robust_plane
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.attitude.ground import USUAL_SLOPE
from fieldgrid.poses.table import PoseTable

CLIMB_SIGMA_RAD, LEAST_CHORD_M, MOST_CHORD_M = 0.01, 3.0, 30.0
"""The path's climb is that between fixes so far apart that their noise makes no more than this."""

BENT_SHARE = 0.6
"""Roll changes along the path by this share of what the climb changes: on a crest that is crossed
at any angle, the second derivative along the path and the mixed one are to each other as 0.61 to
0.35."""

FEWEST_CHORDS = 10
NORMAL_MAD = 1.4826

TOLD_DEG = 3.0
"""A steeper slope, of which nothing tells how the vehicle leans, is worth a word."""

ROW_STEP_M, ALIKE_M = 0.5, 10.0
"""Heights count every half metre of the path; what the ground does beside its plane, and a
receiver's slow error, is the same for so long."""


class Slope(NamedTuple):
    """How steep the ground of a drive is, `lean_rad`, and how fast that changes along the path,
    `bent_rad_m`, radians a metre. Both are 1-sigma, in no known direction. `unseen_rad` is the part
    of the lean that the drive does not show: a single row does not tell how steep it is across."""

    lean_rad: float
    bent_rad_m: float
    unseen_rad: float = 0.0


FLAT = Slope(0.0, 0.0)


def slope_seen(fixes: AcceptedFixes) -> Slope:
    """The slope by the heights of accepted fixes; what their noise makes is taken out."""
    steps_m = np.hypot(np.diff(fixes.east_m), np.diff(fixes.north_m))
    way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    noise_m = 1e-3
    if len(way_m) > 2:
        second_m = float(np.median(np.abs(np.diff(fixes.up_m, 2))))
        noise_m = max(NORMAL_MAD * second_m / np.sqrt(6.0), noise_m)
    chord_m = float(np.clip(np.sqrt(2.0) * noise_m / CLIMB_SIGMA_RAD, LEAST_CHORD_M, MOST_CHORD_M))
    climb = np.diff(np.interp(np.arange(0.0, way_m[-1], chord_m), way_m, fixes.up_m)) / chord_m
    along = bent = 0.0
    if len(climb) >= FEWEST_CHORDS:
        climb_noise = np.sqrt(2.0) * noise_m / chord_m
        along = _beyond(climb, climb_noise)
        bent = _beyond(np.diff(climb) / chord_m, np.sqrt(3.0) * climb_noise / chord_m, brief=False)
    plane, unseen = _plane_slope(fixes, way_m, max(noise_m, 0.05))
    lean = np.hypot(max(along, plane), unseen)
    return Slope(float(np.arctan(lean)), BENT_SHARE * bent, float(np.arctan(unseen)))


def _beyond(values: Float64, noise: float, *, brief: bool = True) -> float:
    """How large values are beyond their noise (root mean square, outliers cut down to three times
    what is usual). What is large in less than half of the drive only, as changes of the climb are
    in the turns on a plane, counts if `brief`."""
    size = np.abs(values)
    usual = NORMAL_MAD * float(np.median(size))
    spread = float(np.sqrt(np.mean(np.minimum(size, 3.0 * max(usual, noise)) ** 2)))
    if not brief:
        spread = min(spread, usual)
    return float(np.sqrt(max(spread**2 - noise**2, 0.0)))


def _plane_slope(fixes: AcceptedFixes, way_m: Float64, sigma_m: float) -> tuple[float, float]:
    """How steep the plane through all fixes is, as far as they lie beside each other, and how
    steep it may be where they do not, 1-sigma."""
    # Of one stretch of the way counts one height, however long the vehicle stood there.
    rows = np.unique(np.searchsorted(way_m, np.arange(0.0, max(way_m[-1], ROW_STEP_M), ROW_STEP_M)))
    east, north, up = (
        axis[rows] - np.median(axis) for axis in (fixes.east_m, fixes.north_m, fixes.up_m)
    )
    prior = (1e3, USUAL_SLOPE, USUAL_SLOPE)
    columns = np.column_stack([np.ones_like(east), east, north])
    rough_m = sigma_m
    for _ in range(2):
        each_m = np.full(len(rows), rough_m * np.sqrt(ALIKE_M / ROW_STEP_M))
        plane, _ = robust_plane(east, north, up, each_m, _wide, prior_sigma=prior)
        rough_m = max(NORMAL_MAD * float(np.median(np.abs(up - columns @ plane))), sigma_m)
    known = columns.T @ columns / each_m[0] ** 2 + np.diag(1.0 / np.square(prior))
    unseen = float(np.sqrt(np.trace(np.linalg.inv(known)[1:, 1:])))
    return float(np.hypot(plane[1], plane[2])), unseen


def _wide(round_: int, residuals: Float64) -> float:
    """The ground is no plane: what is left out is what lies far beyond the usual."""
    if round_ == 0:
        return np.inf
    return 6.0 * max(NORMAL_MAD * float(np.median(np.abs(residuals))), 0.05)


def unsure_slope(
    table: PoseTable, slope: Slope, rig: VehicleGeometry, *, turns_seen: bool
) -> PoseTable:
    """The poses with what an unknown lean of the antenna above the ground adds to their
    sigmas. Of their positions it is common to neighbours; a heading that gyro or camera saw turn
    does not hang on the antenna's track."""
    above_m = abs(rig.antenna.up_m)
    turned_deg = 0.0 if turns_seen else np.degrees(above_m * slope.bent_rad_m)
    return table._replace(
        position_sigma_m=np.hypot(table.position_sigma_m, off_m(slope, rig)),
        heading_sigma_deg=np.hypot(table.heading_sigma_deg, turned_deg),
    )


def off_m(slope: Slope, rig: VehicleGeometry) -> float:
    """How far the lean moves the antenna, 1-sigma along one axis."""
    return float(abs(rig.antenna.up_m) * np.tan(slope.lean_rad) / np.sqrt(2.0))


def slope_notes(slope: Slope, rig: VehicleGeometry | None) -> Iterator[str]:
    """A word on a slope that matters."""
    slope_deg, unseen_deg = np.degrees([slope.lean_rad, slope.unseen_rad]).tolist()
    if rig is None or not rig.antenna.up_m or slope_deg <= TOLD_DEG:
        return
    ground = f"The ground has slopes of about {slope_deg:.0f}°"
    remedy = "Record an accelerometer with the gyro, or map with images."
    if unseen_deg > slope_deg / np.sqrt(2.0):
        ground = "This drive does not show how steep the ground is across its way (8° are usual)"
        remedy = "Drive another row beside it, record an accelerometer, or map with images."
    yield (
        f"{ground}, and nothing tells how the vehicle leans: its positions may be "
        f"{off_m(slope, rig):.2f} m off. {remedy}"
    )
