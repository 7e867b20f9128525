"""Matching, and what part of the images and disparities is searched."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st
from pydantic import ValidationError

from fieldgrid.core import CalibrationError, ConfigError, MatcherKind, StereoSettings
from fieldgrid.geometry import LeverArm, Mount, Rig, StereoCamera
from fieldgrid.perception import StereoMatcher, whole_image
from fieldgrid.perception.stereo import (
    INVALID,
    SearchRegion,
    between_row_pairs,
    equally_exposed,
    search_region,
)
from tests.scenes import paper_rig

SMALL = StereoCamera(240, 120, 200.0, 120.0, 60.0, 0.2)
Image = npt.NDArray[np.uint8]


def pair(disparity_px: float, seed: int = 0) -> tuple[Image, Image]:
    """A texture seen by both cameras: what is at u on the left is at u - disparity on the right."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (120, 400)), (0, 0), 1.2)
    texture = (texture - texture.mean()) / texture.std() * 45.0 + 128.0
    u, v = np.meshgrid(np.arange(240.0), np.arange(120.0))
    images = [
        cv2.remap(
            texture, (u + shift + 60.0).astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC
        )
        for shift in (0.0, disparity_px)
    ]
    left, right = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in images)
    return left, right


def matcher(
    kind: MatcherKind, region: SearchRegion | None = None, row_step: int = 1
) -> StereoMatcher:
    chosen = StereoSettings(matcher=kind, row_step=row_step)
    return StereoMatcher(SMALL, chosen, region or whole_image(SMALL, 48))


MATCHERS = [(kind, 1) for kind in MatcherKind] + [(MatcherKind.SGBM, 2), (MatcherKind.SGBM_3WAY, 2)]


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize(("gain", "offset"), [(0.3, 0.0), (0.6, 30.0), (0.25, 40.0)])
def test_another_exposure_of_one_side_costs_little(side: int, gain: float, offset: float) -> None:
    images = list(pair(11))
    expected = matcher(MatcherKind.SGBM_3WAY).disparity(*images).values
    images[side] = np.rint(gain * images[side] + offset).astype(np.uint8)
    found = matcher(MatcherKind.SGBM_3WAY).disparity(*images).values
    right = (expected >= 0) & (np.abs(found - expected) <= 4)
    assert right.sum() > 0.97 * (expected >= 0).sum()


def test_pairs_of_one_exposure_are_matched_as_they_are() -> None:
    left, right = pair(11)
    for one, other in zip(equally_exposed(left, right), (left, right), strict=True):
        assert one is other


@pytest.mark.parametrize(("kind", "row_step"), MATCHERS)
@pytest.mark.parametrize("disparity_px", [3, 11, 30])
def test_a_known_shift_is_found_to_a_sixteenth(
    kind: MatcherKind, disparity_px: int, row_step: int
) -> None:
    values, row_start = matcher(kind, row_step=row_step).disparity(*pair(disparity_px))
    assert row_start == 0
    assert values.shape == (120, 240)
    assert values.dtype == np.int16
    inner = values[12 * row_step : -12 * row_step, 60:-12]
    assert (inner >= 0).mean() > 0.97
    off = np.abs(inner[inner >= 0] - 16 * disparity_px)
    assert np.mean(off <= 1) > 0.98  # bm is off by two at a few pixels
    assert off.max() <= 2
    assert np.median(off) <= 1


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_a_shift_between_pixels_is_found_to_a_third(kind: MatcherKind) -> None:
    values, _ = matcher(kind).disparity(*pair(17.4))
    inner = values[12:-12, 60:-12]
    found = inner[inner >= 0] / 16.0
    assert found.size > 10_000
    # sgbm is drawn to whole pixels, by up to 0.28 here.
    assert np.median(found) == pytest.approx(17.4, abs=0.3)
    assert (np.abs(found - 17.4) < 0.4).mean() > 0.9


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_what_has_no_match_is_invalid(kind: MatcherKind) -> None:
    left, _ = pair(10.0)
    _, unrelated = pair(10.0, seed=1)
    values, _ = matcher(kind).disparity(left, unrelated)
    assert (values == INVALID).mean() > 0.7
    assert values[values < 0].max() == INVALID


def matched_without_a_match(kind: MatcherKind, **checks: int) -> float:
    """Share of pixels matched in images that have nothing in common: each one a mistake."""
    off = {"uniqueness_percent": 0, "left_right_px": 10, "speckle_px": 0}
    chosen = StereoSettings(matcher=kind, **{**off, **checks})
    images = pair(10.0)[0], pair(10.0, seed=1)[1]
    found = StereoMatcher(SMALL, chosen, whole_image(SMALL, 48)).disparity(*images)
    return float((found.values >= 0).mean())


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_each_check_drops_mistakes(kind: MatcherKind) -> None:
    unchecked = matched_without_a_match(kind)
    assert unchecked > 0.5
    assert matched_without_a_match(kind, uniqueness_percent=20) < 0.8 * unchecked
    assert matched_without_a_match(kind, speckle_px=400) < 0.8 * unchecked
    assert matched_without_a_match(kind, left_right_px=1) < 0.95 * unchecked


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_the_left_right_check_can_be_switched_off(kind: MatcherKind) -> None:
    off = matched_without_a_match(kind, left_right_px=0)
    assert off > matched_without_a_match(kind, left_right_px=10)
    assert off > 1.05 * matched_without_a_match(kind, left_right_px=1)


def test_only_the_rows_of_the_region_are_matched() -> None:
    left, right = pair(11.0)
    region = SearchRegion(40, 110, 48)
    values, row_start = matcher(MatcherKind.SGBM, region).disparity(left, right)
    assert row_start == 40
    assert values.shape == (70, 240)
    spoilt = left.copy()
    spoilt[:40] = spoilt[110:] = 0
    again, _ = matcher(MatcherKind.SGBM, region).disparity(spoilt, right)
    assert np.array_equal(values, again)


def test_pairs_of_rows_keep_the_ground_where_it_is() -> None:
    """Ground that is nearer from row to row: no row is shifted by half a pair (0.08 px here)."""
    left, _ = pair(0.0)
    u, v = np.meshgrid(np.arange(240.0), np.arange(120.0))
    true_px = 8.0 + 0.15 * v
    right = cv2.remap(left, (u + true_px).astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC)
    errors_px = []
    for row_step in (1, 2):
        values, _ = matcher(MatcherKind.SGBM_3WAY, row_step=row_step).disparity(left, right)
        found = np.where(values >= 0, values / 16.0, np.nan)[20:-20, 80:-20]
        errors_px.append(np.nanmean(found - true_px[20:-20, 80:-20], axis=1))
    all_rows, pairs = errors_px
    assert abs(pairs.mean() - all_rows.mean()) < 0.05
    assert abs(pairs[::2].mean() - pairs[1::2].mean()) < 0.03


@given(st.integers(1, 9), st.integers(-40, 40), st.integers(0, 1))
def test_rows_of_a_pair_lie_a_quarter_to_either_side(pairs: int, slope: int, odd: int) -> None:
    """A ramp of `slope` sixteenths a pair of rows, whose rows follow it to a sixteenth."""
    slope = max(-32, min(32, slope))  # two pixels, from which on it would be another surface
    values = (500 + slope * np.arange(pairs, dtype=np.int16))[:, None] + np.zeros(4, np.int16)
    rows = between_row_pairs(values, 2, 2 * pairs + odd)
    assert rows.dtype == np.int16
    assert rows.shape == (2 * pairs + odd, 4)
    line = 500 + slope * (np.arange(2 * pairs) - 0.5) / 2.0
    assert np.abs(rows[1 : 2 * pairs - 1, 0] - line[1:-1]).max(initial=0.0) <= 0.5
    assert np.array_equal(rows[[0, 2 * pairs - 1]], values[[0, -1]])
    if odd:
        assert np.array_equal(rows[-1], rows[-2])


def test_pairs_of_rows_do_not_mix_surfaces_or_fill_holes() -> None:
    values = np.array([[100, INVALID], [133, 160], [100, INVALID]], dtype=np.int16)
    rows = between_row_pairs(values, 2, 6)
    assert np.array_equal(rows, np.repeat(values, 2, axis=0))
    near = between_row_pairs(np.array([[100], [132]], dtype=np.int16), 2, 4)
    assert near[:, 0].tolist() == [100, 108, 124, 132]


def test_blobs_have_their_size_in_pixels_with_pairs_of_rows() -> None:
    """A blob of 40 x 12 px of another depth is kept or dropped as of all rows."""
    left, right = pair(6.0)
    near_left, near_right = pair(20.0, seed=3)
    left[54:66, 100:140], right[54:66, 80:120] = (
        near_left[54:66, 100:140],
        near_right[54:66, 80:120],
    )
    for step in (1, 2):
        for speckle_px, kept in ((200, True), (1200, False)):
            chosen = StereoSettings(row_step=step, block_px=5, speckle_px=speckle_px)
            found = StereoMatcher(SMALL, chosen, whole_image(SMALL, 48)).disparity(left, right)
            inside = found.values[56:64, 106:134]
            assert bool((np.abs(inside - 320) < 16).mean() > 0.5) is kept, (step, speckle_px)


@pytest.mark.parametrize("side", ["left", "right"])
def test_images_of_another_size_are_refused(side: str) -> None:
    images = dict(zip(("left", "right"), pair(5.0), strict=True))
    images[side] = images[side][:, :-2]
    with pytest.raises(CalibrationError, match=rf"{side} image is 238 x 120.*240 x 120"):
        matcher(MatcherKind.BM).disparity(**images)


@pytest.mark.parametrize("kind", list(MatcherKind))
def test_threads_do_not_disturb_each_other(kind: MatcherKind) -> None:
    shared = matcher(kind)
    pairs = [pair(float(d), seed=d) for d in range(3, 19)]
    alone = [matcher(kind).disparity(*images).values for images in pairs]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda images: shared.disparity(*images).values, pairs))
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one, other)


# --- settings


@pytest.mark.parametrize(
    ("kind", "row_step", "block_px", "expected"),
    [
        (MatcherKind.SGBM, 1, None, 9),
        (MatcherKind.SGBM_3WAY, 1, None, 9),
        (MatcherKind.SGBM_3WAY, 2, None, 5),
        (MatcherKind.SGBM_3WAY, 2, 9, 9),
        (MatcherKind.BM, 1, None, 15),
        (MatcherKind.BM, 1, 5, 5),
        (MatcherKind.SGBM, 1, 3, 3),
    ],
)
def test_blocks_that_fit(
    kind: MatcherKind, row_step: int, block_px: int | None, expected: int
) -> None:
    chosen = StereoSettings(matcher=kind, row_step=row_step, block_px=block_px)
    assert chosen.block() == expected
    StereoMatcher(SMALL, chosen, whole_image(SMALL, 16)).disparity(*pair(5.0))


@pytest.mark.parametrize(
    ("kind", "block_px"), [(MatcherKind.BM, 3), (MatcherKind.BM, 8), (MatcherKind.SGBM, 4)]
)
def test_blocks_that_do_not_fit_are_refused(kind: MatcherKind, block_px: int) -> None:
    with pytest.raises(ConfigError, match=rf"{block_px} px does not fit {kind.value}"):
        StereoSettings(matcher=kind, block_px=block_px).block()


@pytest.mark.parametrize(
    "change",
    [
        {"block_px": 2},
        {"matcher": "wls"},
        {"min_range": 3.0},
        {"row_step": 3},
        {"row_step": 2, "matcher": "bm"},
    ],
)
def test_settings_that_cannot_be_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        StereoSettings(**change)  # type: ignore[arg-type]


# --- the region

rigs = st.builds(
    lambda height, tilt, roll, yaw, focal: Rig(
        paper_rig(focal_px=focal).camera, Mount(height, tilt, roll, yaw), paper_rig().antenna
    ),
    st.floats(0.8, 3.5),
    st.floats(-5.0, 30.0),
    st.floats(-8.0, 8.0),
    st.floats(-20.0, 20.0),
    st.floats(400.0, 1200.0),
)


@settings(max_examples=150, deadline=None)
@given(rigs, st.floats(0.5, 4.0), st.floats(8.0, 25.0), st.integers(0, 2**32 - 1))
def test_every_visible_point_of_the_slice_is_below_the_top_row(
    rig: Rig, top_m: float, range_m: float, seed: int
) -> None:
    chosen = StereoSettings(min_range_m=6.0)
    region = search_region(rig, chosen, top_m, range_m)
    rng = np.random.default_rng(seed)
    azimuth, distance = rng.uniform(-1.2, 1.2, 3000), rng.uniform(1.0, range_m, 3000)
    height = rng.choice([top_m, 0.99 * top_m, 0.2], 3000)
    points = np.stack([distance * np.sin(azimuth), distance * np.cos(azimuth), height])
    points[2] -= rig.mount.height_m
    x, y, z = rig.mount.rotation().T @ points
    near = z >= chosen.min_range_m
    u = 320.0 + rig.camera.focal_px * x[near] / z[near]
    v = 240.0 + rig.camera.focal_px * y[near] / z[near]
    visible = (u >= 0.0) & (u < 640.0) & (v >= 0.0) & (v < 480.0)
    assert (v[visible] >= region.row_start).all()
    assert region.row_stop == 480
    assert 0 <= region.row_start <= 464


def test_a_pitching_vehicle_keeps_the_slice_in_the_searched_rows() -> None:
    rig = paper_rig(tilt_deg=15.0)
    region = search_region(rig, StereoSettings(), 2.2, 15.0)
    nose_up = Mount(2.8, 15.0 + 3.5).rotation()  # seen so by a camera that points lower
    _, y, z = nose_up.T @ np.array([0.0, 15.0, 2.2 - 2.8])
    assert 240.0 + 780.0 * y / z >= region.row_start


def test_rows_above_the_slice_are_not_searched() -> None:
    tilted, level = paper_rig(tilt_deg=5.0), paper_rig(tilt_deg=0.0, height_m=3.0)
    assert search_region(tilted, StereoSettings(), 1.0, 15.0).row_start > 30
    # To 15 m a slice of 1 m stays atan(2/15) = 7.6° below the horizon of a camera at 3 m; of
    # that at most 5° are kept for the vehicle's pitch.
    row_start = search_region(level, StereoSettings(), 1.0, 15.0).row_start
    rows_below_axis = (row_start - 240) / 780
    assert np.tan(np.radians(2.6)) < rows_below_axis < np.tan(np.radians(7.6))


@given(st.floats(0.6, 20.0), st.floats(300.0, 1500.0), st.floats(-1.0, 8.0))
def test_the_nearest_range_is_searched_and_multiples_of_16(
    min_range_m: float, focal_px: float, offset_px: float
) -> None:
    camera = StereoCamera(1280, 480, focal_px, 640.0, 240.0, 0.2, 640.0 - offset_px)
    rig = replace(paper_rig(), sensor=camera)
    region = search_region(rig, StereoSettings(min_range_m=min_range_m), 2.2, 15.0)
    nearest_px = focal_px * 0.2 / min_range_m + offset_px
    assert region.num_disparities % 16 == 0
    assert region.num_disparities >= max(16, nearest_px)
    assert region.num_disparities < max(17, nearest_px + 17)


def test_a_nearest_range_at_a_multiple_of_16_is_searched_too() -> None:
    """480 px · 0.2 m / 3 m = 32 px, and 32 disparities are 0 … 31."""
    region = search_region(paper_rig(focal_px=480.0), StereoSettings(min_range_m=3.0), 2.2, 15.0)
    assert region.num_disparities - 1 >= 32


def test_too_near_a_range_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"0\.4 m asks for 400 .* larger min_range_m"):
        search_region(paper_rig(), StereoSettings(min_range_m=0.4), 2.2, 15.0)


def test_a_right_camera_whose_far_points_have_negative_disparity_is_refused() -> None:
    camera = StereoCamera(640, 480, 600.0, 320.0, 240.0, 0.2, cx_right_px=340.0)
    rig = Rig(camera, Mount(2.0, 15.0), LeverArm(0.0, 0.0, 2.0))
    with pytest.raises(CalibrationError, match=r"cx is 20\.0 px beyond the left's"):
        search_region(rig, StereoSettings(), 2.2, 15.0)
