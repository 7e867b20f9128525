"""A gyro that does not turn as the path does, because antenna or stamps are not where they are
declared."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, Datum, Gyro, LeverArm, Motion, VehicleGeometry, wrap_deg
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.poses.faults import excused
from fieldgrid.poses.faults.explained import Explanation, explanation
from fieldgrid.poses.fused import Fusion
from tests.scenes import paper_rig
from tests.simulated import Command, Drive, fixes_of, gyro_of, simulate, time_ns
from tests.told import codes

DATUM = Datum(39.5, -1.1, 700.0)
TIGHT = [
    *(Command(12.0, 1.0), Command(4.2, 0.8, 0.9), Command(12.0, 1.0), Command(4.2, 0.8, -0.9)),
    *(Command(12.0, 1.2), Command(3.0, 0.0), Command(4.2, 0.7, 0.9), Command(12.0, 1.0)),
]
"""Rows of a robot that turns about a point 1.1 m beside it."""

SNAKE = [Command(3.0, 1.0, 0.6), Command(3.0, 1.0, -0.6)] * 6

RIG = paper_rig(antenna=LeverArm(0.0, 0.0, 3.0), rear_axle_forward_m=0.0)
STAMPED = re.compile(r"stamped (\S+) s ± (\S+) s (late|early) against the gyro")
PLACED = re.compile(r"sits (\S+) m ± (\S+) m farther (ahead|back) than")
UNUSED = "The gyro fits the drive only once that is corrected, so it was not used"
WRONG = "check imu_axes"


def estimate(
    drive: Drive,
    *,
    late_s: float = 0.0,
    ahead_m: float = 0.0,
    size: float = 1.0,
    gyro_s: float = 0.0,
    vehicle: VehicleGeometry = RIG,
) -> Estimate:
    """The antenna is declared above the axle and sits `ahead_m` of it, its fixes are stamped late;
    the gyro's rates have a size and are of another time. Without excuse it is left out."""
    fixes = fixes_of(drive, 0.2, 0.01, antenna=LeverArm(0.0, ahead_m, 3.0))
    fixes = fixes.replace(time_ns=fixes.time_ns + round(late_s * 1e9))
    gyro = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    motion = Motion(gyro=Gyro(gyro.time_ns + round(gyro_s * 1e9), size * gyro.rate_rad_s))
    return estimate_poses(fixes, vehicle, DATUM, motion=motion)


def told(found: Estimate, kind: re.Pattern[str]) -> list[float]:
    """Signed values of such notes: late and ahead are positive."""
    seen = [kind.search(note) for note in found.report.notes]
    return [float(one[1]) * (1.0 if one[3] in ("late", "ahead") else -1.0) for one in seen if one]


def within(found: Estimate, drive: Drive) -> tuple[float, float]:
    """The shares of accepted positions and headings within three sigmas, by the gyro's clock."""
    track = found.trajectory
    at_s = (track.time_ns - time_ns(np.zeros(1))[0]) / 1e9
    use = track.accepted & (at_s >= 0.0) & (at_s <= drive.time_s[-1])
    truth = drive.at(at_s[use])
    off_m = np.hypot(track.east_m[use] - truth.east_m, track.north_m[use] - truth.north_m)
    off_deg = np.abs(wrap_deg(track.heading_deg[use] - np.degrees(truth.heading_rad)))
    assert len(off_m)
    return (
        float(np.mean(off_m < 3.44 * track.position_sigma_m[use])),
        float(np.mean(off_deg < 3.0 * track.heading_sigma_deg[use])),
    )


@pytest.mark.parametrize("ahead_m", [-2.2, -1.5, 1.5, 2.2])
def test_an_antenna_that_swings_out_of_the_turns_is_told(ahead_m: float) -> None:
    drive = simulate(TIGHT, 35.0)
    found = estimate(drive, ahead_m=ahead_m)
    assert told(found, PLACED) == [pytest.approx(ahead_m, abs=0.1)]
    assert told(found, STAMPED) == []
    assert not any(WRONG in note for note in found.report.notes)
    assert sum(note.startswith(UNUSED) for note in found.report.notes) == 1
    assert within(found, drive) == (1.0, 1.0)
    assert found.trajectory.accepted.mean() > 0.3


@pytest.mark.parametrize("late_s", [-2.5, -1.5, 1.0, 2.5])
def test_stamps_that_shift_turns_to_where_there_are_none_are_told(late_s: float) -> None:
    drive = simulate(TIGHT, 35.0)
    found = estimate(drive, late_s=late_s)
    assert told(found, STAMPED) == [pytest.approx(late_s, abs=0.1)]
    assert told(found, PLACED) == []
    assert not any(WRONG in note for note in found.report.notes)
    assert min(within(found, drive)) > 0.98


@pytest.mark.parametrize(("size", "gyro_s"), [(-1.0, 0.0), (0.4, 0.0), (1.0, 20.0)])
def test_nothing_excuses_a_gyro_that_is_wrong(size: float, gyro_s: float) -> None:
    """It is upside down, of a wrong unit, of another time."""
    drive = simulate(TIGHT, 35.0)
    found = estimate(drive, size=size, gyro_s=gyro_s)
    assert codes(found.report) == ["gyro-unused"]
    assert within(found, drive) == (1.0, 1.0)
    assert found.trajectory.accepted.mean() > 0.8


@pytest.mark.parametrize(("late_s", "ahead_m"), [(0.0, -1.5)])
def test_of_a_long_drive_a_part_tells_whether_to_go_on(
    late_s: float, ahead_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up to 50 estimates of all of it would take most of a minute for 42 minutes of driving."""
    drive = simulate(TIGHT * 6, 35.0)
    sizes: list[int] = []

    def sized(found: Fusion, *how: Any) -> Explanation | None:
        sizes.append(len(found.drive.time_ns))
        return explanation(found, *how)

    monkeypatch.setattr(excused, "MOST_NODES", 500)
    monkeypatch.setattr(excused, "explanation", sized)
    found = estimate(drive, late_s=late_s, ahead_m=ahead_m)
    kind, size = (STAMPED, late_s) if late_s else (PLACED, ahead_m)
    assert told(found, kind) == [pytest.approx(size, abs=0.1)]
    assert min(within(found, drive)) > 0.98
    assert len(found.trajectory) > 1500
    assert max(sizes[:-1]) <= 510
    assert sizes[-1] > 1500


def test_of_a_log_alone_headings_are_as_unsure_and_the_gyro_stays_named() -> None:
    """Its positions are those of the antenna, wherever that sits."""
    drive = simulate(TIGHT, 35.0)
    found = estimate(drive, ahead_m=-2.2, vehicle=Carrier(0.0))
    assert codes(found.report) == ["gyro-unused"]
    (note,) = (str(one) for one in found.report.findings if one.code == "gyro-unused")
    assert "how far the antenna sits ahead of the axle" in note
    assert within(found, drive)[1] == 1.0
    assert np.median(found.trajectory.position_sigma_m) < 0.1
