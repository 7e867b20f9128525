"""One step of the vehicle: matched, solved, judged, and told in the vehicle's own frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Rig, Steps, roll_pitch_deg
from fieldgrid.perception.odometry.corners import EDGE_PX, Features, nearest_disparity_px
from fieldgrid.perception.odometry.matching import Matches, match_anywhere, match_near
from fieldgrid.perception.odometry.rigid import (
    Lens,
    RefinedMotion,
    RigidMotion,
    predicted,
    refine,
    search,
)

MAX_STEP_M = 5.0
"""How far matches are looked for; a vehicle of this class goes no farther between two frames."""

MIN_FEATURES = 30
MIN_INLIERS = 12
MIN_SHARE = 0.07
"""Least share of the points that a motion puts into the other image to be found there. True
steps of two drives had 0.18 and more, wrong ones between unrelated images 0.05 and less."""

CLEAR_INLIERS, RIVAL_SHARE = 60, 0.6
"""Where fewer than this agree, no second motion may have so large a share of the first one's
support: in a sharp turn, the few vines left in view fit one another in several ways."""

RIVAL_M, RIVAL_DEG = 0.3, 1.5
"""Motions that differ by less are the same."""

MAX_LEAN_DEG = 12.0
MAX_RISE_M, MAX_RISE_SHARE = 0.3, 0.35
"""A vehicle on wheels neither pitches, rolls nor climbs more than this in one step."""

FLOOR_M, FLOOR_SHARE, FLOOR_DEG = 0.004, 0.006, 0.015
"""What the covariance does not know, since all points share it: errors of the calibration and
of the mounting's yaw. Found by comparing with truth."""

LEVEL_SIGMA_RAD = math.radians(1.5)
"""How far the vehicle may be off level when a step starts. Seen from a leaning vehicle, part of
a pitch or a heave looks like a turn or a shift."""

ROUGH_RADIUS_PX, FINE_RADIUS_PX = 12.0, 5.0


class CameraStep(NamedTuple):
    """Motion of the grid origin from one exposure to the next, in the vehicle frame at the first.

    `forward_m` is negative in reverse; `turn_deg` is that of the heading, clockwise. `sigma_m`
    is the 1-sigma error of the displacement along its less certain axis, `sigma_deg` that of
    the turn. `roll_deg` and `pitch_deg` are those of the vehicle at the second exposure against
    its axes at the first, `tilt_sigma_deg` the error of the less certain one. `inliers` is the
    number of points that agree.
    """

    forward_m: float
    right_m: float
    turn_deg: float
    sigma_m: float
    sigma_deg: float
    up_m: float
    roll_deg: float
    pitch_deg: float
    tilt_sigma_deg: float
    inliers: int


class Refusal(StrEnum):
    """Why two frames give no step, in words for a report."""

    FEW_POINTS = f"fewer than {MIN_FEATURES} points with depth in a frame"
    SAME = "the second image is the first again"
    NO_MOTION = "the matched points do not determine a motion"
    FEW_AGREE = f"fewer than {MIN_INLIERS} points agree on a motion"
    NOT_IN_VIEW = "few of the points that should be in both images are found in both"
    LIFTED = "the likeliest motion lifts the vehicle off the ground"
    TIPPED = "the likeliest motion tips the vehicle over"
    RIVAL = "two motions explain the images about as well"
    NOT_COMPARED = "the program was started again between the two frames"
    LOST = "a frame between the two was lost by damage"


def step(start: Features, stop: Features, rig: Rig) -> CameraStep | Refusal:
    """How the grid origin moved between two frames of a rig, or why that cannot be told."""
    found = _motion(start, stop, rig)
    return found if isinstance(found, Refusal) else _in_vehicle_frame(found, rig)


def camera_motion(start: Features, stop: Features, rig: Rig) -> RigidMotion | Refusal:
    """How the left camera moved between two frames, in all six degrees of freedom, or why that
    cannot be told. Of the mount it needs no more than roughly where up is."""
    found = _motion(start, stop, rig)
    return found if isinstance(found, Refusal) else found.motion


def _motion(start: Features, stop: Features, rig: Rig) -> RefinedMotion | Refusal:
    """The motion of the camera, or why it is not to be believed."""
    if min(len(start.blur_px), len(stop.blur_px)) < MIN_FEATURES:
        return Refusal.FEW_POINTS
    if np.array_equal(start.measured_px, stop.measured_px):  # noise moves every other image
        return Refusal.SAME
    camera = rig.camera
    lens = Lens(camera.focal_px, camera.cx_px, camera.cy_px, camera.focal_baseline_px_m)
    matches = match_anywhere(start, stop, rig.mount.rotation(), MAX_STEP_M)
    found = _solved(matches, start, stop, lens)
    if found is None:
        return Refusal.NO_MOTION
    return (
        _doubt(found, start, stop, rig, lens) or _rival(found, matches, start, stop, lens) or found
    )


def _solved(matches: Matches, start: Features, stop: Features, lens: Lens) -> RefinedMotion | None:
    """The motion most matches agree with, matched again near it; None when there is none."""
    motion = search(
        start.points_m[matches.start],
        stop.points_m[matches.stop],
        stop.measured_px[matches.stop],
        lens,
    )
    refined = None
    # The motion tells where to look again, for more matches and for better ones.
    for radius_px in (ROUGH_RADIUS_PX, FINE_RADIUS_PX):
        if motion is None:
            return None
        near = match_near(start, stop, motion, lens, radius_px)
        refined = refine(
            motion,
            start.points_m[near.start],
            start.measured_px[near.start],
            stop.measured_px[near.stop],
            np.column_stack([start.blur_px[near.start], stop.blur_px[near.stop]]),
            lens,
        )
        motion = refined and refined.motion
    return refined


def _doubt(
    found: RefinedMotion, start: Features, stop: Features, rig: Rig, lens: Lens
) -> Refusal | None:
    """Why a motion is not to be believed, None when it is."""
    inliers = int(found.inliers.sum())
    if inliers < MIN_INLIERS:
        return Refusal.FEW_AGREE
    R, t = found.motion
    back = RigidMotion(R.T, -R.T @ t)
    seen = _in_view(start, found.motion, rig, lens), _in_view(stop, back, rig, lens)
    if inliers < MIN_SHARE * max(seen):
        return Refusal.NOT_IN_VIEW
    right_m, forward_m, up_m = _displacement_m(found.motion, rig)
    if abs(up_m) > MAX_RISE_M + MAX_RISE_SHARE * math.hypot(right_m, forward_m):
        return Refusal.LIFTED
    if math.degrees(math.hypot(*_lean_rad(found.motion, rig))) > MAX_LEAN_DEG:
        return Refusal.TIPPED
    return None


def _rival(
    found: RefinedMotion, matches: Matches, start: Features, stop: Features, lens: Lens
) -> Refusal | None:
    """A refusal when what does not fit the motion fits another one nearly as well."""
    inliers = int(found.inliers.sum())
    if inliers >= CLEAR_INLIERS:
        return None
    near = match_near(start, stop, found.motion, lens, ROUGH_RADIUS_PX)
    rest = ~(np.isin(matches.start, near.start) | np.isin(matches.stop, near.stop))
    other = _solved(Matches(matches.start[rest], matches.stop[rest]), start, stop, lens)
    # The rest may lead back to the same motion, by way of matches that were there twice.
    if other is None or _alike(found.motion, other.motion):
        return None
    return Refusal.RIVAL if int(other.inliers.sum()) > RIVAL_SHARE * inliers else None


def _alike(one: RigidMotion, other: RigidMotion) -> bool:
    """Whether two motions differ by less than a rival does."""
    between = one.R_stop_start @ other.R_stop_start.T
    angle_rad = math.acos(min(max((float(np.trace(between)) - 1.0) / 2.0, -1.0), 1.0))
    places_m = [-motion.R_stop_start.T @ motion.t_stop_start_m for motion in (one, other)]
    apart_m = float(np.linalg.norm(places_m[0] - places_m[1]))
    return apart_m < RIVAL_M and math.degrees(angle_rad) < RIVAL_DEG


def _in_view(frame: Features, motion: RigidMotion, rig: Rig, lens: Lens) -> int:
    """How many points of a frame both cameras would see after a motion."""
    camera = rig.camera
    u, v, disparity = predicted(frame.points_m, motion, lens).T
    in_right = u - disparity - camera.disparity_offset_px > EDGE_PX
    in_left = (u < camera.width_px - EDGE_PX) & (v > EDGE_PX) & (v < camera.height_px - EDGE_PX)
    # NaN, behind the camera, is in no view.
    return int(np.count_nonzero(in_left & in_right & (disparity < nearest_disparity_px(camera))))


def _displacement_m(motion: RigidMotion, rig: Rig) -> Float64:
    """Where the middle of the baseline went: right, forward, up in the vehicle frame, metres."""
    middle = np.array([rig.camera.baseline_m / 2.0, 0.0, 0.0])
    R, t = motion
    displacement_m: Float64 = rig.mount.rotation() @ (R.T @ (middle - t) - middle)
    return displacement_m


def _turn_of_vehicle(motion: RigidMotion, rig: Rig) -> Float64:
    """R_start_stop of the vehicle's axes."""
    R_vehicle_camera = rig.mount.rotation()
    turned: Float64 = R_vehicle_camera @ motion.R_stop_start.T @ R_vehicle_camera.T
    return turned


def _lean_rad(motion: RigidMotion, rig: Rig) -> tuple[float, float]:
    """How much the vehicle's vertical tipped to its right and forward."""
    vertical = _turn_of_vehicle(motion, rig)[:, 2]
    return math.atan2(vertical[0], vertical[2]), math.atan2(vertical[1], vertical[2])


def _in_vehicle_frame(found: RefinedMotion, rig: Rig) -> CameraStep:
    """The motion of the point below the middle of the baseline, seen from above."""
    right_m, forward_m, up_m = _displacement_m(found.motion, rig)
    turned = _turn_of_vehicle(found.motion, rig)
    random_m, random_deg, tilt_sigma_deg = _random_errors(found, rig)
    roll_deg, pitch_deg = roll_pitch_deg(turned)
    floor_m = FLOOR_M + FLOOR_SHARE * math.hypot(right_m, forward_m)
    lean_deg = math.degrees(LEVEL_SIGMA_RAD * math.hypot(*_lean_rad(found.motion, rig)))
    return CameraStep(
        forward_m=float(forward_m),
        right_m=float(right_m),
        turn_deg=math.degrees(math.atan2(turned[0, 1], turned[1, 1])),
        sigma_m=math.hypot(random_m, floor_m, LEVEL_SIGMA_RAD * up_m),
        sigma_deg=math.hypot(random_deg, FLOOR_DEG, lean_deg),
        up_m=float(up_m),
        roll_deg=float(roll_deg),
        pitch_deg=float(pitch_deg),
        tilt_sigma_deg=math.hypot(tilt_sigma_deg, FLOOR_DEG),
        inliers=int(found.inliers.sum()),
    )


def _random_errors(found: RefinedMotion, rig: Rig) -> tuple[float, float, float]:
    """1-sigma of displacement (metres, the worse direction), turn and tilt (degrees, the worse
    axis) by covariance.

    With X_stop = exp(w) · R · X + t + d, small w and d move the stop, seen from the start,
    by R' · ((m - t) x w - d), m being the middle of the baseline, and turn it by -R' · w.
    """
    R, t = found.motion
    x, y, z = np.array([rig.camera.baseline_m / 2.0, 0.0, 0.0]) - t
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    to_vehicle = rig.mount.rotation() @ R.T
    level = np.hstack([to_vehicle @ cross, -to_vehicle])[:2]
    worst_m2 = np.linalg.eigvalsh(level @ found.covariance @ level.T)[-1]
    rad2 = to_vehicle @ found.covariance[:3, :3] @ to_vehicle.T
    tilt_rad2 = np.linalg.eigvalsh(rad2[:2, :2])[-1]
    return (
        math.sqrt(max(worst_m2, 0.0)),
        math.degrees(math.sqrt(max(rad2[2, 2], 0.0))),
        math.degrees(math.sqrt(max(tilt_rad2, 0.0))),
    )


def steps_of(times_ns: Sequence[int], found: Sequence[CameraStep | Refusal]) -> Steps:
    """The steps that were found between frames at n + 1 times, as the values of `motion`."""
    kept = [(k, one) for k, one in enumerate(found) if isinstance(one, CameraStep)]
    times = np.asarray(times_ns, dtype=np.int64)
    rows = np.array([k for k, _ in kept], dtype=np.int64)
    values = np.array([one[:-1] for _, one in kept], dtype=np.float64).reshape(len(kept), 9)
    return Steps(times[rows], times[rows + 1], *values.T.copy())
