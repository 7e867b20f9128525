"""What the receiver says of the same drive: how long the ways are, and where the nose points.

Of the camera's yaw it knows nothing: a heading that comes from positions is the direction of
travel itself. But a camera whose ways are too long has a wrong baseline, and its height is wrong
with it; and a recorded heading that is off the course says that the nose, by that heading, is not
where the vehicle goes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64, GnssError, Int64, MeasuredValue, mean_of
from fieldgrid.geometry import Status
from fieldgrid.pipeline.poses import estimate_drive
from fieldgrid.poses import STRAIGHT_PER_M, Estimate, Ways
from fieldgrid.recordings import Recording

RUN_M = 8.0
"""Ways are compared over straight runs of this length."""

FEWEST_RUNS = 3
SCALE_FLOOR = 0.003
WRONG_SCALE, WRONG_SIGMAS = 0.02, 3.0
"""A scale that is off by this share and by more than this number of sigmas is worth a remark."""


class GnssCheck(NamedTuple):
    """`scale` is the camera's way over the receiver's, None where too little was straight on.
    `course_off_deg` is the course minus the recorded heading of the nose, None without one."""

    scale: MeasuredValue | None
    course_off_deg: MeasuredValue | None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "camera_way_over_gnss_way": None if self.scale is None else self.scale._asdict(),
            "course_minus_heading_deg": (
                None if self.course_off_deg is None else self.course_off_deg._asdict()
            ),
        }


def check_against_gnss(recording: Recording, time_ns: Int64, steps: Ways) -> GnssCheck | str:
    """The check, or why there is none, as a sentence."""
    if not len(recording.fixes()):
        return "No fixes, so nothing was compared with them."
    try:
        estimate = estimate_drive(recording)
    except GnssError as problem:
        return f"Nothing was compared with the fixes: {problem}"
    ratios = _ratios(estimate, time_ns, steps)
    scale = mean_of(ratios, SCALE_FLOOR) if len(ratios) >= FEWEST_RUNS else None
    recorded, course_off = estimate.report.recorded, None
    if recorded is not None and not (recorded.mirrored or recorded.course or recorded.flips):
        course_off = MeasuredValue(-recorded.offset_deg, max(recorded.offset_sigma_deg, 0.02))
    return GnssCheck(scale, course_off)


def _ratios(estimate: Estimate, time_ns: Int64, steps: Ways) -> Float64:
    """The camera's way over the receiver's, of straight runs without a gap."""
    trajectory = estimate.trajectory
    if not trajectory.accepted.any():
        return np.zeros(0)
    ratios: list[float] = []
    distance_m, turned_rad, right_m, forward_m = 0.0, 0.0, 0.0, 0.0
    first, last = -1, -1
    for stop, step_m, direction, turn, curvature in zip(*steps, strict=True):
        if abs(curvature) > STRAIGHT_PER_M:
            last = -1
            continue
        if stop != last + 1:
            first, distance_m, turned_rad, right_m, forward_m = stop - 1, 0.0, 0.0, 0.0, 0.0
        last = stop
        bearing = turned_rad + math.radians(direction + turn / 2.0)
        right_m += step_m * math.sin(bearing)
        forward_m += step_m * math.cos(bearing)
        turned_rad += math.radians(turn)
        distance_m += abs(step_m)
        if distance_m < RUN_M:
            continue
        start, end = (trajectory.at(int(time_ns[k])) for k in (first, stop))
        if start.status is not Status.REJECTED and end.status is not Status.REJECTED:
            straight_m = math.hypot(end.east_m - start.east_m, end.north_m - start.north_m)
            if straight_m > RUN_M / 2.0:
                ratios.append(math.hypot(right_m, forward_m) / straight_m)
        last = -1
    return np.array(ratios)


def remarks(check: GnssCheck) -> list[str]:
    """What of a check a reader should know, a sentence each."""
    said = []
    scale, course = check.scale, check.course_off_deg
    if (
        scale is not None
        and abs(scale.value - 1.0) > WRONG_SCALE
        and abs(scale.off(1.0)) > WRONG_SIGMAS
    ):
        percent = 100.0 * (scale.value - 1.0)
        said.append(
            f"The camera's ways are {abs(percent):.1f} % too {'long' if percent > 0 else 'short'} "
            "beside the receiver's, so the baseline is probably wrong, and the height with it; "
            "calibrate the pair again."
        )
    if course is not None and abs(course.value) > 0.5 and abs(course.off(0.0)) > WRONG_SIGMAS:
        said.append(
            f"The course is {course.value:+.2f}° off the recorded heading, so that heading's zero "
            "is not where the vehicle goes; yaw is given against where it goes."
        )
    return said
