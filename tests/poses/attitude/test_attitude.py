"""Roll and pitch of simulated drives over hills, beside what they were."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import Inertial, roll_pitch_deg
from fieldgrid.poses import Attitude
from fieldgrid.poses.attitude.axes import axes_of_tilt
from fieldgrid.poses.attitude.estimate import estimate_attitude
from fieldgrid.poses.attitude.track import AntennaTrack, KnownHeadings
from tests.hilly import (
    Hike,
    antenna_fixes,
    camera_steps,
    hike,
    hills,
    inertial,
    recorded_tilt,
    rows,
    slope,
)
from tests.simulated import Command, time_ns

ANTENNA_M = (-0.12, -0.45, 0.35)
RTK, SF1 = (0.012, 0.01), (0.03, 0.3)


def track_of(way: Hike, period_s: float = 0.2, error_m: tuple[float, float] = RTK) -> AntennaTrack:
    noise_m, wander_m = error_m
    times, enu = antenna_fixes(way, ANTENNA_M, period_s, noise_m, wander_m)
    heading = np.degrees(way.at(np.arange(0.0, way.drive.time_s[-1], period_s)).drive.heading_rad)
    sigma = np.tile(np.array([1.0, 1.0, 2.0]) * noise_m, (len(times), 1))
    n = len(times)
    headings = KnownHeadings(times, heading + 0.2, np.full(n, 0.3))
    return AntennaTrack(times, enu, sigma, np.full(n, wander_m), headings)


class Score(NamedTuple):
    """Errors of roll and pitch at frames, degrees, and their sigmas, pooled."""

    error_deg: npt.NDArray[np.float64]
    sigma_deg: npt.NDArray[np.float64]

    def within_3_sigma(self) -> float:
        return float(np.mean(np.abs(self.error_deg) < 3.0 * self.sigma_deg))

    def percentile(self, share: float) -> float:
        return float(np.percentile(np.abs(self.error_deg), share))


def score(way: Hike, found: Attitude, times: npt.NDArray[np.int64]) -> Score:
    seen = found.at(times)
    k = np.searchsorted(time_ns(way.drive.time_s), times)
    roll, pitch = roll_pitch_deg(way.R[k])
    return Score(
        np.concatenate([seen.roll_deg - roll, seen.pitch_deg - pitch]),
        np.concatenate([seen.roll_sigma_deg, seen.pitch_sigma_deg]),
    )


FRAMES = time_ns(np.arange(1.03, 50.0, 1.0))
FIELD = rows(2, 28.0)
GROUNDS = {
    "level": slope(0.0),
    "15° down": slope(15.0, 30.0),
    "10° across": slope(10.0, 120.0),
    "hills": hills(10.0, 45.0),
}


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("error_m", [RTK, SF1], ids=["rtk", "sf1"])
def test_an_imu_tells_roll_and_pitch(ground: str, error_m: tuple[float, float]) -> None:
    way = hike(GROUNDS[ground], FIELD)
    found = estimate_attitude(
        track_of(way, error_m=error_m), np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=inertial(way)
    )
    seen = score(way, found, FRAMES)
    assert seen.percentile(95) < 0.15
    assert seen.within_3_sigma() == 1.0
    assert np.median(seen.sigma_deg) < 0.3


@pytest.mark.parametrize("period_s", [1.0, 0.1, 0.05])
def test_receivers_of_any_rate_do(period_s: float) -> None:
    way = hike(GROUNDS["hills"], FIELD)
    sensed = inertial(way, force_bias_mps2=(0.2, -0.25, 0.1))  # a degree and more out of square
    found = estimate_attitude(
        track_of(way, period_s), np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=sensed
    )
    seen = score(way, found, FRAMES)
    assert seen.percentile(95) < 0.3
    assert seen.within_3_sigma() > 0.98


def test_a_shaking_imu_is_less_sure_and_says_so() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    sensed = inertial(way, force_noise_mps2=1.5, gyro_noise_dps=1.5)
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=sensed)
    seen = score(way, found, FRAMES)
    assert seen.percentile(95) < 0.8
    assert seen.within_3_sigma() > 0.98
    quiet = estimate_attitude(
        track_of(way), np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=inertial(way)
    )
    assert np.median(found.roll_sigma_deg) > 1.3 * np.median(quiet.roll_sigma_deg)


@pytest.mark.parametrize("ground", GROUNDS)
def test_the_camera_alone_tells_roll_and_pitch(ground: str) -> None:
    way = hike(GROUNDS[ground], FIELD)
    steps = camera_steps(way, lean_deg=0.0)
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), steps=steps)
    seen = score(way, found, np.union1d(steps.start_ns, steps.stop_ns))
    assert seen.percentile(50) < 0.6
    assert seen.percentile(95) < 1.5
    assert seen.within_3_sigma() > 0.98


@pytest.mark.parametrize("told", [True, False])
def test_a_camera_sees_all_of_the_way_or_does_not_tell_how_it_rose(told: bool) -> None:
    way = hike(GROUNDS["hills"], FIELD)
    steps = camera_steps(way)
    track = track_of(way)
    inside = (track.time_ns >= steps.start_ns[0]) & (track.time_ns <= steps.stop_ns[-1])
    track = AntennaTrack(*(column[inside] for column in track[:-1]), track.headings)
    if not told:
        steps = steps._replace(up_m=np.full(len(steps.up_m), np.nan))
    found = estimate_attitude(track, np.array(ANTENNA_M), steps=steps)
    seen = score(way, found, found.time_ns)
    assert seen.within_3_sigma() > 0.98


def test_what_the_camera_sees_is_its_own_attitude() -> None:
    # Mounted a degree higher than declared, it tells points that are placed right all the same.
    way = hike(GROUNDS["hills"], FIELD)
    steps = camera_steps(way, lean_deg=1.0)
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), steps=steps)
    _, pitch = roll_pitch_deg(way.at((steps.start_ns - time_ns(np.zeros(1))) / 1e9).R)
    off = found.at(steps.start_ns).pitch_deg - pitch
    assert float(np.median(off)) == pytest.approx(1.0, abs=0.3)


def test_fixes_alone_give_the_slope_of_the_drive() -> None:
    way = hike(slope(9.0, 75.0), rows(4, 28.0))
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), wanted_ns=FRAMES)
    seen = score(way, found, FRAMES)
    assert seen.percentile(50) < 0.7
    assert seen.within_3_sigma() == 1.0


def test_a_single_row_hides_its_cross_slope_and_sigma_says_so() -> None:
    way = hike(slope(9.0, 120.0), [Command(3.0, 0.0), Command(30.0, 1.4)])
    frames = FRAMES[: np.searchsorted(FRAMES, time_ns(way.drive.time_s[-1:])[0])]
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), wanted_ns=frames).at(frames)
    assert np.all(found.roll_sigma_deg > 5.0)
    assert np.all(np.abs(found.pitch_deg) < 3.0)
    roll, _ = roll_pitch_deg(way.at((frames - time_ns(np.zeros(1))) / 1e9).R)
    assert np.all(np.abs(found.roll_deg - roll) < 3.0 * found.roll_sigma_deg)


def test_a_recorded_tilt_is_taken_as_it_is_stated() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    found = estimate_attitude(
        track_of(way), np.array(ANTENNA_M), wanted_ns=FRAMES, axes=axes_of_tilt(recorded_tilt(way))
    )
    seen = score(way, found, FRAMES)
    assert seen.percentile(95) < 0.6
    assert seen.within_3_sigma() == 1.0


def test_where_an_imu_falls_out_the_attitude_is_carried_over() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    whole = inertial(way)
    late_s = (whole.time_ns - whole.time_ns[0]) / 1e9
    holed = Inertial(*(column[(late_s < 20.0) | (late_s > 30.0)] for column in whole))
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=holed)
    seen = score(way, found, FRAMES)
    assert seen.within_3_sigma() > 0.98
    inside = found.at(time_ns(np.array([25.0])))
    assert inside.roll_sigma_deg[0] > 2.0 * np.median(found.roll_sigma_deg)


def test_outliers_of_fixes_do_not_tip_the_vehicle() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    track = track_of(way)
    track.enu_m[60:64] += [1.0, -2.0, 3.0]
    track.enu_m[150:] += [0.3, 0.1, -0.5]  # the solution moves for good
    found = estimate_attitude(track, np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=inertial(way))
    seen = score(way, found, FRAMES)
    assert seen.percentile(95) < 0.4
    assert seen.within_3_sigma() > 0.95


def test_a_long_drive_is_estimated_in_stretches_without_seams() -> None:
    way = hike(hills(8.0), rows(10, 60.0))
    found = estimate_attitude(track_of(way, 0.5), np.array(ANTENNA_M), sensed=inertial(way, 50.0))
    assert np.all(np.diff(found.time_ns) > 0)
    seen = score(way, found, found.time_ns[found.time_ns < time_ns(way.drive.time_s[-1:])[0]])
    assert seen.percentile(99) < 0.3
    assert seen.within_3_sigma() > 0.99


def test_beyond_its_nodes_an_attitude_is_ever_less_sure() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), sensed=inertial(way))
    end = found.time_ns[-1]
    late = found.at(end + np.array([0, 1, 4, 10_000]) * 1_000_000_000)
    assert np.all(np.diff(late.roll_sigma_deg) > 0.5)
    assert np.all(late.roll_deg == found.roll_deg[-1])


def test_the_same_drive_gives_the_same_bits() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    once, again = (
        estimate_attitude(track_of(way), np.array(ANTENNA_M), sensed=inertial(way))
        for _ in range(2)
    )
    for one, other in zip(once, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_two_fixes_are_enough() -> None:
    way = hike(slope(0.0), FIELD)
    track = track_of(way)
    headings = KnownHeadings(*(column[:2] for column in track.headings))
    short = AntennaTrack(*(column[:2] for column in track[:-1]), headings)
    found = estimate_attitude(short, np.array(ANTENNA_M))
    assert np.isfinite(found.roll_deg).all()
    assert np.all(found.roll_sigma_deg > 3.0)


def test_a_night_between_two_drives_takes_no_nodes() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    track, sensed = track_of(way), inertial(way)
    noon_ns, night_ns = track.time_ns[len(track.time_ns) // 2], 14 * 3600 * 1_000_000_000
    for times in (track.time_ns, sensed.time_ns):
        times[times > noon_ns] += night_ns
    found = estimate_attitude(track, np.array(ANTENNA_M), sensed=sensed)
    assert len(found.time_ns) < 1.5 * len(track.time_ns)
    drive = np.where(found.time_ns > noon_ns, found.time_ns - night_ns, found.time_ns)
    k = np.clip(np.searchsorted(time_ns(way.drive.time_s), drive), 0, len(way.R) - 1)
    roll, pitch = roll_pitch_deg(way.R[k])
    off = np.abs(np.concatenate([found.roll_deg - roll, found.pitch_deg - pitch]))
    sigma = np.concatenate([found.roll_sigma_deg, found.pitch_sigma_deg])
    assert np.percentile(off, 95) < 0.5
    assert np.mean(off < 3.0 * sigma) > 0.97


def test_in_a_long_gap_no_heading_is_known() -> None:
    times = np.array([0.0, 1.0, 2.0, 12.0, 13.0])
    known = KnownHeadings(time_ns(times), times * 100.0, np.full(5, 0.5))
    heading_deg, sigma_deg = known.at(time_ns(np.array([0.5, 2.0, 2.1, 11.9, 12.0, 12.5])))
    np.testing.assert_allclose(heading_deg, [50.0, 200.0, 210.0, 1190.0, 1200.0, 1250.0])
    np.testing.assert_array_equal(sigma_deg, [0.5, 0.5, np.inf, np.inf, 0.5, 0.5])


@pytest.mark.parametrize("known_s", [(25.0, 45.0), (0.0, 500.0), (500.0, 0.0)])
def test_where_no_heading_is_known_the_gyro_carries_it_on(known_s: tuple[float, float]) -> None:
    """In the middle of the drive with its turn, nowhere but at the ends, and at one end only."""
    way = hike(GROUNDS["hills"], FIELD)
    track = track_of(way)
    after_s = (track.time_ns - track.time_ns[0]) / 1e9
    first_s, last_s = known_s
    kept = (after_s < first_s) | (after_s > last_s)
    kept[[0, -1]] = True
    headings = KnownHeadings(*(column[kept] for column in track.headings))
    track = track._replace(headings=headings)
    found = estimate_attitude(track, np.array(ANTENNA_M), wanted_ns=FRAMES, sensed=inertial(way))
    assert score(way, found, FRAMES).within_3_sigma() > 0.98
    assert score(way, found, FRAMES).percentile(95) < 0.5


def test_measurements_that_err_by_more_than_they_state_are_less_sure() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    track, antenna_m = track_of(way, error_m=(0.05, 0.01)), np.array(ANTENNA_M)
    too_sure = track._replace(noise_m=track.noise_m / 4.0)
    honest, raised = (
        estimate_attitude(one, antenna_m, wanted_ns=FRAMES, sensed=inertial(way))
        for one in (track, too_sure)
    )
    assert score(way, raised, FRAMES).within_3_sigma() > 0.98
    assert np.median(raised.roll_sigma_deg) > 0.6 * np.median(honest.roll_sigma_deg)


def test_how_late_a_sensor_may_be_counts_as_it_leans_otherwise_then() -> None:
    way = hike(GROUNDS["hills"], FIELD)
    found = estimate_attitude(track_of(way), np.array(ANTENNA_M), sensed=inertial(way))
    late = found.if_late(-0.3)
    shifted = score(way, late._replace(time_ns=late.time_ns + 300_000_000), FRAMES)
    assert shifted.within_3_sigma() > 0.97
    assert (
        score(way, found._replace(time_ns=late.time_ns + 300_000_000), FRAMES).within_3_sigma()
        < 0.9
    )
    np.testing.assert_array_equal(found.if_late(0.0).roll_sigma_deg, found.roll_sigma_deg)
