"""What a map keeps of a drive to estimate its poses again: there and back, bit by bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import MapError, Quality
from fieldgrid.geometry import (
    Fix,
    FixColumns,
    Gyro,
    Inertial,
    Motion,
    Orientation,
    RecordedTilt,
    Steps,
    WheelSpeed,
)
from fieldgrid.pipeline.inputs import Inputs, from_arrays, to_arrays

NS = st.integers(0, 2**62)
REAL = st.floats(-1e9, 1e9)
COUNT = st.integers(0, 99)

fix_strategy = st.builds(
    Fix,
    time_ns=NS,
    lat_deg=st.one_of(REAL, st.just(math.nan)),
    lon_deg=st.one_of(REAL, st.just(math.inf)),
    height_m=st.one_of(REAL, st.just(math.nan)),
    quality=st.sampled_from(Quality),
    satellites=st.none() | COUNT,
    hdop=st.none() | REAL,
    age_s=st.none() | REAL,
    sigma_m=st.none() | st.floats(0.0, math.inf),
    speed_mps=st.none() | REAL,
    heading_deg=st.none() | st.floats(-180.0, 180.0) | st.just(-1.0),
    heading_sigma_deg=st.none() | REAL,
    heading_quality=st.none() | st.sampled_from(sorted(Quality)[1:]),
    course_deg=st.none() | st.floats(-180.0, 180.0) | st.just(-1.0),
    pitch_deg=st.none() | REAL,
    roll_deg=st.none() | REAL,
    tilt_sigma_deg=st.none() | REAL,
    stamp_sigma_s=st.none() | REAL,
)
fix_lists = st.lists(fix_strategy, max_size=8)


@st.composite
def motions(draw: st.DrawFn) -> Motion:
    def column(n: int, integers: bool) -> npt.NDArray[Any]:
        values = draw(st.lists(NS if integers else REAL, min_size=n, max_size=n))
        return np.array(values, dtype=np.int64 if integers else np.float64)

    def part(kind: type[Any]) -> Any:
        if draw(st.booleans()):
            return None
        n = draw(st.integers(0, 4))
        return kind(*(column(n, name.endswith("_ns")) for name in kind._fields))

    sensed = part(Inertial)
    if sensed is not None:
        three = (np.outer(column, [1.0, 2.0, 3.0]).astype(np.float32) for column in sensed[1:])
        sensed = Inertial(sensed.time_ns, *three)
    return Motion(
        *(part(Gyro), part(WheelSpeed), part(Steps), sensed, part(RecordedTilt)),
        orientation=part(Orientation),
    )


def inputs(rows: list[Fix], motion: Motion | None = None) -> Inputs:
    fixes = FixColumns.of_rows(rows)
    frame_ns = np.array([5, 7, 2**62], dtype=np.int64)
    return Inputs(fixes, motion or Motion(), frame_ns, np.array([True, False, True]))


def same(one: object, other: object) -> bool:
    """Equal, of the same type, and not a number where the other is none."""
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return type(one) is type(other) and one == other


RTK = Quality.RTK_FIXED
FIX = Fix(
    1_308_139_200_000_000_000, 39.5, -1.1, 703.0, RTK, 12, 0.8, 1.0, 0.02, 1.5, -1.0, 0.3, RTK
)


@settings(deadline=None)
@given(fix_lists, motions())
def test_what_is_kept_comes_back(fixes: list[Fix], motion: Motion) -> None:
    own = inputs(fixes, motion)
    arrays = to_arrays(own)
    assert all(column.dtype.kind in "iuf" for column in arrays.values())
    found = from_arrays(arrays)
    assert len(found.fixes) == len(fixes)
    for one, other in zip(found.fixes, fixes, strict=True):
        assert all(same(a, b) for a, b in zip(one, other, strict=True)), (one, other)
    assert found.frame_ns.tolist() == own.frame_ns.tolist()
    assert found.frame_ns.dtype == np.int64
    assert found.ground_found.tolist() == own.ground_found.tolist()
    assert found.ground_found.dtype == np.bool_
    for part, expected in zip(found.motion, motion, strict=True):
        assert (part is None) == (expected is None)
        for a, b in zip(part or (), expected or (), strict=True):
            assert a.dtype == b.dtype
            assert a.tobytes() == b.tobytes()
    # And again the same arrays.
    again = to_arrays(found)
    assert again.keys() == arrays.keys()
    assert all(again[name].tobytes() == column.tobytes() for name, column in arrays.items())


@pytest.mark.parametrize("heading", [-1.0, 0.0, 180.0, None])
def test_a_heading_of_minus_one_degree_is_one(heading: float | None) -> None:
    """-1 stands for nothing among integers only."""
    own = FIX._replace(heading_deg=heading, course_deg=heading, hdop=heading, satellites=None)
    (found,) = from_arrays(to_arrays(inputs([own]))).fixes
    assert found == own


def test_a_position_that_is_no_number_stays_one_and_what_was_not_said_stays_unsaid() -> None:
    """A rejected fix may hold anything; only what may be None comes back as it."""
    own = FIX._replace(lat_deg=math.nan, height_m=math.nan, hdop=math.nan, speed_mps=None)
    (found,) = from_arrays(to_arrays(inputs([own]))).fixes
    assert math.isnan(found.lat_deg)
    assert math.isnan(found.height_m)
    assert found.hdop is None
    assert found.speed_mps is None


@settings(deadline=None)
@given(fix_lists, st.sampled_from(sorted(Fix._field_defaults.keys() - {"quality"})))
def test_a_field_that_the_writer_did_not_know_says_nothing(fixes: list[Fix], field: str) -> None:
    arrays = to_arrays(inputs(fixes))
    arrays.pop(f"fix.{field}", None)
    found = from_arrays(arrays).fixes
    assert [fix.time_ns for fix in found] == [fix.time_ns for fix in fixes]
    unsaid = Fix._field_defaults[field]
    assert [getattr(fix, field) for fix in found] == [unsaid] * len(fixes)


def test_a_field_that_the_reader_does_not_know_is_passed_over() -> None:
    arrays = to_arrays(inputs([FIX]))
    arrays["fix.mood"] = np.array([1.0])
    assert list(from_arrays(arrays).fixes) == [FIX]


def test_a_session_of_a_writer_that_kept_no_fixes_is_told() -> None:
    with pytest.raises(MapError, match="build it again"):
        from_arrays({})


MOTION = Motion(
    Gyro(np.arange(3), np.zeros(3)),
    WheelSpeed(np.arange(3), np.zeros(3)),
    Steps(*np.zeros((11, 3))),
)


@pytest.mark.parametrize("name", ["frame_ns", "ground_found", "gyro.rate_rad_s", "steps.sigma_m"])
def test_inputs_that_lack_something_are_damaged(name: str) -> None:
    arrays = to_arrays(inputs([FIX], MOTION))
    del arrays[name]
    with pytest.raises(MapError, match=rf"damaged: .*{name}.*verify"):
        from_arrays(arrays)


def test_columns_of_different_lengths_are_damaged() -> None:
    arrays = to_arrays(inputs([FIX, FIX]))
    arrays["fix.hdop"] = arrays["fix.hdop"][:1]
    with pytest.raises(MapError, match="damaged"):
        from_arrays(arrays)


@pytest.mark.parametrize("name", [f"fix.{field}" for field in Fix._fields[:5]])
def test_what_every_fix_has_cannot_be_missing(name: str) -> None:
    """Without its place or its quality a fix is none; older writers knew them all."""
    arrays = to_arrays(inputs([FIX]))
    del arrays[name]
    with pytest.raises(MapError):
        from_arrays(arrays)
