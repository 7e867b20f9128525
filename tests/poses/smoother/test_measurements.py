"""What the measurements of a drive tell together."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.poses.smoother.measurements import Measurements

TIME_S = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0])


def turning(ends: list[tuple[int, int]], turn_rad: list[float], gyro_rad: list[float]) -> list:
    """The turns that steps between those nodes and a gyro saw."""
    n, step = len(TIME_S), np.zeros((len(ends), 3))
    step[:, 2] = turn_rad
    nothing = np.full(n, np.nan)
    measured = Measurements(
        *(TIME_S, np.full((n, 2), np.nan), np.full((n, 2), np.nan), nothing, nothing),
        *(nothing, nothing, nothing, nothing, np.array(gyro_rad)),
        *(np.ones(n - 1, np.bool_), np.zeros(n, np.bool_)),
        *(np.array(ends, dtype=np.int64).reshape(-1, 2), step, np.ones((len(ends), 2))),
    )
    return measured.seen_turns_rad().tolist()


UNSEEN = np.nan


def test_a_step_turns_evenly_over_its_time() -> None:
    found = turning([(1, 3)], [0.6], [UNSEEN] * 5)
    assert found == pytest.approx([UNSEEN, 0.2, 0.4, UNSEEN, UNSEEN], nan_ok=True)


def test_what_two_steps_saw_is_their_mean() -> None:
    found = turning([(0, 3), (2, 4)], [0.4, 1.2], [UNSEEN] * 5)
    assert found == pytest.approx([0.1, 0.1, 0.4, 0.6, UNSEEN], nan_ok=True)


def test_a_gyro_is_believed_before_the_camera() -> None:
    found = turning([(0, 2)], [1.0], [0.3, UNSEEN, UNSEEN, 0.0, UNSEEN])
    assert found == pytest.approx([0.3, 0.5, UNSEEN, 0.0, UNSEEN], nan_ok=True)


def test_without_steps_only_the_gyro_is_left() -> None:
    assert turning([], [], [0.1] * 5) == [0.1] * 5
