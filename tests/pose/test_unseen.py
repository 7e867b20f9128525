"""What a drive would not show is named, and no receiver is surer than its kind can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.fixes import FixColumns
from fieldgrid.motion import Motion, WheelSpeed
from fieldgrid.pose import Estimate, UnseenFault, estimate_poses, unseen_sentence
from fieldgrid.quality import Quality
from fieldgrid.rig import Carrier, LeverArm, VehicleGeometry
from fieldgrid.settings import PoseSettings
from tests.scenes import paper_rig
from tests.simulated import DATUM, SLALOM, Command, fixes_of, gyro_of, simulate, steps_of, time_ns

ASIDE, AHEAD, LATE, DRIFT = UnseenFault
DRIVE = simulate(
    [Command(20.0, 1.5), Command(6.3, 1.0, 0.5), Command(20.0, 1.5), Command(6.3, 1.0, -0.5)], 35.0
)
RIG = paper_rig(antenna=LeverArm(0.0, 0.0, 3.0), rear_axle_forward_m=0.0)


def motion(sensors: str) -> Motion:
    at = DRIVE.every(0.1)
    return Motion(
        gyro=gyro_of(DRIVE, noise_dps=0.05) if "gyro" in sensors else None,
        steps=steps_of(DRIVE) if "camera" in sensors else None,
        wheels=WheelSpeed(time_ns(at.time_s), at.speed_mps) if "wheels" in sensors else None,
    )


@pytest.mark.parametrize(
    ("sensors", "vehicle", "unseen"),
    [
        ("", RIG, (ASIDE, AHEAD, LATE, DRIFT)),
        ("", Carrier(0.0), (DRIFT,)),
        ("", paper_rig(antenna=LeverArm(0.0, 0.0, 3.0)), (ASIDE, LATE, DRIFT)),
        ("heading", RIG, (ASIDE, LATE, DRIFT)),
        ("heading, wheels", RIG, (LATE, DRIFT)),
        ("gyro", RIG, (ASIDE, DRIFT)),
        ("gyro, wheels", RIG, (DRIFT,)),
        ("camera", RIG, ()),
    ],
)
def test_what_the_sensors_of_a_drive_would_not_show_is_named(
    sensors: str, vehicle: VehicleGeometry, unseen: tuple[UnseenFault, ...]
) -> None:
    recorded_deg = 0.5 if "heading" in sensors else None
    fixes = fixes_of(DRIVE, 0.2, 0.01, heading_sigma_deg=recorded_deg)
    found = estimate_poses(fixes, vehicle, DATUM, motion=motion(sensors))
    assert found.report.unseen == unseen
    assert found.report.as_dict()["unseen"] == [str(fault) for fault in unseen]


def test_a_drive_that_never_turns_shows_no_antenna() -> None:
    straight = simulate([Command(30.0, 1.5)], 35.0)
    moved = Motion(gyro=gyro_of(straight, noise_dps=0.05))
    found = estimate_poses(fixes_of(straight, 0.2, 0.01), RIG, DATUM, motion=moved)
    assert found.report.unseen == (ASIDE, AHEAD, LATE, DRIFT)


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ((DRIFT,), "not show a receiver that drifts slowly by more than it states; no"),
        ((ASIDE, LATE, DRIFT), "than declared, fixes that are stamped late or a receiver that"),
    ],
)
def test_a_sentence_names_them(faults: tuple[UnseenFault, ...], words: str) -> None:
    assert words in unseen_sentence(faults)


# --- how sure a receiver can be

SLALOMS = simulate(SLALOM, 35.0)


def stating(sigma_m: float, quality: Quality, accuracy_m: float | None = None) -> Estimate:
    fixes: FixColumns = fixes_of(SLALOMS, 0.2, 0.01, quality=quality)
    fixes = replace(fixes, sigma_m=np.full(len(fixes), sigma_m))
    settings = PoseSettings(accuracy_m=accuracy_m)
    return estimate_poses(fixes, Carrier(0.0), DATUM, settings)


@pytest.mark.parametrize(
    ("quality", "stated_m", "counts_m"),
    [
        (Quality.DIFFERENTIAL, 0.1, 0.25),
        (Quality.SBAS, 0.1, 0.25),
        (Quality.GPS, 0.3, 0.75),
        (Quality.DIFFERENTIAL, 0.3, 0.3),
        (Quality.RTK_FLOAT, 0.05, 0.125),
        (Quality.RTK_FIXED, 0.1, 0.1),
        (Quality.UNKNOWN, 0.1, 0.1),
    ],
)
def test_no_position_is_surer_than_half_of_what_is_usual(
    quality: Quality, stated_m: float, counts_m: float
) -> None:
    sigma_m = stating(stated_m, quality).trajectory.position_sigma_m
    assert np.median(sigma_m) == pytest.approx(counts_m, rel=0.15)


def test_it_is_reported_with_its_remedy() -> None:
    (note,) = (n for n in stating(0.1, Quality.DIFFERENTIAL).report.notes if "--accuracy" in n)
    assert "differential fixes state 0.10 m in the median and count as 0.25 m" in note
    for sigma_m, quality, accuracy_m in (
        (0.3, Quality.DIFFERENTIAL, None),
        (0.1, Quality.RTK_FIXED, None),
        (0.1, Quality.DIFFERENTIAL, 0.1),
    ):
        notes = stating(sigma_m, quality, accuracy_m).report.notes
        assert not [note for note in notes if "--accuracy" in note]


def test_a_declared_accuracy_is_believed() -> None:
    found = stating(0.4, Quality.DIFFERENTIAL, accuracy_m=0.1)
    assert np.median(found.trajectory.position_sigma_m) == pytest.approx(0.1, rel=0.15)


def test_only_position_sigmas_know_of_it() -> None:
    """The estimate goes by what is stated, so that a drift beyond it is still found."""
    one = stating(0.1, Quality.UNKNOWN).trajectory
    other = stating(0.1, Quality.DIFFERENTIAL).trajectory
    assert np.array_equal(one.east_m, other.east_m)
    assert np.array_equal(one.heading_sigma_deg, other.heading_sigma_deg)
    wider = other.position_sigma_m / one.position_sigma_m
    assert np.median(wider) == pytest.approx(2.5, rel=1e-3)
    assert 1.0 <= wider.min() <= wider.max() < 2.6


@pytest.mark.parametrize("last_fixed_s", [5.0, None])
def test_fixed_positions_vouch_for_float_ones_near_them(last_fixed_s: float | None) -> None:
    """Here those of the first seconds, for a minute; what comes later counts as its quality."""
    drive = simulate([Command(110.0, 1.5)], 35.0)
    fixes = fixes_of(drive, 0.5, 0.01)
    time_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    fixed = time_s <= (-1.0 if last_fixed_s is None else last_fixed_s)
    quality = np.where(fixed, int(Quality.RTK_FIXED), int(Quality.RTK_FLOAT))
    fixes = replace(fixes, quality=quality, sigma_m=np.full(len(fixes), 0.05))
    found = estimate_poses(fixes, Carrier(0.0), DATUM)
    sigma_m = found.trajectory.position_sigma_m[found.fix_row]
    vouched = time_s < (0.0 if last_fixed_s is None else last_fixed_s + 59.0)
    assert np.all(sigma_m[vouched] < 0.1)
    assert np.all(sigma_m[~vouched & (time_s > 70.0)] > 0.12)
