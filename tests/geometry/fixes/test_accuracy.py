"""Qualities: codes, names, and how sure a fix of each is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fieldgrid.core import Quality
from fieldgrid.geometry import known_codes, least_sigma_m, position_sigma_m, quality_by_sigma


def test_codes_that_the_standard_does_not_have_are_unknown() -> None:
    codes = [-7, -1, 0, 4, 9, 10, 77]
    assert [Quality.of_code(code) for code in codes] == [-1, -1, 0, 4, 9, -1, -1]
    assert known_codes(codes).tolist() == [-1, -1, 0, 4, 9, -1, -1]


@pytest.mark.parametrize(
    ("quality", "sigma_m", "expected"),
    [
        (Quality.RTK_FIXED, math.nan, 0.02),
        (Quality.RTK_FLOAT, math.nan, 0.25),
        (Quality.DIFFERENTIAL, math.nan, 0.5),
        (Quality.SBAS, math.nan, 0.5),
        (Quality.GPS, math.nan, 1.5),
        (Quality.UNKNOWN, math.nan, 1.5),
        (Quality.RTK_FIXED, 0.013, 0.013),
        (Quality.DIFFERENTIAL, 0.27, 0.27),
        (Quality.RTK_FIXED, 0.00001, 0.01),  # millimetres written for metres
        (Quality.DIFFERENTIAL, 0.0003, 0.05),
        (Quality.UNKNOWN, 0.0003, 0.01),
        (Quality.UNKNOWN, 0.03, 0.03),  # nothing contradicts it
        (Quality.GPS, 44.0, 44.0),  # who says that it is bad is believed
        (Quality.RTK_FIXED, 0.0, 0.02),
        (Quality.RTK_FIXED, -1.0, 0.02),
        (Quality.RTK_FIXED, math.inf, 0.02),
    ],
)
def test_position_sigma(quality: Quality, sigma_m: float, expected: float) -> None:
    assert position_sigma_m(quality, sigma_m) == pytest.approx(expected)
    both = position_sigma_m(np.array([quality, Quality.NONE]), np.array([sigma_m, math.nan]))
    assert both.tolist() == pytest.approx([expected, 5.0])


def test_only_centimetres_tell_a_quality() -> None:
    found = quality_by_sigma([0.02, 0.05, 0.051, 0.3, 0.0, -1.0, math.nan])
    assert [Quality(code) for code in found] == [Quality.RTK_FIXED] * 2 + [Quality.UNKNOWN] * 5


@pytest.mark.parametrize(
    ("quality", "least_m"),
    [
        (Quality.GPS, 0.75),
        (Quality.DIFFERENTIAL, 0.25),
        (Quality.SBAS, 0.25),
        (Quality.RTK_FLOAT, 0.125),
        (Quality.RTK_FIXED, 0.015),
        (Quality.UNKNOWN, 0.0),
    ],
)
def test_the_least_error_of_a_quality(quality: Quality, least_m: float) -> None:
    assert least_sigma_m([quality, Quality.UNKNOWN]).tolist() == pytest.approx([least_m, 0.0])
