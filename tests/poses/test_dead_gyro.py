"""A gyro that says the same while the path turns is left out; one without noise is not."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Float64, PoseSettings
from fieldgrid.geometry import Gyro, Inertial, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.faults.gyro.dead_gyro import without_dead_gyro
from fieldgrid.poses.fused import conditioned
from tests.simulated import (
    CIRCLE,
    DATUM,
    K_TURN,
    SLALOM,
    STOP,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
)

FIELD = simulate(
    [c for k in range(4) for c in (Command(25.0, 1.5), Command(9.0, 1.2, 0.3 * (-1) ** k))],
    40.0,
    speed_mps=1.5,
)


def judged(drive: Drive, gyro: Gyro, inertial: Inertial | None = None) -> tuple[Motion, str | None]:
    fixes = conditioned(fixes_of(drive, 0.2, 0.01), PoseSettings(), DATUM).accepted
    return without_dead_gyro(fixes, Motion(gyro=gyro, inertial=inertial))


def stuck_from(first: float, gyro: Gyro, rate_rad_s: float) -> Gyro:
    rate = gyro.rate_rad_s.copy()
    rate[int(first * len(rate)) :] = rate_rad_s
    return gyro._replace(rate_rad_s=rate)


@pytest.mark.parametrize("rate_rad_s", [0.0, 0.1])
def test_a_gyro_that_never_says_anything_else_is_not_used(rate_rad_s: float) -> None:
    gyro = stuck_from(0.0, gyro_of(FIELD), rate_rad_s)
    found, note = judged(FIELD, gyro)
    assert found.gyro is None
    assert note is not None
    assert f"says {np.degrees(rate_rad_s):.3g}°/s throughout while the path turns" in note


@pytest.mark.parametrize("first", [0.2, 0.5, 0.7])
def test_of_a_gyro_that_dies_the_rest_is_left_out(first: float) -> None:
    gyro = stuck_from(first, gyro_of(FIELD, noise_dps=0.1), 0.0)
    rates = np.zeros((len(gyro.time_ns), 3), np.float32)
    found, note = judged(FIELD, gyro, Inertial(gyro.time_ns, rates, rates + np.float32(1.0)))
    assert found.gyro is not None
    assert found.inertial is not None
    assert len(found.gyro.time_ns) == len(found.inertial.time_ns) == int(first * len(gyro.time_ns))
    assert note is not None
    assert "says the same for" in note


@pytest.mark.parametrize("commands", [CIRCLE, SLALOM * 2, K_TURN, STOP, [Command(60.0, 1.5)]])
def test_a_gyro_without_noise_is_left_as_it_is(commands: list[Command]) -> None:
    drive = simulate(commands, 70.0, speed_mps=1.5)
    given = gyro_of(drive)
    found, note = judged(drive, given)
    assert found.gyro is given
    assert note is None


def test_a_gyro_that_says_the_same_all_round_a_circle_is_left_as_it_is() -> None:
    drive = simulate(CIRCLE, 70.0, speed_mps=1.5)
    given = gyro_of(drive)
    given = given._replace(rate_rad_s=np.round(given.rate_rad_s, 6))
    assert np.count_nonzero(given.rate_rad_s == np.median(given.rate_rad_s)) > 1500
    found, note = judged(drive, given)
    assert found.gyro is given
    assert note is None


def _errors(drive: Drive, gyro: Gyro) -> tuple[Float64, float]:
    fixes = fixes_of(drive, 0.2, 0.01)
    estimate = estimate_poses(fixes, None, DATUM, motion=Motion(gyro=gyro))
    track, rows = estimate.trajectory, estimate.fix_row
    truth = drive.at((fixes.time_ns - fixes.time_ns[0]) / 1e9)
    off = np.abs(wrap_deg(track.heading_deg[rows] - np.degrees(truth.heading_rad)))
    used = track.accepted[rows]
    return off[used], float(used.mean())


@pytest.mark.parametrize("first", [0.0, 0.5])
def test_a_drive_with_a_dead_gyro_is_as_good_as_without(first: float) -> None:
    off, used = _errors(FIELD, stuck_from(first, gyro_of(FIELD, noise_dps=0.1), 0.0))
    assert used > 0.98
    assert np.quantile(off, 0.95) < 1.5
