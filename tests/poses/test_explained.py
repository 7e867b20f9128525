"""A gyro that contradicts what was declared: by the stamps of the fixes, or the antenna's place."""

from __future__ import annotations

import re

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, Datum, Gyro, LeverArm, Motion, VehicleGeometry
from fieldgrid.poses import Estimate, estimate_poses
from tests.scenes import paper_rig
from tests.simulated import SLALOM, Command, Drive, fixes_of, gyro_of, simulate

DATUM = Datum(39.5, -1.1, 700.0)
ROWS = [
    *(Command(20.0, 1.5), Command(6.3, 1.0, 0.5), Command(20.0, 1.2), Command(6.3, 0.8, -0.5)),
    *(Command(20.0, 1.6), Command(3.0, 0.0), Command(6.3, 1.0, 0.5), Command(20.0, 1.5)),
]
RIG = paper_rig(antenna=LeverArm(0.0, 0.0, 3.0), rear_axle_forward_m=0.0)
STAMPED = re.compile(r"stamped (\S+) s ± (\S+) s (late|early) against the gyro")
PLACED = re.compile(r"sits (\S+) m ± (\S+) m farther (ahead|back) than")


def estimate(
    drive: Drive,
    *,
    late_s: float = 0.0,
    ahead_m: float = 0.0,
    vehicle: VehicleGeometry = RIG,
) -> Estimate:
    """The antenna is declared above the axle, and sits `ahead_m` of it."""
    fixes = fixes_of(drive, 0.2, 0.01, antenna=LeverArm(0.0, ahead_m, 3.0))
    gyro = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    late = Gyro(gyro.time_ns - round(late_s * 1e9), gyro.rate_rad_s)
    return estimate_poses(fixes, vehicle, DATUM, motion=Motion(gyro=late))


def told(found: Estimate, kind: re.Pattern[str]) -> list[float]:
    """Signed values of such notes: late and ahead are positive."""
    seen = [kind.search(note) for note in found.report.notes]
    return [float(one[1]) * (1.0 if one[3] in ("late", "ahead") else -1.0) for one in seen if one]


@pytest.mark.parametrize("commands", [ROWS, SLALOM])
@pytest.mark.parametrize("late_s", [0.4, 1.0, -1.0, 2.0])
def test_stamps_that_are_off_are_no_antenna(commands: list[Command], late_s: float) -> None:
    found = estimate(simulate(commands, 35.0), late_s=late_s)
    assert told(found, STAMPED) == [pytest.approx(late_s, abs=0.1)]
    assert told(found, PLACED) == []
    (note,) = (note for note in found.report.notes if STAMPED.search(note))
    offset = re.search(r"add (\S+) to --gnss-offset", note)
    assert offset is not None
    assert float(offset[1]) == pytest.approx(-late_s, abs=0.1)


@pytest.mark.parametrize("commands", [ROWS, SLALOM])
@pytest.mark.parametrize("ahead_m", [0.8, -0.8, 2.0])
def test_an_antenna_elsewhere_is_no_matter_of_stamps(
    commands: list[Command], ahead_m: float
) -> None:
    found = estimate(simulate(commands, 35.0), ahead_m=ahead_m)
    assert told(found, STAMPED) == []
    assert told(found, PLACED) == [pytest.approx(ahead_m, abs=0.15)]
    assert np.median(found.trajectory.position_sigma_m) == pytest.approx(
        abs(ahead_m) / np.sqrt(2.0), rel=0.15
    )


def test_positions_are_as_unsure_as_what_is_driven_in_the_delay() -> None:
    drive = simulate(ROWS, 35.0)
    found = estimate(drive, late_s=1.0)
    trajectory = found.trajectory
    start_ns = trajectory.time_ns[found.fix_row[0]]
    truth = drive.at((trajectory.time_ns - start_ns) / 1e9 + 1.0)  # by the gyro's clock
    off_m = np.hypot(trajectory.east_m - truth.east_m, trajectory.north_m - truth.north_m)
    used = trajectory.accepted
    assert np.median(off_m[used]) > 0.8
    assert np.mean(off_m[used] < 3.44 * trajectory.position_sigma_m[used]) > 0.98


def test_in_one_bend_at_an_even_speed_either_may_be_wrong() -> None:
    drive = simulate([Command(10.0, 1.0), Command(10.0, 1.0, 0.15), Command(10.0, 1.0)], 10.0)
    gyro = gyro_of(drive, noise_dps=0.05)
    late = Gyro(gyro.time_ns - round(0.8e9), gyro.rate_rad_s)
    found = estimate_poses(fixes_of(drive, 0.2, 0.03), RIG, DATUM, motion=Motion(gyro=late))
    (note,) = (one for one in found.report.notes if "each would explain it" in one)
    told = re.search(r"(\S+) m farther back .* stamped (\S+) s late .* add (\S+) to --gnss", note)
    assert told is not None
    assert [float(one) for one in told.groups()] == pytest.approx([0.8, 0.8, -0.8], abs=0.1)
    assert np.median(found.trajectory.position_sigma_m) > 0.5


def test_what_does_not_fit_is_named_and_nothing_else() -> None:
    """Without a camera none is named."""
    found = estimate(simulate(ROWS, 35.0), late_s=-1.0, ahead_m=1.0, vehicle=Carrier(0.0))
    (note,) = (one for one in found.report.notes if "not fit together" in one)
    assert note.startswith("Fixes, antenna and gyro do not fit together by")
