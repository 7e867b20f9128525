"""The layers of points and footprints that a GIS shows: copies of the evidence, for display."""

from __future__ import annotations

import math
import sqlite3
from array import array
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Int64
from fieldgrid.geometry import Bounds, Trajectory
from fieldgrid.maps.file.geometry import encode_point, encode_polygon
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.file.schema import GEOMETRIES
from fieldgrid.maps.transfer import to_universal

_COLUMNS = {
    "trajectory": (
        "session, time_ns, time, up_m, heading_deg, heading_sigma_deg, position_sigma_m, "
        "speed_mps, gear, quality, status, reason"
    ),
    "frame_position": "session, frame_id, time_ns, time, heading_deg, quality, status, reason",
    "footprint": "session, frame_id, time_ns, time, status",
}


FEATURE_LAYERS = tuple(_COLUMNS)
"""The layers of features, each with the name of its session."""


_Feature = tuple[tuple[tuple[float, float], ...], tuple[Any, ...]]
"""A row of a layer: the corners that its geometry is made of, and its attributes."""


def show_session(
    connection: sqlite3.Connection,
    session_id: int,
    name: str,
    frames: Callable[[], Iterable[FrameRecord]],
    track: Trajectory | None,
) -> None:
    """Put the features of a session into the layers; `frames` reads its frames each time."""
    _insert(connection, session_id, "trajectory", _fixes(name, track))
    positions = (
        (
            ((frame.pose.east_m, frame.pose.north_m),),
            (
                frame.session, frame.frame_id, frame.pose.time_ns, _moment(frame.pose.time_ns),
                frame.pose.heading_deg, frame.quality, frame.pose.status, frame.pose.reason,
            ),
        )
        for frame in frames()
    )  # fmt: skip
    _insert(connection, session_id, "frame_position", positions)
    _insert(connection, session_id, "footprint", _footprints(frames()))
    announce_extents(connection)


def hide_session(connection: sqlite3.Connection, session_id: int, name: str) -> None:
    """Take the features of a session out of the layers."""
    for layer in GEOMETRIES:
        connection.execute(f"DELETE FROM {layer} WHERE session = ?", (name,))
    connection.execute("DELETE FROM fieldgrid_extent WHERE session_id = ?", (session_id,))
    announce_extents(connection)


def _fixes(name: str, track: Trajectory | None) -> Iterator[_Feature]:
    if track is None:
        return
    gear = getattr(track, "gear", None)  # trajectories of heading by course alone may have none
    columns = (
        track.time_ns, _moments(track.time_ns), track.up_m, track.heading_deg,
        track.heading_sigma_deg, track.position_sigma_m, track.speed_mps,
    )  # fmt: skip
    gears = [None] * len(track) if gear is None else gear.tolist()
    rows = zip(*(column.tolist() for column in columns), strict=True)
    verdicts = zip(gears, track.quality.tolist(), track.status, track.reason, strict=True)
    places = zip(track.east_m.tolist(), track.north_m.tolist(), strict=True)
    for place, row, verdict in zip(places, rows, verdicts, strict=True):
        yield (place,), (name, *row, *verdict)


def _footprints(frames: Iterable[FrameRecord]) -> Iterator[_Feature]:
    for frame in frames:
        half_m, length_m = frame.spec.width_m / 2.0, frame.spec.length_m
        x = np.array([-half_m, half_m, half_m, -half_m])
        y = np.array([0.0, 0.0, length_m, length_m])
        if math.isfinite(frame.pose.heading_deg):
            east, north = to_universal(x, y, frame.pose)
        else:
            east = north = np.full(4, math.nan)
        yield (
            tuple(zip(east.tolist(), north.tolist(), strict=True)),
            (
                frame.session, frame.frame_id, frame.pose.time_ns, _moment(frame.pose.time_ns),
                frame.pose.status,
            ),
        )  # fmt: skip


def _moments(time_ns: Int64) -> npt.NDArray[np.str_]:
    """Times as a GIS reads them: UTC to the millisecond."""
    return np.datetime_as_string(time_ns.astype("datetime64[ns]"), unit="ms", timezone="UTC")


def _moment(time_ns: int) -> str:
    return str(_moments(np.array([time_ns]))[0])


def _insert(
    connection: sqlite3.Connection, session_id: int, layer: str, features: Iterable[_Feature]
) -> None:
    """Add features to a layer, and note the rectangle that they cover."""
    columns = _COLUMNS[layer]
    places = ", ?" * (columns.count(",") + 1)
    is_point = GEOMETRIES[layer] == "POINT"
    insert = f"INSERT INTO {layer} (geom, {columns}) VALUES (?{places})"
    corners = array("d")
    for place, attributes in features:
        geometry = encode_point(*place[0]) if is_point else encode_polygon(place)
        connection.execute(insert, (geometry, *attributes))
        if geometry is not None:
            corners.extend(chain.from_iterable(place))
    if corners:
        east, north = np.array(corners).reshape(-1, 2).T
        bounds = Bounds(*(float(v) for v in (east.min(), north.min(), east.max(), north.max())))
        connection.execute(
            "INSERT INTO fieldgrid_extent VALUES (?, ?, ?, ?, ?, ?)", (session_id, layer, *bounds)
        )


def announce_extents(connection: sqlite3.Connection) -> None:
    """Tell a GIS what each layer covers."""
    for layer in GEOMETRIES:
        connection.execute(
            "UPDATE gpkg_contents SET (min_x, min_y, max_x, max_y) = (SELECT min(west_m), "
            "min(south_m), max(east_m), max(north_m) FROM fieldgrid_extent WHERE layer = :layer) "
            "WHERE table_name = :layer",
            {"layer": layer},
        )
