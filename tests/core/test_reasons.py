"""Reasons for refusals, counted."""

from __future__ import annotations

from fieldgrid.core import commonest_reason, grouped_reasons


def test_reasons_that_differ_in_numbers_only_are_one() -> None:
    reasons = {"HDOP 4.5 > 4": 3, "a jump": 5, "HDOP 12 > 4": 4}
    assert grouped_reasons(reasons) == [(7, "HDOP 12 > 4"), (5, "a jump")]
    assert grouped_reasons({}) == []


def test_the_commonest_is_of_the_largest_group() -> None:
    each_once = [f"position sigma {k / 10:.2f} m > 2 m" for k in range(30, 36)]
    assert commonest_reason(["a jump"] * 3 + each_once + [""] * 20).startswith("position sigma")
