"""Whether the images are what the calibration and the mounting say, seen from a whole drive.

A camera that does not fit still gives grids, of noise. Two things tell it: frames in which no
ground is found, and steps of the camera that its images do not tell. The mounting matters only
to the first, so ground that is missing while steps are found speaks of height and tilt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from fieldgrid.core import (
    BuildSettings,
    FieldgridError,
    Finding,
    RecordingError,
    Severity,
    StopCode,
    commonest_reason,
    error,
    info,
    warning,
)
from fieldgrid.geometry import DepthCamera, Lidar, StereoCamera, Trajectory
from fieldgrid.perception import (
    FEWEST_TIMES,
    Misalignment,
    drive_misalignment,
    features,
)
from fieldgrid.pipeline.inspection.images import misalignment_findings
from fieldgrid.pipeline.inspection.measures import ImageMeasures
from fieldgrid.pipeline.poses import no_ground
from fieldgrid.pipeline.report import SessionReport
from fieldgrid.recordings import CloudFrame, Frame, Recording

GROUND_SHARE, STEP_SHARE, FEWEST_STEPS = 1 / 3, 0.1, 5
"""Ground in fewer of the frames and steps in fewer of the pairs than these shares, of at least
`FEWEST_STEPS` pairs, are no camera of this calibration. Two drives had ground and steps everywhere;
with left and right swapped, ground in 12 % and 4 % of the frames and no step. Fog takes both in the
same frames and leaves the steps of the others."""

PROBES = 5
SWAPPED_TIMES, SWAPPED_POINTS = 3.0, 30
"""Disparities are negative when a pair, exchanged, shows `SWAPPED_TIMES` as many points with depth,
and `SWAPPED_POINTS` at least: swapped, it was 10 and more times as many, of a right pair a tenth. A
principal point that is far off does the same, so both are named."""

FEWEST_CELLS = 100
"""Cells of a metre and more are meant where so many of them lie across a drive."""

HINT_SHARE = 0.05
"""Ground that is missing in more of the frames than this deserves a remark."""


def camera_findings(
    recording: Recording, report: SessionReport, ground: int, every: int
) -> Iterator[Finding]:
    """That a drive which was perceived is not of its calibration's cameras.

    `ground` counts the frames in which the ground was found.
    """
    frames = len(range(0, recording.frame_count, every))
    is_pair = isinstance(recording.rig.sensor, StereoCamera)
    if is_pair and 2 * ground < frames and swapped(recording, every):
        yield SWAPPED
    elif _is_blind(report) and ground < GROUND_SHARE * frames:
        tried = report.camera_steps + report.camera_refusals
        yield error(
            StopCode.CAMERAS_UNFIT.value,
            f"Only {ground} of {frames} frames of {recording.name} show the ground, and only "
            f"{report.camera_steps} of {tried} visual odometry steps can be estimated, so the "
            "images do not fit the calibration.",
            "Give the calibration of these cameras, and check that the pairs are rectified, "
            "synchronised, and not swapped left and right.",
        )


SWAPPED = error(
    StopCode.CAMERAS_SWAPPED.value,
    "The pairs show depth only with left and right exchanged, so the two are swapped, or the "
    "calibration is of other cameras.",
    "Swap the two folders or the two columns of frames.csv, or give the calibration of these "
    "cameras.",
)


def _is_blind(report: SessionReport) -> bool:
    """Whether hardly a step of the camera could be told."""
    tried = report.camera_steps + report.camera_refusals
    return tried >= FEWEST_STEPS and report.camera_steps < STEP_SHARE * tried


def cell_findings(trajectory: Trajectory, settings: BuildSettings) -> Iterator[Finding]:
    """That cells may be centimetres given as metres: of a metre or more, and fewer than
    `FEWEST_CELLS` across the drive."""
    cell_m, ok = settings.universal_cell_m, trajectory.accepted
    if cell_m < 1.0 or not ok.any():
        return
    way_m = max(np.ptp(trajectory.east_m[ok]), np.ptp(trajectory.north_m[ok]))
    cells = math.ceil((way_m + 2.0 * settings.grid.length_m) / cell_m)
    if cells < FEWEST_CELLS:
        yield error(
            StopCode.COARSE_CELLS.value,
            f"Cells of {cell_m:g} m leave at most {cells} of them across this drive.",
            f"--cell is in metres: for {cell_m:g} cm give --cell {cell_m / 100.0:g}.",
        )


def probed_images(recording: Recording, every: int) -> Iterator[ImageMeasures]:
    """What some of the pairs are like; nothing is raised for frames that cannot be read, which
    comes later."""
    camera = recording.rig.sensor
    if not isinstance(camera, StereoCamera):
        return
    for frame in probes(recording, every):
        with suppress(FieldgridError):
            yield ImageMeasures.of(*frame.images(), camera)


def row_findings(
    recording: Recording, every: int, rows: Misalignment | None
) -> tuple[Finding, ...]:
    """What is wrong with the `rows` of pairs, or that their sides are swapped: what matches then,
    does by chance."""
    found = tuple(misalignment_findings(rows))
    if any(one.severity is Severity.ERROR for one in found) and swapped(recording, every):
        return (SWAPPED,)
    return found


def misalignment(recording: Recording, images: Sequence[ImageMeasures]) -> Misalignment | None:
    """How far the rows of left and right are apart, by the images of some pairs."""
    camera = recording.rig.sensor
    if not isinstance(camera, StereoCamera):
        return None
    return drive_misalignment(
        [image.shifts for image in images], (camera.width_px, camera.height_px)
    )


def after_findings(recording: Recording, report: SessionReport) -> Iterator[Finding]:
    """What to look at in calibration and mounting after a build that went through."""
    rig, mount = recording.rig, recording.rig.mount
    missing = report.reasons[no_ground(rig)]
    if missing > HINT_SHARE * report.frames:
        what = "lidar" if isinstance(rig.sensor, Lidar) else "camera"
        fits = ""
        if report.camera_steps > report.camera_refusals:
            fits = " Visual odometry succeeded, so the calibration fits."
        yield warning(
            "ground-missing",
            f"No ground was found in {missing} of {report.frames} frames.{fits}",
            f"Check the {what}'s height of {mount.height_m:g} m and tilt of {mount.tilt_deg:g}° in "
            "the mounting; `fieldgrid mount` measures them.",
        )
    if _is_blind(report):
        tried = report.camera_steps + report.camera_refusals
        reason = commonest_reason(report.camera_refusal_reasons.elements())
        yield warning(
            "steps-missing",
            f"Only {report.camera_steps} of {tried} visual odometry steps succeeded, mostly "
            f"because: {reason}.",
            "Unless the frames are metres apart or show little, check the calibration, and that "
            "the pairs are rectified and synchronised.",
        )


def sensor_findings(
    recording: Recording, settings: BuildSettings, max_range_m: float
) -> Iterator[Finding]:
    """What a build does without for want of a pair, or of what is known of its depths."""
    sensor = recording.rig.sensor
    if settings.pose.uses_camera and not isinstance(sensor, StereoCamera):
        yield info("no-pairs", "There are no stereo pairs, so there is no visual odometry.")
    if isinstance(sensor, DepthCamera) and sensor.baseline_m is None:
        yield warning(
            "depth-range",
            "The growth of the depth error with range is unknown, so depths are used up to "
            f"{max_range_m:g} m.",
            "Add the baseline to their calibration, or give --max-range.",
        )


def sweep_findings(recording: Recording, every: int) -> Iterator[Finding]:
    """What becomes of the motion within a sweep, by one of the clouds that can be read."""
    if not isinstance(recording.rig.sensor, Lidar):
        return
    told = (
        "The clouds have no usable times of their points, or are corrected already, so the "
        "vehicle's motion within a sweep is not corrected."
    )
    for frame in probes(recording, every):
        assert isinstance(frame, CloudFrame)
        with suppress(RecordingError):  # which is told when the frame is staged
            points_m, after_s = frame.source.sweep()
            if after_s is not None:
                told = (
                    f"The points of a sweep ({np.ptp(after_s):.3f} s) are corrected for the "
                    "vehicle's motion within it."
                )
            if after_s is not None or len(points_m) >= FEWEST_TIMES:
                yield info("sweep", told)
                return


def swapped(recording: Recording, every: int) -> bool:
    """Whether some frames of a drive, over all of it, show more with left and right exchanged."""
    camera = recording.rig.camera
    as_is, exchanged = [], []
    for frame in probes(recording, every):
        with suppress(RecordingError):  # it was left out of the drive, too
            left, right = frame.images()
            as_is.append(len(features(camera, left, right).blur_px))
            exchanged.append(len(features(camera, right, left).blur_px))
    points = float(np.median(exchanged)) if exchanged else 0.0
    return points >= SWAPPED_POINTS and points > SWAPPED_TIMES * float(np.median(as_is))


def probes(recording: Recording, every: int) -> Iterator[Frame]:
    """At most `PROBES` frames from all over a drive, of every `every`-th."""
    frames = len(range(0, recording.frame_count, every))
    for k in np.linspace(0, frames - 1, min(frames, PROBES)).round().astype(int).tolist():
        yield from recording.frames(k * every, k * every + 1)
