"""Which frames are looked at."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Datum, Status, Trajectory
from fieldgrid.pipeline.inspection.drive import MOST_FOLLOWED, MOST_SAMPLES, sample_every, stretches


@pytest.mark.parametrize("count", [1, 2, 23, 24, 25, 50, 1000, 100_001])
def test_samples_are_few_and_over_the_whole_drive(count: int) -> None:
    chosen = range(0, count, sample_every(count))
    assert 1 <= len(chosen) <= MOST_SAMPLES
    assert len(chosen) > min(count, MOST_SAMPLES) / 2 - 1


def test_a_short_drive_is_followed_throughout() -> None:
    assert stretches(np.arange(50), None) == [range(50)]


def track_of(time_ns: np.ndarray, heading_deg: np.ndarray) -> Trajectory:
    """Headings at some times, at one place."""
    n = len(time_ns)
    zeros, gears = np.zeros(n), np.zeros(n, dtype=np.int64)
    return Trajectory(
        *(Datum(41.0, -4.0, 700.0), time_ns, zeros, zeros, zeros, heading_deg, zeros, zeros, zeros),
        *(gears, gears, (Status.OK,) * n, ("",) * n, "smooth"),
    )


def test_of_a_long_drive_the_turns_are_followed_and_some_of_all() -> None:
    frames_ns = np.arange(10_000) * 100_000_000
    time_ns = np.arange(0, 1_000_000_000_001, 1_000_000_000)
    heading = np.where(time_ns < 700e9, 10.0, np.minimum(10.0 + (time_ns - 700e9) / 1e9, 190.0))
    runs = stretches(frames_ns, track_of(time_ns, heading))
    assert sum(len(run) for run in runs) <= MOST_FOLLOWED
    assert [run.start for run in runs] == sorted(run.start for run in runs)
    flat = [k for run in runs for k in run]
    assert len(set(flat)) == len(flat)
    assert max(flat) < 10_000
    turning = [run for run in runs if run.stop > 7000 and run.start < 8800]
    assert len(turning) >= 4
    assert runs[0].start == 0
    assert runs[-1].stop > 9900
