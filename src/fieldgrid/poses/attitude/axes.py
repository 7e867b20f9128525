"""How much level axes of the vehicle rise, by what recorded it: two antennas, an AHRS, odometry.

Unlike the angles of a navigation system that is calibrated to its vehicle, each axis has a
constant error of its own: antennas of unequal height, an IMU that is not mounted level. Moreover,
odometry may be in a frame that is not level.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, Int64, Quality, warning
from fieldgrid.geometry import FixColumns, Orientation, RecordedTilt

BASELINE_MOUNT_SIGMA_DEG, IMU_MOUNT_SIGMA_DEG = 1.0, 1.0
"""Antennas a metre apart are mounted to the same height within two centimetres, and an IMU is
level as well."""

UNSTATED_SIGMA_DEG, LEAST_SIGMA_DEG = 0.5, 0.1
"""The error of a baseline's pitch, where its source states none, and of no pitch less."""

LEVEL_DEG = 0.01
"""An axis that rises by the same throughout is one that nothing measured: receivers without a
pitch write 0."""

MOST_GAP_NS = 2_100_000_000
"""Between recorded values no farther apart one is interpolated."""

SWAY_DEG = 1.0
"""How far an axis moves from its nearest recorded value, degrees/√s."""

LASTING_S = 5.0
"""For how long the error of a recorded value stays the same; what lasts longer is taken for the
constant error."""

CONTRADICTED_SIGMAS = 3.0
"""An axis contradicts the rest of the drive if a third of it is more of its sigmas away."""

LEAST_VALUES = 10

ORIENTATION, RECORDED, ANTENNAS = "orientation", "recorded angles", "antennas"
"""What recorded axes are those of."""


def lasting(lasting_s: float | Float64, spacing_s: Float64) -> Float64:
    """What sigmas of values that are `spacing_s` apart, and whose errors are the same for so long,
    are to be multiplied by."""
    return np.sqrt(np.maximum(lasting_s / np.maximum(spacing_s, 1e-3), 1.0))


class AxisTilt(NamedTuple):
    """How much a level axis of the vehicle rises at n instants in order of time, degrees.

    The axis points `toward_deg` clockwise from the nose. `sigma_deg` [n] is what changes of the
    error, `mount_sigma_deg` what stays over a drive; `frame_sigma_deg` how far the frame that it
    was measured in may lean. `source` names it in a note. Axes of the same `body` are turned
    alike, so they are right or wrong together.
    """

    time_ns: Int64
    rise_deg: Float64
    sigma_deg: Float64
    toward_deg: float
    mount_sigma_deg: float
    frame_sigma_deg: float
    source: str
    body: str

    @property
    def direction(self) -> Float64:
        """The axis as the vehicle has it: right, forward, up [3]."""
        toward = np.radians(self.toward_deg)
        return np.array([np.sin(toward), np.cos(toward), 0.0])

    def at(self, node_ns: Int64) -> tuple[Float64, Float64]:
        """Sine of the rise and its sigma at other instants [n]; NaN where nothing is recorded near.

        The sigma is that of a value among others whose errors are the same for a while.
        """
        after = np.clip(np.searchsorted(self.time_ns, node_ns), 1, len(self.time_ns) - 1)
        before_ns, after_ns = self.time_ns[after - 1], self.time_ns[after]
        near = (node_ns >= before_ns) & (node_ns <= after_ns)
        near &= after_ns - before_ns <= MOST_GAP_NS
        late_s = np.minimum(np.abs(node_ns - before_ns), np.abs(after_ns - node_ns)) / 1e9
        rise, sigma = (np.interp(node_ns, self.time_ns, column) for column in self[1:3])
        spacing_s = np.gradient(node_ns / 1e9) if len(node_ns) > 1 else np.ones(1)
        sigma = np.hypot(sigma * lasting(LASTING_S, spacing_s), SWAY_DEG * np.sqrt(late_s))
        return np.sin(np.radians(rise)), np.where(near, np.radians(sigma), np.nan)

    def is_known(self, fix_ns: Int64) -> bool:
        """Whether it is recorded near most of the fixes."""
        return int(np.isfinite(self.at(fix_ns)[1]).sum()) * 2 > len(fix_ns)


def axes_of_tilt(said: RecordedTilt | Orientation) -> tuple[AxisTilt, ...]:
    """The axes forward and right of a recorded roll and pitch; none of fewer than two instants.
    What a recording is sure of is so all the time, and of the vehicle."""
    known = np.isfinite(np.stack(said[1:])).all(axis=0)
    if known.sum() < 2:
        return ()
    time_ns = said.time_ns[known]
    roll_deg, pitch_deg, sigma_deg = (column[known] for column in said[1:4])
    mount_deg, frame_deg, body = float(np.median(sigma_deg)), 0.0, RECORDED
    if isinstance(said, Orientation):
        frame_deg = float(np.max(said.frame_sigma_deg[known]))
        mount_deg, body = IMU_MOUNT_SIGMA_DEG, ORIENTATION
    return tuple(
        AxisTilt(time_ns, rise_deg, sigma_deg, toward_deg, mount_deg, frame_deg, what, body)
        for rise_deg, toward_deg, what in (
            (pitch_deg, 0.0, "recorded pitch"),
            (_right_deg(roll_deg, pitch_deg), 90.0, "recorded roll"),
        )
    )


def _right_deg(roll_deg: Float64, pitch_deg: Float64) -> Float64:
    """How much the axis to the right rises, where roll is known; pitch may be unknown there."""
    sine = np.sin(np.radians(roll_deg)) * np.cos(np.radians(np.nan_to_num(pitch_deg)))
    return np.asarray(np.degrees(np.arcsin(-sine)))


def axes_of_fixes(fixes: FixColumns, offset_deg: float) -> tuple[AxisTilt, ...]:
    """The axes whose rise a receiver states: that of the heading, `offset_deg` clockwise from the
    nose, and where it is stated the one to the right of it. Of a baseline whose ambiguities are
    not fixed nothing is used: it may be off by many degrees, and for minutes."""
    fixes = fixes[np.isin(fixes.heading_quality, (Quality.RTK_FIXED, Quality.UNKNOWN))]
    sigma = np.where(
        fixes.tilt_sigma_deg > 0.0,
        np.maximum(fixes.tilt_sigma_deg, LEAST_SIGMA_DEG),
        UNSTATED_SIGMA_DEG,
    )
    found = []
    for rise_deg, beside_deg, what in (
        (fixes.pitch_deg, 0.0, "pitch"),
        (_right_deg(fixes.roll_deg, fixes.pitch_deg), 90.0, "roll"),
    ):
        known = np.flatnonzero(np.isfinite(rise_deg))
        times_ns, first = np.unique(fixes.time_ns[known], return_index=True)
        rows = known[first]
        if len(rows) < LEAST_VALUES or np.ptp(rise_deg[rows]) < LEVEL_DEG:
            continue
        found.append(
            AxisTilt(
                *(times_ns, rise_deg[rows], sigma[rows], offset_deg + beside_deg),
                *(BASELINE_MOUNT_SIGMA_DEG, 0.0, f"{what} beside the recorded heading", ANTENNAS),
            )
        )
    return tuple(found)


def agreed(
    axes: Sequence[AxisTilt], others: Sequence[tuple[Float64, Float64]]
) -> tuple[tuple[AxisTilt, ...], tuple[Finding, ...]]:
    """The `axes` that agree with `others`, and findings on those that do not.
    `others` is the rise of each axis at its own instants by the rest of the drive with its sigma,
    degrees, [n] each. An axis that contradicts takes all of its body along:
    the roll of an IMU that is mounted backward shows it before its pitch does."""
    findings, denied = [], set()
    for axis, (rise_deg, sigma_deg) in zip(axes, others, strict=True):
        off_deg = axis.rise_deg - rise_deg
        lasting_deg = np.hypot(axis.mount_sigma_deg, axis.frame_sigma_deg)
        away = np.abs(off_deg) / np.hypot(np.hypot(axis.sigma_deg, sigma_deg), lasting_deg)
        if np.percentile(away, 68.0) > CONTRADICTED_SIGMAS:
            usual_deg = float(np.median(off_deg))
            denied.add(axis.body)
            findings.append(
                warning(
                    "tilt-unused",
                    f"The {axis.source} is {usual_deg:+.1f}° (half of it more than "
                    f"{np.median(np.abs(off_deg)):.1f}°) off what the rest of the drive tells, so "
                    f"roll and pitch by the {axis.body} were not used.",
                    "See that heading_offset_deg says where the antennas point, or imu_axes how "
                    "the IMU sits.",
                    Figure(usual_deg, "deg"),
                )
            )
    return tuple(axis for axis in axes if axis.body not in denied), tuple(findings)
