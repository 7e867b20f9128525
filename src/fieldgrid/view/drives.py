"""Drives as the page draws them: paths, time lines, and the frames around a place.

Numbers are rounded to what a picture can show; a drive of hours is thinned evenly, and keeps every
row at which gear or verdict changes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, FieldgridError, Float64, Index, Int64, MapError
from fieldgrid.geometry import Bounds, LeverArm, Trajectory, thinned
from fieldgrid.maps import DrivenMap

MOST_ROWS = 12_000
MOST_FRAMES = 1_500
"""What is drawn at once: more points than these no screen shows."""


def track(universal: DrivenMap, session: str, most_rows: int = MOST_ROWS) -> dict[str, Any]:
    """A drive in columns: positions, heading, sigmas, speed, gear, quality, verdict, residual.

    `time_ms` counts from `start_ms`, milliseconds of UTC; None is NaN. `reasons` are the texts
    that `reason` counts, -1 for none. `residual_m` is how far a fix lay from where the pose puts
    the antenna, horizontally. A session without a trajectory has no rows.
    """
    try:
        found = universal.trajectory(session)
    except MapError:
        return {"rows": 0, "start_ms": 0.0}
    rows = thinned(found.gear, found.accepted, most_rows)
    reasons = list(dict.fromkeys(found.reason[k] for k in rows if found.reason[k]))
    number = {text: k for k, text in enumerate(reasons)}
    start_ns = int(found.time_ns[0]) if len(found) else 0
    return {
        "rows": len(rows),
        "of": len(found),
        "heading_source": found.heading_source,
        "start_ms": start_ns / 1e6,
        "time_ms": _listed((found.time_ns[rows] - start_ns) / 1e6, 0),
        "east_m": _listed(found.east_m[rows], 3),
        "north_m": _listed(found.north_m[rows], 3),
        "up_m": _listed(found.up_m[rows], 2),
        "heading_deg": _listed(found.heading_deg[rows], 2),
        "heading_sigma_deg": _listed(found.heading_sigma_deg[rows], 3),
        "position_sigma_m": _listed(found.position_sigma_m[rows], 3),
        "speed_mps": _listed(found.speed_mps[rows], 2),
        "residual_m": _listed(_residuals(universal, session, found)[rows], 3),
        "gear": found.gear[rows].tolist(),
        "quality": found.quality[rows].tolist(),
        "status": [found.status[k].value for k in rows],
        "reason": [number.get(found.reason[k], -1) for k in rows],
        "reasons": reasons,
    }


def _residuals(universal: DrivenMap, session: str, found: Trajectory) -> Float64:
    """Of each row the distance between its fix and the antenna of its pose, NaN without a fix."""
    distance = np.full(len(found), np.nan)
    info = next(info for info in universal.sessions() if info.name == session)
    try:
        inputs = universal.session_inputs(session)
        time_ns = inputs["fix.time_ns"].astype(np.int64)
        place = (inputs[f"fix.{name}"] for name in ("lat_deg", "lon_deg", "height_m"))
        antenna = LeverArm(**info.config["rig"]["antenna"])
        east, north, _ = universal.datum.to_enu(*place)
    except (KeyError, TypeError, FieldgridError):
        return distance  # of another program, which kept no fixes
    order = np.argsort(time_ns, kind="stable")
    at = np.minimum(np.searchsorted(time_ns[order], found.time_ns), len(order) - 1)
    if len(order) == 0:
        return distance
    fix = order[at]
    phi = np.radians(found.heading_deg)
    sin, cos = np.sin(phi), np.cos(phi)
    antenna_east = found.east_m + antenna.right_m * cos + antenna.forward_m * sin
    antenna_north = found.north_m - antenna.right_m * sin + antenna.forward_m * cos
    apart = np.hypot(east[fix] - antenna_east, north[fix] - antenna_north)
    return np.where(time_ns[fix] == found.time_ns, apart, np.nan)


class FrameTable(NamedTuple):
    """The frames of all active sessions in columns; `session` counts `MapFile.sessions()`."""

    session: Int64
    frame_id: tuple[str, ...]
    reason: tuple[str, ...]
    accepted: AnyArray
    time_ns: Int64
    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    width_m: Float64
    length_m: Float64


def frame_table(universal: DrivenMap, names: Collection[str] | None = None) -> FrameTable:
    """The frames of the active sessions, or of some of them, without their grids."""
    number = {
        info.name: k
        for k, info in enumerate(universal.sessions())
        if (info.active if names is None else info.name in names)
    }
    rows = [
        (
            number[frame.session], frame.frame_id, frame.reason, frame.accepted,
            frame.pose.time_ns, frame.pose.east_m, frame.pose.north_m, frame.pose.heading_deg,
            frame.spec.width_m, frame.spec.length_m,
        )
        for name in number
        for frame in universal.frames(name)
    ]  # fmt: skip
    columns = list(zip(*rows, strict=True)) or [()] * len(FrameTable._fields)
    return FrameTable(
        np.array(columns[0], np.int64), columns[1], columns[2], np.array(columns[3], np.bool_),
        np.array(columns[4], np.int64), *(np.array(c, np.float64) for c in columns[5:]),
    )  # fmt: skip


def frames_within(
    tables: Sequence[FrameTable], bounds: Bounds, sessions: set[int] | None
) -> dict[str, Any]:
    """The frames whose footprints may reach into bounds, evenly thinned where there are many."""
    places = [
        (table, row) for table in tables for row in _rows_within(table, bounds, sessions).tolist()
    ]
    shown = places[:: max(1, math.ceil(len(places) / MOST_FRAMES))]
    found: dict[str, Any] = {"of": len(places)}
    for name in ("session", "frame_id", "reason", "accepted"):
        found[name] = [_plain(getattr(table, name)[row]) for table, row in shown]
    found["time_ms"] = _listed(np.array([t.time_ns[k] / 1e6 for t, k in shown]), 0)
    for name in ("east_m", "north_m", "heading_deg", "width_m", "length_m"):
        found[name] = _listed(np.array([getattr(t, name)[k] for t, k in shown]), 3)
    return found


def _rows_within(table: FrameTable, bounds: Bounds, sessions: set[int] | None) -> Index:
    reach = table.width_m + table.length_m
    inside = (
        (table.east_m + reach >= bounds.west_m)
        & (table.east_m - reach <= bounds.east_m)
        & (table.north_m + reach >= bounds.south_m)
        & (table.north_m - reach <= bounds.north_m)
    )
    if sessions is not None:
        inside &= np.isin(table.session, list(sessions))
    return np.flatnonzero(inside)


def _plain(value: Any) -> Any:
    """A number of NumPy as one that JSON has."""
    return value.item() if isinstance(value, np.generic) else value


def _listed(values: Float64, digits: int) -> list[float | None]:
    """Rounded numbers, None for NaN and infinity, which JSON does not have."""
    rounded = np.round(values, digits).tolist()
    return [value if math.isfinite(value) else None for value in rounded]
