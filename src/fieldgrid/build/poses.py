"""The poses of a recording: its fixes and its own motion, estimated for the map at hand."""

from __future__ import annotations

from collections import Counter

import numpy as np

from fieldgrid.errors import ConfigError, GnssError
from fieldgrid.geodesy import Datum
from fieldgrid.localgrid import reliable_range_m
from fieldgrid.motion import Steps
from fieldgrid.pose import Budget, Estimate, estimate_poses
from fieldgrid.recording import Recording
from fieldgrid.rig import Rig
from fieldgrid.settings import BuildSettings
from fieldgrid.trajectory import Status, Trajectory

USUAL_BUDGET_M = 0.25
"""How far off a cell at the far end of a grid may be when nothing is asked: the paper's cell."""

NO_GROUND = "no ground was found in the image, so heights above it are not known"
"""Why a frame is rejected whose ground plane could not be refined."""


def estimate_drive(
    recording: Recording,
    settings: BuildSettings | None = None,
    datum: Datum | None = None,
    steps: Steps | None = None,
) -> Estimate:
    """Trajectory and report of a recording; `datum` is the recording's own or its first fix.

    `steps` are the camera's, if they have been worked out (:func:`visual_odometry`).
    """
    settings = settings or BuildSettings()
    return estimate_poses(
        recording.fixes(),
        recording.rig,
        datum or recording.datum_hint,
        settings.pose,
        recording.motion()._replace(steps=steps),
        cell_budget(recording.rig, settings),
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


def cell_budget(rig: Rig, settings: BuildSettings) -> Budget:
    """How far off a cell may be where the local grid's farthest points land."""
    asked = settings.pose.cell_budget_m
    reach_m = reliable_range_m(rig, settings.grid.spec(), settings.stereo, settings.density)
    return Budget(asked or max(settings.universal_cell_m, USUAL_BUDGET_M), reach_m)


def check_images(recording: Recording, trajectory: Trajectory) -> None:
    """Raise GnssError when images and fixes have nothing in common, before one is read."""
    if recording.frame_count == 0:
        raise ConfigError(f"Recording {recording.name} holds no frame; record images with it.")
    offset_ns = recording.rig.image_time_offset_ns
    images = recording.frame_times_ns() + offset_ns
    fixes = trajectory.time_ns
    if images[-1] < fixes[0] or images[0] > fixes[-1]:
        raise GnssError(
            f"Images ({_clock(images[0])} to {_clock(images[-1])}) and fixes "
            f"({_clock(fixes[0])} to {_clock(fixes[-1])}) do not overlap in time; choose the log "
            "of this drive with --gnss, or set image_time_offset_s in recording.toml."
        )


def check_poses(recording: Recording, trajectory: Trajectory) -> None:
    """Raise GnssError when no image has a usable pose."""
    images = recording.frame_times_ns() + recording.rig.image_time_offset_ns
    if not trajectory.accepted.any():
        commonest = Counter(trajectory.reason).most_common(1)[0][0]
        raise GnssError(
            f"None of the {len(trajectory)} fixes gives a pose, mostly because: {commonest}; "
            "choose another log with --gnss or another --heading."
        )
    poses = (trajectory.at(time_ns) for time_ns in images.tolist())
    reasons: Counter[str] = Counter()
    for pose in poses:
        if pose.status is Status.OK:
            return
        reasons[pose.reason] += 1
    raise none_usable(recording.name, reasons)


def none_usable(name: str, reasons: Counter[str]) -> GnssError:
    """The error of a drive none of whose frames can be used."""
    reason = reasons.most_common(1)[0][0]
    advice = (
        "check the camera's height and tilt in the mounting"
        if reason == NO_GROUND
        else "choose another log with --gnss or another --heading"
    )
    return GnssError(
        f"None of the {reasons.total()} frames of {name} has a usable pose, mostly because: "
        f"{reason}; {advice}."
    )


def _clock(time_ns: int) -> str:
    moment = np.datetime64(int(time_ns), "ns")
    return str(np.datetime_as_string(moment, unit="ms")) + "Z"
