"""Offsets between clocks that have a name."""

from __future__ import annotations

import pytest

from fieldgrid.poses import Span, explanation, leap_seconds, shift_to_overlap

S = 1_000_000_000
IN_2011, IN_2024 = 1_308_133_815 * S, 1_717_000_000 * S


@pytest.mark.parametrize(
    ("time_ns", "leaps"),
    [
        (IN_2011, 15),
        (IN_2024, 18),
        (1_483_228_799 * S, 17),  # the last second but one of 2016
        (1_483_228_800 * S, 18),
        (315_964_800 * S, 0),
    ],
)
def test_leap_seconds(time_ns: int, leaps: int) -> None:
    assert leap_seconds(time_ns) == leaps


@pytest.mark.parametrize(
    ("offset_s", "told"),
    [
        (15.02, "GPS time is 15 s ahead of UTC, so the fixes carry GPS time"),
        (-18.0, "GPS time is 18 s ahead of UTC, so the images carry GPS time"),
        (7201.0, "2 h is that of a time zone, so one of the two carries local time"),
        (-19_800.0, "5.5 h is that of a time zone, so one of the two carries local time"),
        (172_800.0, "2 days: one of the two has a wrong date"),
        (16.6, ""),
        (0.03, ""),
        (1000.0, ""),
    ],
)
def test_what_an_offset_may_come_from(offset_s: float, told: str) -> None:
    assert explanation(offset_s, IN_2011) == told


@pytest.mark.parametrize("moved_s", [15, -18, 1800, -3600, 7200, 43_200, -86_400, 259_200])
def test_images_are_brought_to_where_the_fixes_are(moved_s: int) -> None:
    fixes = Span(IN_2011, IN_2011 + 10 * S)
    images = Span(IN_2011 + (moved_s + 1) * S, IN_2011 + (moved_s + 9) * S)
    assert shift_to_overlap(images, fixes) == -moved_s


def test_no_name_no_shift() -> None:
    fixes = Span(IN_2011, IN_2011 + 100 * S)
    assert shift_to_overlap(Span(IN_2011 + 1000 * S, IN_2011 + 1080 * S), fixes) is None
