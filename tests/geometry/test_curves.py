"""Every word ends where it should, and the shortest is as short as can be."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from fieldgrid.geometry import Word, words

REACH = st.floats(-8.0, 8.0)
TURN = st.floats(-math.pi, math.pi)


def end_of(word: Word) -> tuple[float, float, float]:
    x = y = yaw = 0.0
    for turn, length in word:
        after = yaw + turn * length
        if turn == 0:
            x, y = x + length * math.cos(yaw), y + length * math.sin(yaw)
        else:
            x += (math.sin(after) - math.sin(yaw)) / turn
            y += (math.cos(yaw) - math.cos(after)) / turn
        yaw = after
    return x, y, yaw


def length_of(word: Word) -> float:
    return sum(abs(length) for _, length in word)


@given(REACH, REACH, TURN, st.booleans())
def test_words_end_at_their_pose(x: float, y: float, phi: float, reverse: bool) -> None:
    found = words(x, y, phi, reverse=reverse)
    assert found
    for word in found:
        east, north, yaw = end_of(word)
        assert math.hypot(east - x, north - y) < 1e-6
        assert abs(math.remainder(yaw - phi, 2.0 * math.pi)) < 1e-6
        assert reverse or all(length >= 0.0 for _, length in word)


@given(REACH, REACH, TURN)
def test_reverse_never_makes_it_longer(x: float, y: float, phi: float) -> None:
    both = min(map(length_of, words(x, y, phi, reverse=True)))
    forward = min(map(length_of, words(x, y, phi, reverse=False)))
    assert math.hypot(x, y) - 1e-9 <= both <= forward + 1e-6


@given(REACH, REACH, TURN)
def test_there_and_back_are_as_long(x: float, y: float, phi: float) -> None:
    """Reeds and Shepp's distance is the same from the goal to the start."""
    cos, sin = math.cos(phi), math.sin(phi)
    back = words(-x * cos - y * sin, x * sin - y * cos, -phi, reverse=True)
    there = min(map(length_of, words(x, y, phi, reverse=True)))
    assert min(map(length_of, back)) == pytest.approx(there, abs=1e-6)


@pytest.mark.parametrize(
    ("pose", "reverse", "length"),
    [
        ((5.0, 0.0, 0.0), False, 5.0),
        ((0.0, 2.0, math.pi), False, math.pi),
        ((-3.0, 0.0, 0.0), True, 3.0),
        ((0.0, 0.0, math.pi), True, math.pi),  # three arcs of a sixth of a turn
        ((10.0, 2.0, math.pi), False, 10.0 + math.pi),
    ],
)
def test_known_lengths(pose: tuple[float, float, float], reverse: bool, length: float) -> None:
    found = min(map(length_of, words(*pose, reverse=reverse)))
    assert found == pytest.approx(length, abs=1e-6)
