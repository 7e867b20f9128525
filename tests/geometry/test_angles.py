"""Headings, yaws, and the one place where they meet."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, strategies as st

from fieldgrid.geometry import heading_deg, heading_from_yaw_rad, wrap_deg, yaw_from_heading_rad
from fieldgrid.geometry.angles import interpolate_deg

angles = st.floats(-1e4, 1e4)
headings = st.floats(-180.0, 180.0, exclude_min=True)


def apart_deg(a: float, b: float) -> float:
    """The angle between two directions, by their unit vectors."""
    a, b = math.radians(a), math.radians(b)
    cross = math.cos(a) * math.sin(b) - math.sin(a) * math.cos(b)
    return abs(math.degrees(math.atan2(cross, math.cos(a - b))))


@given(angles)
@example(180.0)
@example(-180.0)
@example(540.0)
@example(math.nextafter(180.0, 999.0))
@example(math.nextafter(-180.0, -999.0))
def test_wrapping_keeps_the_direction_and_ends_in_the_range(angle: float) -> None:
    wrapped = float(wrap_deg(angle))
    assert -180.0 < wrapped <= 180.0
    assert apart_deg(angle, wrapped) < 1e-9


def test_a_half_turn_is_plus_180() -> None:
    assert wrap_deg([-180.0, 180.0, 540.0, -540.0]).tolist() == [180.0] * 4
    assert wrap_deg([190.0, -190.0, 360.0, 725.0]).tolist() == [-170.0, 170.0, 0.0, 5.0]


@pytest.mark.parametrize(
    ("east", "north", "expected"),
    [(0, 1, 0), (1, 1, 45), (1, 0, 90), (1, -1, 135), (0, -1, 180), (-1, 0, -90), (-1, 1, -45)],
)
def test_heading_is_clockwise_from_north(east: float, north: float, expected: float) -> None:
    assert heading_deg(east, north) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("yaw_deg", "heading"), [(0, 90), (90, 0), (180, -90), (-90, 180), (30, 60), (-45, 135)]
)
def test_ros_yaw_is_counter_clockwise_from_east(yaw_deg: float, heading: float) -> None:
    assert heading_from_yaw_rad(math.radians(yaw_deg)) == pytest.approx(heading, abs=1e-9)
    assert yaw_from_heading_rad(heading) == pytest.approx(math.radians(yaw_deg), abs=1e-12)


@given(headings)
def test_yaw_and_heading_name_the_same_direction(heading: float) -> None:
    yaw = float(yaw_from_heading_rad(heading))
    assert -math.pi < yaw <= math.pi
    assert apart_deg(float(heading_deg(math.cos(yaw), math.sin(yaw))), heading) < 1e-9
    assert apart_deg(float(heading_from_yaw_rad(yaw)), heading) < 1e-9


@given(headings, headings, st.floats(0.0, 1.0))
def test_interpolation_takes_the_shorter_way(start: float, end: float, fraction: float) -> None:
    way = apart_deg(start, end)
    between = interpolate_deg(start, end, fraction)
    assert -180.0 < between <= 180.0
    assert apart_deg(start, between) == pytest.approx(fraction * way, abs=1e-6)
    assert apart_deg(between, end) == pytest.approx((1.0 - fraction) * way, abs=1e-6)


def test_interpolation_across_south() -> None:
    assert interpolate_deg(170.0, -170.0, 0.25) == pytest.approx(175.0)
    assert interpolate_deg(-170.0, 170.0, 0.75) == pytest.approx(175.0)
