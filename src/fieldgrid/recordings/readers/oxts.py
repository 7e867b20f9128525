"""Rows of an OXTS inertial navigation system as KITTI stores them: fixes and the gyro."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Float32, Float64, Int64, Quality, RecordingError
from fieldgrid.geometry import (
    NOT_SAID,
    FixColumns,
    Gyro,
    Inertial,
    Motion,
    RecordedTilt,
    heading_from_yaw_rad,
)

FIELDS = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("ax", "ay", "az", "af", "al", "au", "wx", "wy", "wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)
"""The names of a row's numbers, in their order: degrees, metres, radians, seconds."""

_MOST_SATELLITES = 1000
_MOST_RAD = {"roll": 1.0, "pitch": 1.0, "yaw": 6.3}
"""Beyond these an angle is in degrees, or damaged: vehicles lean by less than 57°."""

_HEADING_SIGMA_DEG, _TILT_SIGMA_DEG = 0.1, 0.03  # of the RT3003 by its data sheet

# Qualities of OXTS's position modes. -1 is a row that KITTI interpolated for a packet that
# was lost: its position and time stamp do not belong together, so it is "estimated".
_INTERPOLATED = -1
_QUALITY_OF_POSMODE = {
    _INTERPOLATED: Quality.ESTIMATED,
    2: Quality.GPS,
    3: Quality.GPS,
    4: Quality.DIFFERENTIAL,
    5: Quality.RTK_FLOAT,
    6: Quality.RTK_FIXED,
    7: Quality.SBAS,
    8: Quality.DIFFERENTIAL,
    9: Quality.DIFFERENTIAL,
}


def oxts_fixes(time_ns: Int64, rows: Float64) -> FixColumns:
    """A fix for each row of `rows` (n x 30, :data:`FIELDS`) at its UTC time.

    Raises RecordingError for angles that cannot be in radians.
    """
    value = {name: rows[:, k] for k, name in enumerate(FIELDS)}
    for name, most_rad in _MOST_RAD.items():
        beyond = np.flatnonzero(np.abs(value[name]) > most_rad)
        if beyond.size:
            raise RecordingError(
                f"Row {beyond[0] + 1} of oxts has a {name} of {value[name][beyond[0]]:g}, which is "
                f"no angle of a vehicle in radians ({len(beyond)} of {len(rows)} rows); the rows "
                "of KITTI are in radians, so convert degrees, or unpack the drive again."
            )
    modes = [_QUALITY_OF_POSMODE.get(int(mode), Quality.NONE) for mode in value["posmode"]]
    return FixColumns.of(
        time_ns,
        lat_deg=value["lat"],
        lon_deg=value["lon"],
        height_m=value["alt"],
        quality=modes,
        satellites=np.clip(value["numsats"], NOT_SAID, _MOST_SATELLITES),
        sigma_m=value["pos_accuracy"],
        speed_mps=np.hypot(value["vf"], value["vl"]),
        heading_deg=heading_from_yaw_rad(value["yaw"]),
        heading_sigma_deg=_HEADING_SIGMA_DEG,
        stamp_sigma_s=0.0,
    )


def oxts_motion(time_ns: Int64, rows: Float64) -> Motion:
    """Gyro, accelerometer and stated tilt, without the rows that KITTI interpolated."""
    real = rows[:, FIELDS.index("posmode")] != _INTERPOLATED
    order = np.argsort(time_ns[real], kind="stable")
    times_ns, kept = np.unique(time_ns[real][order], return_index=True)
    if times_ns.size == 0:
        return Motion()
    value = dict(zip(FIELDS, rows[real][order][kept].T, strict=True))

    def vehicle(forward: str, left: str, up: str) -> Float32:
        """In the vehicle's axes: right, forward, up."""
        return np.stack([-value[left], value[forward], value[up]], axis=1).astype(np.float32)

    # The level components f, l and u would hide the tilt: x, y and z are the unit's own axes. Its
    # pitch is positive with the nose down, its roll with the left side up.
    return Motion(
        gyro=Gyro(times_ns, -value["wu"]),
        inertial=Inertial(times_ns, vehicle("wx", "wy", "wz"), vehicle("ax", "ay", "az")),
        tilt=RecordedTilt(
            times_ns,
            np.degrees(value["roll"]),
            -np.degrees(value["pitch"]),
            np.full(len(times_ns), _TILT_SIGMA_DEG),
        ),
    )
