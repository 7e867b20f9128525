"""Which frames are looked at."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.pipeline.mounting.selection import OF_FRAMES, STRETCHES, stretches, usual_every
from tests.simulated import DATUM, START


def fixes(speed_mps: float, *, quality: int = 4, rest_s: int = 0) -> FixColumns:
    """Fixes at 5 Hz, eastward, after some seconds at rest."""
    found = []
    for k in range(5 * (rest_s + 20)):
        time_s = k / 5.0
        east = speed_mps * max(time_s - rest_s, 0.0)
        lat, lon, height = (float(v) for v in DATUM.to_geodetic(east, 0.0, 0.0))
        found.append(Fix(START + round(time_s * 1e9), lat, lon, height, quality))
    return FixColumns.of_rows(found)


def frame_times(rate_hz: float, count: int = 50) -> np.ndarray:
    return START + np.round(np.arange(count) / rate_hz * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    ("rate_hz", "speed_mps", "every"), [(10.0, 1.0, 9), (30.0, 1.5, 19), (1.0, 1.5, 1), (10, 11, 1)]
)
def test_frames_are_about_a_metre_apart(rate_hz: float, speed_mps: float, every: int) -> None:
    found = usual_every(frame_times(rate_hz), fixes(speed_mps))
    assert found == pytest.approx(every, abs=1)
    assert found * speed_mps / rate_hz <= 1.01 or found == 1


def test_standing_still_does_not_slow_the_drive_down() -> None:
    moving = usual_every(frame_times(10.0), fixes(1.0))
    assert usual_every(frame_times(10.0), fixes(1.0, rest_s=60)) == pytest.approx(moving, abs=1)


def test_without_speed_every_frame_is_taken() -> None:
    assert usual_every(frame_times(10.0), FixColumns.of([])) == 1
    assert usual_every(frame_times(10.0), fixes(1.0, quality=0)) == 1
    assert usual_every(frame_times(10.0), fixes(0.0)) == 1
    assert usual_every(frame_times(10.0, 1), fixes(1.0)) == 1


def test_a_short_drive_is_one_stretch() -> None:
    assert stretches(100, 3) == [range(0, 100, 3)]


def test_a_long_drive_is_looked_at_here_and_there() -> None:
    found = stretches(36_000, 2)
    assert len(found) == STRETCHES
    assert all(len(stretch) == OF_FRAMES and stretch.step == 2 for stretch in found)
    assert found[0][0] == 0
    assert found[-1][-1] >= 36_000 - 2
    assert sum(map(len, found)) == len({k for stretch in found for k in stretch})
