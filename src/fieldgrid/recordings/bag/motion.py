"""How the vehicle of a bag moved: gyro, wheels, and all axes of an IMU or what states its lean.

An orientation turns a body's axes into those of a frame whose z axis is up (REP 103, REP 145), so
its third row is the vertical as the body has it. The heading that it holds is not used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64, counted
from fieldgrid.geometry import Gyro, Motion, Orientation, RecordedTilt, WheelSpeed
from fieldgrid.recordings.bag.content import BagIndex
from fieldgrid.recordings.bag.listeners import Numbers
from fieldgrid.recordings.bag.topic_names import IMU
from fieldgrid.recordings.bag.transforms import Transforms, imu_rotation, is_optical
from fieldgrid.recordings.ros.gnss_messages import ORIENTATION, TILT
from fieldgrid.recordings.tables.motion_files import (
    AXES,
    R_VEHICLE_FLU,
    MotionSeries,
    directions,
    gravity_unit_mps2,
    in_order,
    inertial_of,
    skipped,
)

OPTICAL_AXES = "rdf"
TAKEN = f"axes taken as {AXES}"
_GRAVITY_SHARE = 0.95
"""Of what an accelerometer feels, an axis that is upright feels this much."""

_UPRIGHT = 0.5
"""Of an axis along the vertical, more than this is along it."""

UNSTATED_SIGMA_DEG, LEAST_SIGMA_DEG = 1.0, 0.5
"""The error of an orientation that states none, and of none less."""

ODOMETRY_FRAME_SIGMA_DEG = 2.0
"""By how much the frame of odometry may lean: that of a vehicle that did not start level."""

LEVEL = math.radians(0.01)
"""A vertical that moves less throughout belongs to poses in the plane, or to an IMU that estimates
nothing."""

UPRIGHT = math.cos(math.radians(30.0))
"""A vehicle leans less on average."""

LEAST_STEP_NS = 40_000_000
"""Nearer values add little, and a map keeps them all."""


def find_motion(content: BagIndex, imu_axes: str = AXES) -> tuple[Motion, tuple[str, ...]]:
    """What moves the vehicle, and remarks. The axes of the IMU are `imu_axes` if these are others
    than the usual, else those of the static transforms, else of the name of its frame."""
    notes: list[str] = []
    motion = _turning(content, imu_axes, notes)
    motion = motion._replace(wheels=_wheels(content, notes))
    if isinstance(tilt := content.readings.tilt(TILT), RecordedTilt):
        motion = motion._replace(tilt=tilt)
    return motion._replace(orientation=_leaning(content, imu_axes, motion, notes)), tuple(notes)


def _turning(content: BagIndex, imu_axes: str, notes: list[str]) -> Motion:
    """Gyro and, where it is known how all its axes sit, the whole IMU."""
    topic = content.roles.get("imu", "")
    times_ns, sensed = content.readings.series(topic)
    turns = ~np.isnan(sensed[:, :3]).all(axis=1)
    if not turns.all():
        notes.append(f"{topic}: {counted(int((~turns).sum()), 'message')} without a gyro.")
    times_ns, sensed = times_ns[turns], sensed[turns, :6]
    if not len(times_ns):
        return Motion()
    R_flu_imu, told = axes_of(content.transforms, imu_axes, content.frame_id("imu"))
    felt_ns, rows = content.readings.series(content.roles.get("acceleration"))
    if len(felt_ns):
        sensed[:, 3:] = between(times_ns, in_order(felt_ns, rows[:, 3:6], 3)[0])
    upward, is_whole = R_flu_imu[2], True
    if told == TAKEN and (felt := felt_upward(sensed[:, 3:])) is not None:
        upward, is_whole = felt, False
        told = f"axes taken so that gravity is felt upward, along {upward.astype(int).tolist()}"
    series, lost = in_order(times_ns, -rate_about(sensed[:, :3], upward))
    notes += [*skipped(topic, lost, "message"), f"{topic}: {told}."]
    if not len(series.time_ns):
        return Motion()
    # With one axis, an IMU says 0 or NaN of the others.
    if not (is_whole and turns_across(sensed, upward)):
        return Motion(gyro=Gyro(*series))
    R_vehicle_imu = R_VEHICLE_FLU @ R_flu_imu
    with np.errstate(over="ignore", invalid="ignore"):
        turned = [sensed[:, part] @ R_vehicle_imu.T for part in (slice(3), slice(3, 6))]
    inertial = inertial_of(in_order(times_ns, np.hstack(turned), 3)[0], notes)
    return Motion(gyro=Gyro(*series), inertial=inertial)


def _wheels(content: BagIndex, notes: list[str]) -> WheelSpeed | None:
    """The speed by odometry, else by transforms that move."""
    topic = content.roles.get("odometry", "")
    if content.moving is not None:
        _, whose, wheels = content.moving
        notes.append(f"{topic}: no topic has odometry, so the speed is that of {whose}.")
        return wheels if len(wheels.time_ns) else None
    times_ns, rows = content.readings.series(topic)
    if not len(times_ns):
        return None
    series, lost = in_order(times_ns, rows[:, 0])
    notes += skipped(topic, lost, "message")
    return WheelSpeed(*series) if len(series.time_ns) else None


def _leaning(
    content: BagIndex, imu_axes: str, motion: Motion, notes: list[str]
) -> Orientation | None:
    """Roll and pitch that messages state: those of the topic that was given for them, else, where
    no accelerometer tells them, those of the IMU or of the odometry. An accelerometer is what an
    IMU has its orientation from: it does not count twice."""
    given, readings = content.roles.get("attitude", ""), content.readings
    if not given:
        if isinstance(kept := readings.tilt(ORIENTATION), Orientation):
            return kept
        sensed = motion.inertial
        feels = sensed is not None and bool(np.isfinite(sensed.force_mps2).any())
        if feels or motion.tilt is not None:
            return None
    for topic in [given] if given else map(content.roles.get, ("imu", "odometry")):
        times_ns, rows = readings.series(topic)
        heard = readings.of(topic, Numbers)
        if heard is None or not np.isfinite(rows[:, -4]).any():
            continue
        is_imu = readings.bag.topics[heard.name].type == IMU
        axes = imu_axes if is_imu else AXES
        R_flu_body, how = axes_of(content.transforms, axes, heard.body)
        frame_sigma_deg = 0.0 if is_imu else ODOMETRY_FRAME_SIGMA_DEG
        found: Orientation | Untold
        if how == TAKEN and is_imu and felt_upward(rows[:, 3:6]) is not None:
            found = Untold("it does not feel gravity along its z axis", by_axes=True)
        else:
            seen = times_ns, rows[:, -4:], R_flu_body, frame_sigma_deg
            found = orientation_of(*seen, axes_known=how != TAKEN)
        if isinstance(found, Orientation):
            notes.append(f"{topic}: roll and pitch by its orientation.")
            return found
        if given or found.by_axes:
            by_mounting = "imu_axes in mounting.json or " if is_imu else ""
            remedy = f"; say how it sits by {by_mounting}a static transform"
            notes.append(
                f"{topic}: tells no roll and pitch: {found.why}{remedy if found.by_axes else ''}."
            )
    return None


def axes_of(transforms: Transforms, axes: str, frame: str) -> tuple[Float64, str]:
    """From the axes of a frame to forward, left, up [3, 3], and how that is known: `TAKEN` where
    nothing tells it."""
    if axes == AXES:
        R_flu_imu = imu_rotation(frame, transforms)
        if R_flu_imu is not None:
            return R_flu_imu, "axes by the static transforms"
        if is_optical(frame):
            axes = OPTICAL_AXES
    told = TAKEN if axes == AXES else f"axes taken as {axes}"
    return np.array(directions(axes), dtype=np.float64).T, told


def felt_upward(forces_mps2: Float64) -> Float64 | None:
    """The axis of an IMU along which gravity is felt, [3], where that is another than the third.
    None where what is felt has not the size of gravity: then no axis is told by it."""
    known = np.isfinite(forces_mps2).all(axis=1)
    if not known.any():
        return None
    usual = np.median(forces_mps2[known], axis=0)
    own = int(np.abs(usual).argmax())
    upright = abs(usual[own]) >= _GRAVITY_SHARE * float(np.linalg.norm(usual))
    if gravity_unit_mps2(usual) is None or not upright:
        return None
    upward = np.zeros(3)
    upward[own] = np.sign(usual[own])
    return None if upward[2] == 1.0 else upward


def between(times_ns: Int64, series: MotionSeries) -> Float64:
    """Values [n, k] of a series at other times, straight between its own; NaN outside of it."""
    if not len(series.time_ns):
        return np.full((len(times_ns), series.values.shape[1]), math.nan)
    first_ns = times_ns[0]
    at, known = (times_ns - first_ns) / 1e9, (series.time_ns - first_ns) / 1e9
    columns = [np.interp(at, known, one, math.nan, math.nan) for one in series.values.T]
    return np.column_stack(columns)


def turns_across(sensed: Float64, upward: Float64) -> bool:
    """Whether the rates [n, 3 or more] of an IMU say anything of its axes across the vertical."""
    across = sensed[:, [k for k in range(3) if abs(upward[k]) < _UPRIGHT]]
    return bool(np.nan_to_num(across).any())


def rate_about(rates: Float64, row: Float64) -> Float64:
    """The rate about an axis; an axis that is one of the IMU's own gives its very numbers."""
    own = row != 0.0  # of the other axes an IMU may say NaN
    with np.errstate(over="ignore", invalid="ignore"):  # such a rate is none, and left out
        return np.asarray(rates[:, own] @ row[own], dtype=np.float64)


class Untold(NamedTuple):
    """Why orientations tell no roll and pitch; `by_axes` where it is how the body sits that is not
    known."""

    why: str
    by_axes: bool = False


def orientation_of(
    times_ns: Int64,
    values: Float64,
    R_flu_body: Float64,
    frame_sigma_deg: float,
    *,
    axes_known: bool,
) -> Orientation | Untold:
    """Roll and pitch by verticals and sigmas [n, 4] of a body that sits so in its vehicle.

    Where that is taken and not known (`axes_known`), a vertical downward is none: a frame north,
    east, down and a body forward, right, down look the same, and their pitches are opposite.
    """
    (time_ns, kept), _ = in_order(times_ns, values, 3)
    if len(time_ns) < 2:
        return Untold("fewer than two messages have an orientation")
    up = kept[:, :3] @ (R_VEHICLE_FLU @ R_flu_body).T
    if np.ptp(up, axis=0).max() < LEVEL:
        return Untold("its orientation never leans otherwise, as that of poses in the plane")
    mean_up = float(up[:, 2].mean())
    if abs(mean_up) < UPRIGHT:
        return Untold("by its orientation the vehicle lies on its side", by_axes=True)
    if mean_up < 0.0 and not axes_known:
        return Untold("by its orientation the vehicle is upside down", by_axes=True)
    up = up * np.sign(mean_up)  # frames whose z axis points down: north, east, down
    rows, k = [], 0
    while k < len(time_ns):
        rows.append(k)
        k = int(np.searchsorted(time_ns, time_ns[k] + LEAST_STEP_NS))
    return stated_orientation(time_ns[rows], up[rows], kept[rows, 3], frame_sigma_deg)


def stated_orientation(
    time_ns: Int64, up: Float64, sigma_deg: Float64, frame_sigma_deg: float
) -> Orientation:
    """Roll and pitch by verticals [n, 3] in the vehicle's axes, with their stated 1-sigma errors
    [n], NaN for none."""
    right, forward, above = up.T
    sigma = np.maximum(np.where(sigma_deg > 0.0, sigma_deg, UNSTATED_SIGMA_DEG), LEAST_SIGMA_DEG)
    return Orientation(
        time_ns,
        np.degrees(np.arctan2(-right, above)),
        np.degrees(np.arctan2(forward, np.hypot(right, above))),
        sigma,
        np.full(len(time_ns), frame_sigma_deg),
    )
