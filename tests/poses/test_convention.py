"""A recorded heading beside the estimated one: what is wrong with it, and what to declare."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import HeadingConvention, Rig, nose_heading_deg, wrap_deg
from fieldgrid.poses.faults.convention import Comparison, compare
from tests.scenes import paper_rig

_Float64 = npt.NDArray[np.float64]

N = 400


def drive(seed: int = 0, gear: int = 1) -> tuple[_Float64, _Float64, npt.NDArray[np.int64]]:
    """Headings that turn by a circle and a half, their errors, the gear."""
    random = np.random.default_rng(seed)
    heading = np.asarray(wrap_deg(np.linspace(-100.0, 440.0, N) + random.normal(0.0, 0.5, N)))
    return heading, np.full(N, 0.8), np.full(N, gear)


def rig_of(convention: HeadingConvention = "cw_north", offset_deg: float | None = None) -> Rig:
    plain = paper_rig()
    return Rig(
        plain.camera,
        plain.mount,
        plain.antenna,
        heading_offset_deg=offset_deg,
        heading_convention=convention,
    )


def declared(clause: str, rig: Rig) -> Rig:
    """The rig after a user has done as the clause says."""
    offset = re.search(r'"heading_offset_deg": (-?[\d.]+)', clause)
    convention = re.search(r'"heading_convention": "(\w+)"', clause)
    assert offset or convention
    told: HeadingConvention = rig.heading_convention
    if convention:
        assert convention[1] in ("cw_north", "ccw_east")
        told = "ccw_east" if convention[1] == "ccw_east" else "cw_north"
    return rig_of(told, float(offset[1]) if offset else rig.heading_offset_deg)


@settings(deadline=None)
@given(st.floats(-180.0, 180.0), st.integers(0, 100))
def test_an_offset_is_found(offset_deg: float, seed: int) -> None:
    heading, sigma, gear = drive(seed)
    noise = np.random.default_rng(seed + 1).normal(0.0, 1.0, N)
    found = compare(np.asarray(wrap_deg(heading + offset_deg + noise)), heading, sigma, gear)
    assert found is not None
    assert abs(wrap_deg(found.offset_deg - offset_deg)) < 0.3
    assert found.scatter_deg == pytest.approx(1.0, rel=0.2)
    assert found.offset_sigma_deg == pytest.approx(found.scatter_deg / 2.0)
    assert (found.mirrored, found.course, found.compared) == (False, False, N)


@settings(deadline=None)
@given(
    st.sampled_from(["cw_north", "ccw_east"]),
    st.floats(-180.0, 180.0),
    st.sampled_from(["cw_north", "ccw_east"]),
    st.one_of(st.none(), st.floats(-180.0, 180.0)),
)
def test_who_declares_what_is_advised_is_right(
    true: HeadingConvention,
    true_deg: float,
    told: HeadingConvention,
    told_deg: float | None,
) -> None:
    """Whatever the receiver means and whatever the mounting says so far, REP-103's yaw too."""
    heading, sigma, gear = drive()
    turned = heading + true_deg
    recorded = turned if true == "cw_north" else 90.0 - turned
    rig = rig_of(told, told_deg)
    found = compare(nose_heading_deg(rig, recorded), heading, sigma, gear)
    assert found is not None
    assert found.mirrored == (true != told)
    if not found.mirrored and abs(found.offset_deg) < 1.0:
        return
    better = declared(found.correction(rig), rig)
    off = wrap_deg(nose_heading_deg(better, recorded) - heading)
    assert np.abs(off).max() < 1.1  # a degree of yaw is not worth a second line


def test_corrections_in_words() -> None:
    offset = Comparison(92.04, 0.1, 1.0, False, False, 400)
    assert offset.correction(None) == '"heading_offset_deg": 92.0'
    assert "92.0° off the nose throughout" in offset.diagnosis()
    yaw = Comparison(90.3, 0.1, 1.0, True, False, 400)
    assert yaw.correction(None) == '"heading_convention": "ccw_east"'
    assert "counter-clockwise" in yaw.diagnosis()
    aside = Comparison(0.0, 0.1, 1.0, True, False, 400)
    assert (
        aside.correction(None) == '"heading_convention": "ccw_east" and "heading_offset_deg": 90.0'
    )
    behind = Comparison(-178.0, 0.1, 1.0, False, False, 400)
    assert "points backwards" in behind.diagnosis()


def test_the_course_is_no_heading() -> None:
    heading, sigma, gear = drive()
    gear[150:250] = -1
    course = np.where(gear < 0, heading + 180.0, heading)
    found = compare(np.asarray(wrap_deg(course)), heading, sigma, gear)
    assert found is not None
    assert found.course
    nose = compare(heading, heading, sigma, gear)
    assert nose is not None
    assert not nose.course
    # A few headings in reverse decide nothing.
    gear[152:250] = 1
    few = compare(np.where(gear < 0, heading + 180.0, heading), heading, sigma, gear)
    assert few is not None
    assert not few.course


def test_a_heading_that_turns_around_means_nothing_throughout() -> None:
    """As of a receiver that finds its attitude on the way: only the road, a tenth of the drive, is
    known best, and there it points backwards."""
    heading, _, gear = drive()
    road = np.arange(N) < N // 10
    recorded = np.asarray(wrap_deg(np.where(road, heading + 180.0, heading)))
    found = compare(recorded, heading, np.where(road, 3.0, 12.0), gear)
    assert found is not None
    assert abs(found.offset_deg) == pytest.approx(180.0, abs=0.1)
    assert (found.flips, found.flipped) == (True, 0.9)
    # What is known no better does not tell which way round it is, and a tenth is no change.
    vague = compare(recorded, heading, np.where(road, 3.0, 40.0), gear)
    kept = compare(recorded, heading, np.where(road, 12.0, 3.0), gear)
    assert vague is not None
    assert kept is not None
    assert not vague.flips
    assert not kept.flips
    assert abs(kept.offset_deg) < 0.1


def test_who_only_backs_up_is_compared_too() -> None:
    heading, sigma, gear = drive()
    gear[:] = -1
    nose = compare(np.asarray(wrap_deg(heading + 3.0)), heading, sigma, gear)
    assert nose is not None
    assert nose.offset_deg == pytest.approx(3.0, abs=1e-9)
    # The course of who backs up, and the nose where a camera that looks back takes ahead for back.
    other = compare(np.asarray(wrap_deg(heading + 180.0)), heading, sigma, gear)
    assert other is not None
    assert not other.course
    assert "only backs up" in other.diagnosis()


def test_a_straight_drive_leaves_the_sign_open() -> None:
    heading = np.full(N, 30.0) + np.random.default_rng(0).normal(0.0, 1.0, N)
    found = compare(wrap_deg(-heading + 60.0), heading, np.full(N, 1.0), np.ones(N, np.int64))
    assert found is not None
    assert not found.mirrored
    assert found.offset_deg == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("lacking", ["recorded", "sure", "forward"])
def test_too_little_to_compare(lacking: str) -> None:
    heading, sigma, gear = drive()
    recorded = heading.copy()
    {"recorded": recorded, "sure": sigma, "forward": gear}[lacking][19:] = {
        "recorded": np.nan,
        "sure": 5.0,
        "forward": 0,
    }[lacking]
    assert compare(recorded, heading, sigma, gear) is None


def test_what_is_unsure_or_missing_does_not_count() -> None:
    heading, sigma, gear = drive()
    recorded = heading + 3.0
    recorded[:100], sigma[:100] = heading[:100] + 80.0, 6.0
    recorded[100:150] = np.nan
    recorded[150:200], gear[150:200] = heading[150:200] - 60.0, 0
    found = compare(recorded, heading, sigma, gear)
    assert found is not None
    assert found.offset_deg == pytest.approx(3.0, abs=1e-9)
    assert found.compared == 200


def test_some_wild_headings_do_not_move_the_offset() -> None:
    heading, sigma, gear = drive()
    recorded = heading + 3.0
    recorded[::8] += 90.0
    found = compare(recorded, heading, sigma, gear)
    assert found is not None
    assert found.offset_deg == pytest.approx(3.0, abs=0.5)
