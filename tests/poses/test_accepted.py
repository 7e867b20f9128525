"""What is taken of fixes that can be used."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.fused import conditioned
from tests.simulated import DATUM, SLALOM, fixes_of, simulate


@pytest.mark.parametrize("cut", [True, False])
def test_digits_that_a_log_cuts_off_are_an_error(cut: bool) -> None:
    """Minutes with four decimals, 0.19 m, of a receiver that states centimetres: cut off, all
    fixes lie half a step south and west."""
    drive = simulate(SLALOM, 20.0, speed_mps=1.5)
    fixes = fixes_of(drive, 0.2, 0.01, seed=3)
    step_deg = 1e-4 / 60.0
    whole = np.floor if cut else np.round
    coarse = fixes.replace(
        lat_deg=whole(fixes.lat_deg / step_deg) * step_deg,
        lon_deg=whole(fixes.lon_deg / step_deg) * step_deg,
    )
    stated_m = float(np.median(fixes.position_sigma_m()))
    log = conditioned(coarse, PoseSettings(), DATUM)
    assert log.accepted.sigma_m == pytest.approx(
        np.hypot(stated_m, 0.185 / np.sqrt(12.0)), rel=0.02
    )
    found = estimate_poses(coarse, None, DATUM).trajectory
    true_m = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)[:2]
    east, north = (np.interp(found.time_ns, fixes.time_ns, axis_m) for axis_m in true_m)
    off_m = np.hypot(found.east_m - east, found.north_m - north)[found.accepted]
    assert (off_m <= 3.0 * found.position_sigma_m[found.accepted]).mean() > 0.97
