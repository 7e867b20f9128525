"""Why a cell has its value: what every layer says of it, and each frame that saw it.

A frame comes with where it stood, and with the part of its images in which the cell lies.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from itertools import product
from typing import Any

import numpy as np

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import (
    FREE_UP_TO,
    OBSTACLE_ABOVE,
    Bounds,
    DepthCamera,
    Lidar,
    Pose,
    Rig,
    StereoCamera,
)
from fieldgrid.maps import LAYERS, DrivenMap, MapView, SessionInfo, decision, to_local

_NEAREST_M = 0.1
"""A point nearer to the camera's plane than this has no place in its image."""

_SLICE_TOP_M = 2.2
"""The height up to which a cell is drawn into an image, where a session does not say its own."""


def explain(
    universal: DrivenMap, east_m: float, north_m: float, sessions: Collection[str] | None
) -> dict[str, Any]:
    """The cell at a point, of all active sessions or some of them, newest frame last."""
    found = universal.query(east_m, north_m)
    infos = {info.name: (k, info) for k, info in enumerate(universal.sessions())}
    chosen = [one for one in found.contributions if sessions is None or one.session in sessions]
    bounds = found.bounds
    rigs = {name: _rig(infos[name][1]) for name in {one.session for one in chosen}}
    names = [name for name in LAYERS if name != "density"]
    view = universal.read(bounds, layers=names, sessions=sessions, decide="density")
    return {
        "east_m": east_m,
        "north_m": north_m,
        "bounds": list(bounds),
        "verdict": _verdict(view),
        "values": _values(view),
        "frames": [
            {
                "frame_id": one.frame_id,
                "density": round(one.density, 1),
                "obstacle": one.density > OBSTACLE_ABOVE,
                "cells": one.cells,
                "time_ms": one.pose.time_ns / 1e6,
                "east_m": one.pose.east_m,
                "north_m": one.pose.north_m,
                "heading_deg": one.pose.heading_deg,
                "heading_sigma_deg": _known(one.pose.heading_sigma_deg),
                "position_sigma_m": _known(one.pose.position_sigma_m),
                "quality": one.quality,
                "images": list(one.images),
                "session": infos[one.session][0],
                "places": [
                    _place(rigs[one.session], one.pose, bounds, k, infos[one.session][1])
                    for k in range(len(one.images))
                ],
            }
            for one in chosen
        ],
    }


def _verdict(view: MapView) -> str:
    """What a cell counts as for whoever decides, with the reason where it is not what the drives
    saw."""
    decided, (worst, seen, _) = view.decided, view.decision()
    assert decided is not None  # it was read to decide
    what = "Obstacle" if worst[0, 0] > OBSTACLE_ABOVE else "In doubt"
    what = "Free" if worst[0, 0] <= FREE_UP_TO else what
    why = [said for flag, said in decision.REASONS.items() if decided.flags[0, 0] & flag]
    if worst[0, 0] > decided.worst[0, 0]:
        why.append("the ground falls away")
    return f"{what if seen[0, 0] else 'Never seen'}{': ' if why else ''}{', '.join(why)}"


def _values(view: MapView) -> dict[str, float | None]:
    """What each layer says of a cell; empty where it was not observed."""
    if not view.observed[0, 0]:
        return {}
    values = {name: float(view.layer(name)[0, 0]) for name in ("density", *view.layers)}
    values["sigma"] = math.sqrt(max(values["variance"], 0.0))
    return {name: _known(value) for name, value in values.items()}


def _rig(info: SessionInfo) -> Rig | None:
    rig = info.config.get("rig")
    if not isinstance(rig, Mapping):
        return None
    try:
        return Rig.from_dict(rig)
    except CalibrationError:
        return None  # of another program: its images are shown without a mark


def _place(
    rig: Rig | None, pose: Pose, bounds: Bounds, image: int, info: SessionInfo
) -> list[float] | None:
    """Where the cell's column of air is in an image: left, top, right, bottom, in pixels.

    None where the rig is not known or has no image, and where the column is not in the image.
    """
    if rig is None or isinstance(rig.sensor, Lidar):
        return None
    corners = product(
        (bounds.west_m, bounds.east_m), (bounds.south_m, bounds.north_m), (0.0, _slice_top(info))
    )
    east_m, north_m, up_m = zip(*corners, strict=True)
    x_m, y_m = to_local(east_m, north_m, pose)
    pixels = [
        project(rig, float(x), float(y), z, image) for x, y, z in zip(x_m, y_m, up_m, strict=True)
    ]
    if any(pixel is None for pixel in pixels):
        return None
    u, v = np.array(pixels, dtype=np.float64).T
    box = [
        max(float(u.min()), 0.0),
        max(float(v.min()), 0.0),
        min(float(u.max()), rig.sensor.width_px - 1.0),
        min(float(v.max()), rig.sensor.height_px - 1.0),
    ]
    return box if box[0] < box[2] and box[1] < box[3] else None


def _slice_top(info: SessionInfo) -> float:
    try:
        top_m = float(info.config["settings"]["density"]["slice_top_m"])
    except (KeyError, TypeError, ValueError):
        return _SLICE_TOP_M
    return top_m if 0.0 < top_m < 20.0 else _SLICE_TOP_M


def project(
    rig: Rig, right_m: float, forward_m: float, up_m: float, image: int
) -> tuple[float, float] | None:
    """The pixel (u, v) of a point of the vehicle frame, on level ground.

    `image` 0 is the left one of a pair, 1 the right one. None for a point behind the camera.
    """
    sensor = rig.sensor
    in_vehicle = np.array([right_m, forward_m, up_m - rig.mount.height_m])
    x, y, z = (float(value) for value in rig.mount.rotation().T @ in_vehicle)
    if z < _NEAREST_M:
        return None
    if isinstance(sensor, StereoCamera):
        # The grid origin lies in the middle of the baseline.
        x += sensor.baseline_m / 2.0 if image == 0 else -sensor.baseline_m / 2.0
        right_cx = sensor.cx_px if sensor.cx_right_px is None else sensor.cx_right_px
        cx_px, fx_px = sensor.cx_px if image == 0 else right_cx, sensor.focal_px
        fy_px = fx_px
    elif isinstance(sensor, DepthCamera):
        cx_px, fx_px, fy_px = sensor.cx_px, sensor.fx_px, sensor.fy_px
    else:
        return None
    return cx_px + fx_px * x / z, sensor.cy_px + fy_px * y / z


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
