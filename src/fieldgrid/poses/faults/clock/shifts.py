"""Offsets between the clocks of images and fixes that have a name: GPS time, zones, days."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from fieldgrid.poses.gnss.gps_time import leap_seconds

LEAPS_S, ZONES_S = 0.5, 5.0
"""An offset is one of GPS time, or of a time zone, when it is so near to it."""

TODAY_S = 18
"""What GPS time has been ahead of UTC since 2017: simulators use it for any date."""

DAY_S, HALF_HOUR_S, LARGEST_ZONE_S = 86_400, 1_800, 50_400

COVERED = 0.9
"""Images and fixes lie side by side when the fixes cover this share of the images' time."""


class Span(NamedTuple):
    """The first and the last time of something, UTC nanoseconds."""

    first_ns: int
    last_ns: int


def explanation(offset_s: float, time_ns: int) -> str:
    """What an offset that is to be added to image times may come from; empty if nothing known."""
    size_s = abs(offset_s)
    fixes_ahead = "the fixes" if offset_s > 0.0 else "the images"
    for leaps_s in sorted({leap_seconds(time_ns), TODAY_S}):
        if abs(size_s - leaps_s) < LEAPS_S:
            return f"GPS time is {leaps_s} s ahead of UTC, so {fixes_ahead} carry GPS time"
    hours = round(size_s / HALF_HOUR_S) / 2.0
    near_half = abs(size_s - HALF_HOUR_S * round(size_s / HALF_HOUR_S)) < ZONES_S
    if near_half and HALF_HOUR_S <= size_s <= LARGEST_ZONE_S:
        return f"{hours:g} h is that of a time zone, so one of the two carries local time"
    if abs(size_s - DAY_S * round(size_s / DAY_S)) < ZONES_S and size_s >= DAY_S:
        days = round(size_s / DAY_S)
        return f"{days} day{'s' if days > 1 else ''}: one of the two has a wrong date"
    return ""


def named_shifts(time_ns: int) -> Iterator[float]:
    """Seconds that image times may have to be moved by, the smallest first, both ways."""
    sizes = {float(leap_seconds(time_ns)), float(TODAY_S), float(DAY_S)}
    sizes |= {float(size) for size in range(HALF_HOUR_S, LARGEST_ZONE_S + 1, HALF_HOUR_S)}
    for size in sorted(sizes):
        yield size
        yield -size


def shift_to_overlap(images: Span, fixes: Span) -> float | None:
    """The smallest offset with a name, seconds, that brings images to where the fixes are."""
    length_ns = max(images.last_ns - images.first_ns, 1)
    for shift_s in named_shifts(fixes.first_ns):
        shift_ns = round(shift_s * 1e9)
        first_ns = max(images.first_ns + shift_ns, fixes.first_ns)
        last_ns = min(images.last_ns + shift_ns, fixes.last_ns)
        if last_ns - first_ns >= COVERED * length_ns:
            return shift_s
    days = round((fixes.first_ns - images.first_ns) / (DAY_S * 1e9))
    apart_ns = images.first_ns + days * DAY_S * 1_000_000_000
    if days and fixes.first_ns <= apart_ns <= fixes.last_ns:
        return float(days * DAY_S)
    return None
