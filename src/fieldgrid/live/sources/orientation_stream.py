"""Roll and pitch that a stream states, by the rules of a bag: recorded ones, those of a topic that
was given for them, and the orientations of its IMU or odometry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.geometry import Orientation, RecordedTilt
from fieldgrid.live.pose.sensor_rows import Rows, rows_of
from fieldgrid.live.sources.imu_stream import ImuStream
from fieldgrid.recordings import (
    AXES,
    IMU,
    LEAST_STEP_NS,
    ODOMETRY_FRAME_SIGMA_DEG,
    ORIENTATION,
    R_VEHICLE_FLU,
    TAKEN,
    TILT,
    Tilts,
    Transforms,
    Untold,
    axes_of,
    lean_of,
    orientation_of,
    stated_orientation,
)

SETTLED_NS = 5_000_000_000
"""Time for which orientations are held before one source is chosen: the other may begin later."""

IMU_FIRST_NS = 30_000_000_000
"""Time for which odometry waits for an IMU whose orientation has not changed yet."""

MOST_HELD = 100_000
"""Number of orientations of a source that are held; one that never leans until then is not used."""

ATTITUDE = "attitude"
"""The role of a topic that was given for roll and pitch."""

RECORDED: dict[str, tuple[str, type[RecordedTilt | Orientation]]] = {
    TILT: ("tilt", RecordedTilt),
    ORIENTATION: ("orientation", Orientation),
}
"""Topics of converted drives: the part of the motion that they hold, and its rows."""


_Leans = list[tuple[int, tuple[float, ...]]]
"""Times, and what `lean_of` says of messages that tell something."""


class _AttitudeSource(NamedTuple):
    """The source that tells roll and pitch, and from its axes to the vehicle's, upward [3, 3]."""

    role: str
    R_vehicle_body: Float64


class OrientationStream:
    """Takes messages of an `imu` and of `odometry`, and gives rows of orientation.

    As in a bag, an accelerometer or recorded roll and pitch go first, then the IMU's orientation,
    then that of odometry. Where a topic was given for them (`is_given`), it alone counts.
    Of `transforms` those count that are known when the source is chosen.
    """

    def __init__(
        self, imu_axes: str, imu: ImuStream, transforms: Transforms, *, is_given: bool = False
    ) -> None:
        self._imu, self._transforms, self._is_given = imu, transforms, is_given
        self._roles = (ATTITUDE,) if is_given else ("imu", "odometry")
        self._imu_axes = imu_axes
        # The roles whose messages are those of an Imu, and of the IMU that the stream is read for.
        self._imus, self._is_of_imu = {"imu"}, {"imu"}
        self._held: dict[str, _Leans] = {}
        self._bodies: dict[str, str] = {}
        self._chosen: _AttitudeSource | None = None
        self._since_ns: int | None = None
        self._last_ns = 0
        self._next_try = 2
        self._is_unused = False
        """Whether an accelerometer, or what was recorded, tells roll and pitch."""
        self.notes: list[str] = []
        """What is reported of it."""

    def recorded(self, topic: str, said: str) -> list[tuple[str, Rows]]:
        """The rows of a text on a topic of `RECORDED`."""
        part, kind = RECORDED[topic]
        tilts = Tilts(kind)
        tilts.add(said)
        found = tilts.found()
        if found is None or (part == "orientation" and (self._is_given or self._chosen)):
            return []
        if not self._is_given and self._chosen is None:
            self._is_unused = True
            self._held.clear()
        return [(part, rows_of(part, *found))]

    def take_given(
        self, message: Any, time_ns: int, kind: str, *, is_of_imu: bool
    ) -> list[tuple[str, Rows]]:
        """Rows that are known with the next message of the topic that was given, whose messages
        are of a `kind`; `is_of_imu` where it is the topic of the IMU, too."""
        if kind == IMU:
            self._imus.add(ATTITUDE)
        self._is_of_imu = {ATTITUDE} if is_of_imu else set()
        # A pose names the frame that it is in, and not whose it is.
        body = message.header.frame_id if kind == IMU else getattr(message, "child_frame_id", "")
        return self.take(ATTITUDE, message, time_ns, str(body))

    def take(self, role: str, message: Any, time_ns: int, body: str) -> list[tuple[str, Rows]]:
        """Rows that are known with the next message of a role, whose frame is `body`."""
        if self._is_unused or role not in self._roles:
            return []
        if self._chosen is not None:
            return self._next(message, time_ns) if role == self._chosen.role else []
        self._bodies[role] = self._bodies.get(role) or body
        held = self._held.setdefault(role, [])
        if len(held) < MOST_HELD and np.isfinite((lean := lean_of(message))[0]):
            held.append((time_ns, lean))
        self._since_ns = time_ns if self._since_ns is None else self._since_ns
        waited_ns = time_ns - self._since_ns
        count = sum(map(len, self._held.values()))
        # Twice as many each time: what does not lean is not looked at with each message.
        if waited_ns < SETTLED_NS or count < self._next_try:
            return []
        if self._imu.feels is None and not self._is_given:
            return []
        self._next_try = 2 * count
        return self._choose(waits_for_imu=waited_ns < IMU_FIRST_NS)

    def finish(self) -> list[tuple[str, Rows]]:
        """The rows of what is held, when nothing more comes."""
        if self._is_unused or self._chosen is not None:
            return []
        return self._choose(waits_for_imu=False)

    def _choose(self, *, waits_for_imu: bool) -> list[tuple[str, Rows]]:
        if self._imu.feels and not self._is_given:
            self._is_unused = True
            self._held.clear()
            return []
        for role in self._roles:
            held = self._held.get(role)
            if not held:
                continue
            found = self._found(role, held)
            if isinstance(found, Orientation):
                self._held.clear()
                self._last_ns = int(found.time_ns[-1])
                return [("orientation", Rows(found.time_ns, found[1:]))]
            if found.by_axes:
                by_imu = " or imu_axes in mounting.json" if role in self._imus else ""
                self._note(
                    f"has orientations of its {role} that tell no roll and pitch: {found.why}; say "
                    f"how it sits by a static transform at the start of the stream{by_imu}."
                )
            elif self._is_given and not waits_for_imu:
                self._note(f"has a topic for the attitude that tells none: {found.why}.")
            elif waits_for_imu and role == "imu":
                break
        return []

    def _found(self, role: str, held: _Leans) -> Orientation | Untold:
        axes = self._imu_axes if role in self._imus else AXES
        try:
            R_flu_body, how = axes_of(self._transforms, axes, self._bodies[role])
        except CalibrationError as problem:
            return Untold(str(problem).removesuffix("."), by_axes=True)
        if role in self._is_of_imu and how == TAKEN and not self._imu.is_whole:
            return Untold("it does not feel gravity along its z axis", by_axes=True)
        times_ns = np.array([at_ns for at_ns, _ in held], dtype=np.int64)
        values = np.array([lean for _, lean in held])
        found = orientation_of(
            *(times_ns, values, R_flu_body, self._frame_sigma_deg(role)), axes_known=how != TAKEN
        )
        if isinstance(found, Orientation):
            R_vehicle_body = R_VEHICLE_FLU @ R_flu_body
            upward = np.sign(float((values[:, :3] @ R_vehicle_body.T)[:, 2].mean()))
            self._chosen = _AttitudeSource(role, upward * R_vehicle_body)
        return found

    def _next(self, message: Any, time_ns: int) -> list[tuple[str, Rows]]:
        """The row of a message of the chosen source."""
        assert self._chosen is not None
        if time_ns < self._last_ns + LEAST_STEP_NS:
            return []
        values = np.array([lean_of(message)])
        if np.isnan(values[0, 0]):
            return []
        self._last_ns = time_ns
        found = stated_orientation(
            np.array([time_ns], dtype=np.int64),
            values[:, :3] @ self._chosen.R_vehicle_body.T,
            values[:, 3],
            self._frame_sigma_deg(self._chosen.role),
        )
        return [("orientation", Rows(found.time_ns, found[1:]))]

    def _frame_sigma_deg(self, role: str) -> float:
        return 0.0 if role in self._imus else ODOMETRY_FRAME_SIGMA_DEG

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
