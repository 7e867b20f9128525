"""What a map is as messages of ROS 2: grids, paths, fixes and the frame they are in.

The frame `map` is the map's own plane: x east, y north, z up in metres from the datum. `earth` is
WGS84's Earth-centred frame (REP-105), and the static transform between the two is the datum.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, Bool, Float32, Float64, Int64, Quality
from fieldgrid.geometry import (
    Datum,
    Fix,
    Lattice,
    LeverArm,
    Trajectory,
    Window,
    geodetic_to_ecef,
    yaw_from_heading_rad,
)
from fieldgrid.maps import MapView
from fieldgrid.recordings import (
    EARTH,
    MAP,
    NOT_SAID,
    header_of,
    nav_sat_fix,
    new,
    path_message,
    pose,
    time_of,
    transform,
    transforms,
    turn_left,
    vector,
)


def occupancy_grid(
    lattice: Lattice, window: Window, occupancy: npt.NDArray[np.int8], time_ns: int
) -> Any:
    """nav_msgs/OccupancyGrid of an occupancy [rows north, columns east], as Nav2 takes it."""
    bounds = lattice.bounds(window)
    return new(
        "nav_msgs/OccupancyGrid",
        header=header_of(time_ns, MAP),
        info=new(
            "nav_msgs/MapMetaData",
            map_load_time=time_of(time_ns),
            resolution=lattice.cell_m,
            width=window.width,
            height=window.height,
            origin=pose(bounds.west_m, bounds.south_m),
        ),
        data=np.ascontiguousarray(occupancy).reshape(-1),
    )


def grid_map(view: MapView, layers: Mapping[str, AnyArray], time_ns: int) -> Any:
    """grid_map_msgs/GridMap of layers [rows north, columns east]; NaN where not observed.

    Its index (0, 0) is the cell in the north-east; the first index runs west, the second south.
    """
    bounds, width, height = view.bounds, view.window.width, view.window.height
    info = new(
        "grid_map_msgs/GridMapInfo",
        resolution=view.lattice.cell_m,
        length_x=bounds.east_m - bounds.west_m,
        length_y=bounds.north_m - bounds.south_m,
        pose=pose((bounds.west_m + bounds.east_m) / 2, (bounds.south_m + bounds.north_m) / 2),
    )
    # Column-major: its rows are our columns, so a row of ours is a column of its storage.
    axes = (("column_index", height, width * height), ("row_index", width, width))
    layout = new(
        "std_msgs/MultiArrayLayout",
        dim=[
            new("std_msgs/MultiArrayDimension", label=label, size=size, stride=stride)
            for label, size, stride in axes
        ],
        data_offset=0,
    )
    return new(
        "grid_map_msgs/GridMap",
        header=header_of(time_ns, MAP),
        info=info,
        layers=list(layers),
        basic_layers=[next(iter(layers))],
        data=[
            new("std_msgs/Float32MultiArray", layout=layout, data=_floats(values, view.observed))
            for values in layers.values()
        ],
        outer_start_index=0,
        inner_start_index=0,
    )


def path(track: Trajectory, rows: Int64, time_ns: int) -> Any:
    """nav_msgs/Path of some rows that have a heading, each with its own time, on the plane of the
    map, where `/map` lies."""
    places = np.column_stack([track.east_m[rows], track.north_m[rows], np.zeros(len(rows))])
    return path_message(
        time_ns,
        MAP,
        track.time_ns[rows].tolist(),
        places,
        yaw_from_heading_rad(track.heading_deg[rows]),
    )


class Antenna(NamedTuple):
    """A frame whose positions fixes are, and where it is on a level vehicle."""

    frame: str
    at: LeverArm


def antenna_on(base: str, antenna: Antenna, time_ns: int) -> Any:
    """geometry_msgs/TransformStamped: where the antenna is in the vehicle's frame, forward, left,
    up."""
    return transform(
        time_ns,
        base,
        antenna.frame,
        np.array([antenna.at.forward_m, -antenna.at.right_m, antenna.at.up_m]),
        turn_left(0.0),
    )


def fixes(
    track: Trajectory, wanted: Bool, base: str, antenna: Antenna | None, up_sigma_m: Float64
) -> Iterator[tuple[int, Any]]:
    """The time in ns and the sensor_msgs/NavSatFix of each wanted row that a fix gave.

    The positions are those of the antenna, where the pose has it, in its own frame; where nothing
    tells the antenna, of the vehicle's grid origin, the frame `base`. `up_sigma_m` are the 1-sigma
    errors of the heights by row, which places that were aligned do not tell; where one is not
    known, its variance is 10^6.
    """
    given = wanted & (track.quality != Quality.ESTIMATED)
    arm = LeverArm(0.0, 0.0, 0.0) if antenna is None else antenna.at
    if antenna is not None:
        given &= np.isfinite(track.heading_deg)
    rows = np.flatnonzero(given)
    heading = np.radians(np.nan_to_num(track.heading_deg[rows]))
    sin, cos = np.sin(heading), np.cos(heading)
    places = track.datum.to_geodetic(
        track.east_m[rows] + arm.right_m * cos + arm.forward_m * sin,
        track.north_m[rows] - arm.right_m * sin + arm.forward_m * cos,
        track.up_m[rows] + arm.up_m,
    )
    for k, lat_deg, lon_deg, height_m in zip(rows, *places, strict=True):
        time_ns, sigma_m = int(track.time_ns[k]), float(track.position_sigma_m[k])
        fix = Fix(
            time_ns,
            float(lat_deg),
            float(lon_deg),
            float(height_m),
            Quality(track.quality[k]),
            sigma_m=sigma_m if math.isfinite(sigma_m) else None,
        )
        message = nav_sat_fix(fix, base if antenna is None else antenna.frame)
        if fix.sigma_m:
            up_m = float(up_sigma_m[k])
            message.position_covariance[8] = up_m * up_m if math.isfinite(up_m) else NOT_SAID
        yield time_ns, message


def driven(track: Trajectory, rows: Int64, base: str) -> Iterator[tuple[int, Any, Any]]:
    """The time in ns, the nav_msgs/Odometry and the tf2_msgs/TFMessage of rows that have a heading:
    where the frame `base` of the vehicle, forward, left, up, is in the map.

    The speed is negative in reverse. What is not known has a variance of 10^6.
    """
    yaw_rad = yaw_from_heading_rad(track.heading_deg[rows])
    for k, yaw in zip(rows.tolist(), yaw_rad.tolist(), strict=True):
        time_ns, gear = int(track.time_ns[k]), int(track.gear[k])
        at_m = np.array([track.east_m[k], track.north_m[k], track.up_m[k]])
        position, turn = float(track.position_sigma_m[k]), float(track.heading_sigma_deg[k])
        sigmas = [position, position, math.nan, math.nan, math.nan, math.radians(turn)]
        speed_mps = float(np.nan_to_num(track.speed_mps[k]))
        message = new(
            "nav_msgs/Odometry",
            header=header_of(time_ns, MAP),
            child_frame_id=base,
            pose=new(
                "geometry_msgs/PoseWithCovariance",
                pose=pose(float(at_m[0]), float(at_m[1]), float(at_m[2]), yaw),
                covariance=variances(sigmas),
            ),
            twist=new(
                "geometry_msgs/TwistWithCovariance",
                twist=new(
                    "geometry_msgs/Twist",
                    linear=vector(-abs(speed_mps) if gear < 0 else speed_mps, 0.0, 0.0),
                    angular=vector(0.0, 0.0, 0.0),
                ),
                covariance=variances([math.nan] * 6),
            ),
        )
        yield time_ns, message, transforms(transform(time_ns, MAP, base, at_m, turn_left(yaw)))


def variances(sigmas: Sequence[float]) -> Float64:
    """A covariance [36] of six errors that are independent."""
    found: Float64 = np.diag([s * s if math.isfinite(s) else NOT_SAID for s in sigmas]).reshape(-1)
    return found


def earth_to_map(datum: Datum, time_ns: int) -> Any:
    """geometry_msgs/TransformStamped: where the frame `map` is in the frame `earth`."""
    x, y, z = geodetic_to_ecef(datum.lat_deg, datum.lon_deg, datum.height_m)
    # About the axis of the Earth until x points east, then about x until z points up.
    about_z = math.radians(datum.lon_deg + 90.0) / 2.0
    about_x = math.radians(90.0 - datum.lat_deg) / 2.0
    rotation = new(
        "geometry_msgs/Quaternion",
        x=math.cos(about_z) * math.sin(about_x),
        y=math.sin(about_z) * math.sin(about_x),
        z=math.sin(about_z) * math.cos(about_x),
        w=math.cos(about_z) * math.cos(about_x),
    )
    return transform(time_ns, EARTH, MAP, np.array([x, y, z], dtype=np.float64), rotation)


def _floats(values: AnyArray, observed: Bool) -> Float32:
    """The values from the north-east cell westwards, and so on southwards; NaN if unobserved."""
    floats = values[::-1, ::-1].astype(np.float32, order="C")
    floats[~observed[::-1, ::-1]] = np.nan
    return floats.reshape(-1)
