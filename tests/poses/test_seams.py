"""A solution that leaps and says nothing of it: how far it may be off, from both sides."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import Float64, PoseSettings
from fieldgrid.geometry import Carrier, FixColumns, Motion
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.poses.faults.leaps.seams import LEAP_S, seam_doubt
from tests.simulated import DATUM, K_TURN, Command, Drive, fixes_of, gyro_of, simulate

PERIOD_S, STATED_M = 0.2, 0.02
ROWS = [Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2)]


def straight(leap_m: Float64) -> tuple[Float64, Float64]:
    """Points of a drive north at 1 m/s that lie aside, and their times."""
    time_s = PERIOD_S * np.arange(len(leap_m))
    return np.stack([leap_m, time_s], axis=1), time_s


def doubt_of(leap_m: Float64, denied: Float64, stated_m: Float64 | float = STATED_M) -> Float64:
    stated = np.broadcast_to(np.asarray(stated_m, dtype=np.float64), leap_m.shape)
    return seam_doubt(*straight(leap_m), stated, 0.01, denied > 0.0).sigma_m


def denied_at(n: int, *rows: int) -> Float64:
    found = np.zeros(n)
    found[list(rows)] = 1.0
    return found


def test_without_leaps_there_is_no_doubt() -> None:
    found = seam_doubt(*straight(np.zeros(100)), np.full(100, STATED_M), 0.01, np.zeros(100) > 0.0)
    assert not found.sigma_m.any()
    assert np.isinf(found.lasting_s).all()


def test_of_two_solutions_as_long_either_may_be_wrong() -> None:
    aside = np.where(np.arange(200) < 100, 0.0, 3.0)
    sigma_m = doubt_of(aside, denied_at(200, 100))
    # Half of a mean square of 3 m for each, along one axis.
    assert sigma_m == pytest.approx(np.full(200, 1.5), abs=0.1)


def test_what_lasted_longer_is_rather_right() -> None:
    long = doubt_of(np.where(np.arange(400) < 300, 0.0, 3.0), denied_at(400, 300))
    # Right with the probability of their shares, 3 to 1.
    assert long[0] == pytest.approx(np.sqrt(0.25 * 9.0 / 2.0), abs=0.1)
    assert long[-1] == pytest.approx(np.sqrt(0.75 * 9.0 / 2.0), abs=0.1)


def test_a_receiver_that_says_how_bad_it_is_leaves_the_better_one_alone() -> None:
    aside = np.where(np.arange(200) < 100, 0.0, 3.0)
    stated = np.where(np.arange(200) < 100, 0.02, 1.5)
    sigma_m = doubt_of(aside, denied_at(200, 100), stated)
    assert sigma_m[0] < 0.03  # 1 in 5625 that it is the wrong one
    assert sigma_m[-1] == pytest.approx(3.0 / np.sqrt(2.0), abs=0.1)


def test_an_excursion_says_nothing_of_what_lasts() -> None:
    brief = (np.arange(300) >= 150) & (np.arange(300) < 156)
    found = seam_doubt(
        *straight(np.where(brief, 4.0, 0.0)),
        np.full(300, STATED_M),
        0.01,
        brief,
    )
    assert found.sigma_m.max() < STATED_M
    assert (found.lasting_s > LEAP_S).all()


def test_many_excursions_in_a_curve_are_still_one_solution() -> None:
    time_s = PERIOD_S * np.arange(300)
    turned = 0.2 * np.clip(time_s - 28.0, 0.0, 8.0)
    points = np.cumsum(PERIOD_S * np.stack([np.sin(turned), np.cos(turned)], axis=1), axis=0)
    denied = np.isin(np.arange(300), [141, 151, 161, 171, 181])
    points[denied] += [2.0, -1.0]
    found = seam_doubt(points, time_s, np.full(300, STATED_M), 0.01, denied)
    assert not found.sigma_m.any()


def test_what_no_one_denied_a_vehicle_may_have_driven() -> None:
    aside = np.where(np.arange(200) < 100, 0.0, 3.0)
    assert not doubt_of(aside, np.zeros(200)).any()


def test_nothing_outlasts_a_leap_and_a_wrong_solution_may_have_grown() -> None:
    aside = np.where(np.arange(200) < 100, 0.0, 3.0)
    denied = denied_at(200, 100) > 0.0
    found = seam_doubt(*straight(aside), np.full(200, STATED_M), 0.01, denied)
    assert np.flatnonzero(found.lasting_s <= LEAP_S).tolist() == [99]
    assert found.lasting_s[0] == pytest.approx(2.0 * 100 * PERIOD_S, rel=0.02)
    assert found.sigma_m.max() == pytest.approx(3.0 / 2.0, abs=0.1)


@given(
    st.lists(st.tuples(st.integers(1, 60), st.floats(-50.0, 50.0)), min_size=1, max_size=12),
    st.integers(0, 2**32 - 1),
)
def test_any_leaps_give_a_finite_doubt_that_no_shift_changes(
    parts: list[tuple[int, float]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    aside = np.concatenate([np.full(count, off) for count, off in parts])
    denied = rng.random(len(aside)) < 0.2
    # Round numbers lie on a threshold to the last bit, where rounding decides what is a leap, and
    # a shift rounds otherwise. Measured positions do not.
    aside += rng.uniform(-1e-3, 1e-3, len(aside))
    points, time_s = straight(aside)
    stated = np.full(len(aside), STATED_M)
    found = seam_doubt(points, time_s, stated, 0.01, denied)
    assert np.isfinite(found.sigma_m).all()
    assert (found.sigma_m <= 2.0 * np.ptp(aside) + 10.0).all()
    assert (found.lasting_s > 0.0).all()
    moved = seam_doubt(points + np.array([1e5, -2e5]), time_s, stated, 0.01, denied)
    assert moved.sigma_m == pytest.approx(found.sigma_m, rel=1e-3, abs=1e-3)


def leaping(drive: Drive, leap_m: float, at_share: float) -> FixColumns:
    """RTK fixes that lie elsewhere from a share of the drive on."""
    fixes = fixes_of(drive, PERIOD_S, 0.01, quality=4, speed=True)
    off_m = leap_m * (np.arange(len(fixes)) >= at_share * len(fixes))
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    lat, lon, _ = DATUM.to_geodetic(east + 0.8 * off_m, north + 0.6 * off_m, up)
    return fixes.replace(lat_deg=lat, lon_deg=lon)


def inside(found: Estimate, drive: Drive) -> float:
    """The share of accepted positions that lie within three of their sigmas of the truth."""
    one = found.trajectory
    truth = drive.at((one.time_ns - one.time_ns[found.fix_row[0]]) / 1e9)
    off_m = np.hypot(one.east_m - truth.east_m, one.north_m - truth.north_m)
    return float(np.mean((off_m <= 3.44 * one.position_sigma_m)[one.accepted]))


@pytest.mark.parametrize("leap_m", [0.8, 3.0, 15.0])
@pytest.mark.parametrize("at_share", [0.2, 0.8])
def test_positions_say_what_a_leap_shows(leap_m: float, at_share: float) -> None:
    drive = simulate(ROWS)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    wide = PoseSettings(max_position_sigma_m=20.0)
    found = estimate_poses(leaping(drive, leap_m, at_share), Carrier(0.0), DATUM, wide, motion)
    assert found.trajectory.position_sigma_m.max() > leap_m / 4.0
    if found.trajectory.accepted.any():
        assert inside(found, drive) > 0.98
    assert any("solution leaps once" in note for note in found.report.notes)


def test_where_to_cut_a_drive_that_leaps_is_named() -> None:
    drive = simulate(ROWS)
    fixes = leaping(drive, 15.0, 0.2)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    found = estimate_poses(fixes, Carrier(0.0), DATUM, motion=motion)
    assert not found.trajectory.accepted.any()
    (note,) = (one for one in found.report.notes if "--until or --from" in one)
    moment = datetime.fromisoformat(note.partition("--from ")[2].rstrip("."))
    cut_ns = round(moment.timestamp() * 1000) * 10**6
    for inside, until_ns in ((fixes.time_ns < cut_ns, cut_ns), (fixes.time_ns >= cut_ns, 2**62)):
        part = motion.between(cut_ns if until_ns > cut_ns else 0, until_ns)
        alone = estimate_poses(fixes[inside], Carrier(0.0), DATUM, motion=part)
        assert alone.trajectory.accepted.mean() > 0.8


def test_a_drive_that_does_not_leap_is_as_sure_as_ever() -> None:
    drive = simulate(ROWS)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    found = estimate_poses(leaping(drive, 0.0, 0.5), Carrier(0.0), DATUM, motion=motion)
    assert found.trajectory.accepted.mean() > 0.98
    assert np.median(found.trajectory.position_sigma_m) < 0.05
    assert not any("leap" in note for note in found.report.notes)


def test_fixes_that_are_stamped_alike_are_no_leaps() -> None:
    """A log of whole seconds: the later ones of each are denied, since no vehicle jumps."""
    points_m, time_s = straight(np.zeros(150))
    same = np.arange(150) % 5 > 0
    found = seam_doubt(points_m, np.floor(time_s + 1e-9), np.full(150, STATED_M), 0.01, same)
    assert np.isfinite(found.sigma_m).all()
    assert found.sigma_m[~same].max() < 1.0
