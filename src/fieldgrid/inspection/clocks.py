"""The clocks of images and fixes: whether they tell the same time, and what to do if not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fieldgrid.build.poses import MISPLACED_M, usual_speed_mps
from fieldgrid.build.shifts import explanation
from fieldgrid.choices import Doubt
from fieldgrid.inspection.findings import Finding, error, info, warning
from fieldgrid.motion import Gyro, Steps
from fieldgrid.pose import ClockOffset
from fieldgrid.pose.clock import WIDEST_S
from fieldgrid.trajectory import Trajectory

TURN_SIGMA_DEG, FEWEST_TURNS = 0.3, 10
"""How far the turns of a gyro and of a camera differ when their clocks agree, and how many are
needed."""


def with_gyro(steps: Steps | None, gyro: Gyro | None, offset_s: float) -> bool:
    """Whether the camera's turns fit the gyro's clearly better as they are stamped than when they
    are moved by `offset_s`: then the images go with the gyro, and the fixes are off."""
    if steps is None or gyro is None or len(steps.start_ns) < FEWEST_TURNS:
        return False
    time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
    mean = (gyro.rate_rad_s[1:] + gyro.rate_rad_s[:-1]) / 2.0
    turned = np.degrees(np.concatenate([[0.0], np.cumsum(mean * np.diff(time_s))]))

    def misfit(shift_s: float) -> float:
        start_s, stop_s = (
            (at_ns - gyro.time_ns[0]) / 1e9 + shift_s for at_ns in (steps.start_ns, steps.stop_ns)
        )
        inside = (start_s >= 0.0) & (stop_s <= time_s[-1])
        if np.count_nonzero(inside) < FEWEST_TURNS:
            return float("inf")
        turn = np.interp(stop_s, time_s, turned) - np.interp(start_s, time_s, turned)
        off = (turn - steps.turn_deg)[inside] / TURN_SIGMA_DEG
        return float(np.log1p(off * off).mean())

    return misfit(0.0) < 0.5 * misfit(offset_s)


def clock_unknown(followed: int) -> Finding:
    """That the camera's motion in so many frames does not tell its clock."""
    return info(
        "clock-unknown",
        f"The clock of the images cannot be told from {followed} frames: the drive is too even, "
        "too short, or badly seen.",
        "Weave a little, or turn on the spot, at the start of a drive.",
    )


def clock_findings(
    clock: ClockOffset, declared_ns: int, trajectory: Trajectory, *, fixes_off: bool
) -> Iterator[Finding]:
    """That the images' clock is certainly off by more than `declared_ns`, the offset that image
    times have already. `fixes_off` says that the gyro goes with the images."""
    speed_mps = usual_speed_mps(trajectory)
    far_m = abs(clock.offset_s) * speed_mps
    whole_s = declared_ns / 1e9 + clock.offset_s
    why = explanation(clock.offset_s, int(trajectory.time_ns[0]))
    wrong = far_m > MISPLACED_M or abs(clock.offset_s) > WIDEST_S
    tell = error if wrong else warning
    yield tell(
        Doubt.CLOCK_OFFSET.value,
        f"The images are stamped {-clock.offset_s:+.3f} ± {clock.sigma_s:.3f} s against the fixes, "
        f"by {clock.steps} steps of the camera{f' ({why})' if why else ''}; at {speed_mps:.1f} m/s "
        f"that is {far_m:.2f} m.",
        f"The gyro goes with the images, so move the stamps of the fixes by {-clock.offset_s:.3f} "
        "s in their log."
        if fixes_off
        else f"Give --time-offset {whole_s:.3f}, or image_time_offset_s = {whole_s:.3f} in "
        "recording.toml.",
    )
