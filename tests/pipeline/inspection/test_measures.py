"""What is measured of a pair of images."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from fieldgrid.geometry import StereoCamera
from fieldgrid.perception import FrameGround, drive_misalignment
from fieldgrid.perception.vertical import misalignment
from fieldgrid.pipeline.inspection.measures import ImageMeasures, PairMeasures, blur

SIZE_PX = (640, 480)


def look(shifts: np.ndarray) -> PairMeasures:
    ground = FrameGround(2.0, 0.0, 0.0, True)
    images = ImageMeasures((100.0, 100.0), 0.0, 0.0, 0.2, shifts)
    return PairMeasures("0", 0, images, 500, ground, 0.5)


def shifts_of(seed: int, constant_px: float, per_width_px: float, wrong: float) -> np.ndarray:
    """Matches all over the image, some of them wrong."""
    draw = np.random.default_rng(seed)
    at = draw.uniform((0.0, 0.0), SIZE_PX, (300, 2))
    shift = constant_px + per_width_px * (at[:, 0] / SIZE_PX[0] - 0.5)
    shift += draw.normal(0.0, 0.1, 300)
    is_wrong = draw.uniform(size=300) < wrong
    shift[is_wrong] = draw.uniform(-24.0, 24.0, np.count_nonzero(is_wrong))
    return np.column_stack([at, shift])


@settings(max_examples=40, deadline=None)
@example(seed=0, constant_px=1.0, per_width_px=-2.0, wrong=0.0)
@given(
    seed=st.integers(0, 1000),
    constant_px=st.floats(-18.0, 18.0),
    per_width_px=st.floats(-2.0, 2.0),
    wrong=st.floats(0.0, 0.25),
)
def test_misalignment_in_spite_of_wrong_matches(
    seed: int, constant_px: float, per_width_px: float, wrong: float
) -> None:
    shifts = shifts_of(seed, constant_px, per_width_px, wrong)
    found = misalignment([shifts], SIZE_PX)
    assert found is not None
    # Where its matches happen to lie: the median of evenly spread ones is off by chance.
    columns = shifts[:, 0] / SIZE_PX[0] - 0.5
    expected_px = float(np.median(np.abs(constant_px + per_width_px * columns)))
    assert found.residual_px == pytest.approx(expected_px, abs=0.12)
    roll_deg = np.degrees(np.arctan(per_width_px / SIZE_PX[0]))
    assert found.roll_deg == pytest.approx(roll_deg, abs=0.02)


def test_too_few_matches_tell_nothing() -> None:
    assert misalignment([], SIZE_PX) is None
    assert misalignment([shifts_of(0, 5.0, 0.0, 0.0)[:20]], SIZE_PX) is None


@pytest.mark.parametrize("pushed_at", [0.2, 0.5, 0.6, 0.8])
def test_a_camera_that_was_pushed_is_noticed_though_most_pairs_are_right(pushed_at: float) -> None:
    count = 10
    pairs = [shifts_of(k, 2.0 * (k >= pushed_at * count), 0.0, 0.1) for k in range(count)]
    found = drive_misalignment(pairs, SIZE_PX)
    assert found is not None
    assert found.residual_px == pytest.approx(2.0, abs=0.3)
    assert found.pairs >= 2
    before = drive_misalignment([shifts_of(k, 0.3, 0.0, 0.1) for k in range(count)], SIZE_PX)
    assert before is not None
    assert before.residual_px == pytest.approx(0.3, abs=0.1)
    assert before.pairs == count


def test_blur_does_not_depend_on_contrast() -> None:
    image = np.random.default_rng(0).integers(0, 200, (120, 160)).astype(np.uint8)
    assert blur(image) == pytest.approx(blur((image // 4 * 1).astype(np.uint8)), abs=0.03)
    assert blur(np.full((50, 50), 7, dtype=np.uint8)) == 0.0


def test_exposure_is_that_of_the_worse_image() -> None:
    camera = StereoCamera(64, 48, 100.0, 31.5, 23.5, 0.2)
    size = (camera.height_px, camera.width_px)
    found = ImageMeasures.of(np.zeros(size, np.uint8), np.full(size, 255, np.uint8), camera)
    assert found[:3] == ((0.0, 255.0), 1.0, 1.0)
    assert (found.is_dark, found.exposure_ratio) == (True, 255.0)
