"""Fixes as columns, and rows of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import GnssError, Quality
from fieldgrid.geometry import NOT_SAID, Fix, FixColumns

REAL = st.floats(allow_nan=False)
KNOWN = st.sampled_from(sorted(Quality)[1:])
ROWS = st.lists(
    st.builds(
        Fix,
        st.integers(-(2**63), 2**63 - 1),
        REAL,
        REAL,
        REAL,
        st.sampled_from(Quality),
        satellites=st.none() | st.integers(0, 99),
        hdop=st.none() | REAL,
        age_s=st.none() | REAL,
        sigma_m=st.none() | REAL,
        speed_mps=st.none() | REAL,
        heading_sigma_deg=st.none() | REAL,
        heading_deg=st.none() | REAL | st.just(-1.0),
        heading_quality=st.none() | KNOWN,
        course_deg=st.none() | REAL,
        pitch_deg=st.none() | REAL,
        roll_deg=st.none() | REAL,
        tilt_sigma_deg=st.none() | REAL,
        stamp_sigma_s=st.none() | REAL,
    ),
    max_size=6,
)


@given(ROWS)
def test_rows_come_back_from_columns(rows: list[Fix]) -> None:
    columns = FixColumns.of_rows(rows)
    again = list(columns)
    assert again == rows
    assert all(type(a.quality) is Quality for a in again)
    assert [columns[k] for k in range(len(rows))] == rows
    assert columns == FixColumns.of_rows(again)


@given(ROWS, ROWS)
def test_joined_fixes_are_those_of_both_logs(one: list[Fix], two: list[Fix]) -> None:
    joined = FixColumns.joined([FixColumns.of_rows(one), FixColumns.of_rows(two)])
    assert list(joined) == [*one, *two]


@given(ROWS)
def test_in_order_is_stable(rows: list[Fix]) -> None:
    ordered = FixColumns.of_rows(rows).in_order()
    assert list(ordered) == sorted(rows, key=lambda fix: fix.time_ns)


def three() -> FixColumns:
    return FixColumns.of([30, 10, 20], lat_deg=[1.0, 2.0, 3.0], quality=Quality.GPS)


def test_what_is_left_out_is_not_said() -> None:
    first = three()[0]
    assert (first.time_ns, first.lat_deg, first.height_m) == (30, 1.0, 0.0)
    assert np.isnan(first.lon_deg)  # every fix has a place, if only a wrong one
    assert first[5:] == (None,) * len(first[5:])
    assert three().satellites.tolist() == [NOT_SAID] * 3
    assert FixColumns.of([]) == FixColumns.of_rows([])
    assert FixColumns.joined([]) == FixColumns.of([])
    assert FixColumns.of([1])[0].quality is Quality.UNKNOWN


def test_masks_slices_and_indices_select() -> None:
    fixes = three()
    assert fixes[fixes.time_ns > 10].lat_deg.tolist() == [1.0, 3.0]
    assert fixes[1:].lat_deg.tolist() == [2.0, 3.0]
    assert fixes[np.array([2, 0])].lat_deg.tolist() == [3.0, 1.0]
    assert fixes[-1].lat_deg == 3.0
    with pytest.raises(IndexError):
        fixes[3]


def test_a_replaced_column_leaves_the_others() -> None:
    fixes = three()
    changed = fixes.replace(hdop=np.array([1.0, 2.0, 3.0]))
    assert changed.hdop.tolist() == [1.0, 2.0, 3.0]
    assert np.isnan(fixes.hdop).all()
    assert changed.time_ns is fixes.time_ns
    assert changed != fixes
    assert fixes != three()[::-1]
    assert fixes == three()


def test_columns_that_do_not_fit_are_refused() -> None:
    with pytest.raises(GnssError, match=r"column hdop of 3 fixes has the shape \(2,\)"):
        three().replace(hdop=np.zeros(2))
    with pytest.raises(GnssError, match=r"column quality .* code that Quality has not"):
        FixColumns.of([1, 2], quality=[4, 10])
    with pytest.raises(TypeError, match="no column mood"):
        FixColumns.of([1], mood=[1.0])


def test_the_sigma_of_a_row_is_that_of_its_column() -> None:
    fixes = FixColumns.of([1, 2], quality=[4, 2], sigma_m=[np.nan, 0.3])
    assert fixes.position_sigma_m().tolist() == [fix.position_sigma_m for fix in fixes]
    assert fixes.position_sigma_m().tolist() == [0.02, 0.3]
