"""Which frames' points a session keeps: those of a drive that tells how its vehicle leans, and
sweeps whose points have times, within a bound."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from fieldgrid.core import Closing, shortened
from fieldgrid.live.given import GIVEN_ROWS
from fieldgrid.live.kept.kept_drive import POINTS, KeptFrame
from fieldgrid.live.kept.points_file import GridInput, PointsFile, RecordSpan, packed, points_end
from fieldgrid.live.pose.sensor_rows import Rows
from fieldgrid.perception import LocalGridder, Sweep

UNTOLD_NS = 60_000_000_000
"""The time from the first frame on, by stamps and by the clock of the machine, for which points
are kept of a drive that does not tell how its vehicle leans: what tells it may come later."""

RESERVE_BYTES = 1_000_000_000
"""With less free on their disk no points are kept: grids, journal and the map need the room."""

AGAIN_BYTES = 1_100_000_000
"""With this number of bytes free again points are kept, where that was the reason."""

_AS_DRIVEN = (
    "are not kept: their grids stay as they were made while driving, level by the roll and pitch "
    "known then."
)
_NO_MORE = f"so the points of later frames {_AS_DRIVEN}"
_NOT_NOW = f"so until there is room the points of frames {_AS_DRIVEN}"
_AGAIN = "The points of frames are kept again."

LOST = (
    f"The points of the frames ({POINTS}) are missing or damaged, so grids cannot be made again at "
    "the end of the drive; they stay as they were made while driving."
)

_TOO_LATE = (
    "How the vehicle leans is known only now, and the points of earlier frames were not kept, so "
    "all local grids stay perpendicular to the ground ahead; for level grids, build the drive from "
    "a recording at its end (fieldgrid live --finish-from RECORDING)."
)


class KeptPoints(Closing):
    """The points of a session's frames, as far as its end needs them; safe from any thread.

    `is_levelling` says whether the session's grids are to be level where the drive tells how its
    vehicle leans.
    """

    def __init__(
        self,
        path: Path,
        reach_m: float,
        most_bytes: int,
        first_ns: int | None,
        frames: Sequence[KeptFrame] = (),
    ) -> None:
        """Open the file of a session, or make it for one that has no frame yet (`first_ns` is the
        time of the first of its `frames`). Of grids that reach `reach_m`, at most `most_bytes` are
        kept; none where that is 0. A file that is damaged at its beginning counts as none. OSError
        where there can be no file."""
        self._path, self._reach_m, self._most = path, reach_m, most_bytes
        self._first_ns = first_ns
        self._lock = threading.Lock()
        self._is_needed, self._warning = False, ""
        self._since_ns = time.monotonic_ns()
        is_kept = points_end(path) is not None
        begins = first_ns is None and most_bytes > 0
        if begins and not is_kept:
            path.unlink(missing_ok=True)
        self._file = PointsFile(path) if begins or is_kept else None
        self._has_level = any(frame.is_level for frame in frames)
        # Of other frames they may have been removed, since nothing told how the vehicle leans.
        needed = (frame.points for frame in frames if frame.is_level or frame.is_timed)
        self.is_lost = self._file is None and any(place is not None for place in needed)
        if self.is_lost:
            self._warning = LOST
        self._is_full = self._file is not None and self._file.size >= most_bytes
        self._is_refused, self._least_free = False, RESERVE_BYTES

    @property
    def is_levelling(self) -> bool:
        """Whether points of all frames were kept from the first one on, up to the bound, or were
        until they were lost: some grids are level then."""
        return self._file is not None or self._has_level

    def note_rows(self, part: str, rows: Rows) -> None:
        """Rows of a sensor that were pushed: of some, the drive tells how its vehicle leans."""
        leans = part in ("tilt", "orientation", GIVEN_ROWS) and len(rows.time_ns) > 0
        leans = leans or (part == "inertial" and bool(np.isfinite(rows.columns[1]).any()))
        with self._lock:
            if leans and not self._is_needed:
                self._is_needed = True
                if not self.is_levelling and not self.is_lost:
                    self._warning = _TOO_LATE

    def record(self, seen: GridInput) -> bytes | None:
        """A frame's points as `add` takes them; None where they are not kept or cannot be."""
        with self._lock:
            if isinstance(seen, Sweep) and seen.after_s is not None:
                self._is_needed = True
            if self._file is None or self._is_full or self._lacks_room():
                return None
        try:
            return packed(seen, self._reach_m)
        except Exception as error:  # noqa: BLE001 - it costs the points, and no frame
            with self._lock:
                self._warning = f"Points of a frame cannot be kept: {shortened(repr(error))}"
            return None

    def add(self, record: bytes | None, time_ns: int) -> RecordSpan | None:
        """Keep the points of the next frame; where they are, None where they are not kept. Beyond
        their bound, those of all later frames are not; while the disk has no room, those of then.
        """
        with self._lock:
            if self._first_ns is None:
                self._first_ns, self._since_ns = time_ns, time.monotonic_ns()
            # Stamps alone may jump, or run ahead in a replay.
            took_ns = min(time_ns - self._first_ns, time.monotonic_ns() - self._since_ns)
            if not self._is_needed and took_ns > UNTOLD_NS:
                self._give_up()
            if record is None or self._file is None or self._is_full:
                return None
            if self._file.size + len(record) > self._most:
                self._is_full = True
                self._warning = f"The points of the frames take {self._most / 1e9:g} GB, {_NO_MORE}"
                return None
            if self._lacks_room():
                return None
            try:
                place = self._file.append(record)
            except OSError as error:
                self._refuse(f"{self._path} could not be written ({error.strerror})")
                return None
            if self._is_refused:
                self._is_refused, self._least_free, self._warning = False, RESERVE_BYTES, _AGAIN
            return place

    def take_back(self, at: RecordSpan | None) -> None:
        """Give the room of the points added last back: their frame is not kept."""
        with self._lock:
            if at is not None and self._file is not None:
                self._file.take_back(at)

    def _lacks_room(self) -> bool:
        """Whether grids, journal and map need what is free on the disk."""
        is_short = False
        with suppress(OSError):  # a disk that does not tell may refuse them, too
            is_short = shutil.disk_usage(self._path.parent).free < self._least_free
        if is_short:
            self._least_free = AGAIN_BYTES  # it is not told at each file that comes and goes
            least = f"less than {RESERVE_BYTES / 1e9:g} GB free"
            self._refuse(f"The disk of {self._path} has {least}")
        return is_short

    def _refuse(self, why: str) -> None:
        """The disk takes no points for now, which is told once."""
        if not self._is_refused:
            self._is_refused, self._warning = True, f"{why}, {_NOT_NOW}"

    def _give_up(self) -> None:
        """Remove what was kept for nothing."""
        if self._file is not None:
            with suppress(OSError):
                os.truncate(self._path, 0)  # a name may come back after a power cut
                self._path.unlink()
            self._file.close()
            self._file = None

    def take_warning(self) -> str:
        """What the user must know, once; empty where there is nothing."""
        with self._lock:
            warning, self._warning = self._warning, ""
        return warning

    def read(self, at: RecordSpan | None, gridder: LocalGridder) -> GridInput | None:
        """The points of a frame that are there; None where they were not kept or are damaged."""
        return None if at is None or self._file is None else self._file.read(at, gridder)

    def has(self, at: RecordSpan | None) -> bool:
        """Whether the points of a frame are there and whole."""
        return at is not None and self._file is not None and self._file.has(at)

    def sync(self) -> None:
        """Return when what was added is on the disk. OSError where the disk refuses."""
        with self._lock:
            file = None if self._file is None else self._file.duplicate()
        if file is not None:
            try:
                os.fsync(file)
            finally:
                os.close(file)

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._file is not None:
                self._file.close()
