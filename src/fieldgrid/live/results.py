"""What a live session gives, as frozen values, and the bounded queue to whoever takes them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float32
from fieldgrid.geometry import FixColumns, LocalGrid, Pose
from fieldgrid.maps import Costmap, MapView

CLIENT_S = 2.0
"""Time for which a client that does not take its results is waited for at the end."""

MOST_WAITING = 256
"""Results that wait for a client; the oldest give way, and are counted."""


class What(StrEnum):
    """What an event is about."""

    SESSION = "session"
    FRAME_DROPPED = "frame dropped"
    FRAME_BAD = "frame bad"
    FRAME_LATE = "frame late"
    FIX_REFUSED = "fix refused"
    POSE = "pose"
    INPUT = "input"
    DISK = "disk"
    CLIENT = "client"


class WindowDoubt(IntEnum):
    """Why the window is not to be trusted; `NONE` where it is."""

    NONE = 0
    NO_FIXES = 1
    """There are no fixes, or too few."""
    POSE = 2
    """The pose is not good enough, or older than it may be."""
    NO_FRAMES = 3
    """What the sensors say is newer than the last frame by too much."""
    SILENT = 4
    """Nothing is pushed any more."""


@dataclass(frozen=True, slots=True)
class LiveEvent:
    """Something that the driver or the program may want to know, in words. `time_ns` is the latest
    time of what was pushed."""

    what: What
    text: str
    time_ns: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"event": self.what.value, "text": self.text, "time_ns": self.time_ns}


@dataclass(frozen=True, slots=True, eq=False)
class LiveGrid:
    """The local grid of a frame, in the vehicle frame: no pose is in it. `latency_s` is from the
    push to here."""

    frame_id: str
    time_ns: int
    grid: LocalGrid
    ground_found: bool
    latency_s: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, without the cells."""
        obstacles = self.grid.observed & (self.grid.density > 100)
        return {
            "grid": self.frame_id,
            "time_ns": self.time_ns,
            "observed_cells": int(self.grid.observed.sum()),
            "obstacle_cells": int(obstacles.sum()),
            "ground_found": self.ground_found,
            "latency_ms": round(1e3 * self.latency_s, 1),
        }


@dataclass(frozen=True, slots=True)
class LivePose:
    """The pose of a frame. `is_settled` when nothing that is pushed later changes it here: the
    fixes of the lag after it are in. `gear` is +1 forward, -1 reverse, 0 at rest or not known."""

    frame_id: str
    pose: Pose
    gear: int
    is_settled: bool

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; None for what is not known."""
        return {
            "pose": self.frame_id,
            "time_ns": self.pose.time_ns,
            **numbers_of(self.pose),
            "gear": self.gear,
            "status": self.pose.status.value,
            "reason": self.pose.reason,
            "settled": self.is_settled,
        }


@dataclass(frozen=True, slots=True, eq=False)
class LiveWindow:
    """The map around the vehicle, from the frames of this session whose pose is good enough.

    `doubt` says why it is not to be trusted now, and `doubt_code` of which kind that is; it is
    empty where it is. `pose` is the latest one of the vehicle, None before the first. `age_s`
    [rows north, columns east] is how long before the latest data a cell was last seen,
    `sigma_m` how far off a cell at the far end of the frame that saw it last may be (1 sigma);
    both NaN where nothing was seen. `latency_s` is from the push of `frame_id`, the newest
    frame, to here; None, and no name, while that is not in it. `gear` is that of the pose: +1
    forward, -1 reverse, 0 at rest or not known. `fixes` are those of the last seconds by the
    receiver's word, of its antenna, `used` [n] which of them the pose goes by.
    """

    time_ns: int
    costmap: Costmap
    view: MapView
    age_s: Float32
    sigma_m: Float32
    pose: Pose | None
    doubt: str
    frames: int
    frame_id: str
    latency_s: float | None
    doubt_code: WindowDoubt
    gear: int
    fixes: FixColumns
    used: Bool

    @property
    def is_trusted(self) -> bool:
        """Whether a controller may drive by it."""
        return not self.doubt

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, without the cells."""
        seen = self.view.observed
        return {
            "window": self.frame_id,
            "time_ns": self.time_ns,
            "trusted": self.is_trusted,
            "doubt": self.doubt,
            "doubt_code": int(self.doubt_code),
            "gear": self.gear,
            "frames": self.frames,
            "known_cells": int(seen.sum()),
            "bounds_m": [float(value) for value in self.view.bounds],
            "oldest_s": known_or_none(float(np.max(self.age_s[seen]))) if seen.any() else None,
            "worst_sigma_m": known_or_none(float(np.max(self.sigma_m[seen])))
            if seen.any()
            else None,
            "latency_ms": None if self.latency_s is None else round(1e3 * self.latency_s, 1),
        }


LiveResult = LiveEvent | LiveGrid | LivePose | LiveWindow


class Counts(NamedTuple):
    """What has been pushed in all, also before a restart; `frames` are those that are kept."""

    frames: int
    dropped: int
    late: int
    bad: int
    fixes: int
    rows: dict[str, int]
    missed_results: int
    callback_errors: int


class Outbox:
    """Results on their way to a client that may be slow, dead, or none: it never blocks."""

    def __init__(self) -> None:
        self._waiting: deque[LiveResult] = deque(maxlen=MOST_WAITING)
        self._changed = threading.Condition()
        self._closed = False
        self.missed = self.failed = 0
        """Results that gave way to newer ones before a client took them, and at which it failed."""

    def put(self, result: LiveResult) -> None:
        """Add a result, in the place of the oldest where there is no room. A window, of which each
        takes 10 MB, takes the place of one that still waits."""
        with self._changed:
            if isinstance(result, LiveWindow):
                older = next((one for one in self._waiting if isinstance(one, LiveWindow)), None)
                if older is not None:
                    self._waiting.remove(older)
                    self.missed += 1
            self.missed += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(result)
            self._changed.notify()

    def take(self, timeout_s: float | None = None) -> LiveResult | None:
        """The next result; None when there is none in time, or none any more."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed, timeout_s)
            return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Nothing more comes; what waits can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def deliver(self, callback: Callable[[LiveResult], None]) -> threading.Thread:
        """Call a client with the results in a thread of its own, until none comes any more. What it
        raises is counted, and told once."""
        thread = threading.Thread(
            target=self._deliver, args=(callback,), name="fieldgrid-results", daemon=True
        )
        thread.start()
        return thread

    def _deliver(self, callback: Callable[[LiveResult], None]) -> None:
        while (result := self.take()) is not None:
            try:
                callback(result)
            except Exception as error:  # noqa: BLE001 - a client's mistake does not end the mapping
                self.failed += 1
                if self.failed == 1:
                    what = f"{type(error).__name__}: {error}"
                    text = f"The callback raised {what}; later ones are counted, not told."
                    self.put(LiveEvent(What.CLIENT, text, time.time_ns()))


def numbers_of(pose: Pose) -> dict[str, float | None]:
    """Where the vehicle is, with sigmas and speed, for JSON; None for what is not known."""
    names = "east_m", "north_m", "heading_deg", "position_sigma_m", "heading_sigma_deg", "speed_mps"
    return {name: known_or_none(getattr(pose, name)) for name in names}


def known_or_none(value: float) -> float | None:
    """A value for JSON; None where it is not finite."""
    return value if np.isfinite(value) else None
