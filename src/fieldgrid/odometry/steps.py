"""One step of the vehicle: matched, solved, judged, and told in the vehicle's own frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.motion import Steps
from fieldgrid.odometry.corners import EDGE_PX, Features, nearest_disparity_px
from fieldgrid.odometry.matching import Matches, match_anywhere, match_near
from fieldgrid.odometry.rigid import Lens, Motion3, Refined, predicted, refine, search
from fieldgrid.rig import Rig

MAX_STEP_M = 5.0
"""How far matches are looked for; a vehicle of this class goes no farther between two frames."""

MIN_FEATURES = 30
MIN_INLIERS = 12
MIN_SHARE = 0.07
"""Of the points that a motion puts into the other image, so many must be found there. True
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
NEAR_DISPARITY_PX = 1.5
GUESS_LEAN_RAD = math.radians(4.0)
"""A guess knows nothing of pitch and roll."""


class Step(NamedTuple):
    """Motion of the grid origin from one exposure to the next, in the vehicle frame at the first.

    `forward_m` is negative in reverse; `turn_deg` is that of the heading, clockwise. `sigma_m`
    is the 1-sigma error of the displacement along its less certain axis, `sigma_deg` that of
    the turn. `inliers` is the number of points that agree.
    """

    forward_m: float
    right_m: float
    turn_deg: float
    sigma_m: float
    sigma_deg: float
    inliers: int


class Refusal(NamedTuple):
    """No step, and why, in words for a report."""

    reason: str
    inliers: int = 0


class Guess(NamedTuple):
    """What is known of a step before the images are seen, with 1-sigma errors."""

    forward_m: float
    right_m: float
    turn_deg: float
    sigma_m: float
    sigma_deg: float


def step(start: Features, stop: Features, rig: Rig, guess: Guess | None = None) -> Step | Refusal:
    """How the grid origin moved between two frames of a rig, or why that cannot be told.

    A `guess` narrows the search to three of its sigmas, which helps where the images overlap
    little; nothing else of it enters the step.
    """
    found = _found(start, stop, rig, guess)
    return found if isinstance(found, Refusal) else _in_vehicle_frame(found, rig)


def camera_motion(start: Features, stop: Features, rig: Rig) -> Motion3 | Refusal:
    """How the left camera moved between two frames, in all six degrees of freedom, or why that
    cannot be told. Of the mount it needs no more than roughly where up is."""
    found = _found(start, stop, rig, None)
    return found if isinstance(found, Refusal) else found.motion


def _found(start: Features, stop: Features, rig: Rig, guess: Guess | None) -> Refined | Refusal:
    """The motion of the camera, or why it is not to be believed."""
    fewest = min(len(start.blur_px), len(stop.blur_px))
    if fewest < MIN_FEATURES:
        return Refusal(f"only {fewest} points with depth in a frame, {MIN_FEATURES} are needed")
    lens = lens_of(rig)
    matches = (
        match_anywhere(start, stop, rig.mount.rotation(), MAX_STEP_M)
        if guess is None
        else _match_guessed(start, stop, rig, guess)
    )
    found = _solved(matches, start, stop, lens)
    if found is None:
        return Refusal("the matched points do not determine a motion")
    doubt = _doubt(found, start, stop, rig) or _rival(found, matches, start, stop, lens)
    return doubt or found


def lens_of(rig: Rig) -> Lens:
    """What turns the points of a rig's left camera into pixels."""
    camera = rig.camera
    return Lens(camera.focal_px, camera.cx_px, camera.cy_px, camera.focal_baseline_px_m)


def _match_guessed(start: Features, stop: Features, rig: Rig, guess: Guess) -> Matches:
    """Matches about where a guess expects them, as far off as its sigmas and a lean allow."""
    depth_m = start.points_m[:, 2]
    angle_rad = 3.0 * math.radians(guess.sigma_deg) + GUESS_LEAN_RAD
    radius_px = rig.camera.focal_px * (angle_rad + 3.0 * guess.sigma_m / depth_m)
    # A shift of a metre changes the disparity d by d / depth, a turn that of points aside.
    share = np.minimum((3.0 * guess.sigma_m + angle_rad * depth_m) / depth_m, 1.0)
    disparity_px = NEAR_DISPARITY_PX + start.measured_px[:, 2] * share
    motion = _guessed_motion(guess, rig)
    return match_near(start, stop, motion, lens_of(rig), radius_px, disparity_px)


def _guessed_motion(guess: Guess, rig: Rig) -> Motion3:
    """The motion of the camera on a vehicle that stays level."""
    R_vehicle_camera, turn = rig.mount.rotation(), math.radians(guess.turn_deg)
    cosine, sine = math.cos(turn), math.sin(turn)
    R_start_stop = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    R_stop_start = R_vehicle_camera.T @ R_start_stop.T @ R_vehicle_camera
    middle = np.array([rig.camera.baseline_m / 2.0, 0.0, 0.0])
    way = R_vehicle_camera.T @ np.array([guess.right_m, guess.forward_m, 0.0])
    return Motion3(R_stop_start, middle - R_stop_start @ (middle + way))


def _solved(matches: Matches, start: Features, stop: Features, lens: Lens) -> Refined | None:
    """The motion most matches agree with, matched again near it; None when there is none."""
    points_m, stop_points_m = start.points_m[matches.start], stop.points_m[matches.stop]
    motion = search(points_m, stop_points_m, stop.measured_px[matches.stop], lens)
    if motion is None:
        return None
    # The motion tells where to look again, for more matches and for better ones.
    rough = _refined(motion, start, stop, lens, ROUGH_RADIUS_PX)
    return rough and _refined(rough.motion, start, stop, lens, FINE_RADIUS_PX)


def _refined(
    motion: Motion3, start: Features, stop: Features, lens: Lens, radius_px: float
) -> Refined | None:
    """The motion after matching again near where it puts the points."""
    near = _match_near(motion, start, stop, lens, radius_px)
    return refine(
        motion,
        start.points_m[near.start],
        start.measured_px[near.start],
        stop.measured_px[near.stop],
        np.column_stack([start.blur_px[near.start], stop.blur_px[near.stop]]),
        lens,
    )


def _match_near(
    motion: Motion3, start: Features, stop: Features, lens: Lens, radius_px: float
) -> Matches:
    """Matches about where a motion puts the points, as near for all of them."""
    count = len(start.blur_px)
    radii_px, disparity_px = np.full(count, radius_px), np.full(count, NEAR_DISPARITY_PX)
    return match_near(start, stop, motion, lens, radii_px, disparity_px)


def _doubt(found: Refined, start: Features, stop: Features, rig: Rig) -> Refusal | None:
    """Why a motion is not to be believed, None when it is."""
    inliers = int(found.inliers.sum())
    if inliers < MIN_INLIERS:
        return Refusal(
            f"only {inliers} points agree on a motion, {MIN_INLIERS} are needed", inliers
        )
    R, t = found.motion
    there, back = Motion3(R, t), Motion3(np.ascontiguousarray(R.T), -R.T @ t)
    expected = max(_in_view(start, there, rig), _in_view(stop, back, rig))
    if inliers < MIN_SHARE * expected:
        return Refusal(
            f"only {inliers} of {expected} points are where the likeliest motion puts them", inliers
        )
    right_m, forward_m, up_m = _way_m(found.motion, rig)
    lean_deg = math.degrees(math.hypot(*_lean_rad(found.motion, rig)))
    if abs(up_m) > MAX_RISE_M + MAX_RISE_SHARE * math.hypot(right_m, forward_m):
        return Refusal(f"the likeliest motion lifts the vehicle by {up_m:.1f} m", inliers)
    if lean_deg > MAX_LEAN_DEG:
        return Refusal(f"the likeliest motion tips the vehicle by {lean_deg:.0f}°", inliers)
    return None


def _rival(
    found: Refined, matches: Matches, start: Features, stop: Features, lens: Lens
) -> Refusal | None:
    """A refusal when what does not fit the motion fits another one nearly as well."""
    inliers = int(found.inliers.sum())
    if inliers >= CLEAR_INLIERS:
        return None
    near = _match_near(found.motion, start, stop, lens, ROUGH_RADIUS_PX)
    rest = ~(np.isin(matches.start, near.start) | np.isin(matches.stop, near.stop))
    left = Matches(matches.start[rest], matches.stop[rest])
    other = _solved(left, start, stop, lens)
    # The rest may lead back to the same motion, by way of matches that were there twice.
    if other is None or _alike(found.motion, other.motion):
        return None
    support = int(other.inliers.sum())
    if support <= RIVAL_SHARE * inliers:
        return None
    return Refusal(f"{inliers} points agree on a motion, but {support} on another one", inliers)


def _alike(one: Motion3, other: Motion3) -> bool:
    """Whether two motions differ by less than a rival does."""
    between = one.R_stop_start @ other.R_stop_start.T
    angle_rad = math.acos(min(max((float(np.trace(between)) - 1.0) / 2.0, -1.0), 1.0))
    places_m = [-motion.R_stop_start.T @ motion.t_stop_start_m for motion in (one, other)]
    apart_m = float(np.linalg.norm(places_m[0] - places_m[1]))
    return apart_m < RIVAL_M and math.degrees(angle_rad) < RIVAL_DEG


def _in_view(frame: Features, motion: Motion3, rig: Rig) -> int:
    """How many points of a frame both cameras would see after a motion."""
    camera = rig.camera
    u, v, disparity = predicted(frame.points_m, *motion, *lens_of(rig)).T
    in_right = u - disparity - camera.disparity_offset_px > EDGE_PX
    in_left = (u < camera.width_px - EDGE_PX) & (v > EDGE_PX) & (v < camera.height_px - EDGE_PX)
    # NaN, behind the camera, is in no view.
    return int(np.count_nonzero(in_left & in_right & (disparity < nearest_disparity_px(camera))))


def _way_m(motion: Motion3, rig: Rig) -> Float64:
    """Where the middle of the baseline went: right, forward, up in the vehicle frame, metres."""
    middle = np.array([rig.camera.baseline_m / 2.0, 0.0, 0.0])
    R, t = motion
    way: Float64 = rig.mount.rotation() @ (R.T @ (middle - t) - middle)
    return way


def _turn_of_vehicle(motion: Motion3, rig: Rig) -> Float64:
    """R_start_stop of the vehicle's axes."""
    R_vehicle_camera = rig.mount.rotation()
    turned: Float64 = R_vehicle_camera @ motion.R_stop_start.T @ R_vehicle_camera.T
    return turned


def _lean_rad(motion: Motion3, rig: Rig) -> tuple[float, float]:
    """How much the vehicle's vertical tipped to its right and forward."""
    vertical = _turn_of_vehicle(motion, rig)[:, 2]
    return math.atan2(vertical[0], vertical[2]), math.atan2(vertical[1], vertical[2])


def _in_vehicle_frame(found: Refined, rig: Rig) -> Step:
    """The motion of the point below the middle of the baseline, seen from above."""
    right_m, forward_m, up_m = _way_m(found.motion, rig)
    turned = _turn_of_vehicle(found.motion, rig)
    random_m, random_deg = _random_errors(found, rig)
    floor_m = FLOOR_M + FLOOR_SHARE * math.hypot(right_m, forward_m)
    lean_deg = math.degrees(LEVEL_SIGMA_RAD * math.hypot(*_lean_rad(found.motion, rig)))
    return Step(
        forward_m=float(forward_m),
        right_m=float(right_m),
        turn_deg=math.degrees(math.atan2(turned[0, 1], turned[1, 1])),
        sigma_m=math.hypot(random_m, floor_m, LEVEL_SIGMA_RAD * up_m),
        sigma_deg=math.hypot(random_deg, FLOOR_DEG, lean_deg),
        inliers=int(found.inliers.sum()),
    )


def _random_errors(found: Refined, rig: Rig) -> tuple[float, float]:
    """1-sigma of displacement (metres, the worse direction) and turn (degrees) by covariance.

    With X_stop = exp(w) · R · X + t + d, small w and d move the stop, seen from the start,
    by R' · ((m - t) x w - d), m being the middle of the baseline, and turn it by -R' · w.
    """
    R, t = found.motion
    x, y, z = np.array([rig.camera.baseline_m / 2.0, 0.0, 0.0]) - t
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    to_vehicle = rig.mount.rotation() @ R.T
    level = np.hstack([to_vehicle @ cross, -to_vehicle])[:2]
    worst_m2 = np.linalg.eigvalsh(level @ found.covariance @ level.T)[-1]
    turn_rad2 = to_vehicle[2] @ found.covariance[:3, :3] @ to_vehicle[2]
    return math.sqrt(max(worst_m2, 0.0)), math.degrees(math.sqrt(max(turn_rad2, 0.0)))


def steps_of(times_ns: Sequence[int], found: Sequence[Step | Refusal]) -> Steps:
    """The steps that were found between frames at n + 1 times, as the values of `motion`."""
    kept = [(k, one) for k, one in enumerate(found) if isinstance(one, Step)]
    times = np.asarray(times_ns, dtype=np.int64)
    rows = np.array([k for k, _ in kept], dtype=np.int64)
    values = np.array([one[:5] for _, one in kept], dtype=np.float64).reshape(len(kept), 5)
    return Steps(times[rows], times[rows + 1], *values.T.copy())
