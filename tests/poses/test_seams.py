"""A solution that leaps and says nothing of it: how far it may be off, from both sides."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Carrier, FixColumns, Motion
from fieldgrid.poses import Estimate, estimate_poses
from tests.simulated import DATUM, K_TURN, Command, Drive, fixes_of, gyro_of, simulate

PERIOD_S = 0.2
ROWS = [Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2)]


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


def test_what_lasted_longer_is_rather_right() -> None:
    """Right with the probability of their shares, 4 to 1."""
    drive = simulate(ROWS)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    wide = PoseSettings(max_position_sigma_m=20.0)
    found = estimate_poses(leaping(drive, 3.0, 0.8), Carrier(0.0), DATUM, wide, motion)
    sigma_m = found.trajectory.position_sigma_m[found.fix_row]
    assert sigma_m[0] == pytest.approx(np.sqrt(0.2 * 9.0 / 2.0), rel=0.3)
    assert sigma_m[-1] == pytest.approx(np.sqrt(0.8 * 9.0 / 2.0), rel=0.3)
