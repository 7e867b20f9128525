"""Rows of an OXTS inertial navigation system as KITTI stores them: fixes and the gyro."""

from __future__ import annotations

import numpy as np

from fieldgrid.angles import heading_from_yaw_rad
from fieldgrid.array_types import Float64, Int64
from fieldgrid.gnss import Fix
from fieldgrid.motion import Gyro, Motion

FIELDS = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("ax", "ay", "az", "af", "al", "au", "wx", "wy", "wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)
"""The names of a row's numbers, in their order: degrees, metres, radians, seconds."""

_HEADING_SIGMA_DEG = 0.1  # of the RT3003 by its data sheet

# OXTS position modes as GGA qualities. -1 is a row that KITTI interpolated for a packet that
# was lost: its position and time stamp do not belong together, so it is "estimated".
_INTERPOLATED = -1
_QUALITY_OF_POSMODE = {_INTERPOLATED: 6, 2: 1, 3: 1, 4: 2, 5: 5, 6: 4, 7: 9, 8: 2, 9: 2}


def oxts_fixes(time_ns: Int64, rows: Float64) -> list[Fix]:
    """A fix for each row of `rows` (n x 30, :data:`FIELDS`) at its UTC time."""
    value = {name: rows[:, k] for k, name in enumerate(FIELDS)}
    speeds = np.hypot(value["vf"], value["vl"])
    headings = heading_from_yaw_rad(value["yaw"])
    return [
        Fix(
            time_ns=time,
            lat_deg=lat,
            lon_deg=lon,
            height_m=height,
            quality=_QUALITY_OF_POSMODE.get(int(mode), 0),
            satellites=int(satellites) if satellites >= 0 else None,
            sigma_m=sigma,
            speed_mps=speed,
            heading_deg=heading,
            heading_sigma_deg=_HEADING_SIGMA_DEG,
        )
        for time, lat, lon, height, mode, satellites, sigma, speed, heading in zip(
            time_ns.tolist(),
            *(value[name].tolist() for name in ("lat", "lon", "alt", "posmode", "numsats")),
            value["pos_accuracy"].tolist(),
            speeds.tolist(),
            headings.tolist(),
            strict=True,
        )
    ]


def oxts_motion(time_ns: Int64, rows: Float64) -> Motion:
    """The gyro about the vehicle's vertical, without the rows that KITTI interpolated."""
    real = rows[:, FIELDS.index("posmode")] != _INTERPOLATED
    order = np.argsort(time_ns[real], kind="stable")
    times_ns, kept = np.unique(time_ns[real][order], return_index=True)
    if times_ns.size == 0:
        return Motion()
    upward_rad_s = rows[real, FIELDS.index("wu")][order][kept]
    return Motion(gyro=Gyro(times_ns, -upward_rad_s))
