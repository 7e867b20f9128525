"""The state of a live session that clients show, also as plain values."""

from __future__ import annotations

import base64
import io
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from fieldgrid.geometry import Status
from fieldgrid.live.results import LiveEvent, LivePose, LiveResult, LiveWindow, What, numbers_of
from fieldgrid.live.servers.feed import whole_units

MOST_PATH = 20_000
"""Poses of the path that are kept: half an hour at ten frames a second."""

MOST_EVENTS = 30

AGE_UNIT_S, SIGMA_UNIT_M = 0.25, 0.01
MOST_UNITS = 254


class PathStep(NamedTuple):
    """A settled pose of the path, metres, and its gear; `is_good` as far as it is in the map."""

    east_m: float
    north_m: float
    gear: int
    is_good: bool


class LiveState:
    """Takes results of a session from any thread, and keeps what a new client is shown: the
    newest window, the path, the latest events. It is bounded and never blocks.

    `on_change` is called after each window and event, in the thread that gave it.
    """

    def __init__(self, session: str = "", on_change: Callable[[], None] | None = None) -> None:
        self.session, self._on_change = session, on_change
        self._lock = threading.Lock()
        self._window: LiveWindow | None = None
        self._path: deque[PathStep] = deque(maxlen=MOST_PATH)
        self._events: deque[tuple[int, LiveEvent]] = deque(maxlen=MOST_EVENTS)
        self._walked = self._said = 0
        self._drawn: tuple[LiveWindow, dict[str, Any]] | None = None
        self.number = 0
        """Counts windows and events."""

    def take(self, result: LiveResult) -> None:
        """Take a result."""
        with self._lock:
            if isinstance(result, LivePose):
                pose = result.pose
                if result.is_settled and np.isfinite(pose.east_m):
                    is_good = pose.status is not Status.REJECTED
                    self._path.append(PathStep(pose.east_m, pose.north_m, result.gear, is_good))
                    self._walked += 1
                return
            if isinstance(result, LiveWindow):
                self._window = result
            elif isinstance(result, LiveEvent) and result.what is not What.FRAME_DROPPED:
                self._events.append((self._said, result))
                self._said += 1
            else:
                return
            self.number += 1
        if self._on_change is not None:
            self._on_change()

    def told(self, walked: int = 0, said: int = 0) -> dict[str, Any]:
        """All that is known now as plain values for JSON, but of the path and the events what is
        new to a client that has had `walked` poses and `said` events."""
        with self._lock:
            window, number = self._window, self.number
            new = max(self._walked - walked, 0)
            path = [
                (round(step.east_m, 3), round(step.north_m, 3), step.gear, step.is_good)
                for step in list(self._path)[max(len(self._path) - new, 0) :]
            ]
            events = [(event.what.value, event.text) for k, event in self._events if k >= said]
            counted = {"walked": self._walked, "said": self._said}
        told: dict[str, Any] = {"session": self.session, "number": number, **counted}
        told |= {"path": path, "events": events, "window": None}
        if window is not None:
            drawn = self._drawn  # made once for all clients
            if drawn is None or drawn[0] is not window:
                drawn = self._drawn = (window, _window(window))
            told["window"] = drawn[1]
        return told


def _window(window: LiveWindow) -> dict[str, Any]:
    """A window for the page: what it says of itself, and its cells as a picture."""
    datum, fixes = window.costmap.datum, window.fixes
    east_m, north_m, _ = datum.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    seen = np.isfinite(east_m + north_m)
    places = np.round(np.stack([east_m, north_m], axis=1)[seen], 3).tolist()
    said = zip(places, fixes.quality[seen].tolist(), window.used[seen].tolist(), strict=True)
    pose = None
    if window.pose is not None:
        is_good = window.pose.status is not Status.REJECTED
        pose = {**numbers_of(window.pose), "gear": window.gear, "is_good": is_good}
    return {
        **window.as_dict(),
        "datum": {
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
        },
        "cell_m": window.costmap.lattice.cell_m,
        "pose": pose,
        "fixes": [(*place, quality, is_used) for place, quality, is_used in said],
        "cells": base64.b64encode(draw_cells(window)).decode("ascii"),
    }


def draw_cells(window: LiveWindow) -> bytes:
    """The cells as PNG, row 0 in the north: the cost in red; the age in green, in quarters of a
    second; how far off the cell may be in blue, in centimetres. Ages and errors are rounded up,
    254 that or more, 255 not known."""
    parts = (
        window.costmap.costs,
        whole_units(window.age_s, AGE_UNIT_S, MOST_UNITS).astype(np.uint8),
        whole_units(window.sigma_m, SIGMA_UNIT_M, MOST_UNITS).astype(np.uint8),
    )
    written = io.BytesIO()
    pixels = np.ascontiguousarray(np.stack(parts, axis=-1)[::-1])
    Image.fromarray(pixels, "RGB").save(written, "PNG", compress_level=1)
    return written.getvalue()
