"""Where the batch estimate contradicts its gears."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.pose.drive import MISPLACED_S, lasting


@pytest.mark.parametrize("hz", [1, 5, 20])
def test_only_alasting_contradiction_counts(hz: int) -> None:
    time_s = np.arange(30 * hz) / hz
    brief = (time_s > 3.0) & (time_s < 3.0 + MISPLACED_S)  # a cusp that is misplaced
    long = (time_s >= 10.0) & (time_s <= 10.0 + 3.0 * MISPLACED_S)
    np.testing.assert_array_equal(lasting(brief | long, time_s), long)


def test_a_contradiction_at_the_ends_counts_too() -> None:
    time_s = np.arange(40) / 5.0
    against = (time_s < 2.0) | (time_s > 6.0)
    np.testing.assert_array_equal(lasting(against, time_s), against)
    assert not lasting(np.zeros(40, dtype=np.bool_), time_s).any()
