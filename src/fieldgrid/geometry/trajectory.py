"""The trajectory: where the vehicle was, where its nose pointed, how sure that is.

A row a fix, rejected ones included with their reason, and rows between them where something
else than the receiver knew the way. Poses are those of the *grid origin*
(see `geometry.rig`), in the Local Tangent Plane of one datum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from fieldgrid.core import Bool, Float64, GnssError, Index, Int64, notebook, palette
from fieldgrid.geometry.angles import interpolate_deg
from fieldgrid.geometry.geodesy import Datum

MAX_GAP_NS = 1_500_000_000
"""Accepted fixes may be this far apart for a pose to be interpolated between them: a receiver of
1 Hz may be late."""

HEIGHT_SHARE = 2.0
"""GNSS heights are half as accurate as positions."""


class Status(StrEnum):
    """The verdict on a fix or a pose.

    Held is a pose at rest, whose heading is the one that the vehicle stopped with: as good as
    ok, while its sigma lasts.
    """

    OK = "ok"
    REJECTED = "rejected"
    HELD = "held"


@dataclass(frozen=True, slots=True)
class Pose:
    """The grid origin at one instant: LTP metres, heading in degrees, 1-sigma errors.

    A rejected pose keeps its best estimate and says why in `reason`. `up_sigma_m` is the 1-sigma
    error of `up_m`; by default that of GNSS heights, which are half as accurate as positions, and
    infinite where nothing is stated.
    """

    time_ns: int
    east_m: float
    north_m: float
    up_m: float
    heading_deg: float
    position_sigma_m: float
    heading_sigma_deg: float
    speed_mps: float
    status: Status = Status.OK
    reason: str = ""
    up_sigma_m: float = math.nan

    def __post_init__(self) -> None:
        if math.isnan(self.up_sigma_m):
            up_sigma_m = HEIGHT_SHARE * self.position_sigma_m
            object.__setattr__(
                self, "up_sigma_m", math.inf if math.isnan(up_sigma_m) else up_sigma_m
            )


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses of the grid origin, ordered by time. All arrays have length n.

    `gear` is +1 forward, -1 reverse, 0 at rest. `quality` is that of the fix
    (`Quality`), estimated in rows without one. `heading_source` names how
    headings were found (smooth, course, recorded, constant:DEG).
    """

    datum: Datum
    time_ns: Int64
    east_m: Float64
    north_m: Float64
    up_m: Float64
    heading_deg: Float64
    position_sigma_m: Float64
    heading_sigma_deg: Float64
    speed_mps: Float64
    gear: Int64
    quality: Int64
    status: tuple[Status, ...]
    reason: tuple[str, ...]
    heading_source: str
    accepted: Bool = field(init=False, repr=False, compare=False)
    """Mask of the rows whose verdict is ok or held."""
    _ok: Index = field(init=False, repr=False, compare=False)
    _ok_time_ns: Int64 = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.time_ns)
        # Found once: every frame of a drive asks for its pose.
        accepted = np.array(
            [status is not Status.REJECTED for status in self.status], dtype=np.bool_
        )
        object.__setattr__(self, "accepted", accepted)
        object.__setattr__(self, "_ok", np.flatnonzero(accepted))
        object.__setattr__(self, "_ok_time_ns", self.time_ns[self._ok])
        columns = (
            self.east_m, self.north_m, self.up_m, self.heading_deg, self.position_sigma_m,
            self.heading_sigma_deg, self.speed_mps, self.gear, self.quality, self.status,
            self.reason,
        )  # fmt: skip
        if any(len(column) != n for column in columns):
            raise GnssError("The columns of a trajectory differ in length; build it from fixes.")
        if np.any(np.diff(self.time_ns) < 0) or np.any(np.diff(self.time_ns[self.accepted]) == 0):
            raise GnssError("The times of a trajectory must increase; sort and drop duplicates.")

    def __len__(self) -> int:
        return len(self.time_ns)

    def _repr_html_(self) -> str:
        """The path by gear, and what was accepted, for a notebook."""
        lines = []
        for gear, colour in palette.GEARS.items():
            runs = np.flatnonzero(np.diff(self.accepted & (self.gear == gear), prepend=0, append=0))
            for first, end in runs.reshape(-1, 2):
                # On to the first pose of the next gear, so that the path is whole.
                part = slice(first, end + 1)
                lines.append(notebook.Line(colour, self.east_m[part], self.north_m[part]))
        seconds = float(np.ptp(self.time_ns)) / 1e9 if len(self) else 0.0
        facts = (
            ("poses", f"{len(self)}, {int(self.accepted.sum())} accepted"),
            ("duration", f"{seconds:.1f} s"),
            ("length", f"{self.length_m():.1f} m"),
            ("heading", self.heading_source),
        )
        return notebook.drawing(lines) + notebook.table(facts)

    def length_m(self) -> float:
        """Length of the accepted path in metres."""
        ok = self.accepted
        return float(np.sum(np.hypot(np.diff(self.east_m[ok]), np.diff(self.north_m[ok]))))

    def at(self, time_ns: int) -> Pose:
        """The pose at an instant: linear in position, the shorter way round in heading.

        Between accepted fixes more than `MAX_GAP_NS` apart, or outside all of them, the pose
        is that of the nearest accepted fix and is rejected, with the reason.
        """
        ok = self._ok
        if ok.size == 0:
            raise GnssError(
                "The trajectory has no usable pose, so no image can be placed; "
                "look at the reasons for which they were rejected."
            )
        after = int(np.searchsorted(self._ok_time_ns, time_ns))
        if after < ok.size and self.time_ns[ok[after]] == time_ns:
            return self._row(int(ok[after]))
        if after == 0 or after == ok.size:
            nearest = int(ok[min(after, ok.size - 1)])
            side = "before the first" if after == 0 else "after the last"
            gap_s = abs(int(self.time_ns[nearest]) - time_ns) / 1e9
            return self._row(
                nearest, time_ns, f"{gap_s:.2f} s {side} usable pose: {self._why(time_ns)}"
            )
        return self._between(int(ok[after - 1]), int(ok[after]), time_ns)

    def _between(self, a: int, b: int, time_ns: int) -> Pose:
        span_ns = int(self.time_ns[b] - self.time_ns[a])
        share = (time_ns - int(self.time_ns[a])) / span_ns
        if span_ns > MAX_GAP_NS:
            reason = f"no usable pose for {span_ns / 1e9:.2f} s around it: {self._why(time_ns)}"
            return self._row(a if share < 0.5 else b, time_ns, reason)

        def mix(column: Float64) -> float:
            return float((1.0 - share) * column[a] + share * column[b])

        return Pose(
            time_ns=time_ns,
            east_m=mix(self.east_m),
            north_m=mix(self.north_m),
            up_m=mix(self.up_m),
            heading_deg=interpolate_deg(
                float(self.heading_deg[a]), float(self.heading_deg[b]), share
            ),
            position_sigma_m=float(max(self.position_sigma_m[a], self.position_sigma_m[b])),
            heading_sigma_deg=float(max(self.heading_sigma_deg[a], self.heading_sigma_deg[b])),
            speed_mps=mix(self.speed_mps),
        )

    def _row(self, k: int, time_ns: int | None = None, reason: str = "") -> Pose:
        return Pose(
            time_ns=int(self.time_ns[k]) if time_ns is None else time_ns,
            east_m=float(self.east_m[k]),
            north_m=float(self.north_m[k]),
            up_m=float(self.up_m[k]),
            heading_deg=float(self.heading_deg[k]),
            position_sigma_m=float(self.position_sigma_m[k]),
            heading_sigma_deg=float(self.heading_sigma_deg[k]),
            speed_mps=float(self.speed_mps[k]),
            status=Status.REJECTED if reason else Status.OK,
            reason=reason,
        )

    def _why(self, time_ns: int) -> str:
        """Why there is no usable pose at an instant: the reason of the nearest rejected one
        between the accepted ones around it, or that there was none."""
        after = int(np.searchsorted(self._ok_time_ns, time_ns))
        start = int(self._ok[after - 1]) + 1 if after > 0 else 0
        stop = int(self._ok[after]) if after < self._ok.size else len(self)
        if start >= stop:
            return "nothing tells where the vehicle was"
        gaps_ns = np.abs(self.time_ns[start:stop] - time_ns)
        return self.reason[start + int(np.argmin(gaps_ns))]


def thinned(gear: Int64, accepted: Bool, most: int) -> Index:
    """Rows of a trajectory to be drawn: about `most` of them, evenly, and each at which gear or
    verdict changes."""
    every = -(-len(gear) // most)
    if every < 2:
        return np.arange(len(gear))
    keep = np.zeros(len(gear), dtype=np.bool_)
    keep[::every] = keep[-1] = True
    change = np.flatnonzero((np.diff(gear) != 0) | (np.diff(accepted.astype(np.int8)) != 0))
    if len(change) < most:
        keep[change] = keep[change + 1] = True
    return np.flatnonzero(keep)
