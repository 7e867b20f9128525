"""Clocks, order and pairs of stamped messages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from fieldgrid.core import RecordingError
from fieldgrid.recordings import MAX_APART_NS
from fieldgrid.recordings.bag.order import WINDOW, clock, ordered, pair

UTC = 1_700_000_000_000_000_000
MS = 1_000_000


def times(*values_ms: float) -> np.ndarray:
    return np.array([UTC + round(v * MS) for v in values_ms], dtype=np.int64)


def test_header_stamps_are_taken_where_they_are_utc() -> None:
    stamps, received = times(0, 100, 200), times(50, 150, 250)
    assert clock("/t", stamps, received).time_ns.tolist() == stamps.tolist()
    assert clock("/t", stamps, received, received=True).time_ns.tolist() == received.tolist()


def test_a_few_stamps_that_are_none_are_left_out_and_many_give_way_to_the_recorders() -> None:
    stamps, received = times(*range(0, 2000, 100)), times(*range(50, 2050, 100))
    stamps[3] = 0
    found = clock("/t", stamps, received)
    assert not found.received
    assert found.time_ns[3] == 0
    stamps[:10] = 5
    found = clock("/t", stamps, received)
    assert found.received
    assert found.time_ns.tolist() == received.tolist()


def test_without_any_utc_there_is_an_error() -> None:
    nothing = np.arange(3, dtype=np.int64)
    with pytest.raises(RecordingError, match=r"times of /t are no UTC"):
        clock("/t", nothing, nothing)


def test_order_within_the_window_is_restored_and_what_is_later_left_out() -> None:
    found = ordered(times(0, 200, 100, 300, 300))
    assert found.time_ns.tolist() == times(0, 100, 200, 300).tolist()
    assert found.place.tolist() == [0, 2, 1, 3]
    assert (found.late, found.timeless) == (1, 0)
    late = ordered(times(*range(10, 10 + 3 * WINDOW), 0))
    assert late.place.tolist() == list(range(3 * WINDOW))
    assert late.late == 1


@given(st.lists(st.integers(-1, 200), max_size=120))
def test_ordered_is_increasing_needs_few_and_keeps_all_that_is_near(values: list[int]) -> None:
    raw = np.array([0 if v < 0 else UTC + v for v in values], dtype=np.int64)
    found = ordered(raw)
    assert np.all(np.diff(found.time_ns) > 0)
    assert raw[found.place].tolist() == found.time_ns.tolist()
    assert len(found.place) + found.late + found.timeless == len(values)
    # A reader that passes messages on in this order holds few of them.
    held: set[int] = set()
    wanted = iter(found.place.tolist())
    place, kept = next(wanted, -1), set(found.place.tolist())
    for k in range(len(values)):
        held |= {k} & kept
        while place in held:
            held.remove(place)
            place = next(wanted, -1)
        assert len(held) <= WINDOW + 1


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=60, unique=True), st.randoms())
def test_shuffled_by_less_than_the_window_nothing_is_lost(values: list[int], random) -> None:  # type: ignore[no-untyped-def]
    increasing = sorted(values)
    half = WINDOW // 2
    mixed = []
    for k in range(0, len(increasing), half):
        block = increasing[k : k + half]
        random.shuffle(block)
        mixed += block
    found = ordered(np.array(mixed, dtype=np.int64) + UTC)
    assert found.time_ns.tolist() == [UTC + v for v in increasing]


def test_equal_stamps_pair_even_where_another_is_near() -> None:
    left, right = pair(times(0, 100, 200), times(-1, 0, 100, 101, 200))
    assert left.tolist() == [0, 1, 2]
    assert right.tolist() == [1, 2, 4]


def test_the_nearest_within_the_tolerance_pair() -> None:
    left, right = pair(times(0, 100, 200, 300), times(3, 98, 260, 300.5))
    assert left.tolist() == right.tolist() == [0, 1, 3]


def test_the_tolerance_is_a_quarter_of_the_interval_and_ten_milliseconds() -> None:
    fast = np.arange(0, 200, 20)
    assert len(pair(times(*fast), times(*(fast + 4.9)))[0]) == 10
    assert len(pair(times(*fast), times(*(fast + 5.1)))[0]) == 0
    slow = np.arange(0, 2000, 200)
    assert len(pair(times(*slow), times(*(slow + 9.9)))[0]) == 10
    assert len(pair(times(*slow), times(*(slow + 10.1)))[0]) == 0


increasing = st.lists(st.integers(0, 2000), max_size=60, unique=True).map(
    lambda values: np.array(sorted(values), dtype=np.int64) * MS + UTC
)


@example(times(0, 71, 80), times(0, 80, 81))
@example(times(0, 80, 81), times(0, 71, 80))
@given(increasing, increasing)
def test_pairs_never_cross_and_are_within_the_tolerance(
    left: np.ndarray, right: np.ndarray
) -> None:
    of_left, of_right = pair(left, right)
    assert np.all(np.diff(of_left) > 0)
    assert np.all(np.diff(of_right) > 0)
    assert np.all(np.abs(left[of_left] - right[of_right]) <= MAX_APART_NS)
    assert set(left[of_left]) >= set(left) & set(right)
