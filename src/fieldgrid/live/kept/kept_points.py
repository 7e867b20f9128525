"""Which frames' points a session keeps: those of a drive that tells how its vehicle leans, and
sweeps whose points have times, within a bound."""

from __future__ import annotations

import shutil
import time
from collections import deque
from contextlib import suppress
from pathlib import Path

import numpy as np

from fieldgrid.core import shortened
from fieldgrid.live.given import GIVEN_ROWS
from fieldgrid.live.kept.points import packed
from fieldgrid.live.pose.sensor_rows import Rows
from fieldgrid.perception import Sweep
from fieldgrid.pipeline import GridInput

UNTOLD_NS = 60_000_000_000
"""The time from the first frame on, by stamps and by the clock of the machine, for which points
are kept of a drive that does not tell how its vehicle leans: what tells it may come later."""

RESERVE_BYTES = 1_000_000_000
"""With less free on their disk no points are kept: grids, sensor data and the map need the room."""

AGAIN_BYTES = 1_100_000_000
"""With this number of bytes free again points are kept, where that was the reason."""

_AS_DRIVEN = (
    "are not kept: their grids stay as they were made while driving, level by the roll and pitch "
    "known then."
)
_NO_MORE = f"so the points of later frames {_AS_DRIVEN}"
_NOT_NOW = f"so until there is room the points of frames {_AS_DRIVEN}"
_AGAIN = "The points of frames are kept again."

_TOO_LATE = (
    "How the vehicle leans is known only now, and the points of earlier frames were not kept, so "
    "all local grids stay perpendicular to the ground ahead; for level grids, build the drive from "
    "a recording at its end (fieldgrid live --finish-from RECORDING)."
)


class KeptPoints:
    """Decides whether the points of a frame are kept, and packs them.

    `is_levelling` says whether the session's grids are to be level where the drive tells how its
    vehicle leans: points of all frames were kept from the first one on, up to the bound.
    """

    def __init__(
        self,
        folder: Path,
        reach_m: float,
        most_bytes: int,
        first_ns: int | None,
        *,
        held_bytes: int,
        is_levelling: bool,
    ) -> None:
        """Of grids that reach `reach_m`, at most `most_bytes` are kept on the disk of the `folder`,
        of which `held_bytes` are there; `first_ns` is the time of the session's first frame."""
        self._folder, self._reach_m, self._most = folder, reach_m, most_bytes
        self._first_ns, self._held = first_ns, held_bytes
        self._since_ns = time.monotonic_ns()
        self.is_levelling = is_levelling
        self._is_needed = False
        self._is_refused = False
        self.warnings: deque[str] = deque()
        """What the user must know."""

    def note_rows(self, part: str, rows: Rows) -> None:
        """Rows of a sensor that were pushed, by any thread: of some, the drive tells how its
        vehicle leans."""
        leans = part in ("tilt", "orientation", GIVEN_ROWS) and len(rows.time_ns) > 0
        leans = leans or (part == "inertial" and bool(np.isfinite(rows.columns[1]).any()))
        if leans and not self._is_needed:
            self._is_needed = True
            if not self.is_levelling:
                self.warnings.append(_TOO_LATE)

    def packed(self, seen: GridInput, time_ns: int) -> bytes:
        """The points of the next frame; empty where they are not kept. Beyond their bound, those of
        all later frames are not; while the disk has no room, those of then."""
        if self._first_ns is None:
            self._first_ns, self._since_ns = time_ns, time.monotonic_ns()
        self._is_needed |= isinstance(seen, Sweep) and seen.after_s is not None
        # Stamps alone may jump, or run ahead in a replay.
        took_ns = min(time_ns - self._first_ns, time.monotonic_ns() - self._since_ns)
        self.is_levelling &= self._is_needed or took_ns <= UNTOLD_NS
        if not self.is_levelling or self._held >= self._most or self._lacks_room():
            return b""
        try:
            record = packed(seen, self._reach_m)
        except Exception as error:  # noqa: BLE001 - it costs the points, and no frame
            self.warnings.append(f"Points of a frame cannot be kept: {shortened(repr(error))}")
            return b""
        if self._held + len(record) > self._most:
            self._held = self._most
            self.warnings.append(
                f"The points of the frames take {self._most / 1e9:g} GB, {_NO_MORE}"
            )
            return b""
        return record

    def kept(self, size: int) -> None:
        """So many bytes of points were taken by the disk."""
        self._held += size
        if self._is_refused and size:
            self._is_refused = False
            self.warnings.append(_AGAIN)

    def refused(self, why: str) -> None:
        """The disk takes no points for now, which is told once."""
        if not self._is_refused:
            self._is_refused = True
            self.warnings.append(f"{why}, {_NOT_NOW}")

    def _lacks_room(self) -> bool:
        """Whether grids, sensor data and map need what is free on the disk."""
        is_short = False
        # Otherwise it would be told at each file that comes and goes.
        least_bytes = AGAIN_BYTES if self._is_refused else RESERVE_BYTES
        with suppress(OSError):  # a disk that does not tell may refuse them, too
            is_short = shutil.disk_usage(self._folder).free < least_bytes
        if is_short:
            least = f"less than {RESERVE_BYTES / 1e9:g} GB free"
            self.refused(f"The disk of {self._folder} has {least}")
        return is_short
