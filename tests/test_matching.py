"""The memory of matched pairs changes nothing but the time."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid import stereo
from fieldgrid.choices import MatcherKind
from fieldgrid.rig import StereoCamera
from fieldgrid.settings import StereoSettings
from fieldgrid.stereo import StereoMatcher, whole_image
from tests.matching import Matcher, matched_once

CAMERA = StereoCamera(96, 64, 80.0, 48.0, 32.0, 0.2)
LEFT = np.random.default_rng(1).integers(0, 256, (64, 96), dtype=np.uint8)
RIGHT = np.roll(LEFT, -5, axis=1)


def disparities(left: np.ndarray, settings: StereoSettings, most: int = 16) -> np.ndarray:
    return StereoMatcher(CAMERA, settings, whole_image(CAMERA, most)).disparity(left, RIGHT).values


def test_what_is_remembered_is_what_is_matched() -> None:
    other = LEFT.copy()
    other[40:50, 40:60] = 7
    bm = StereoSettings(matcher=MatcherKind.BM)
    cases = ((LEFT, StereoSettings(), 16), (other, StereoSettings(), 16), (LEFT, bm, 16),
             (LEFT, StereoSettings(), 32))  # fmt: skip
    plain = [disparities(*case) for case in cases]
    assert len({values.tobytes() for values in plain}) == len(plain)
    with matched_once():
        for _ in range(2):
            for case, values in zip(cases, plain, strict=True):
                np.testing.assert_array_equal(disparities(*case), values)


def test_a_pair_is_matched_once_and_each_has_its_own_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.matching._known", {})
    with matched_once():
        first, second = (stereo.make_matcher(StereoSettings(), 16) for _ in range(2))
        assert isinstance(first, Matcher)
        assert isinstance(second, Matcher)
        values = first.compute(LEFT, RIGHT)
        before = values.copy()
        values[:] = 0
        np.testing.assert_array_equal(second.compute(LEFT, RIGHT), before)
        assert (first.matched, second.matched) == (1, 0)
    assert not isinstance(stereo.make_matcher(StereoSettings(), 16), Matcher)
