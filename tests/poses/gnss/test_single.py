"""Logs of two receivers, and of a clock that was set back, are refused."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import GnssError
from fieldgrid.geometry import FixColumns
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, SLALOM, fixes_of, simulate

FIXES = fixes_of(simulate(SLALOM, 20.0, speed_mps=1.2), 0.2, 0.02)


def used(fixes: FixColumns) -> float:
    return float(estimate_poses(fixes, None, DATUM).trajectory.accepted.mean())


@pytest.mark.parametrize("apart_m", [0.0, 0.6])
def test_two_receivers_in_one_log_are_refused_and_rows_that_come_twice_are_not(
    apart_m: float,
) -> None:
    twice = FIXES[np.repeat(np.arange(len(FIXES)), 2)]
    beside = np.tile([0.0, apart_m], len(FIXES)) / 111_200.0
    both = twice.replace(lat_deg=twice.lat_deg + beside)
    if apart_m:
        with pytest.raises(GnssError, match="two receivers"):
            used(both)
    else:
        assert used(both) > 0.45


def test_stamps_in_whole_seconds_are_those_of_one_receiver() -> None:
    whole_ns = FIXES.time_ns // 1_000_000_000 * 1_000_000_000
    assert used(FIXES.replace(time_ns=whole_ns)) > 0.45


@pytest.mark.parametrize(("by_s", "refused"), [(-18.0, True), (18.0, False)])
def test_a_clock_that_is_set_back_while_fixes_go_on_is_refused(by_s: float, refused: bool) -> None:
    after = np.arange(len(FIXES)) > len(FIXES) // 2
    set_ns = FIXES.time_ns + round(by_s * 1e9) * after
    if refused:
        with pytest.raises(GnssError, match=r"go back by 17\.8 s"):
            used(FIXES.replace(time_ns=set_ns))
    else:
        assert used(FIXES.replace(time_ns=set_ns)) > 0.5


def test_two_parts_of_a_drive_in_the_wrong_order_are_one_drive() -> None:
    middle = len(FIXES) // 2
    rows = np.r_[middle : len(FIXES), 0:middle]
    assert used(FIXES[rows]) == used(FIXES)


def test_a_row_that_comes_late_is_put_in_order() -> None:
    rows = [*range(20), *range(21, 50), 20, *range(50, len(FIXES))]
    assert used(FIXES[np.array(rows)]) == used(FIXES)


def test_a_few_stamps_that_are_minutes_ahead_refuse_no_log() -> None:
    at = np.arange(len(FIXES))
    ahead_ns = 300_000_000_000 * ((at >= 40) & (at < 45))
    assert used(FIXES.replace(time_ns=FIXES.time_ns + ahead_ns)) > 0.45
