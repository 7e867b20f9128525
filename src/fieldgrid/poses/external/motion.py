"""How a vehicle moves by given poses: its speed, its rests, and whether it heads where it goes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, GnssError, PoseSettings
from fieldgrid.geometry import GivenPoses
from fieldgrid.poses.external.georeference import CLEAR_SIGMAS

CHORD_S, REST_M, STRAIGHT_DEG = 1.0, 0.05, 2.0
"""A vehicle whose poses move less within this time is at rest; one that turns less in it drives
straight, so that its course is its heading, whatever point of it is looked at."""

BACKWARD_SHARE = 0.6
"""A vehicle that backs for a larger share of its way is one whose sensor looks backwards."""


class Chords(NamedTuple):
    """The way around each of n poses: its length, how much of it is ahead (metres), how long it
    took, by how much its course is off the heading, degrees clockwise, and how far it turns."""

    length_m: Float64
    ahead_m: Float64
    seconds: Float64
    aside_deg: Float64
    turned_deg: Float64


def chords_of(poses: GivenPoses) -> Chords:
    """The way around each pose; headings without a jump at 360°."""
    time_ns, heading = poses.time_ns, poses.heading_deg
    half_ns, k = round(CHORD_S / 2.0 * 1e9), np.arange(len(time_ns))
    first = np.maximum(np.minimum(np.searchsorted(time_ns, time_ns - half_ns), k - 1), 0)
    last = np.searchsorted(time_ns, time_ns + half_ns, side="right") - 1
    last = np.minimum(np.maximum(last, k + 1), len(k) - 1)
    x, y = poses.x_m[last] - poses.x_m[first], poses.y_m[last] - poses.y_m[first]
    sin, cos = np.sin(np.radians(heading)), np.cos(np.radians(heading))
    ahead, right = x * sin + y * cos, x * cos - y * sin
    aside = np.degrees(np.arctan2(np.where(ahead < 0.0, -right, right), np.abs(ahead)))
    seconds = np.maximum(time_ns[last] - time_ns[first], 1) / 1e9
    return Chords(np.hypot(x, y), ahead, seconds, aside, heading[last] - heading[first])


def resting(chords: Chords) -> Bool:
    """Where the vehicle does not move."""
    return np.asarray(chords.length_m < REST_M * np.maximum(chords.seconds, CHORD_S))


def course_off_heading_deg(chords: Chords, settings: PoseSettings) -> float:
    """By how much the course is off the heading where the vehicle drives straight, degrees, where
    that is clear. Raises GnssError for a heading that is none of the vehicle."""
    moving = ~resting(chords)
    way_m = float(chords.length_m[moving].sum())
    back = float(chords.length_m[moving & (chords.ahead_m < 0.0)].sum()) / max(way_m, 1e-9)
    if back > BACKWARD_SHARE and settings.starts is None and not settings.gear_spans:
        raise GnssError(
            f"By the poses the vehicle drives backwards for {100.0 * back:.0f} % of its way; if "
            "their body looks backwards, declare that with --poses-axes (bru for flu), and "
            "if the vehicle backed, say --starts reverse."
        )
    straight = moving & (np.abs(chords.turned_deg) < STRAIGHT_DEG)
    if not straight.any():
        return 0.0
    aside_deg = chords.aside_deg[straight]
    off_deg = float(np.median(aside_deg))
    scatter_deg = 1.48 * float(np.median(np.abs(aside_deg - off_deg)))
    # Neighbours err alike; a tenth of them is taken to be independent.
    sigma_deg = scatter_deg / np.sqrt(max(straight.sum() / 10.0, 1.0))
    if abs(off_deg) < CLEAR_SIGMAS * sigma_deg:
        return 0.0
    if abs(off_deg) > settings.max_heading_offset_deg:
        raise GnssError(
            f"The vehicle moves {off_deg:+.1f}° ± {sigma_deg:.1f}° off the forward axis of the "
            "poses where it drives straight (clockwise); declare the axes of their body with "
            "--poses-axes, or of camera axes the camera's yaw in mounting.json."
        )
    return off_deg
