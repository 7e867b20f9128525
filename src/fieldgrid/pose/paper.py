"""The paper's way to headings: the course over a baseline, one that is recorded, or one given."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.course import NOISE_SHARE, STATION_M, Course, course, course_of_axle, stations
from fieldgrid.pose.accepted import AcceptedFixes
from fieldgrid.rig import VehicleGeometry
from fieldgrid.settings import PoseSettings
from fieldgrid.trajectory import MAX_GAP_NS

CONSTANT_SIGMA_DEG = 1.0
"""What a heading given by hand is taken to be good for."""

STANDING_MPS = 0.1
"""Below this speed, as the receiver measured it, a vehicle stands and its positions wander."""


def stated_heading(heading_deg: Float64, sigma_deg: Float64) -> Course:
    """Headings that the log or the user states, with their sigmas; NaN where they do not."""
    n, sigma_deg = len(heading_deg), np.where(np.isnan(heading_deg), np.inf, sigma_deg)
    return Course(heading_deg, sigma_deg, np.ones(n, dtype=np.int64), np.zeros(n))


def course_heading(
    fixes: AcceptedFixes, rig: VehicleGeometry | None, settings: PoseSettings
) -> Course:
    """Course where it is the heading: at the axle that does not steer, when the rig names it.

    The antenna, a metre ahead, swings outward in a turn: its course leads the heading by
    asin(distance · curvature), 11° at a radius of 5 m.
    """
    part = np.concatenate([[0], np.cumsum(np.diff(fixes.time_ns) > MAX_GAP_NS)])
    baseline_m = settings.baseline_m or default_baseline_m(fixes.sigma_m)
    step_m = max(STATION_M, 2.0 * NOISE_SHARE * float(np.median(fixes.sigma_m)))
    points = fixes.points_m()
    at = stations(points, part, fixes.speed_mps < STANDING_MPS, step_m)
    east_m, north_m = points[at].T
    up_m = 0.0 if rig is None else rig.antenna.up_m
    found = course(east_m, north_m, fixes.sigma_m[at], part[at], baseline_m, up_m)
    if rig is not None and rig.rear_axle_forward_m is not None:
        ahead_m = rig.antenna.forward_m - rig.rear_axle_forward_m
        found = course_of_axle(found, east_m, north_m, part[at], ahead_m)
    # The fixes between two stations have the heading of the one before.
    station = np.searchsorted(at, np.arange(len(fixes.time_ns)), side="right") - 1
    heading, sigma, gear, span = found
    return Course(heading[station], sigma[station], gear[station], span[station])


def default_baseline_m(sigma_m: Float64) -> float:
    """A baseline for the fixes at hand: 200 sigma, between 4 and 12 m.

    At a fix every 0.3 m that gives about 0.3° from 2 cm. Longer ones cut corners: rows are
    not straight to a degree over more than a few metres.
    """
    return float(np.clip(200.0 * np.median(sigma_m), 4.0, 12.0))
