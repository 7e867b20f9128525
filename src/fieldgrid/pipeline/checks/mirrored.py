"""Whether the path of the fixes is the mirror image of what the camera saw.

A longitude without its minus or its W, or latitude and longitude exchanged, turns every curve the
other way round. The drive stays smooth, distances stay right or nearly so, and no clock, lever arm
or gear explains what is left: a map of it is wrong everywhere and says so nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Finding, Int64, StopCode, error
from fieldgrid.geometry import Gyro, Steps, Trajectory
from fieldgrid.recordings import Recording, how_to_say

MOST_STEPS = 200
"""Number of steps of the camera that are laid over the fixes at once: the drift of the camera grows
with their number."""

FEWEST_STEPS = 5
NEAR_NS = 1_500_000_000
"""How far an image may be from the next accepted fix to have a place of its own."""

OFF_M, SHARE = 1.0, 0.35
"""The path is mirrored where the camera's lies so far off it as it is, and by no more than this
share of that once it is mirrored. Of honest drives it is the path as it is that fits far better; a
straight way fits both ways alike."""

Path = npt.NDArray[np.complex128]


def mirror_findings(
    recording: Recording, trajectory: Trajectory, steps: Steps | None
) -> Iterator[Finding]:
    """That the fixes turn left where the camera turns right, over the whole drive."""
    if steps is None:
        return
    as_is_m, mirrored_m, exchanged_m = _misfit(steps, trajectory)
    if as_is_m < OFF_M or min(mirrored_m, exchanged_m) > SHARE * as_is_m:
        return
    told = (
        "The path of the fixes is a mirror image of the camera's path: the two are "
        f"{as_is_m:.2f} m apart"
    )
    datum = trajectory.datum
    first = f"latitude {datum.lat_deg:.6f}, longitude {datum.lon_deg:.6f}"
    gyro = recording.motion().gyro
    if exchanged_m < mirrored_m:
        why = f", and {exchanged_m:.2f} m with latitude and longitude exchanged."
        remedy = (
            f"The drive is at {first}: if that is not the field, exchange the two; for a table, "
            f"name its columns: {how_to_say(lat='COLUMN', lon='COLUMN')}."
        )
    elif gyro is not None and _turns_against(steps, gyro):
        why = (
            f", and {mirrored_m:.2f} m with left and right exchanged, and the gyro turns as "
            "the fixes do, so the images were flipped."
        )
        remedy = "Store the images as the camera sees."
    else:
        as_too = "" if gyro is None else ", and the gyro turns as the camera does"
        why = f", and {mirrored_m:.2f} m with left and right exchanged{as_too}."
        remedy = (
            f"The drive is at {first}: if that is not the field, a sign (a minus, a W or an S) was "
            "lost in the log: put it before each longitude or latitude."
        )
    yield error(StopCode.MIRRORED.value, f"{told}{why}", remedy)


def _misfit(steps: Steps, trajectory: Trajectory) -> list[float]:
    """The distance of the camera's path from that of the fixes, root mean square, metres: as they
    are, with left and right exchanged, and with latitude and longitude exchanged. 0 where too
    little of the two paths is known."""
    placed = trajectory.accepted
    time_ns = trajectory.time_ns[placed]
    north_m, east_m = trajectory.north_m[placed], trajectory.east_m[placed]
    lat, lon = np.radians([trajectory.datum.lat_deg, trajectory.datum.lon_deg])
    as_is, exchanged = north_m + 1j * east_m, east_m / np.cos(lat) + 1j * north_m * np.cos(lon)
    count, squares = 0, np.zeros(3)
    for first, stop in _chains(steps) if len(time_ns) > 1 else ():
        seen = _driven(steps, first, stop)
        at_ns = np.concatenate([steps.start_ns[first : first + 1], steps.stop_ns[first:stop]])
        known = _near(at_ns, time_ns)
        if known.sum() <= FEWEST_STEPS:
            continue
        # Seconds from the first fix: nanoseconds since 1970 have no room in a float.
        at_s, fix_s = (at_ns[known] - time_ns[0]) / 1e9, (time_ns - time_ns[0]) / 1e9
        fixed, other = np.interp(at_s, fix_s, as_is), np.interp(at_s, fix_s, exchanged)
        count += int(known.sum())
        pairs = ((fixed, seen[known]), (fixed, np.conj(seen[known])), (other, seen[known]))
        squares += [_squares(path, way) for path, way in pairs]
    return list(np.sqrt(squares / max(count, 1)).tolist())


def _chains(steps: Steps) -> list[tuple[int, int]]:
    """Pieces of steps that follow each other, as first and stop."""
    breaks = np.flatnonzero(steps.start_ns[1:] != steps.stop_ns[:-1]) + 1
    edges = [0, *breaks.tolist(), len(steps.start_ns)]
    return [
        (at, min(at + MOST_STEPS, stop))
        for first, stop in pairwise(edges)
        for at in range(first, stop, MOST_STEPS)
        if stop - at >= FEWEST_STEPS
    ]


def _driven(steps: Steps, first: int, stop: int) -> Path:
    """Places after each step of a piece, forward + i right of the vehicle at its start."""
    heading = np.radians(np.concatenate([[0.0], np.cumsum(steps.turn_deg[first:stop])]))
    ways = (steps.forward_m + 1j * steps.right_m)[first:stop] * np.exp(1j * heading[:-1])
    return np.concatenate([[0.0], np.cumsum(ways)])


def _near(at_ns: Int64, fix_ns: Int64) -> npt.NDArray[np.bool_]:
    after = np.clip(np.searchsorted(fix_ns, at_ns), 1, len(fix_ns) - 1)
    least = np.minimum(np.abs(at_ns - fix_ns[after - 1]), np.abs(fix_ns[after] - at_ns))
    return np.asarray(least <= NEAR_NS)


def _squares(fixed: Path, seen: Path) -> float:
    """The sum of squared distances once one path is turned and moved onto the other."""
    a, b = fixed - fixed.mean(), seen - seen.mean()
    whole: Any = np.sum(np.abs(a) ** 2) + np.sum(np.abs(b) ** 2)
    return max(0.0, float(whole - 2.0 * np.abs(np.sum(a * np.conj(b)))))


def _turns_against(steps: Steps, gyro: Gyro) -> bool:
    """Whether the gyro turns the other way than the camera."""
    time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
    rises = np.diff(time_s) * (gyro.rate_rad_s[1:] + gyro.rate_rad_s[:-1]) / 2.0
    angle = np.concatenate([[0.0], np.cumsum(rises)])
    start_s, stop_s = ((ns - gyro.time_ns[0]) / 1e9 for ns in (steps.start_ns, steps.stop_ns))
    told = np.interp(stop_s, time_s, angle) - np.interp(start_s, time_s, angle)
    return bool(np.sum(told * steps.turn_deg) < 0.0)
