"""An IMU of a stream: rates and forces as rows, in the axes that its first messages show."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, Int64
from fieldgrid.live.pose.sensor_rows import Rows, rows_of
from fieldgrid.recordings import (
    R_VEHICLE_FLU,
    TAKEN,
    MotionSeries,
    Transforms,
    axes_of,
    felt_upward,
    gravity_unit_mps2,
    inertial_of,
    rate_about,
    sensed_by,
    turns_across,
)

HELD, HELD_NS = 50, 1_000_000_000
"""Number of messages, or their time span, that are held until it is decided which way is up."""

MOST_UNTURNED = 100_000
"""Number of messages that are kept of an IMU that has not turned about a level axis yet: it may
have one axis only, and then it has none that tells how a vehicle leans."""

_PARTS = slice(0, 3), slice(3, 6)


class _ImuAxes(NamedTuple):
    """The vertical in the IMU's axes [3], the vehicle's axes seen from them [3, 3], None where they
    are not known, and what a force is in m/s², NaN where it is no force."""

    upward: Float64
    R_vehicle_imu: Float64 | None
    unit_mps2: float


class ImuStream:
    """Takes messages of an IMU, and gives rows of gyro and, with all axes, of an inertial sensor.

    `axes` say how it sits; where those are the usual ones, the static transforms, the name of its
    frame and gravity may say others, as in a bag. Of `transforms` those count that are known when
    the first messages are.
    """

    def __init__(self, axes: str, transforms: Transforms | None = None) -> None:
        self._said = axes
        self._transforms = Transforms() if transforms is None else transforms
        self._frame = ""
        self._held: list[tuple[int, Float64]] = []
        self._axes: _ImuAxes | None = None
        self._unturned: deque[tuple[int, Float64]] | None = deque(maxlen=MOST_UNTURNED)
        self.notes: list[str] = []
        """What the user must know of it."""

    @property
    def feels(self) -> bool | None:
        """Whether an accelerometer tells how the vehicle leans; None until that is clear."""
        if self._axes is None:
            return None if self._held else False
        if not self.is_whole or np.isnan(self._axes.unit_mps2):
            return False
        return None if self._unturned is not None else True

    @property
    def is_whole(self) -> bool:
        """Whether it is known how all its axes sit, as far as its messages tell."""
        return self._axes is None or self._axes.R_vehicle_imu is not None

    def take(self, message: Any, time_ns: int) -> list[tuple[str, Rows]]:
        """Rows, by their parts, that are known with the next message, of `sensor_msgs/Imu`."""
        sensed = np.array(sensed_by(message))
        if np.isnan(sensed[:3]).all():
            return []
        self._held.append((time_ns, sensed))
        if self._axes is None:
            self._frame = str(message.header.frame_id)
            if len(self._held) < HELD and time_ns - self._held[0][0] < HELD_NS:
                return []
        return self.finish()

    def check_transforms(self) -> None:
        """Note transforms that came after the axes were decided, and say others."""
        if self._axes is None:
            return
        (R_flu_imu, told), used = self._sits(), self._axes.R_vehicle_imu
        is_used = used is not None and np.array_equal(R_VEHICLE_FLU @ R_flu_imu, used)
        if told != TAKEN and not is_used:
            self._note(
                "has a static transform of the IMU that came after its first messages, and is "
                "not used; record /tf_static from the start, or say imu_axes in mounting.json."
            )

    def finish(self) -> list[tuple[str, Rows]]:
        """The rows of all messages that are held."""
        held, self._held = self._held, []
        if not held:
            return []
        if self._axes is None:
            self._axes = self._decided(*_stacked(held))
        times_ns, sensed = _stacked(held)
        rate_rad_s = -rate_about(sensed[:, :3], self._axes.upward)
        known = np.isfinite(rate_rad_s)
        made = (
            [("gyro", rows_of("gyro", times_ns[known], rate_rad_s[known]))] if known.any() else []
        )
        return made + self._inertial(self._axes, held)

    def _sits(self) -> tuple[Float64, str]:
        """From its axes to forward, left, up, and how that is known, as of a bag."""
        try:
            return axes_of(self._transforms, self._said, self._frame)
        except CalibrationError as problem:
            self._note(f"has transforms that do not say how the IMU sits: {problem}")
            return axes_of(Transforms(), self._said, self._frame)

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _decided(self, times_ns: Int64, sensed: Float64) -> _ImuAxes:
        R_flu_imu, told = self._sits()
        if told == TAKEN and (felt := felt_upward(sensed[:, 3:])) is not None:
            self.notes.append(
                "has an IMU that does not lie flat: it is taken as turned so that gravity is felt "
                f"upward, along {felt.astype(int).tolist()}, and roll and pitch are not used; say "
                "imu_axes in mounting.json."
            )
            return _ImuAxes(felt, None, np.nan)
        R_vehicle_imu = R_VEHICLE_FLU @ R_flu_imu
        turned = np.hstack([sensed[:, part] @ R_vehicle_imu.T for part in _PARTS])
        remarks: list[str] = []
        found = inertial_of(MotionSeries(times_ns, turned), remarks)
        self.notes += [f"has an IMU: {remark}" for remark in remarks]
        unit_mps2 = None
        if found is not None and np.isfinite(found.force_mps2).any():
            known = np.isfinite(turned).all(axis=1)
            unit_mps2 = gravity_unit_mps2(np.median(turned[known, 3:], axis=0))
        return _ImuAxes(R_flu_imu[2], R_vehicle_imu, unit_mps2 or np.nan)

    def _inertial(
        self, axes: _ImuAxes, messages: list[tuple[int, Float64]]
    ) -> list[tuple[str, Rows]]:
        """Rows of all axes, if it has them."""
        if axes.R_vehicle_imu is None:
            return []
        if self._unturned is not None:
            # With one axis, an IMU says 0 or NaN of the others.
            self._unturned.extend(messages)
            if not turns_across(_stacked(messages)[1], axes.upward):
                return []
            messages, self._unturned = list(self._unturned), None
        times_ns, sensed = _stacked(messages)
        rates, forces = (sensed[:, part] @ axes.R_vehicle_imu.T for part in _PARTS)
        forces = forces.astype(np.float32)
        if axes.unit_mps2 != 1.0:  # NaN, too
            forces = forces * np.float32(axes.unit_mps2)
        known = np.isfinite(rates).all(axis=1)
        if not np.isnan(axes.unit_mps2):  # a sample without its force is as if there were none
            known &= np.isfinite(forces).all(axis=1)
        if not known.any():
            return []
        return [("inertial", rows_of("inertial", times_ns[known], rates[known], forces[known]))]


def _stacked(messages: list[tuple[int, Float64]]) -> tuple[Int64, Float64]:
    """Times [n], and rates and forces [n, 6]."""
    times_ns, sensed = zip(*messages, strict=True)
    return np.array(times_ns, dtype=np.int64), np.stack(sensed)
