"""Columns of times as they stand in a table."""

from __future__ import annotations

from decimal import Decimal

from hypothesis import given, strategies as st

from fieldgrid.recordings.tables.times import NO_TIME, TimeScale, to_utc_ns

_DIGITS = st.text("0123456789", min_size=0, max_size=12)


@given(
    whole=st.integers(1, 12).flatmap(
        lambda wide: st.lists(
            st.text("0123456789", min_size=wide, max_size=wide), min_size=1, max_size=6
        )
    ),
    fraction=_DIGITS,
    other=st.sampled_from(["", "1308133811.25", " 1308133811.250", "1308133811", "nan", "-3.5"]),
)
def test_seconds_are_exact_whether_their_points_are_aligned_or_not(
    whole: list[str], fraction: str, other: str
) -> None:
    """Another cell among them has each read on its own."""
    scale = TimeScale(places=9)
    cells = [f"{one}.{fraction[::-1][k:]}{fraction[::-1][:k]}" for k, one in enumerate(whole)]
    found = to_utc_ns(cells, scale, decimal_comma=False)
    assert found.tolist() == to_utc_ns([*cells, other], scale, decimal_comma=False)[:-1].tolist()
    for cell, time_ns in zip(cells, found.tolist(), strict=True):
        exact_ns = int(Decimal(cell) * 10**9)
        assert time_ns in (exact_ns, NO_TIME)
    in_range = "1308133811.1234567899"
    assert (
        to_utc_ns([in_range] * 2, scale, decimal_comma=False).tolist()
        == [1_308_133_811_123_456_789] * 2
    )


def test_whole_numbers_keep_each_digit() -> None:
    scale = TimeScale(places=0)
    for cells in (["1308133811123456789"], ["777777777777777777"], ["9" * 19, "1" + "0" * 18]):
        expected = [int(cell) if cell[0] != "9" else NO_TIME for cell in cells]
        assert to_utc_ns(cells, scale, decimal_comma=False).tolist() == expected
