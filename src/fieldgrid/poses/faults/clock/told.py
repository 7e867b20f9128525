"""What is told of the clocks of images, gyro and fixes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fieldgrid.core import Figure, Finding, Int64, StopCode, error, utc_text, warning
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.clock.change import ClockChange
from fieldgrid.poses.faults.clock.offset import ClockFindings
from fieldgrid.poses.faults.clock.search import WIDEST_S, ClockOffset, MotionContradiction
from fieldgrid.poses.faults.clock.shifts import explanation

MISPLACED_M = 0.25
"""A clock that moves the drive by more than this makes a wrong map: it is the paper's cell."""


def clock_findings(
    clocks: ClockFindings, fixes: AcceptedFixes, frame_ns: Int64 | None
) -> Iterator[Finding]:
    """That images, gyro or fixes are stamped otherwise than the others; `frame_ns` [n] are the
    stamps of the images."""
    if clocks.change is not None:
        yield _changed(clocks.change)
    if clocks.offset is not None and clocks.offset.is_certain:
        yield _off(clocks.offset, fixes)
    if clocks.contradiction is not None and clocks.contradiction.is_certain:
        yield _misplaced(clocks.contradiction, frame_ns)


SPEED_S = 2.0
"""The speed is that of the fixes over this time, so that their noise makes none. A drive that
was estimated with a camera of another clock has no speed to rely on."""


def _off(clock: ClockOffset, fixes: AcceptedFixes) -> Finding:
    """One offset: an error where it moves the drive by more than a map can bear."""
    time_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    ways_m = [np.interp(time_s + SPEED_S, time_s, way) - way for way in fixes.points_m().T]
    speed_mps = np.hypot(*ways_m) / SPEED_S
    moving = speed_mps[speed_mps > 0.1]
    usual_mps = float(np.median(moving)) if len(moving) else 0.0
    far_m = abs(clock.offset_s) * usual_mps
    is_wrong = far_m > MISPLACED_M or abs(clock.offset_s) > WIDEST_S
    why = explanation(clock.offset_s, int(fixes.time_ns[0]))
    far = f"; at {usual_mps:.1f} m/s that is {far_m:.2f} m" if usual_mps else ""
    remedy = (
        f"The gyro goes with the images: add {-clock.offset_s:.3f} to --gnss-offset, or to "
        "gnss_time_offset_s in recording.toml."
        if clock.gyro_too
        else f"Add {clock.offset_s:.3f} to --time-offset, or to image_time_offset_s in "
        "recording.toml."
    )
    return (error if is_wrong else warning)(
        StopCode.CLOCK_OFFSET.value,
        f"The images are stamped {-clock.offset_s:+.3f} s ± {clock.sigma_s:.3f} s against the "
        f"fixes, by {clock.steps} steps of the camera{f' ({why})' if why else ''}{far}.",
        remedy,
        Figure(-clock.offset_s, "s"),
    )


def _changed(change: ClockChange) -> Finding:
    whose, beside, sign, option = (
        ("fixes", "images and gyro", 1.0, "--gnss-offset")
        if change.gyro_too
        else ("images", "fixes", -1.0, "--time-offset")
    )
    return error(
        StopCode.CLOCK_JUMP.value,
        f"The {whose} are stamped {sign * change.before_s:+.2f} s against the {beside} up to "
        f"{utc_text(change.time_ns)} and {sign * change.after_s:+.2f} s from there on, by "
        f"{change.steps} steps of the camera: a clock was set during the drive, two clocks drift "
        "apart, or images were lost and their stamps given to the next ones.",
        "Split the drive there into two recordings, or keep one part by --until or --from, and "
        f"give {option} for the one that is off.",
    )


def _misplaced(found: MotionContradiction, frame_ns: Int64 | None) -> Finding:
    """Images and fixes of other moments, which no single offset explains."""
    apart_ns = np.diff(np.zeros(0, np.int64) if frame_ns is None else frame_ns)
    # Not those of a camera that is triggered each so many seconds.
    whole_seconds = (apart_ns % 1_000_000_000 == 0).all() and len(np.unique(apart_ns)) > 1
    if found.gyro_too:
        remedy = (
            "The gyro agrees with the images, so the fixes are of another drive, of another clock, "
            "or far less accurate than reported; check the log, and if it is the clock, give "
            "--gnss-offset."
        )
    elif whole_seconds:
        remedy = (
            "The images are stamped in whole seconds, so each is up to a second late; let the "
            "recorder write milliseconds, or take the stamps from the files' names or times if "
            "those have them."
        )
    else:
        remedy = (
            "The images are not in the order of their stamps, some are missing or have wrong "
            "stamps, or their clock is seconds off; check the order in frames.csv (as text, 10 "
            "comes before 2), the recorder, and the clock of the computer."
        )
    return error(
        StopCode.FRAMES_MISPLACED.value,
        f"{found.off} of {found.steps} steps of the camera do not match the fixes, and no offset "
        "of a clock explains it.",
        remedy,
    )
