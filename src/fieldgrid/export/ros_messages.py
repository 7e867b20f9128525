"""What a map is as messages of ROS 2: grids, paths, fixes and the frame they are in.

The frame `map` is the map's own plane: x east, y north, z up in metres from the datum. `earth` is
WGS84's Earth-centred frame (REP-105), and the static transform between the two is the datum.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.angles import yaw_from_heading_rad
from fieldgrid.array_types import AnyArray, Bool, Float32
from fieldgrid.geodesy import Datum, geodetic_to_ecef
from fieldgrid.mapfile import MapView
from fieldgrid.quality import Quality
from fieldgrid.ros import types
from fieldgrid.trajectory import Trajectory

FRAME, EARTH = "map", "earth"

_NO_FIX, _FIX, _SBAS, _GBAS = -1, 0, 1, 2
_STATUS = {
    Quality.NONE: _NO_FIX,
    Quality.DIFFERENTIAL: _SBAS,
    Quality.RTK_FIXED: _GBAS,
    Quality.RTK_FLOAT: _GBAS,
    Quality.SBAS: _SBAS,
}
"""NavSatStatus of qualities; the others are a fix."""

_UNKNOWN_COVARIANCE, _APPROXIMATED = 0, 1


def occupancy_grid(view: MapView, occupancy: npt.NDArray[np.int8], time_ns: int) -> Any:
    """nav_msgs/OccupancyGrid of an occupancy [rows north, columns east], as Nav2 takes it."""
    bounds = view.bounds
    info = _new(
        "nav_msgs/msg/MapMetaData",
        map_load_time=_time(time_ns),
        resolution=view.lattice.cell_m,
        width=view.window.width,
        height=view.window.height,
        origin=_pose(bounds.west_m, bounds.south_m),
    )
    return _new(
        "nav_msgs/msg/OccupancyGrid",
        header=_header(time_ns),
        info=info,
        data=np.ascontiguousarray(occupancy).reshape(-1),
    )


def grid_map(view: MapView, layers: Mapping[str, AnyArray], time_ns: int) -> Any:
    """grid_map_msgs/GridMap of layers [rows north, columns east]; NaN where not observed.

    Its index (0, 0) is the cell in the north-east; the first index runs west, the second south.
    """
    bounds, width, height = view.bounds, view.window.width, view.window.height
    info = _new(
        "grid_map_msgs/msg/GridMapInfo",
        resolution=view.lattice.cell_m,
        length_x=bounds.east_m - bounds.west_m,
        length_y=bounds.north_m - bounds.south_m,
        pose=_pose((bounds.west_m + bounds.east_m) / 2, (bounds.south_m + bounds.north_m) / 2),
    )
    # Column-major: its rows are our columns, so a row of ours is a column of its storage.
    layout = _new(
        "std_msgs/msg/MultiArrayLayout",
        dim=[
            _new(
                "std_msgs/msg/MultiArrayDimension",
                label="column_index",
                size=height,
                stride=width * height,
            ),
            _new("std_msgs/msg/MultiArrayDimension", label="row_index", size=width, stride=width),
        ],
        data_offset=0,
    )
    return _new(
        "grid_map_msgs/msg/GridMap",
        header=_header(time_ns),
        info=info,
        layers=list(layers),
        basic_layers=[next(iter(layers))],
        data=[
            _new(
                "std_msgs/msg/Float32MultiArray",
                layout=layout,
                data=_floats(values, view.observed),
            )
            for values in layers.values()
        ],
        outer_start_index=0,
        inner_start_index=0,
    )


def path(track: Trajectory, time_ns: int) -> Any:
    """nav_msgs/Path of the accepted poses that have a heading; each has its own time."""
    rows = np.flatnonzero(track.accepted & np.isfinite(track.heading_deg))
    yaw_rad = yaw_from_heading_rad(track.heading_deg[rows])
    poses = [
        _new(
            "geometry_msgs/msg/PoseStamped",
            header=_header(int(track.time_ns[k])),
            pose=_pose(
                float(track.east_m[k]), float(track.north_m[k]), float(track.up_m[k]), float(yaw)
            ),
        )
        for k, yaw in zip(rows, yaw_rad, strict=True)
    ]
    return _new("nav_msgs/msg/Path", header=_header(time_ns), poses=poses)


def fixes(track: Trajectory) -> Iterator[tuple[int, Any]]:
    """The time in ns and the sensor_msgs/NavSatFix of each accepted row that a fix gave.

    The positions are those of the vehicle's grid origin, not of its antenna. The height's
    variance is not estimated; twice the horizontal sigma is usual.
    """
    rows = np.flatnonzero(track.accepted & (track.quality != Quality.ESTIMATED))
    lat, lon, height = track.datum.to_geodetic(
        track.east_m[rows], track.north_m[rows], track.up_m[rows]
    )
    for k, place in zip(rows, zip(lat, lon, height, strict=True), strict=True):
        time_ns, sigma_m = int(track.time_ns[k]), float(track.position_sigma_m[k])
        status = _STATUS.get(Quality(track.quality[k]), _FIX)
        yield time_ns, _fix(place, time_ns, status, sigma_m)


def datum_fix(datum: Datum, time_ns: int) -> Any:
    """sensor_msgs/NavSatFix of the origin of the frame `map`; its height is ellipsoidal."""
    return _fix((datum.lat_deg, datum.lon_deg, datum.height_m), time_ns, _FIX, math.nan)


def earth_to_map(datum: Datum, time_ns: int) -> Any:
    """tf2_msgs/TFMessage: where the frame `map` is in the frame `earth`."""
    x, y, z = geodetic_to_ecef(datum.lat_deg, datum.lon_deg, datum.height_m)
    # About the axis of the Earth until x points east, then about x until z points up.
    about_z = math.radians(datum.lon_deg + 90.0) / 2.0
    about_x = math.radians(90.0 - datum.lat_deg) / 2.0
    rotation = _new(
        "geometry_msgs/msg/Quaternion",
        x=math.cos(about_z) * math.sin(about_x),
        y=math.sin(about_z) * math.sin(about_x),
        z=math.sin(about_z) * math.cos(about_x),
        w=math.cos(about_z) * math.cos(about_x),
    )
    translation = _new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))
    transform = _new(
        "geometry_msgs/msg/TransformStamped",
        header=_header(time_ns, EARTH),
        child_frame_id=FRAME,
        transform=_new("geometry_msgs/msg/Transform", translation=translation, rotation=rotation),
    )
    return _new("tf2_msgs/msg/TFMessage", transforms=[transform])


def text(content: str) -> Any:
    """std_msgs/String."""
    return _new("std_msgs/msg/String", data=content)


def _floats(values: AnyArray, observed: Bool) -> Float32:
    """The values from the north-east cell westwards, and so on southwards; NaN if unobserved."""
    floats = values[::-1, ::-1].astype(np.float32, order="C")
    floats[~observed[::-1, ::-1]] = np.nan
    return floats.reshape(-1)


def _fix(place: tuple[float, float, float], time_ns: int, status: int, sigma_m: float) -> Any:
    known = math.isfinite(sigma_m)
    variance = np.array([1.0, 1.0, 4.0]) * sigma_m**2 if known else np.zeros(3)
    return _new(
        "sensor_msgs/msg/NavSatFix",
        header=_header(time_ns),
        status=_new("sensor_msgs/msg/NavSatStatus", status=status, service=1),
        latitude=float(place[0]),
        longitude=float(place[1]),
        altitude=float(place[2]),
        position_covariance=np.diag(variance).reshape(-1),
        position_covariance_type=_APPROXIMATED if known else _UNKNOWN_COVARIANCE,
    )


def _pose(x: float, y: float, z: float = 0.0, yaw_rad: float = 0.0) -> Any:
    return _new(
        "geometry_msgs/msg/Pose",
        position=_new("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_new(
            "geometry_msgs/msg/Quaternion",
            x=0.0,
            y=0.0,
            z=math.sin(yaw_rad / 2.0),
            w=math.cos(yaw_rad / 2.0),
        ),
    )


def _header(time_ns: int, frame: str = FRAME) -> Any:
    return _new("std_msgs/msg/Header", stamp=_time(time_ns), frame_id=frame)


def _time(time_ns: int) -> Any:
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return _new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def _new(name: str, **fields: Any) -> Any:
    return types().types[name](**fields)
