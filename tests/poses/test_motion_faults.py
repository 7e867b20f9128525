"""Gyros that are stuck, spoilt or dead, wheels whose sign is turned round, and right ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.geometry import Gyro, LeverArm, Motion, WheelSpeed, wrap_deg
from fieldgrid.poses import Estimate, estimate_poses
from tests.scenes import paper_rig
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
    steps_of,
    time_ns,
)
from tests.told import codes

FIELD = simulate(
    [c for k in range(4) for c in (Command(25.0, 1.5), Command(9.0, 1.2, 0.3 * (-1) ** k))],
    40.0,
    speed_mps=1.5,
)


def estimated(drive: Drive, motion: Motion) -> Estimate:
    return estimate_poses(fixes_of(drive, 0.2, 0.01), None, DATUM, motion=motion)


def says(found: Estimate, what: str) -> bool:
    return any(what in note for note in found.report.notes)


def off_deg(found: Estimate, drive: Drive) -> Float64:
    """How far headings at the fixes are off where their poses are used, NaN elsewhere."""
    track, rows = found.trajectory, found.fix_row
    truth = drive.at((track.time_ns[rows] - track.time_ns[rows[0]]) / 1e9)
    off = np.abs(wrap_deg(track.heading_deg[rows] - np.degrees(truth.heading_rad)))
    return np.where(track.accepted[rows], off, np.nan)


def dead_from(share: float, rate_rad_s: float) -> Callable[[Gyro], Gyro]:
    def change(gyro: Gyro) -> Gyro:
        rate = gyro.rate_rad_s.copy()
        rate[int(share * len(rate)) :] = rate_rad_s
        return gyro._replace(rate_rad_s=rate)

    return change


def spoilt(gyro: Gyro) -> Gyro:
    """Three words are no rates, and for two seconds it says the same."""
    rate = gyro.rate_rad_s.copy()
    rate[[7, 1007, 2007]] = 50.0, -900.0, np.float64(np.finfo(np.float32).max)
    rate[3000:3100] = rate[3000]
    return gyro._replace(rate_rad_s=rate)


def in_degrees(gyro: Gyro) -> Gyro:
    return gyro._replace(rate_rad_s=np.degrees(gyro.rate_rad_s))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (dead_from(0.0, 0.0), "throughout while the path turns"),
        (dead_from(0.0, 0.1), "throughout while the path turns"),
        (dead_from(0.2, 0.0), "the same"),
        (dead_from(0.7, 0.0), "the same"),
        (spoilt, "3 turn faster than 360°/s and 100 repeat"),
        (in_degrees, "which no vehicle does"),
    ],
)
def test_what_a_gyro_cannot_mean_is_left_out(change: Callable[[Gyro], Gyro], told: str) -> None:
    found = estimated(FIELD, Motion(gyro=change(gyro_of(FIELD, noise_dps=0.1))))
    assert says(found, told)
    off = off_deg(found, FIELD)
    assert np.isfinite(off).mean() > 0.95
    assert np.nanquantile(off, 0.95) < 3.0


@pytest.mark.parametrize("commands", [CIRCLE, SLALOM * 2, K_TURN, STOP, [Command(60.0, 1.5)]])
@pytest.mark.parametrize("digits", [6, 3])
def test_a_gyro_without_noise_or_with_few_digits_is_right(
    commands: list[Command], digits: int
) -> None:
    drive = simulate(commands, 70.0, speed_mps=1.5)
    gyro = gyro_of(drive)
    found = estimated(drive, Motion(gyro=gyro._replace(rate_rad_s=gyro.rate_rad_s.round(digits))))
    assert not says(found, "gyro")
    assert np.nanmax(off_deg(found, drive)) < 2.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_camera_tells_which_way_a_gyro_turns(sense: float, seed: int) -> None:
    drive = simulate(K_TURN, 35.0 + 50.0 * seed)
    right = gyro_of(drive, bias_dps=0.4, noise_dps=0.05, seed=seed)
    gyro = right._replace(rate_rad_s=sense * right.rate_rad_s)
    found = estimated(drive, Motion(gyro=gyro, steps=steps_of(drive, noise=1.0)))
    assert says(found, "turns the other way") is (sense < 0.0)
    assert not says(found, "mirrored")
    # Without it the path may be the one that is wrong.
    assert says(estimated(drive, Motion(gyro=gyro)), "mirrored") is (sense < 0.0)


def wheels_of(drive: Drive, sign: float) -> WheelSpeed:
    return WheelSpeed(time_ns(drive.time_s)[::10], sign * drive.speed_mps[::10])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_camera_tells_the_sense_of_wheels(sign: float) -> None:
    drive = simulate([*K_TURN, *SLALOM], 30.0, speed_mps=1.5)
    steps = steps_of(drive, 1.0, noise=1.0, seed=2)
    found = estimated(drive, Motion(steps=steps, wheels=wheels_of(drive, sign)))
    assert says(found, "other way than the camera") is (sign < 0.0)
    track = found.trajectory
    true = np.interp(track.time_ns, time_ns(drive.time_s), drive.gear())
    moving = track.accepted & (np.abs(true) == 1.0)
    assert (np.sign(track.speed_mps[moving]) == true[moving]).mean() > 0.97
    alone = estimated(drive, Motion(wheels=wheels_of(drive, sign)))
    assert says(alone, "By its wheels the vehicle backs up") is (sign < 0.0)
    assert says(alone, "If that is wrong") is (sign < 0.0)


@pytest.mark.parametrize(("sign", "backs_up"), [(1.0, False), (-1.0, False), (1.0, True)])
def test_a_gyro_and_an_antenna_ahead_of_the_axle_tell_the_sense_of_wheels(
    sign: float, backs_up: bool
) -> None:
    """Also of a vehicle that really backs up."""
    gear = -1.0 if backs_up else 1.0
    commands = [one._replace(speed_mps=gear * one.speed_mps) for one in (*SLALOM, *SLALOM)]
    drive = simulate(commands, 30.0, speed_mps=1.5 * gear)
    antenna = LeverArm(0.0, 0.8, 2.0)
    rig = paper_rig(antenna=antenna, rear_axle_forward_m=0.0)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05), wheels=wheels_of(drive, sign))
    fixes = fixes_of(drive, noise_m=0.01, antenna=antenna)
    found = estimate_poses(fixes, rig, DATUM, motion=motion)
    assert np.nanmax(off_deg(found, drive)) < 5.0
    assert codes(found.report) == (["wheels-turned"] if sign < 0.0 and not backs_up else [])
