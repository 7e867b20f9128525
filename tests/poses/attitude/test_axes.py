"""Axes of the vehicle whose rise is recorded: two antennas, an IMU's own estimate, odometry."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from fieldgrid.core import Quality
from fieldgrid.geometry import FixColumns, Orientation, R_level_vehicle
from fieldgrid.poses.attitude.axes import AxisTilt, axes_of_fixes, axes_of_tilt
from fieldgrid.poses.attitude.estimate import estimate_attitude
from tests.hilly import Hike, axis_rises, camera_steps, hike, hills, inertial, slope
from tests.poses.attitude.test_attitude import ANTENNA_M, FIELD, FRAMES, RTK, SF1, score, track_of

ARM_M = np.array(ANTENNA_M)
CRESTS = hike(hills(10.0, 45.0), FIELD)


def axis(way: Hike, toward_deg: float, period_s: float = 0.2, **off: float) -> AxisTilt:
    """What two antennas state, a degree of whose height is not known."""
    times, rises = axis_rises(way, toward_deg, period_s, **off)
    sigma = np.full(len(times), off.get("noise_deg", 0.3))
    return AxisTilt(times, rises, sigma, toward_deg, 1.0, 0.0, "pitch", "antennas")


# --- what is stated means


def fixes(heading_axis: dict[str, float], rows: int = 20) -> FixColumns:
    """Fixes that state this, and a little more from row to row."""
    columns = {name: value + 0.01 * np.arange(rows) for name, value in heading_axis.items()}
    return FixColumns.of(np.arange(rows) * 200_000_000, **columns)


def vertical_of(found: tuple[AxisTilt, ...]) -> np.ndarray:
    """The vertical in the vehicle, right and forward [2], by the first values of two axes."""
    directions = np.stack([axis.direction[:2] for axis in found])
    return np.linalg.solve(directions, [np.sin(np.radians(axis.rise_deg[0])) for axis in found])


@pytest.mark.parametrize(("roll", "pitch"), [(4.0, 9.0), (-4.0, 9.0), (4.0, -9.0)])
def test_an_orientation_is_the_vertical(roll: float, pitch: float) -> None:
    times = np.arange(3)
    said = Orientation(times, *(np.full(3, v) for v in (roll, pitch, 0.5, 2.0)))
    found = axes_of_tilt(said)
    assert vertical_of(found) == pytest.approx(R_level_vehicle(roll, pitch)[2, :2])
    assert [axis.frame_sigma_deg for axis in found] == [2.0, 2.0]


@pytest.mark.parametrize("known", [0, 1, 2])
def test_an_orientation_of_numbers_that_are_none_is_none(known: int) -> None:
    times, values = np.arange(5), np.where(np.arange(5) < known, 1.0, np.nan)
    found = axes_of_tilt(Orientation(times, values, values, np.ones(5), np.zeros(5)))
    assert len(found) == (2 if known == 2 else 0)
    assert axes_of_tilt(Orientation(*(column[:0] for column in (times, *[values] * 4)))) == ()


@pytest.mark.parametrize("offset_deg", [0.0, 90.0, -90.0, 180.0, 35.0])
def test_a_heading_s_axis_points_where_the_heading_does(offset_deg: float) -> None:
    # A vehicle with its nose 9° up and its right side 4° down.
    up = R_level_vehicle(4.0, 9.0)[2]
    toward = np.radians(offset_deg)
    ahead = np.array([np.sin(toward), np.cos(toward), 0.0])
    right = np.array([np.cos(toward), -np.sin(toward), 0.0])
    pitch_deg = np.degrees(np.arcsin(up @ ahead))
    roll_deg = np.degrees(np.arcsin(-(up @ right) / np.cos(np.radians(pitch_deg))))
    both = axes_of_fixes(fixes({"pitch_deg": pitch_deg, "roll_deg": roll_deg}), offset_deg)
    assert vertical_of(both) == pytest.approx(up[:2])
    (one,) = axes_of_fixes(fixes({"pitch_deg": pitch_deg}), offset_deg)
    assert one.direction == pytest.approx(ahead)
    assert one.rise_deg[0] == pytest.approx(pitch_deg)


def test_what_is_stated_of_the_sigma_counts_with_a_floor() -> None:
    (axis,) = axes_of_fixes(fixes({"pitch_deg": 1.0, "tilt_sigma_deg": 0.02}), 0.0)
    assert axis.sigma_deg[0] == 0.1
    assert axis.sigma_deg[-1] == pytest.approx(0.21)
    (axis,) = axes_of_fixes(fixes({"pitch_deg": 1.0}), 0.0)
    assert set(axis.sigma_deg) == {0.5}


def test_a_pitch_of_zero_throughout_is_none() -> None:
    level = FixColumns.of(np.arange(20) * 200_000_000, pitch_deg=0.0, roll_deg=0.0)
    assert axes_of_fixes(level, 0.0) == ()
    assert axes_of_fixes(fixes({"pitch_deg": 1.0}, 5), 0.0) == ()


@pytest.mark.parametrize("quality", [Quality.NONE, Quality.GPS, Quality.RTK_FLOAT])
def test_a_baseline_that_is_not_fixed_states_no_pitch(quality: Quality) -> None:
    stated = fixes({"pitch_deg": 1.0})
    codes = np.full(20, int(quality), dtype=np.int64)
    assert axes_of_fixes(stated.replace(heading_quality=codes), 0.0) == ()
    codes[::2] = int(Quality.RTK_FIXED)
    (axis,) = axes_of_fixes(stated.replace(heading_quality=codes), 0.0)
    assert axis.time_ns.tolist() == stated.time_ns[::2].tolist()


# --- what they tell


def test_antennas_fore_and_aft_tell_the_pitch() -> None:
    track = track_of(CRESTS)
    without = score(CRESTS, estimate_attitude(track, ARM_M, wanted_ns=FRAMES), FRAMES)
    found = estimate_attitude(track, ARM_M, wanted_ns=FRAMES, axes=[axis(CRESTS, 0.0)])
    seen, half = score(CRESTS, found, FRAMES), len(FRAMES)
    assert np.percentile(np.abs(without.error_deg[half:]), 95) > 2.0
    assert np.percentile(np.abs(seen.error_deg[half:]), 95) < 1.0
    assert seen.within_3_sigma() == 1.0
    # What is not told stays as unsure as it was.
    roll_sigma = np.median(seen.sigma_deg[:half])
    assert roll_sigma > 0.9 * np.median(without.sigma_deg[:half]) > 2.0


def test_antennas_across_tell_the_roll_and_those_that_stand_askew_of_both() -> None:
    errors = {}
    for toward in (0.0, 45.0, 90.0):
        said = [axis(CRESTS, toward)]
        found = estimate_attitude(track_of(CRESTS), ARM_M, wanted_ns=FRAMES, axes=said)
        seen = score(CRESTS, found, FRAMES)
        assert seen.within_3_sigma() == 1.0
        errors[toward] = np.percentile(np.abs(seen.error_deg[: len(FRAMES)]), 95)
    assert errors[90.0] < 1.2 < errors[45.0] < errors[0.0]


@pytest.mark.parametrize("error_m", [RTK, SF1], ids=["rtk", "sf1"])
def test_antennas_of_unequal_height_are_told_by_the_camera(error_m: tuple[float, float]) -> None:
    way = hike(slope(10.0, 120.0), FIELD)
    steps = camera_steps(way)
    frames = np.union1d(steps.start_ns, steps.stop_ns)
    track = track_of(way, error_m=error_m)
    said = [axis(way, 90.0, mount_deg=1.5)]
    without = estimate_attitude(track, ARM_M, wanted_ns=frames, steps=steps)
    found = estimate_attitude(track, ARM_M, wanted_ns=frames, steps=steps, axes=said)
    seen = score(way, found, frames)
    assert seen.within_3_sigma() == 1.0
    assert seen.percentile(95) < 0.4
    assert np.median(found.roll_sigma_deg) < np.median(without.roll_sigma_deg)


@pytest.mark.parametrize("period_s", [0.05, 0.2, 1.0])
def test_any_rate_does(period_s: float) -> None:
    way = hike(slope(12.0, 30.0), FIELD)
    said = [axis(way, 0.0, period_s, mount_deg=0.5)]
    found = estimate_attitude(track_of(way, 0.2), ARM_M, wanted_ns=FRAMES, axes=said)
    seen = score(way, found, FRAMES)
    assert seen.percentile(95) < 2.0
    assert seen.within_3_sigma() == 1.0


def test_a_hole_of_the_recorded_axis_is_bridged_and_less_sure() -> None:
    whole = axis(CRESTS, 0.0)
    kept = np.abs(whole.time_ns / 1e9 % 60.0 - 25.0) > 6.0
    holed = whole._replace(
        **{name: getattr(whole, name)[kept] for name in ("time_ns", "rise_deg", "sigma_deg")}
    )
    found = estimate_attitude(track_of(CRESTS), ARM_M, wanted_ns=FRAMES, axes=[holed])
    assert score(CRESTS, found, FRAMES).within_3_sigma() == 1.0
    sigma = found.at(FRAMES).pitch_sigma_deg
    inside = np.abs(FRAMES / 1e9 % 60.0 - 25.0) < 3.0
    assert np.median(sigma[inside]) > 1.2 * np.median(sigma[~inside])


def test_a_frame_that_leans_is_told_where_the_vehicle_turns() -> None:
    way = hike(slope(8.0, 30.0), FIELD)
    said = []
    for toward in (0.0, 90.0):
        times, rises = axis_rises(way, toward, 0.1, frame_deg=(2.0, -1.0))
        said.append(
            AxisTilt(
                times, rises, np.full(len(times), 0.3), toward, 1.0, 2.0, "pitch", "orientation"
            )
        )
    steps = camera_steps(way)
    frames = np.union1d(steps.start_ns, steps.stop_ns)
    found = estimate_attitude(track_of(way), ARM_M, wanted_ns=frames, steps=steps, axes=said)
    seen = score(way, found, frames)
    assert seen.percentile(95) < 0.4
    assert seen.within_3_sigma() == 1.0
    assert found.findings == ()


def test_the_frame_of_odometry_is_not_that_of_antennas() -> None:
    """Odometry whose frame leans must not make what good antennas tell worse."""
    way = hike(slope(8.0, 30.0), FIELD)
    antennas = [axis(way, 0.0), axis(way, 90.0)]
    odometry = []
    for toward in (0.0, 90.0):
        times, rises = axis_rises(way, toward, 0.1, frame_deg=(4.0, 3.0))
        sigma = np.full(len(times), 0.5)
        odometry.append(AxisTilt(times, rises, sigma, toward, 1.0, 2.0, "pitch", "orientation"))
    alone, both = (
        score(way, estimate_attitude(track_of(way), ARM_M, wanted_ns=FRAMES, axes=axes), FRAMES)
        for axes in (antennas, [*odometry, *antennas])
    )
    assert both.percentile(95) < 1.1 * alone.percentile(95)
    assert both.within_3_sigma() == 1.0


# --- what contradicts


def test_an_axis_that_contradicts_the_imu_is_named_and_not_used() -> None:
    way = hike(slope(12.0, 120.0), FIELD)  # rolls by 12°, one side and the other
    wrong = axis(way, 90.0)._replace(toward_deg=0.0)  # antennas across, said to be fore and aft
    sensed = inertial(way)
    alone = estimate_attitude(track_of(way), ARM_M, wanted_ns=FRAMES, sensed=sensed)
    found = estimate_attitude(track_of(way), ARM_M, wanted_ns=FRAMES, sensed=sensed, axes=[wrong])
    (told,) = found.findings
    assert told.code == "tilt-unused"
    assert told.message.startswith("The pitch is ")
    for one, other in pairwise((alone[:7], found[:7])):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_antennas_said_to_point_backward_are_named() -> None:
    way = hike(slope(12.0, 30.0), FIELD)
    wrong = axis(way, 180.0)._replace(toward_deg=0.0)
    found = estimate_attitude(
        track_of(way), ARM_M, wanted_ns=FRAMES, sensed=inertial(way), axes=[wrong]
    )
    assert len(found.findings) == 1


def test_an_axis_that_contradicts_takes_its_body_along() -> None:
    """An IMU that is mounted backward, on a slope of 12° across: only one of its axes
    contradicts, and the other one is as wrong."""
    way = hike(slope(12.0, 120.0), FIELD)
    ahead, right = (
        one._replace(rise_deg=-one.rise_deg) for one in (axis(way, 0.0), axis(way, 90.0))
    )
    track = track_of(way)
    alone = estimate_attitude(track, ARM_M, wanted_ns=FRAMES)
    found = estimate_attitude(track, ARM_M, wanted_ns=FRAMES, axes=[ahead, right])
    assert len(found.findings) == 1
    assert np.array_equal(found.pitch_deg, alone.pitch_deg)
    # Of another body it would be used.
    other = ahead._replace(body="orientation")
    apart = estimate_attitude(track, ARM_M, wanted_ns=FRAMES, axes=[other, right])
    assert len(apart.findings) == 1
    assert not np.array_equal(apart.pitch_deg, alone.pitch_deg)


def test_wrong_ambiguities_of_a_while_do_not_matter() -> None:
    said = axis(CRESTS, 0.0)
    wrong = said._replace(rise_deg=said.rise_deg + 25.0 * (np.arange(len(said.rise_deg)) % 9 == 0))
    found = estimate_attitude(
        track_of(CRESTS), ARM_M, wanted_ns=FRAMES, sensed=inertial(CRESTS), axes=[wrong]
    )
    assert found.findings == ()
    seen = score(CRESTS, found, FRAMES)
    assert seen.percentile(95) < 0.2
    assert seen.within_3_sigma() == 1.0
