"""The clocks of images and fixes: whether they tell the same time, and what to do if not."""

from __future__ import annotations

from collections.abc import Iterator

from fieldgrid.build.poses import MISPLACED_M, clock_remedy, misplaced, usual_speed_mps
from fieldgrid.build.shifts import explanation
from fieldgrid.choices import StopCode
from fieldgrid.inspection.findings import Finding, error, info, warning
from fieldgrid.pose import ClockOffset
from fieldgrid.pose.clock_search import WIDEST_S
from fieldgrid.recording import Recording
from fieldgrid.trajectory import Trajectory


def clock_unknown(followed: int) -> Finding:
    """The finding that the camera's motion in `followed` frames does not tell its clock."""
    return info(
        "clock-unknown",
        f"The clock offset of the images cannot be estimated from {followed} frames: the drive is "
        "too uniform, too short, or has poor images.",
        "Start a drive with a few turns.",
    )


def clock_findings(
    clock: ClockOffset, recording: Recording, trajectory: Trajectory
) -> Iterator[Finding]:
    """The finding that the images' clock is certainly off by more than the recording declares."""
    far_m = abs(clock.offset_s) * usual_speed_mps(trajectory)
    why = explanation(clock.offset_s, int(trajectory.time_ns[0]))
    wrong = far_m > MISPLACED_M or abs(clock.offset_s) > WIDEST_S
    remedy = clock_remedy(recording, clock)
    yield (error if wrong else warning)(
        StopCode.CLOCK_OFFSET.value,
        f"The images are stamped {-clock.offset_s:+.3f} ± {clock.sigma_s:.3f} s against the fixes, "
        f"by {clock.steps} steps of the camera{f' ({why})' if why else ''}"
        f"{misplaced(clock.offset_s, trajectory, '; ')}.",
        remedy[0].upper() + remedy[1:],
    )
