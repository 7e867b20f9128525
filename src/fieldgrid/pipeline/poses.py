"""The poses of a recording: its fixes and its own motion, estimated for the map at hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from fieldgrid.core import (
    BuildSettings,
    ConfigError,
    DatumError,
    Finding,
    FrameOrigin,
    GnssError,
    Int64,
    RecordingError,
    Severity,
    commonest_reason,
    info,
    utc_text,
    warning,
)
from fieldgrid.geometry import (
    MAX_DISTANCE_M,
    Carrier,
    Datum,
    FixColumns,
    GridSpec,
    Lidar,
    Pose,
    Rig,
    Status,
    Steps,
    Trajectory,
)
from fieldgrid.perception import reliable_range_m
from fieldgrid.pipeline.checks.stuck import REPEATED, StuckCamera
from fieldgrid.poses import (
    ErrorBudget,
    Estimate,
    Span,
    estimate_poses,
    explanation,
    shift_to_overlap,
)
from fieldgrid.recordings import Drive, Recording, no_fixes

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
    return estimate_poses(
        drive.fixes(),
        drive.rig or carrier,
        datum,
        settings.pose,
        drive.motion()._replace(steps=steps),
        None if drive.rig is None else cell_budget(drive.rig, settings),
        frame_ns=drive.image_times_ns() if isinstance(drive, Recording) else None,
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


def told_of(drive: Drive) -> list[Finding]:
    """What those who read a drive found out, and what of it was lost."""
    return [
        *(warning("losses", loss, "Copy or record it again.") for loss in drive.losses),
        *(info("note", note) for note in drive.notes),
    ]


def settled(findings: Iterable[Finding], settings: BuildSettings) -> tuple[Finding, ...]:
    """What is told of a build that goes on. Raises RecordingError for the first error; one that the
    settings accept becomes a warning."""
    told = []
    for one in findings:
        if one.severity is not Severity.ERROR:
            told.append(one)
        elif one.code in settings.checks.accept:
            told.append(warning(one.code, f"Accepted {one.code}: {one.message}", figure=one.figure))
        else:
            raise RecordingError(one.whole())
    return tuple(told)


def frame_poses(
    trajectory: Trajectory, rig: Rig, frames: Iterable[tuple[int, bool, Sequence[str]]]
) -> Iterator[Pose]:
    """The poses of frames in order of time, by the time of each, whether its ground was found, and
    the hashes of its images. They are rejected where it was not, or an image is that of an earlier
    place."""
    camera = StuckCamera()
    for time_ns, ground_found, images_sha256 in frames:
        pose = trajectory.at(time_ns)
        if pose.status is Status.OK and not ground_found:
            pose = replace(pose, status=Status.REJECTED, reason=no_ground(rig))
        camera, pose = camera.judged(images_sha256, pose)
        yield pose


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
