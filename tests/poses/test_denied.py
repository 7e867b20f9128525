"""What a drive denies of its antenna and stamps is told, and its positions are as unsure."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.core import Quality
from fieldgrid.geometry import Carrier, Datum, Gyro, LeverArm, Motion, VehicleGeometry
from fieldgrid.poses import Estimate, estimate_poses
from tests.scenes import paper_rig
from tests.simulated import K_TURN, SLALOM, Command, Drive, fixes_of, gyro_of, simulate, steps_of
from tests.told import codes

DATUM = Datum(39.5, -1.1, 700.0)
ROWS = [
    *(Command(20.0, 1.5), Command(6.3, 1.0, 0.5), Command(20.0, 1.5), Command(6.3, 1.0, -0.5)),
    Command(20.0, 1.5),
]
RTK_M = 0.01


def estimate(
    drive: Drive, vehicle: VehicleGeometry, late_s: float = 0.0, ahead_m: float = 0.0
) -> Estimate:
    """With an antenna that sits farther ahead, and fixes that are stamped late."""
    fixes = fixes_of(drive, 0.2, RTK_M, antenna=LeverArm(0.0, ahead_m, 3.0))
    gyro = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    late = Gyro(gyro.time_ns - round(late_s * 1e9), gyro.rate_rad_s)
    return estimate_poses(fixes, vehicle, DATUM, motion=Motion(gyro=late))


def rig() -> VehicleGeometry:
    return paper_rig(antenna=LeverArm(0.0, 0.0, 3.0), rear_axle_forward_m=0.0)


def sigmas_m(found: Estimate) -> tuple[float, float]:
    """The median and the largest."""
    sigma_m = found.trajectory.position_sigma_m[found.trajectory.accepted]
    return float(np.median(sigma_m)), float(sigma_m.max())


@pytest.mark.parametrize("commands", [SLALOM, K_TURN, ROWS])
def test_what_is_declared_rightly_is_not_denied(commands: list[Command]) -> None:
    found = estimate(simulate(commands, 35.0), rig())
    assert codes(found.report) == []
    assert sigmas_m(found)[1] < 0.1


def test_positions_are_as_unsure_as_a_denied_antenna_is_off() -> None:
    found = estimate(simulate(ROWS, 35.0), rig(), ahead_m=1.5)
    assert any("farther ahead than mounting.json says" in note for note in found.report.notes)
    assert sigmas_m(found)[0] == pytest.approx(1.5 / np.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize("commands", [ROWS, K_TURN])
@pytest.mark.parametrize("ahead_m", [0.5, -0.9, 1.5])
def test_recorded_headings_tell_all_of_how_far_ahead_an_antenna_sits(
    commands: list[Command], ahead_m: float
) -> None:
    """Those that a wrong place contradicts most have little weight: it is found step by step."""
    drive = simulate(commands, 35.0)
    antenna = LeverArm(0.0, ahead_m, 3.0)
    fixes = fixes_of(drive, 0.2, RTK_M, antenna=antenna, heading_sigma_deg=0.5)
    found = estimate_poses(fixes, rig(), DATUM)
    (note,) = (note for note in found.report.notes if "than mounting.json says" in note)
    told = re.search(r"sits (.*) m ± (.*) m farther (ahead|back)", note)
    assert told is not None
    sign = 1.0 if told[3] == "ahead" else -1.0
    assert abs(sign * float(told[1]) - ahead_m) < 3.0 * float(told[2]) + 0.01
    assert float(told[2]) < 0.1
    assert sigmas_m(found)[0] == pytest.approx(abs(ahead_m) / np.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize("commands", [SLALOM, K_TURN, ROWS])
def test_recorded_headings_do_not_deny_what_is_declared_rightly(commands: list[Command]) -> None:
    fixes = fixes_of(simulate(commands, 35.0), 0.2, RTK_M, heading_sigma_deg=0.5)
    found = estimate_poses(fixes, rig(), DATUM)
    assert codes(found.report) == []
    assert sigmas_m(found)[1] < 0.1


def test_no_mean_makes_float_positions_surer_than_stated() -> None:
    drive, least = simulate(ROWS, 35.0), []
    for quality in (Quality.RTK_FIXED, Quality.RTK_FLOAT):
        fixes = fixes_of(drive, 0.2, 0.02, quality=quality)
        fixes = replace(fixes, sigma_m=np.full(len(fixes), 0.3))
        found = estimate_poses(fixes, rig(), DATUM, motion=Motion(gyro=gyro_of(drive)))
        assert found.trajectory.position_sigma_m.max() < 0.4
        least.append(found.trajectory.position_sigma_m.min())
    assert least[0] < least[1]
    assert least[1] >= 0.3


def test_positions_are_as_unsure_as_a_denied_delay_is_long() -> None:
    drive = simulate(ROWS, 35.0)
    found = estimate(drive, rig(), late_s=0.3)
    assert any("stamp" in note for note in found.report.notes)
    trajectory = found.trajectory
    start_ns = trajectory.time_ns[found.fix_row[0]]
    # In the clock of the gyro, which is that of images, the vehicle was there earlier.
    truth = drive.at((trajectory.time_ns - start_ns) / 1e9 - 0.3)
    used = trajectory.accepted
    off_m = np.hypot(trajectory.east_m - truth.east_m, trajectory.north_m - truth.north_m)[used]
    assert np.median(off_m) > 0.2
    assert np.mean(off_m < 3.44 * trajectory.position_sigma_m[used]) > 0.98


def test_what_is_denied_has_a_figure_for_programs() -> None:
    """Late stamps and places to the right are positive, and nothing is rounded."""
    late = estimate(simulate(ROWS, 35.0), rig(), late_s=0.3)
    (delay,) = (one for one in late.report.findings if one.code == "fixes-stamped")
    assert delay.figure is not None
    assert delay.figure.value == pytest.approx(0.3, abs=0.05)
    assert f"stamped {delay.figure.value:.2f} s ±" in delay.message
    drive = simulate(ROWS, 35.0)
    fixes = fixes_of(drive, 0.2, RTK_M, antenna=LeverArm(-0.6, 0.0, 3.0))
    found = estimate_poses(fixes, rig(), DATUM, motion=Motion(steps=steps_of(drive)))
    (place,) = (one for one in found.report.findings if one.code == "antenna-place")
    told = place.as_dict()
    assert json.loads(json.dumps(told)) == told
    assert told["figure"] == {"value": pytest.approx(-0.6, abs=0.05), "unit": "m"}
    assert f"{-told['figure']['value']:.2f} m ±" in place.message
    (unseen,) = (one for one in late.report.findings if one.code == "unseen")
    assert unseen.as_dict()["figure"] is None


@pytest.mark.parametrize(
    ("late_s", "ahead_m", "code"),
    [(0.5, 0.0, "fixes-stamped"), (1.0, 0.0, "fixes-stamped"), (0.0, 0.8, "antenna-place")],
)
def test_what_is_denied_is_no_drift(late_s: float, ahead_m: float, code: str) -> None:
    """Fixes wander beside a drive with the wrong stamps or place by more than they state."""
    found = estimate(simulate(ROWS, 35.0), rig(), late_s=late_s, ahead_m=ahead_m)
    assert codes(found.report) == [code]


def test_a_log_alone_knows_only_its_antenna() -> None:
    """Where the antenna sits moves none of its positions."""
    found = estimate(simulate(ROWS, 35.0), Carrier(0.0), ahead_m=1.5)
    assert sigmas_m(found)[0] < 0.1


@pytest.mark.parametrize(("share", "sigma_m"), [(1.0, (0.8, 1.5)), (1.0 / 3.0, (0.0, 0.18))])
def test_a_camera_that_saw_little_denies_nothing(
    share: float, sigma_m: tuple[float, float]
) -> None:
    """One that saw all takes an antenna 1.5 m ahead for images that are stamped wrongly, by what is
    driven in 1.2 m; of a third it would be one 0.24 m aside."""
    drive = simulate(ROWS, 35.0)
    fixes = fixes_of(drive, 0.2, RTK_M, antenna=LeverArm(0.0, 1.5, 3.0))
    steps = steps_of(drive)
    seen = round(share * len(steps.start_ns))
    some = steps._replace(**{name: column[:seen] for name, column in steps._asdict().items()})
    found = estimate_poses(fixes, rig(), DATUM, motion=Motion(steps=some))
    assert bool(codes(found.report)) is (share == 1.0)
    assert sigma_m[0] < sigmas_m(found)[0] < sigma_m[1]


@pytest.mark.parametrize("share", [0.2, 0.3, 0.4, 0.45])
def test_a_gyro_that_ended_early_denies_nothing(share: float) -> None:
    drive = simulate(ROWS, 35.0)
    fixes = fixes_of(drive, 0.2, RTK_M, antenna=LeverArm(0.0, 1.5, 3.0))
    gyro = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    seen = round(share * len(gyro.time_ns))
    early = Gyro(gyro.time_ns[:seen], gyro.rate_rad_s[:seen])
    found = estimate_poses(fixes, rig(), DATUM, motion=Motion(gyro=early))
    assert not any("than mounting.json says" in note for note in found.report.notes)
    assert sigmas_m(found)[0] < 0.1
