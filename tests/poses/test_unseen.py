"""What a drive would not show is named, and no receiver is surer than its kind can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.core import PoseSettings, Quality
from fieldgrid.geometry import (
    Carrier,
    FixColumns,
    LeverArm,
    Motion,
    Steps,
    VehicleGeometry,
    WheelSpeed,
)
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.poses.faults.unseen import UnseenFault, unseen_findings
from tests.scenes import paper_rig
from tests.simulated import (
    DATUM,
    SLALOM,
    START,
    Command,
    fixes_of,
    gyro_of,
    simulate,
    steps_of,
    time_ns,
)

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


@pytest.mark.parametrize(
    ("heading", "steps_used", "unseen"),
    [
        ("smooth", None, ()),
        ("smooth", 3, (ASIDE, AHEAD, LATE, DRIFT)),
        ("course", None, (DRIFT,)),
        ("constant:35", None, (DRIFT,)),
    ],
)
def test_a_drift_is_shown_where_the_camera_looks_for_it(
    heading: str, steps_used: int | None, unseen: tuple[UnseenFault, ...]
) -> None:
    """Over most of the drive, and where the drive gives the headings."""
    steps = steps_of(DRIVE)
    steps = Steps._make(column[:steps_used] for column in steps)
    settings = PoseSettings(heading=heading)
    fixes = fixes_of(DRIVE, 0.2, 0.01)
    found = estimate_poses(fixes, RIG, DATUM, settings, Motion(steps=steps))
    assert found.report.unseen == unseen


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
    (told,) = unseen_findings(faults)
    assert words in told.message


# --- how sure a receiver can be

SLALOMS = simulate(SLALOM, 35.0)


def stating(
    sigma_m: float,
    quality: Quality,
    accuracy_m: float | None = None,
    *,
    heading: str = "smooth",
    digits: int = 10,
) -> Estimate:
    """Poses by fixes of one kind, which a log holds to so many digits."""
    fixes: FixColumns = fixes_of(SLALOMS, 0.2, 0.01, quality=quality)
    fixes = fixes.replace(
        sigma_m=np.full(len(fixes), sigma_m),
        lat_deg=np.round(fixes.lat_deg, digits),
        lon_deg=np.round(fixes.lon_deg, digits),
    )
    settings = PoseSettings(accuracy_m=accuracy_m, heading=heading)
    return estimate_poses(fixes, Carrier(0.0), DATUM, settings)


def half_fixed(first: bool, quality: Quality, fixed_s: float, stated_m: float) -> FixColumns:
    """Fixes on the first or last part of a drive with RTK; the others 0.3 m off to the north."""
    fixes = fixes_of(DRIVE, 0.2, 0.01)
    time_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    fixed = time_s < fixed_s if first else time_s > time_s[-1] - fixed_s
    return fixes.replace(
        quality=np.where(fixed, int(Quality.RTK_FIXED), int(quality)),
        sigma_m=np.where(fixed, 0.015, stated_m),
        lat_deg=fixes.lat_deg + np.where(fixed, 0.0, 0.3 / 111_320.0),
    )


def holed(quality: Quality) -> FixColumns:
    """Fixes that state 0.1 m, with a hole of 12 s."""
    fixes = fixes_of(DRIVE, 0.2, 0.01, quality=quality)
    time_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    fixes = fixes.replace(sigma_m=np.full(len(fixes), 0.1))
    return fixes[(time_s < 20.0) | (time_s > 32.0)]


def level_camera() -> Motion:
    """A camera's motion that says nothing of how the vehicle leans. It errs as it states."""
    steps = steps_of(DRIVE, noise=1.0, seed=3)
    unknown = np.full(len(steps.start_ns), np.nan)
    leans = {"up_m": unknown, "roll_deg": unknown, "pitch_deg": unknown, "tilt_sigma_deg": unknown}
    return Motion(steps=steps._replace(**leans))


def slow_notes(found: Estimate) -> list[str]:
    return [str(one) for one in found.report.findings if one.code == "accuracy"]


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


@pytest.mark.parametrize(("stated_m", "believed_m"), [(0.005, 0.01), (0.012, 0.012)])
def test_fixed_ambiguities_leave_a_centimetre_and_a_half(
    stated_m: float, believed_m: float
) -> None:
    """Beside what the swaying antenna and the steering add."""
    plain, fixed = (
        stating(stated_m, kind).trajectory for kind in (Quality.UNKNOWN, Quality.RTK_FIXED)
    )
    missing_m2 = fixed.position_sigma_m**2 - plain.position_sigma_m**2
    assert missing_m2 == pytest.approx(np.full(len(missing_m2), 0.015**2 - believed_m**2))
    assert np.array_equal(fixed.accepted, plain.accepted)


def test_it_is_reported_with_its_remedy() -> None:
    (note,) = slow_notes(stating(0.1, Quality.DIFFERENTIAL))
    assert "differential fixes state 0.1 m in the median and count as 0.25 m. If" in note
    assert "give --accuracy METRES" in note
    for sigma_m, quality, accuracy_m in (
        (0.3, Quality.DIFFERENTIAL, None),
        (0.1, Quality.RTK_FIXED, None),
        (0.005, Quality.RTK_FIXED, None),
        (0.1, Quality.DIFFERENTIAL, 0.1),
    ):
        assert not slow_notes(stating(sigma_m, quality, accuracy_m))


def test_the_note_has_the_receivers_own_figure() -> None:
    """Not what of it is believed, nor what few digits add."""
    (note,) = slow_notes(stating(0.02, Quality.DIFFERENTIAL, digits=6))
    assert "state 0.02 m" in note


@pytest.mark.parametrize(("fixed_s", "is_named"), [(1.5, True), (30.0, False)])
def test_no_remedy_is_named_that_spoils_the_other_fixes(fixed_s: float, is_named: bool) -> None:
    """A declared accuracy would make RTK fixes of the same drive less sure."""
    fixes = half_fixed(True, Quality.DIFFERENTIAL, fixed_s, 0.1)
    (note,) = slow_notes(estimate_poses(fixes, RIG, DATUM, motion=motion("camera")))
    assert ("--accuracy" in note) is is_named
    assert "count as 0.25 m" in note


def test_a_declared_accuracy_is_believed() -> None:
    found = stating(0.4, Quality.DIFFERENTIAL, accuracy_m=0.1)
    assert np.median(found.trajectory.position_sigma_m) == pytest.approx(0.1, rel=0.15)


def test_only_position_sigmas_know_of_it() -> None:
    """The estimate goes by what is stated, so that a drift beyond it is still found."""
    one, other = (
        estimate_poses(holed(kind), RIG, DATUM, motion=level_camera()).trajectory
        for kind in (Quality.UNKNOWN, Quality.DIFFERENTIAL)
    )
    assert np.array_equal(one.east_m, other.east_m)
    assert np.array_equal(one.heading_sigma_deg, other.heading_sigma_deg)
    # Also in the hole, where the drift of the estimate itself is none of the receiver's.
    assert one.position_sigma_m.max() > 0.104
    missing_m2 = other.position_sigma_m**2 - one.position_sigma_m**2
    assert missing_m2 == pytest.approx(np.full(len(missing_m2), 0.25**2 - 0.1**2))


@pytest.mark.parametrize("digits", [10, 6])
def test_few_digits_are_another_error(digits: int) -> None:
    for heading in ("course", "smooth"):
        found = stating(0.1, Quality.DIFFERENTIAL, heading=heading, digits=digits).trajectory
        assert np.median(found.position_sigma_m[found.accepted]) > 0.249


@pytest.mark.parametrize("first", [True, False])
def test_a_gap_is_as_unsure_as_its_ends(first: bool) -> None:
    """From RTK fixes to others that are 0.3 m off, and from these to RTK."""
    fixes = half_fixed(first, Quality.DIFFERENTIAL, 36.0 if first else 16.5, 0.06)
    time_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    start_s, end_s = 28.0, 44.0
    fixes = fixes[(time_s < start_s) | (time_s > end_s)]
    found = estimate_poses(fixes, RIG, DATUM, motion=level_camera()).trajectory
    at_s = (found.time_ns - fixes.time_ns[0]) / 1e9
    hole = (at_s > start_s) & (at_s < end_s)
    truth = DRIVE.at((found.time_ns - START) / 1e9)
    off_m = np.hypot(found.east_m - truth.east_m, found.north_m - truth.north_m)
    assert off_m[hole].max() > 0.1
    assert np.all(off_m[hole] < 3.44 * found.position_sigma_m[hole])
    # It changes bit by bit, from the one to the other.
    sigma_m = found.position_sigma_m[hole]
    sigma_m = sigma_m if first else sigma_m[::-1]
    assert sigma_m[0] < 0.1
    assert sigma_m[-1] > 0.23
    assert np.abs(np.diff(sigma_m)).max() < 0.05


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
