"""The poses of a recording: its fixes and its own motion, estimated for the map at hand."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from fieldgrid.core import (
    BuildSettings,
    CalibrationError,
    ConfigError,
    DatumError,
    FieldgridError,
    FrameOrigin,
    GnssError,
    Int64,
    RecordingError,
    StopCode,
    commonest_reason,
    utc_text,
)
from fieldgrid.geometry import (
    MAX_DISTANCE_M,
    Carrier,
    Datum,
    FixColumns,
    GridSpec,
    Lidar,
    Rig,
    Status,
    Steps,
    Trajectory,
)
from fieldgrid.perception import reliable_range_m
from fieldgrid.pipeline.checks.shifts import Span, explanation, shift_to_overlap
from fieldgrid.pipeline.checks.stuck import REPEATED
from fieldgrid.poses import (
    WIDEST_S,
    ClockChange,
    ClockOffset,
    ErrorBudget,
    Estimate,
    estimate_poses,
    off_sentence,
)
from fieldgrid.recordings import Drive, Recording, no_fixes

ASKEW_DEG = 2.0
"""A camera that looks so far aside puts what is 7 m away by a cell of the paper elsewhere. Less
than that a vehicle may slip on a slope, which looks the same."""

USUAL_BUDGET_M = 0.25
"""How far off a cell at the far end of a grid may be when nothing is asked: the paper's cell."""

_OTHER_LOG = "choose another log with --gnss; `fieldgrid inspect` tries each --heading"
_GNSS_OFFSET = "give --gnss-offset {0} or gnss_time_offset_s = {0} in recording.toml"
_IMAGE_OFFSET = "give --time-offset {0} or image_time_offset_s = {0} in recording.toml"


def estimate_drive(
    drive: Drive,
    settings: BuildSettings | None = None,
    datum: Datum | None = None,
    steps: Steps | None = None,
    *,
    carrier: Carrier | None = None,
    level_grids: bool = True,
) -> Estimate:
    """Trajectory and report of a drive; `datum` is the drive's own or its first fix.

    `steps` are the camera's, if they have been worked out (:func:`visual_odometry`). `carrier` is
    the vehicle of a drive that has no rig. `level_grids` as in `estimate_poses`. Raises DatumError
    before all else where no fix is within reach of the datum, GnssError where there is no log.
    """
    if not drive.gnss_source and not len(drive.fixes()) and drive.motion().poses is None:
        raise no_fixes(drive.name, drive.log.notes)
    settings = settings or BuildSettings()
    datum = datum or drive.datum_hint
    if datum is not None:
        _check_reach(drive, datum, settings.pose.frame_origin or drive.fixes())
    frame_ns = None
    if isinstance(drive, Recording):
        frame_ns = drive.frame_times_ns() + drive.rig.image_time_offset_ns
    return estimate_poses(
        drive.fixes(),
        drive.rig or carrier,
        datum,
        settings.pose,
        drive.motion()._replace(steps=steps),
        None if drive.rig is None else cell_budget(drive.rig, settings),
        frame_ns=frame_ns,
        level_grids=level_grids,
    )


def _check_reach(drive: Drive, datum: Datum, places: FixColumns | FrameOrigin) -> None:
    """Raise DatumError when all fixes, or the origin of given poses, are too far from a datum: what
    else is wrong of a drive in another country does not matter."""
    # The chord: beyond the horizon, metres east and north are fewer again.
    enu_m = datum.to_enu(places.lat_deg, places.lon_deg, np.nan_to_num(places.height_m))
    apart_m = np.ravel(np.linalg.norm(enu_m, axis=0))
    nearest_m = float(np.fmin.reduce(apart_m, initial=np.inf))
    if MAX_DISTANCE_M < nearest_m < np.inf:
        raise DatumError(
            f"The {'fixes' if isinstance(places, FixColumns) else 'poses'} of {drive.name} are "
            f"{nearest_m / 1000:.0f} km from the datum "
            f"{datum.described()}, over {MAX_DISTANCE_M / 1000:.0f} km; build a map of its own of "
            "this drive, or give a --datum near the field."
        )


def estimate_trajectory(
    recording: Recording,
    settings: BuildSettings | None = None,
    datum: Datum | None = None,
    steps: Steps | None = None,
) -> Trajectory:
    """The trajectory of a recording's grid origin; see :func:`estimate_drive`.

    Raises GnssError when no fix can be used.
    """
    return estimate_drive(recording, settings, datum, steps).trajectory


MISPLACED_M = 0.25
"""A clock that moves the drive by more than this makes a wrong map: it is the paper's cell."""


def cell_budget(rig: Rig, settings: BuildSettings) -> ErrorBudget:
    """How far off a cell may be where the local grid's farthest points land."""
    asked = settings.pose.cell_budget_m
    reach_m = reliable_range_m(rig, GridSpec.of(settings.grid), settings.stereo, settings.density)
    return ErrorBudget(asked or max(settings.universal_cell_m, USUAL_BUDGET_M), reach_m)


def no_ground(rig: Rig) -> str:
    """Why a frame is rejected whose ground plane could not be refined."""
    seen = "cloud" if isinstance(rig.sensor, Lidar) else "image"
    return f"no ground was found in the {seen}, so heights above it are not known"


def check_images(recording: Recording, trajectory: Trajectory) -> None:
    """Raise GnssError when images and fixes have nothing in common, before one is read."""
    if recording.frame_count == 0:
        raise ConfigError(f"Recording {recording.name} holds no frame; record images with it.")
    images = recording.image_times_ns()
    fixes = trajectory.time_ns
    if images[-1] < fixes[0] or images[0] > fixes[-1]:
        raise GnssError(
            f"Images ({utc_text(images[0])} to {utc_text(images[-1])}) and fixes "
            f"({utc_text(fixes[0])} to {utc_text(fixes[-1])}) do not overlap in time; "
            f"{_advice(recording, images, fixes)}."
        )


def _advice(recording: Recording, images: Int64, fixes: Int64) -> str:
    """What to do about images and fixes that are apart."""
    choose = "choose the log of this drive with --gnss"
    seen, fixed = Span(int(images[0]), int(images[-1])), Span(int(fixes[0]), int(fixes[-1]))
    shift_s = shift_to_overlap(seen, fixed)
    if shift_s is None:
        began_s = round((fixed.first_ns - seen.first_ns) / 1e9)
        return (
            "if it is the log of this drive, and both began at about the same time, "
            f"{_offset_words(recording, fixed, began_s)} (visual odometry gives the rest), "
            f"otherwise {choose}"
        )
    return (
        f"they would if images were {abs(shift_s):g} s {'later' if shift_s > 0 else 'earlier'} "
        f"({explanation(shift_s, fixed.first_ns)}): if that is so, "
        f"{_offset_words(recording, fixed, shift_s)}, else {choose}"
    )


def _offset_words(recording: Recording, fixed: Span, shift_s: float) -> str:
    """How to move images by `shift_s` against the fixes: where a gyro overlaps no fix either, it
    goes with the images, and the fixes are moved the other way."""
    gyro = recording.motion().gyro
    if gyro is not None and (gyro.time_ns[-1] < fixed.first_ns or gyro.time_ns[0] > fixed.last_ns):
        return _GNSS_OFFSET.format(f"{recording.log.moved_ns / 1e9 - shift_s:.10g}")
    return _IMAGE_OFFSET.format(f"{recording.rig.image_time_offset_ns / 1e9 + shift_s:.10g}")


class BuildDoubt(NamedTuple):
    """What stops a build unless it is accepted."""

    code: StopCode
    error: FieldgridError


def settle(doubted: BuildDoubt | None, settings: BuildSettings) -> tuple[str, ...]:
    """A note about a doubt that the settings accept, none where there is no doubt; else its error
    is raised, and says how to accept it."""
    if doubted is None:
        return ()
    if doubted.code in settings.checks.accept:
        return (f"Accepted {doubted.code}: {doubted.error}",)
    sentence = str(doubted.error).removesuffix(".")
    raise type(doubted.error)(f"{sentence}; to build nevertheless, give --accept {doubted.code}.")


def doubted_clock(recording: Recording, estimate: Estimate) -> BuildDoubt | None:
    """The doubt about stamps of images that are certainly wrong, by more than a map can bear."""
    clock, trajectory = estimate.report.clock, estimate.trajectory
    if clock is None or not clock.is_certain:
        return None
    far_m = abs(clock.offset_s) * usual_speed_mps(trajectory)
    if far_m <= MISPLACED_M and abs(clock.offset_s) <= WIDEST_S:
        return None
    why = explanation(clock.offset_s, int(trajectory.time_ns[0]))
    error = GnssError(
        f"The images of {recording.name} are stamped {-clock.offset_s:+.2f} s ± "
        f"{clock.sigma_s:.2f} s against the fixes, as {clock.steps} steps of the camera show"
        f"{f' ({why})' if why else ''}{misplaced(clock.offset_s, trajectory, ', and ')}; "
        f"{clock_remedy(recording, clock)}"
    )
    return BuildDoubt(StopCode.CLOCK_OFFSET, error)


def doubted_jump(recording: Recording, estimate: Estimate) -> BuildDoubt | None:
    """The doubt about images, gyro or fixes whose clock changes at some instant."""
    change = estimate.report.clock_change
    if change is None:
        return None
    return BuildDoubt(StopCode.CLOCK_JUMP, _change_error(recording, change))


def _change_error(recording: Recording, change: ClockChange) -> RecordingError:
    whose, beside, sign, option = (
        ("fixes", "images and gyro", 1.0, "--gnss-offset")
        if change.gyro_too
        else ("images", "fixes", -1.0, "--time-offset")
    )
    return RecordingError(
        f"The {whose} of {recording.name} are stamped {sign * change.before_s:+.2f} s against the "
        f"{beside} up to {utc_text(change.time_ns)} and {sign * change.after_s:+.2f} s from there "
        f"on, as {change.steps} visual odometry steps show: a clock was set during the drive, two "
        "clocks drift apart, or images were lost and their stamps given to the next ones; split "
        f"the drive there into two recordings, and give {option} for the one that is off."
    )


def doubted_frames(recording: Recording, estimate: Estimate) -> BuildDoubt | None:
    """The doubt about images and fixes that are of other moments, which no single offset
    explains."""
    found = estimate.report.contradiction
    if found is None or not found.is_certain:
        return None
    told = (
        f"{found.off} of {found.steps} visual odometry steps of {recording.name} do not match the "
        "fixes, and no clock offset explains it"
    )
    apart_ns = np.diff(recording.frame_times_ns())
    # Not those of a camera that is triggered each so many seconds.
    whole_seconds = (apart_ns % 1_000_000_000 == 0).all() and len(np.unique(apart_ns)) > 1
    if found.gyro_too:
        why = (
            "The gyro agrees with the images, so the fixes are of another drive, of another clock, "
            "or far less accurate than reported; check the log, and if it is the clock, give "
            "--gnss-offset."
        )
    elif whole_seconds:
        why = (
            "The images are stamped in whole seconds, so each is up to a second late; let the "
            "recorder write milliseconds, or take the stamps from the files' names or times if "
            "those have them."
        )
    else:
        why = (
            "The images are not in the order of their stamps, some are missing or have wrong "
            "stamps, or their clock is seconds off; check the order in frames.csv (as text, 10 "
            "comes before 2), the recorder, and the clock of the computer."
        )
    return BuildDoubt(StopCode.FRAMES_MISPLACED, RecordingError(f"{told}. {why}"))


def doubted_yaw(recording: Recording, estimate: Estimate) -> BuildDoubt | None:
    """The doubt about a camera that certainly looks elsewhere than declared, by `ASKEW_DEG` or
    more: the map would be wrong."""
    yaw = estimate.report.camera_yaw
    if yaw is None or not yaw.is_off or abs(yaw.off_deg) < ASKEW_DEG:
        return None
    return BuildDoubt(
        StopCode.CAMERA_YAW,
        CalibrationError(
            f"{off_sentence(yaw)}; measure the mounting with `fieldgrid mount --write`, or correct "
            "camera_yaw_deg in mounting.json."
        ),
    )


def clock_remedy(recording: Recording, clock: ClockOffset) -> str:
    """What to give so that images and fixes are of one clock, with what is declared already."""
    if clock.gyro_too:
        whole_s = recording.log.moved_ns / 1e9 - clock.offset_s
        return f"the gyro goes with the images: {_GNSS_OFFSET.format(f'{whole_s:.3f}')}."
    whole_s = recording.rig.image_time_offset_ns / 1e9 + clock.offset_s
    return f"{_IMAGE_OFFSET.format(f'{whole_s:.3f}')}."


def usual_speed_mps(trajectory: Trajectory) -> float:
    """The median speed of a drive while it moves."""
    speed = np.abs(trajectory.speed_mps[trajectory.accepted])
    return float(np.median(speed[speed > 0.1])) if (speed > 0.1).any() else 0.0


def misplaced(offset_s: float, trajectory: Trajectory, before: str) -> str:
    """How far images of another time are from their places, after the words `before`; nothing
    where no usable pose tells how fast the drive was."""
    speed_mps = usual_speed_mps(trajectory)
    if speed_mps == 0.0:
        return ""
    return f"{before}at {speed_mps:.1f} m/s that is {abs(offset_s) * speed_mps:.2f} m"


def check_poses(recording: Recording, trajectory: Trajectory) -> None:
    """Raise GnssError when no image has a usable pose."""
    images = recording.image_times_ns()
    if not trajectory.accepted.any():
        raise GnssError(
            f"None of the {len(trajectory)} poses of the drive can be used, mostly because: "
            f"{commonest_reason(trajectory.reason)}; {_OTHER_LOG}."
        )
    reasons: Counter[str] = Counter()
    for pose in map(trajectory.at, images.tolist()):
        if pose.status is Status.OK:
            return
        reasons[pose.reason] += 1
    raise none_usable(recording.name, reasons, recording.rig)


def none_usable(name: str, reasons: Counter[str], rig: Rig) -> GnssError:
    """The error of a drive none of whose frames can be used."""
    reason = commonest_reason(reasons.elements())
    advice = _OTHER_LOG
    if reason == REPEATED:
        advice = "look at the driver of the camera or lidar, and record the drive again"
    elif reason == no_ground(rig) and isinstance(rig.sensor, Lidar):
        advice = "check the lidar's height and tilt in the mounting, and the axes of the clouds"
    elif reason == no_ground(rig):
        advice = "check the calibration, and the camera's height and tilt in the mounting"
    return GnssError(
        f"None of the {reasons.total()} frames of {name} has a usable pose, mostly because: "
        f"{reason}; {advice}."
    )
