"""Which frames an inspection looks at: a few over the whole drive closely, and stretches of
neighbours for the camera's own motion."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.array_types import Float64, Int64

MOST_SAMPLES = 24
"""Pairs that are looked at closely."""

MOST_FOLLOWED = 320
"""Frames that the camera's motion is told from: all of a short drive."""

STRETCHES = 8


def sample_every(frame_count: int) -> int:
    """Every how many-th frame is looked at closely."""
    return max(1, math.ceil(frame_count / MOST_SAMPLES))


def stretches(
    frame_ns: Int64,
    time_ns: Int64,
    heading_deg: Float64,
) -> list[range]:
    """Runs of neighbouring frames: all in one where they are few, else half of them spread over
    the drive and half where it turns most, which tells clocks apart.

    `heading_deg` [n] is what is known of the drive at `time_ns` [n] before the images are seen.
    """
    count = len(frame_ns)
    if count <= MOST_FOLLOWED:
        return [range(count)]
    length = MOST_FOLLOWED // STRETCHES
    starts = range(0, count - length + 1, length)
    spread = np.linspace(0, len(starts) - 1, STRETCHES // 2).round().astype(int).tolist()
    turn = np.abs(np.diff(np.unwrap(np.radians(np.nan_to_num(heading_deg)))))
    turned = np.concatenate([[0.0], np.cumsum(turn)])
    at = np.interp(frame_ns, time_ns, turned) if len(time_ns) else np.zeros(count)
    by_turn = np.argsort([-(at[start + length - 1] - at[start]) for start in starts]).tolist()
    chosen = list(dict.fromkeys([*spread, *by_turn]))[:STRETCHES]
    return [range(starts[k], starts[k] + length) for k in sorted(chosen)]
