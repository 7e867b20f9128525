"""Rows that repeat a position, told from a vehicle that stands."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Fix
from fieldgrid.poses import Gate
from tests.poses.gnss.judged import judge
from tests.poses.gnss.sentences import NOON, SECOND

M_PER_DEG = 111_195.0


def written(
    speeds_mps: list[float],
    *,
    row_s: float,
    receiver_s: float,
    rounded_deg: float = 1e-5 / 60.0,
    told: bool = False,
) -> list[Fix]:
    """A drive due north, one speed for each second, as a logger writes what a receiver has."""
    rows = round(len(speeds_mps) / row_s)
    start_m = np.concatenate([[0.0], np.cumsum(speeds_mps)])
    fixes = []
    for k in range(rows):
        now_s = k * row_s
        fresh_s = np.floor(now_s / receiver_s + 1e-6) * receiver_s
        second = min(int(fresh_s + 1e-6), len(speeds_mps) - 1)
        distance_m = start_m[second] + (fresh_s - second) * speeds_mps[second]
        lat_deg = round((41.65 + distance_m / M_PER_DEG) / rounded_deg) * rounded_deg
        speed = speeds_mps[second] if told else None
        fixes.append(Fix(NOON + round(now_s * SECOND), lat_deg, -4.72, 700.0, 4, speed_mps=speed))
    return fixes


def repeats(fixes: list[Fix]) -> list[int]:
    return [k for k, v in enumerate(judge(fixes)) if v.gate is Gate.REPEAT]


def test_a_logger_quicker_than_its_receiver_repeats_positions() -> None:
    """40 Hz of a receiver with 10 Hz: three of four rows."""
    fixes = written([1.0] * 20, row_s=0.025, receiver_s=0.1)
    assert repeats(fixes) == [k for k in range(800) if k % 4]
    verdicts = judge(fixes)
    assert verdicts[1].reason == "repeats the position of the fix 0.03 s before"
    assert verdicts[403].reason == "repeats the position of the fix 0.07 s before"


def test_they_repeat_where_it_stands_too_but_not_all() -> None:
    fixes = written([1.0] * 10 + [0.0] * 10 + [1.0] * 10, row_s=0.025, receiver_s=0.1)
    kept = [k for k, v in enumerate(judge(fixes)) if v.ok]
    standing = [k for k in kept if 420 <= k < 780]
    assert standing == list(range(420, 780, 4))  # what the receiver can have made


def test_a_receiver_that_hangs_while_the_vehicle_moves() -> None:
    fixes = written([2.0] * 20, row_s=0.2, receiver_s=0.2)
    hung = [
        f._replace(lat_deg=fixes[50].lat_deg) if 50 < k < 56 else f for k, f in enumerate(fixes)
    ]
    assert repeats(hung) == [51, 52, 53, 54, 55]
    assert judge(hung)[55].reason == "repeats the position of the fix 1.00 s before"


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("rounded_deg", [1e-5 / 60.0, 1e-4 / 60.0])
@pytest.mark.parametrize("row_s", [0.1, 0.2, 1.0])
def test_a_vehicle_that_stops_and_goes_stands(row_s: float, rounded_deg: float, told: bool) -> None:
    speeds = [1.5] * 10 + [1.0, 0.5, 0.2] + [0.0] * 10 + [0.2, 0.5, 1.0] + [1.5] * 10
    fixes = written(speeds, row_s=row_s, receiver_s=row_s, rounded_deg=rounded_deg, told=told)
    verdicts = judge(fixes)
    standing = range(round(13.5 / row_s), round(22.5 / row_s))
    assert all(verdicts[k].ok for k in standing)


def test_slow_motion_on_coarse_positions_is_no_repeat() -> None:
    """5 Hz at 0.2 m/s, and 10 Hz at 1.5 m/s, with 18.5 cm from one position to the next."""
    for speed, row_s in ((0.2, 0.2), (1.5, 0.1)):
        fixes = written([speed] * 60, row_s=row_s, receiver_s=row_s, rounded_deg=1e-4 / 60.0)
        assert repeats(fixes) == []


def test_a_log_that_never_moves_is_left_alone() -> None:
    assert repeats(written([0.0] * 30, row_s=0.05, receiver_s=0.1)) == []


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_row_written_twice_is_kept_once(speed: float) -> None:
    fixes = written([speed] * 10, row_s=0.2, receiver_s=0.2)
    twice = [*fixes[:20], fixes[19], *fixes[20:]]
    assert repeats(twice) == [20]
    assert judge(twice)[20].reason == "repeats the fix before it, place and time"


def test_a_wild_fix_beside_it_does_not_make_a_standing_vehicle_move() -> None:
    fixes = written([1.0] * 5 + [0.0] * 10 + [1.0] * 5, row_s=0.2, receiver_s=0.2)
    for k in (44, 45, 50, 52):
        fixes[k] = fixes[k]._replace(lat_deg=fixes[k].lat_deg + 4e-4)
    assert repeats(fixes) == []


def test_where_the_receiver_says_that_it_stands_it_does() -> None:
    fixes = written([2.0] * 20, row_s=0.2, receiver_s=0.2, told=True)
    hung = [
        f._replace(lat_deg=fixes[50].lat_deg, speed_mps=0.0) if 50 < k < 53 else f
        for k, f in enumerate(fixes)
    ]
    assert repeats(hung) == []
