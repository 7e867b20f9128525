"""Fixes and camera show which way a gyro turns, or the drive says that they do not."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.gyro.sense import CLEAR_NATS, gyro_sense
from fieldgrid.poses.fused import conditioned
from tests.simulated import (
    DATUM,
    K_TURN,
    SLALOM,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
    steps_of,
)

BACKS = [Command(12.0, 1.5), Command(8.0, -1.0, 0.15), Command(10.0, 1.2, 0.1)]


def accepted(drive: Drive, period_s: float, noise_m: float, *, holes: bool) -> AcceptedFixes:
    fixes = fixes_of(drive, period_s, noise_m)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    some = fixes[late_s % 10.0 < 5.0] if holes else fixes
    settings = PoseSettings(quality=4, accuracy_m=5.0 * noise_m)
    return conditioned(some, settings, DATUM).accepted


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize(("period_s", "noise_m"), [(0.1, 0.01), (1.0, 0.01), (0.2, 0.3)])
@pytest.mark.parametrize("commands", [SLALOM, BACKS])
def test_lines_tell_the_sense_in_either_gear(
    commands: list[Command], period_s: float, noise_m: float, holes: bool
) -> None:
    drive = simulate(commands, 35.0)
    fixes = accepted(drive, period_s, noise_m, holes=holes)
    right = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    upside_down = right._replace(rate_rad_s=-right.rate_rad_s)
    for gyro, wrong in ((right, False), (upside_down, True)):
        found = gyro_sense(fixes, None, gyro)
        assert found.turns
        assert not found.is_unknown
        assert found.is_wrong == wrong


@pytest.mark.parametrize("seed", range(4))
def test_where_turns_lie_in_holes_nothing_wrong_is_said(seed: int) -> None:
    """A K-turn ends in the line in which it began."""
    drive = simulate(K_TURN, 35.0 + 50.0 * seed)
    right = gyro_of(drive, bias_dps=0.4, noise_dps=0.05, seed=seed)
    fixes = accepted(drive, 0.2, 0.3, holes=True)
    found = gyro_sense(fixes, None, right)
    turned = gyro_sense(fixes, None, right._replace(rate_rad_s=-right.rate_rad_s))
    assert not found.is_wrong
    assert turned.is_unknown or turned.is_wrong
    assert found.is_unknown or seed > 0


def test_straight_on_the_sense_does_not_matter() -> None:
    drive = simulate([Command(60.0, 1.5)], 35.0)
    gyro = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    found = gyro_sense(accepted(drive, 0.2, 0.01, holes=False), None, gyro)
    assert abs(found.nats) < CLEAR_NATS
    assert not found.turns
    assert not found.is_unknown


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_camera_tells_the_sense(sense: float) -> None:
    drive = simulate(K_TURN, 35.0)
    right = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    gyro = right._replace(rate_rad_s=sense * right.rate_rad_s)
    fixes = accepted(drive, 0.2, 0.3, holes=True)
    found = gyro_sense(fixes, steps_of(drive, noise=1.0), gyro)
    assert not found.is_unknown
    assert found.is_wrong == (sense < 0.0)


def test_across_a_hole_of_the_gyro_nothing_is_compared() -> None:
    drive = simulate(SLALOM, 35.0)
    whole = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    late_s = (whole.time_ns - whole.time_ns[0]) / 1e9
    seen = late_s % 8.0 < 4.5
    gyro = whole._replace(time_ns=whole.time_ns[seen], rate_rad_s=whole.rate_rad_s[seen])
    found = gyro_sense(accepted(drive, 0.2, 0.01, holes=False), None, gyro)
    assert np.isfinite(found.nats)
    assert not found.is_wrong
