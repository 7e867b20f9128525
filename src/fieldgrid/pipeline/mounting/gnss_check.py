"""What the receiver says of the same drive: how long the ways are, and where the nose points.

Of the camera's yaw it knows nothing: a heading that comes from positions is the direction of
travel itself. But a camera whose ways are too long has a wrong baseline, and its height is wrong
with it; and a recorded heading that is off the course says that the nose, by that heading, is not
where the vehicle goes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import GnssError, Int64, MeasuredValue
from fieldgrid.geometry import Rig, Steps
from fieldgrid.pipeline.checks.camera_scale import (
    CameraScale,
    camera_scale,
    scale_findings,
    tells_heights,
)
from fieldgrid.pipeline.poses import estimate_drive
from fieldgrid.poses import Ways
from fieldgrid.recordings import Recording

WRONG_SIGMAS = 3.0
"""A course that is off by more than this number of sigmas is worth a remark."""


class GnssCheck(NamedTuple):
    """`scale` is the camera's way over the receiver's, None where too little can be compared.
    `course_off_deg` is the course minus the recorded heading of the nose, None without one."""

    scale: CameraScale | None
    course_off_deg: MeasuredValue | None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "camera_way_over_gnss_way": (
                None
                if self.scale is None
                else {"value": self.scale.ratio, "sigma": self.scale.sigma}
            ),
            "course_minus_heading_deg": (
                None if self.course_off_deg is None else self.course_off_deg._asdict()
            ),
        }


def check_against_gnss(
    recording: Recording, time_ns: Int64, ways: Ways, yaw_deg: float = 0.0
) -> GnssCheck | str:
    """The check of the `ways` between frames at `time_ns`, of a sensor that looks `yaw_deg` to the
    right, or why there is none, as a sentence."""
    fixes, zeros = recording.fixes(), np.zeros(len(ways.stop))
    if not len(fixes):
        return "No fixes, so nothing was compared with them."
    try:
        estimate = estimate_drive(recording)
    except GnssError as problem:
        return f"Nothing was compared with the fixes: {problem}"
    ends = time_ns[ways.stop - 1], time_ns[ways.stop]
    aside = np.radians(ways.direction_deg + ways.turn_deg / 2.0 + yaw_deg)
    steps = Steps(*ends, ways.forward_m * np.cos(aside), *[zeros] * 8)
    scale = camera_scale(steps, estimate.trajectory, heights_told=tells_heights(fixes))
    recorded, course_off = estimate.report.recorded, None
    if recorded is not None and not (recorded.mirrored or recorded.course or recorded.flips):
        course_off = MeasuredValue(-recorded.offset_deg, max(recorded.offset_sigma_deg, 0.02))
    return GnssCheck(scale, course_off)


def remarks(check: GnssCheck, rig: Rig) -> list[str]:
    """What of a check a reader should know, a sentence each."""
    said = [str(one) for one in scale_findings(check.scale, rig)]
    course = check.course_off_deg
    if course is not None and abs(course.value) > 0.5 and abs(course.off(0.0)) > WRONG_SIGMAS:
        said.append(
            f"The course is {course.value:+.2f}° off the recorded heading, so that heading's zero "
            "is not where the vehicle goes; yaw is given against where it goes."
        )
    return said
