"""From the fixes of an antenna to the trajectory of the grid origin, by every way to headings."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from fieldgrid.core import ConfigError, GnssError, PoseSettings
from fieldgrid.geometry import (
    Carrier,
    Datum,
    Fix,
    FixColumns,
    LeverArm,
    Motion,
    Rig,
    Status,
    Trajectory,
    wrap_deg,
)
from fieldgrid.poses import ErrorBudget, Estimate, Gate, estimate_poses
from fieldgrid.poses.accepted import datum_of
from fieldgrid.poses.estimate import carry_lever
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.verdict import Verdicts
from fieldgrid.poses.settings import heading_source
from fieldgrid.poses.table import default_baseline_m
from tests.scenes import Leg, Path, drive, paper_rig
from tests.simulated import (
    K_TURN,
    SLALOM,
    STOP,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
    steps_of,
)

_Float64 = npt.NDArray[np.float64]

SECOND = 1_000_000_000
START = 1_308_139_200 * SECOND
DATUM = Datum(39.5, -1.1, 700.0)
PLAIN = Fix(START, 39.5, -1.1, 703.0, quality=4, satellites=12, hdop=0.8, age_s=1.0)
AXLE_M = -2.0
"""The axle that does not steer is 2 m behind the grid origin."""

ABOVE_AXLE = Carrier(0.0)
"""A log whose antenna is declared to be above the axle."""

TURNING = [Leg(15.0), Leg(12.0, 0.18), Leg(9.0), Leg(9.0, -0.18), Leg(12.0)]


def fixes_along(
    path: Path,
    antenna: LeverArm,
    *,
    recorded: bool,
    quality: int = 4,
    noise_m: float = 0.0,
) -> list[Fix]:
    """Five fixes a second, 0.3 m apart, of an antenna on a vehicle whose axle follows a path."""
    east, north = path.of(antenna.right_m, antenna.forward_m - AXLE_M)
    noise = np.random.default_rng(2).normal(0.0, noise_m, (2, len(east))) if noise_m else (0.0, 0.0)
    lat, lon, height = DATUM.to_geodetic(
        east + noise[0], north + noise[1], np.full(len(east), antenna.up_m)
    )
    return [
        PLAIN._replace(
            time_ns=START + k * SECOND // 5,
            lat_deg=float(lat[k]),
            lon_deg=float(lon[k]),
            height_m=float(height[k]),
            quality=quality,
            speed_mps=1.5,
            heading_deg=float(path.heading_deg[k]) if recorded else None,
            heading_sigma_deg=0.3 if recorded else None,
        )
        for k in range(len(east))
    ]


def position_error_m(found: Trajectory, path: Path) -> _Float64:
    east, north = path.of(0.0, -AXLE_M)  # the grid origin
    return np.hypot(found.east_m - east, found.north_m - north)


def heading_error_deg(found: Trajectory, path: Path) -> _Float64:
    return np.abs(wrap_deg(found.heading_deg - path.heading_deg))


def poses(fixes: Sequence[Fix] | FixColumns, rig: Rig | None, heading: str) -> Trajectory:
    columns = fixes if isinstance(fixes, FixColumns) else FixColumns.of_rows(fixes)
    return estimate_poses(columns, rig, DATUM, PoseSettings(heading=heading)).trajectory


# --- the lever arm


@pytest.mark.parametrize(
    "heading", [0.0, 200.0, *(pytest.param(one, marks=pytest.mark.long) for one in (100.0, 300.0))]
)
@pytest.mark.parametrize("antenna", [LeverArm(0.4, -1.2, 2.6), LeverArm(-0.7, 1.5, 3.0)])
def test_the_antenna_is_carried_to_the_grid_origin(heading: float, antenna: LeverArm) -> None:
    path = drive(TURNING, heading)
    rig = paper_rig(antenna=antenna)
    found = poses(fixes_along(path, antenna, recorded=True), rig, "recorded")
    assert found.accepted.all()
    assert found.heading_source == "recorded"
    assert position_error_m(found, path).max() < 0.05
    assert np.abs(found.up_m).max() < 1e-3
    # The recorded heading is believed but for the offset that the course shows.
    assert heading_error_deg(found, path).max() < 1.0
    assert found.heading_sigma_deg.tolist() == [0.3] * len(found)
    # Without the lever arm every pose would be off by its length.
    forgotten = poses(fixes_along(path, antenna, recorded=True), paper_rig(), "recorded")
    off = math.hypot(antenna.right_m, antenna.forward_m)
    assert position_error_m(forgotten, path) == pytest.approx(off, abs=0.05)


@given(st.floats(-180.0, 180.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_the_lever_arm_undoes_eq_3(heading: float, right: float, forward: float) -> None:
    nose = np.exp(1j * math.radians(90.0 - heading))
    antenna = complex(200.0, -70.0) + nose * (forward - 1j * right)
    east, north = carry_lever(
        np.array([antenna.real]),
        np.array([antenna.imag]),
        np.array([heading]),
        LeverArm(right, forward, 2.0),
    )
    assert (east[0], north[0]) == pytest.approx((200.0, -70.0), abs=1e-9)


def test_without_a_heading_the_antenna_stays_where_it_is() -> None:
    east, north = carry_lever(
        np.array([5.0]), np.array([6.0]), np.array([np.nan]), LeverArm(1.0, 1.0, 0.0)
    )
    assert (east[0], north[0]) == (5.0, 6.0)


# --- heading from the course


@pytest.mark.parametrize("ahead_m", [1.0, 2.5])
def test_the_rear_axle_s_course_is_the_heading_in_a_turn(ahead_m: float) -> None:
    antenna = LeverArm(0.3, AXLE_M + ahead_m, 2.6)
    path = drive(TURNING, 35.0)
    fixes = fixes_along(path, antenna, recorded=False)
    rig = paper_rig(antenna=antenna, rear_axle_forward_m=AXLE_M)
    corrected = poses(fixes, rig, "course")
    plain = poses(fixes, paper_rig(antenna=antenna), "course")
    assert corrected.heading_source == plain.heading_source == "course"
    error, plain_error = (heading_error_deg(found, path) for found in (corrected, plain))
    turning = np.r_[62:85, 132:145]  # well inside the two turns
    # The antenna, ahead of the axle, leads by atan(ahead · curvature).
    lead_deg = math.degrees(math.atan(0.18 * ahead_m))
    assert plain_error[turning] == pytest.approx(lead_deg, rel=0.2)
    assert error[turning].max() < 1.5
    assert error.max() < 6.0  # where the path steps from straight to arc
    assert np.sqrt(np.mean(error**2)) < 0.2 * np.sqrt(np.mean(plain_error**2))
    assert position_error_m(corrected, path).max() < 0.3


def test_reverse_keeps_the_heading_and_turns_the_speed() -> None:
    antenna = LeverArm(0.0, AXLE_M, 2.6)
    path = drive([Leg(15.0), Leg(6.0, gear=-1), Leg(15.0)], 35.0)
    found = poses(fixes_along(path, antenna, recorded=False), paper_rig(antenna=antenna), "course")
    assert heading_error_deg(found, path).max() < 1.0
    assert position_error_m(found, path).max() < 0.05
    assert (found.speed_mps[55:65] == -1.5).all()
    assert (found.speed_mps[:45] == 1.5).all()
    assert (found.speed_mps[-45:] == 1.5).all()


def test_a_drive_that_begins_in_a_turn_is_less_sure_there() -> None:
    """How the vehicle stood before its first fix is not known, and fades over some metres."""
    antenna = LeverArm(0.0, AXLE_M + 2.0, 2.6)
    path = drive([Leg(20.0, 0.15)], 35.0)
    fixes = fixes_along(path, antenna, recorded=False)
    rig = paper_rig(antenna=antenna, rear_axle_forward_m=AXLE_M)
    corrected = poses(fixes, rig, "course")
    plain = poses(fixes, paper_rig(antenna=antenna), "course")
    more = corrected.heading_sigma_deg / plain.heading_sigma_deg
    assert more[0] > 1.5
    assert (more[40:] < 1.05).all()
    error = heading_error_deg(corrected, path)
    assert (error <= 3.0 * corrected.heading_sigma_deg).all()


@pytest.mark.parametrize("ahead_m", [1.5, -1.5])
def test_a_fishtail_keeps_the_heading_of_the_vehicle(ahead_m: float) -> None:
    """Also in reverse, and also with the antenna behind the axle, as on a trailed implement."""
    antenna = LeverArm(0.0, AXLE_M + ahead_m, 2.6)
    legs = [Leg(15.0), Leg(6.0, 0.12), Leg(9.0, -0.12, gear=-1), Leg(6.0, 0.12), Leg(15.0)]
    path = drive(legs, 35.0)
    found = poses(
        fixes_along(path, antenna, recorded=False),
        paper_rig(antenna=antenna, rear_axle_forward_m=AXLE_M),
        "course",
    )
    error = heading_error_deg(found, path)
    assert np.median(error) < 0.5
    ok = found.accepted
    assert ok.mean() > 0.7
    assert np.percentile(error[ok], 95) < 5.0
    assert error.max() < 12.0
    reverse = slice(75, 95)
    assert (found.speed_mps[reverse] == -1.5).all()
    assert error[reverse].max() < 3.0


def test_the_course_does_not_reach_across_a_gap() -> None:
    antenna = LeverArm(0.0, AXLE_M, 2.6)
    path = drive([Leg(15.0), Leg(15.0, 0.1)], 35.0)
    fixes = fixes_along(path, antenna, recorded=False)
    late = [fix._replace(time_ns=fix.time_ns + 5 * SECOND) for fix in fixes[50:]]
    rig = paper_rig(antenna=antenna)
    found = poses([*fixes[:50], *late], rig, "course")
    alone = poses(fixes[:50], rig, "course")
    assert np.array_equal(found.heading_deg[:50], alone.heading_deg)


def test_a_path_too_short_for_a_course_is_rejected_in_words() -> None:
    path = drive([Leg(0.9)])
    found = poses(fixes_along(path, LeverArm(0, 0, 0), recorded=False), paper_rig(), "course")
    assert not found.accepted.any()
    assert all("heading unknown" in reason for reason in found.reason)


def test_a_constant_heading_holds_everywhere() -> None:
    antenna = LeverArm(0.4, 1.2, 2.6)
    path = drive([Leg(12.0)], -100.0)
    found = poses(
        fixes_along(path, antenna, recorded=False), paper_rig(antenna=antenna), "constant:260"
    )
    assert found.heading_deg.tolist() == [-100.0] * len(found)
    assert found.heading_source == "constant:-100"
    assert position_error_m(found, path).max() < 1e-5


# --- heading sources


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("smooth", "smooth"),
        ("course", "course"),
        ("recorded", "recorded"),
        ("constant:80", "constant:80"),
        ("constant:-100.5", "constant:-100.5"),
        ("constant:+270", "constant:-90"),
        ("constant:360", "constant:0"),
    ],
)
def test_heading_sources(text: str, expected: str) -> None:
    assert str(heading_source(text)) == expected
    assert PoseSettings().heading == "smooth"


@pytest.mark.parametrize(
    "text",
    ["", "auto", "gyro", "constant", "constant:", "constant:north", "constant:1e2", "constant:400",
     "constant:nan", "constant:80 ", "Course"],
)  # fmt: skip
def test_other_heading_sources_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="constant:DEG") as caught:
        heading_source(text)
    assert repr(text) in str(caught.value)


def test_a_recorded_heading_must_be_there() -> None:
    fixes = fixes_along(drive([Leg(9.0)]), LeverArm(0, 0, 0), recorded=False)
    with pytest.raises(GnssError, match="--heading smooth"):
        poses(fixes, paper_rig(), "recorded")


def test_unknown_settings_are_refused() -> None:
    with pytest.raises(ValidationError, match="basline"):
        PoseSettings(basline_m=3.0)  # type: ignore[call-arg]


# --- the datum, and what cannot be used


def test_the_datum_is_the_first_accepted_fix_rounded() -> None:
    fixes = [
        PLAIN._replace(quality=0, lat_deg=0.0, lon_deg=0.0),
        PLAIN._replace(
            time_ns=START + 1, lat_deg=39.123456789, lon_deg=-1.987654321, height_m=700.12345
        ),
        PLAIN._replace(time_ns=START + SECOND),
    ]
    log = FixColumns.of_rows(fixes)
    assert datum_of(log, condition(log)) == Datum(39.1234568, -1.9876543, 700.123)


def test_a_drive_has_the_datum_that_it_is_given_or_its_own() -> None:
    fixes = FixColumns.of_rows(fixes_along(drive([Leg(9.0)]), LeverArm(0, 0, 0), recorded=True))
    other = Datum(39.51, -1.1, 650.0)
    assert estimate_poses(fixes, paper_rig(), other).trajectory.datum == other
    own = estimate_poses(fixes, paper_rig()).trajectory
    assert own.datum == Datum(
        round(fixes[0].lat_deg, 7), round(fixes[0].lon_deg, 7), round(fixes[0].height_m, 3)
    )
    moved = estimate_poses(fixes, paper_rig(), other).trajectory
    # 0.01° of latitude is 1110 m; the second plane lies that much farther north.
    assert (own.north_m - moved.north_m).mean() == pytest.approx(1110.3, abs=2.0)


def test_without_a_usable_fix_the_commonest_reason_is_told() -> None:
    fixes = [
        PLAIN._replace(time_ns=START + k * SECOND, satellites=3 if k < 2 else 12, hdop=9.0)
        for k in range(6)
    ]
    log = FixColumns.of_rows(fixes)
    for attempt in (lambda: estimate_poses(log, paper_rig()), lambda: datum_of(log, VERDICTS)):
        with pytest.raises(GnssError, match="None of the 6 fixes") as caught:
            attempt()
        assert "HDOP 9 > 4" in str(caught.value)
        assert "--gnss" in str(caught.value)


VERDICTS = Verdicts(
    np.zeros(6, dtype=np.bool_),
    (*[Gate.SATELLITES] * 2, *[Gate.HDOP] * 4),
    (*["3 satellites < 5"] * 2, *["HDOP 9 > 4"] * 4),
)


@pytest.mark.parametrize(
    ("change", "reason", "remedy"),
    [
        ({"lat_deg": 950.0}, "not on Earth", "name columns and units in [gnss.columns] of rec"),
        (
            {"height_m": 4e6},
            "height 4000000.0 m",
            "name columns and units in [gnss.columns] of rec",
        ),
        ({"quality": 0}, "not allowed", "declare its quality with --quality"),
        ({"satellites": 3}, "3 satellites < 5", "min_satellites of the table pose.gnss"),
        ({"hdop": 9.0}, "HDOP 9 > 4", "max_hdop of the table pose.gnss"),
        ({"age_s": 900.0}, "differential age 900", "max_age_s of the table pose.gnss"),
    ],
)
def test_the_remedy_is_one_of_the_reason(
    change: dict[str, float], reason: str, remedy: str
) -> None:
    log = FixColumns.of_rows(
        [PLAIN._replace(time_ns=START + k * SECOND, **change) for k in range(6)]  # type: ignore[arg-type]
    )
    with pytest.raises(GnssError) as caught:
        estimate_poses(log, paper_rig())
    assert reason in str(caught.value)
    assert remedy in str(caught.value)
    assert ("--quality" in str(caught.value)) == ("quality" in change)


def test_no_fix_at_all_is_told() -> None:
    with pytest.raises(GnssError, match="no position at all"):
        estimate_poses(FixColumns.of([]), paper_rig())


def test_rejected_fixes_stay_as_rows_with_their_reasons() -> None:
    path = drive([Leg(12.0)], 35.0)
    fixes = fixes_along(path, LeverArm(0, AXLE_M, 2.6), recorded=True)
    fixes[10] = fixes[10]._replace(hdop=9.0)
    fixes[20] = fixes[20]._replace(quality=0)
    fixes[30] = fixes[30]._replace(lat_deg=fixes[30].lat_deg + 1e-4)  # 11 m aside
    found = poses(fixes, paper_rig(antenna=LeverArm(0, AXLE_M, 2.6)), "recorded")
    assert len(found) == len(fixes)
    assert np.flatnonzero(~found.accepted).tolist() == [10, 20, 30]
    assert "HDOP 9" in found.reason[10]
    assert "quality 0" in found.reason[20]
    assert "jump of 11" in found.reason[30]
    assert found.reason[11] == ""
    assert found.quality[20] == 0
    assert position_error_m(found, path)[found.accepted].max() < 0.02


def test_a_rejected_fix_does_not_bend_the_course() -> None:
    path = drive([Leg(15.0)], 35.0)
    fixes = fixes_along(path, LeverArm(0, AXLE_M, 2.6), recorded=False)
    fixes[25] = fixes[25]._replace(lat_deg=fixes[25].lat_deg + 5e-5)
    found = poses(fixes, paper_rig(antenna=LeverArm(0, AXLE_M, 2.6)), "course")
    assert found.status[25] is Status.REJECTED
    assert heading_error_deg(found, path)[found.accepted].max() < 0.01


def test_the_seam_of_a_solution_that_has_moved_is_accepted_with_its_reason() -> None:
    path = drive([Leg(45.0)], 35.0)
    fixes = fixes_along(path, LeverArm(0, AXLE_M, 2.6), recorded=True)
    moved = [fix._replace(lat_deg=fix.lat_deg + 1e-4) for fix in fixes[60:]]
    fixes = [*fixes[:60], *moved]
    verdicts = condition(FixColumns.of_rows(fixes))
    found = poses(fixes, paper_rig(antenna=LeverArm(0, AXLE_M, 2.6)), "recorded")
    (seam,) = [k for k, reason in enumerate(verdicts.reason) if verdicts.ok[k] and reason]
    assert "the solution has moved" in found.reason[seam]
    assert found.status[seam] is Status.OK


def test_fixes_are_put_in_the_order_of_time() -> None:
    fixes = fixes_along(drive([Leg(9.0)]), LeverArm(0, 0, 0), recorded=True)
    shuffled = [fixes[k] for k in np.random.default_rng(0).permutation(len(fixes))]
    a, b = (poses(some, paper_rig(), "recorded") for some in (fixes, shuffled))
    assert np.array_equal(a.time_ns, b.time_ns)
    assert np.array_equal(a.east_m, b.east_m)


# --- the limits of certainty


def test_poses_that_are_not_sure_enough_are_rejected_in_words() -> None:
    fixes = fixes_along(drive([Leg(9.0)]), LeverArm(0, 0, 0), recorded=True)
    unsure = [fix._replace(heading_sigma_deg=5.0) for fix in fixes[:5]] + fixes[5:]
    unsure[10] = unsure[10]._replace(sigma_m=4.5)
    found = poses(unsure, paper_rig(), "recorded")
    assert found.reason[0] == "heading sigma 5.0° > 3°"
    assert found.reason[10] == "position sigma 4.51 m > 2 m"  # with the unknown slope
    assert np.flatnonzero(~found.accepted).tolist() == [0, 1, 2, 3, 4, 10]
    wider = PoseSettings(heading="recorded", max_heading_sigma_deg=6.0, max_position_sigma_m=5.0)
    log = FixColumns.of_rows(unsure)
    assert estimate_poses(log, paper_rig(), DATUM, wider).trajectory.accepted.all()


def test_a_fix_without_its_recorded_heading_is_rejected() -> None:
    fixes = fixes_along(drive([Leg(9.0)]), LeverArm(0, 0, 0), recorded=True)
    fixes[3] = fixes[3]._replace(heading_deg=None)
    found = poses(fixes, paper_rig(), "recorded")
    assert np.flatnonzero(~found.accepted).tolist() == [3]
    assert "heading unknown" in found.reason[3]


@pytest.mark.parametrize(("sigma_m", "expected_m"), [(0.01, 4.0), (0.04, 8.0), (0.5, 12.0)])
def test_poorer_fixes_get_a_longer_baseline(sigma_m: float, expected_m: float) -> None:
    assert default_baseline_m(np.full(5, sigma_m)) == pytest.approx(expected_m)


# --- the default: one estimate of everything


def estimate(
    simulated: Drive,
    *,
    motion: Motion | None = None,
    rig: Rig | Carrier | None = ABOVE_AXLE,
    fixes: Sequence[Fix] | FixColumns | None = None,
    settings: PoseSettings | None = None,
    budget: ErrorBudget | None = None,
) -> Estimate:
    fixes = fixes_of(simulated, 0.2, 0.01) if fixes is None else fixes
    columns = fixes if isinstance(fixes, FixColumns) else FixColumns.of_rows(fixes)
    return estimate_poses(columns, rig, DATUM, settings, motion, budget)


def off_deg(found: Trajectory, simulated: Drive) -> _Float64:
    truth = simulated.at((found.time_ns - START) / 1e9)
    return np.abs(wrap_deg(found.heading_deg - np.degrees(truth.heading_rad)))


@pytest.mark.parametrize("commands", [pytest.param(SLALOM, marks=pytest.mark.long), K_TURN, STOP])
@pytest.mark.parametrize("aids", ["nothing", "gyro", "steps", "heading", "all"])
def test_every_sensor_helps(commands: list[Command], aids: str) -> None:
    simulated = simulate(commands, 35.0)
    motion = Motion(
        gyro=gyro_of(simulated, bias_dps=0.4, noise_dps=0.05) if aids in ("gyro", "all") else None,
        steps=steps_of(simulated, noise=1.0) if aids in ("steps", "all") else None,
    )
    sigma = 0.5 if aids in ("heading", "all") else None
    fixes = fixes_of(simulated, 0.2, 0.01, heading_sigma_deg=sigma)
    found, row, report, _ = estimate(simulated, motion=motion, fixes=fixes)
    truth = simulated.at((found.time_ns - START) / 1e9)
    moving = (np.abs(truth.speed_mps) > 0.2) & found.accepted
    error = off_deg(found, simulated)
    assert found.heading_source == "smooth"
    assert error[found.accepted].max() < (5.0 if aids == "nothing" else 3.0)
    assert np.median(error[moving]) < 1.0
    assert np.mean(error[found.accepted] < 3.0 * found.heading_sigma_deg[found.accepted]) > 0.95
    assert np.mean(found.gear[moving] == truth.gear()[moving]) > 0.98
    assert found.accepted.mean() > (0.45 if aids == "nothing" else 0.9)
    assert np.hypot(found.east_m - truth.east_m, found.north_m - truth.north_m).max() < 0.1
    assert np.array_equal(found.time_ns[row], [fix.time_ns for fix in fixes])
    assert (found.quality[row] == 4).all()
    if motion.gyro is not None:
        assert report.gyro_bias_dps == pytest.approx(0.4, abs=0.1)
    else:
        assert math.isnan(report.gyro_bias_dps)
    assert (report.recorded is None) == (sigma is None)


def test_the_grid_origin_is_where_the_rig_says() -> None:
    simulated = simulate(SLALOM, 35.0, speed_mps=1.5)
    rig = paper_rig(antenna=LeverArm(0.3, -0.6, 2.4), rear_axle_forward_m=-2.0)
    fixes = fixes_of(simulated, 0.2, antenna=LeverArm(0.3, 1.4, 2.4))
    found, row, *_ = estimate(simulated, rig=rig, fixes=fixes)
    origin = simulated.every(0.2).point(0.0, 2.0)
    off = np.hypot(found.east_m[row] - origin[:, 0], found.north_m[row] - origin[:, 1])
    assert np.median(off[found.accepted[row]]) < 0.03
    assert off[found.accepted[row]].max() < 0.15
    assert np.abs(found.up_m).max() < 0.01


@pytest.mark.parametrize("heading", ["smooth", "course", "recorded", "constant:35"])
def test_the_same_drive_has_the_same_bits(heading: str) -> None:
    """Also when its fixes come in another order."""
    simulated = simulate(K_TURN, 35.0)
    fixes = fixes_of(simulated, 0.2, 0.02, heading_sigma_deg=0.5)
    motion = Motion(gyro=gyro_of(simulated), steps=steps_of(simulated, noise=1.0))
    order = np.random.default_rng(0).permutation(len(fixes))
    settings = PoseSettings(heading=heading)
    one, two, shuffled = (
        estimate(simulated, motion=motion, fixes=some, settings=settings)
        for some in (fixes, fixes, fixes[order])
    )
    for other in (two, shuffled):
        for name in ("time_ns", "east_m", "north_m", "up_m", "heading_deg", "position_sigma_m",
                     "heading_sigma_deg", "speed_mps", "gear", "quality"):  # fmt: skip
            same = np.array_equal(
                getattr(one.trajectory, name), getattr(other.trajectory, name), equal_nan=True
            )
            assert same, name
        assert one.trajectory.status == other.trajectory.status
        assert one.trajectory.reason == other.trajectory.reason
        assert np.array_equal(one.fix_row, other.fix_row)
        assert one.report.notes == other.report.notes


def test_standing_is_held_with_a_growing_sigma() -> None:
    simulated = simulate([Command(15.0, 1.5), Command(60.0, 0.0)], 35.0)
    motion = Motion(gyro=gyro_of(simulated))
    found = estimate(simulated, motion=motion).trajectory
    late = found.time_ns > START + 20 * SECOND
    assert {found.status[k] for k in np.flatnonzero(late)[:-10]} == {Status.HELD}
    assert (found.gear[late][:-10] == 0).all()
    assert (found.speed_mps[late][:-10] == 0.0).all()
    sigma = found.heading_sigma_deg[late]
    assert (np.diff(sigma) > -1e-6).all()
    assert off_deg(found, simulated)[late].max() < 1.0


def test_who_never_moves_has_no_heading() -> None:
    random = np.random.default_rng(3)
    still = simulate([Command(40.0, 0.0)])
    found = estimate(still, fixes=fixes_of(still, 0.2, 0.01, seed=int(random.integers(99))))
    assert not found.trajectory.accepted.any()
    assert len(found.trajectory) >= 200
    assert set(found.trajectory.reason) == {
        "heading unknown: none is recorded, and the vehicle does not move"
    }


def test_rejected_fixes_get_the_estimate_of_their_time() -> None:
    simulated = simulate(SLALOM, 35.0, speed_mps=1.5)
    fixes = list(fixes_of(simulated, 0.2, 0.01))
    fixes[0] = fixes[0]._replace(quality=0)
    fixes[-1] = fixes[-1]._replace(hdop=9.0)
    fixes[30] = fixes[30]._replace(lat_deg=fixes[30].lat_deg + 1e-4)  # 11 m aside
    fixes[50] = fixes[50]._replace(satellites=2)
    fixes.insert(61, fixes[60])
    found, row, *_ = estimate(simulated, fixes=fixes)
    for k, reason in ((0, "quality 0"), (30, "jump of 11"), (50, "2 satellites"), (-1, "HDOP 9")):
        assert found.status[row[k]] is Status.REJECTED
        assert reason in found.reason[row[k]]
    assert row[60] != row[61]
    assert found.time_ns[row[60]] == found.time_ns[row[61]]
    assert [found.status[row[k]] for k in (60, 61)].count(Status.REJECTED) == 1
    assert len(set(row.tolist())) == len(fixes)
    truth = simulated.at((found.time_ns - START) / 1e9)
    off = np.hypot(found.east_m - truth.east_m, found.north_m - truth.north_m)
    inside = row[1:-1]
    assert off[inside].max() < 0.1
    # Before the first and after the last accepted one nothing is known but the fix itself.
    assert np.isnan(found.heading_deg[row[[0, -1]]]).all()
    assert off[row[[0, -1]]].max() < 0.1
    assert found.quality[row[0]] == 0
    assert (np.diff(found.time_ns) >= 0).all()
    # Each is a row of its own beside the pose of its time, which it does not spoil.
    for k in (30, 50):
        own = np.flatnonzero(found.time_ns == fixes[k].time_ns)
        assert len(own) == 2
        (pose,) = own[own != row[k]]
        assert found.status[pose] is Status.OK
        assert (found.quality[pose], found.quality[row[k]]) == (6, fixes[k].quality)
        assert found.east_m[pose] == found.east_m[row[k]]
        assert found.heading_deg[pose] == found.heading_deg[row[k]]
        assert found.at(fixes[k].time_ns).status is Status.OK


def test_a_way_between_holes_on_which_every_fix_is_rejected_is_told_and_no_error() -> None:
    """Half a minute of it, with nothing known of the ways before and after."""
    simulated = simulate([Command(120.0, 1.5, 0.02)], 35.0, speed_mps=1.5)
    fixes = []
    for fix in fixes_of(simulated, 0.2, 0.01):
        after_s = (fix.time_ns - START) / SECOND
        if not 30.0 < after_s < 90.0:
            fixes.append(fix)
        elif 45.0 < after_s < 75.0:
            fixes.append(fix._replace(hdop=9.0))
    found, row, *_ = estimate(simulated, fixes=fixes)
    seconds = (found.time_ns - START) / SECOND
    lost = (seconds > 40.0) & (seconds < 80.0)
    assert lost.sum() >= 2 * 149  # the rejected fixes and the nodes of their times
    assert not found.accepted[lost].any()
    assert (found.position_sigma_m[lost] > 2.0).all()
    assert all("HDOP 9" in found.reason[row[k]] for k, f in enumerate(fixes) if f.hdop == 9.0)
    assert found.accepted[~lost].mean() > 0.95
    truth = simulated.at(seconds)
    off = np.hypot(found.east_m - truth.east_m, found.north_m - truth.north_m)
    assert off[~lost].max() < 0.1


def test_between_slow_fixes_there_are_rows_of_estimates() -> None:
    simulated = simulate(SLALOM, 35.0, speed_mps=1.5)
    found, row, *_ = estimate(simulated, fixes=fixes_of(simulated, 1.0, 0.01))
    assert np.diff(found.time_ns).max() <= 250_000_000
    between = np.setdiff1d(np.arange(len(found)), row)
    assert (found.quality[between] == 6).all()
    assert off_deg(found, simulated)[found.accepted].max() < 8.0


def test_the_budget_rejects_what_lands_in_wrong_cells() -> None:
    simulated = simulate(SLALOM, 35.0, speed_mps=1.5)
    near = estimate(simulated, budget=ErrorBudget(5.0, 12.0)).trajectory
    far = estimate(simulated, budget=ErrorBudget(0.01, 12.0)).trajectory
    assert near.accepted.mean() > 0.9
    assert not far.accepted.any()
    assert any("a cell 12 m ahead would be off" in reason for reason in far.reason)


# --- recorded headings that mean something else


@pytest.mark.parametrize(
    ("shown", "advice"),
    [
        (lambda heading: heading + 90.0, '"heading_offset_deg": 90.'),
        (lambda heading: heading + 180.0, "points backwards"),
        (lambda heading: 90.0 - heading, '"heading_convention": "ccw_east"'),
        (lambda heading: -heading, '"heading_convention": "ccw_east" and "heading_offset_deg": '),
    ],
)
def test_a_heading_of_another_convention_is_an_error_that_says_so(
    shown: object, advice: str
) -> None:
    assert callable(shown)
    simulated = simulate(SLALOM, 35.0, speed_mps=1.5)
    fixes = [
        fix._replace(heading_deg=float(wrap_deg(shown(fix.heading_deg))))
        for fix in fixes_of(simulated, 0.2, 0.01, heading_sigma_deg=0.3)
    ]
    for heading in ("smooth", "recorded"):
        with pytest.raises(GnssError, match=r"mounting\.json") as caught:
            poses(fixes, None, heading)
        assert advice in str(caught.value)
        assert "--heading course" in str(caught.value)
    # The advice can be followed: without the heading the drive is estimated, with a note.
    settings = PoseSettings(heading="course")
    found = estimate(simulated, fixes=fixes, settings=settings)
    assert found.report.recorded is not None
    assert any(advice in note for note in found.report.notes)


def test_a_small_offset_is_taken_out_and_told() -> None:
    simulated = simulate(SLALOM, 35.0, speed_mps=1.5)
    fixes = [
        fix._replace(heading_deg=float(wrap_deg((fix.heading_deg or 0.0) + 3.0)))
        for fix in fixes_of(simulated, 0.2, 0.01, heading_sigma_deg=0.3)
    ]
    found = estimate(simulated, fixes=fixes)
    assert off_deg(found.trajectory, simulated)[found.trajectory.accepted].max() < 1.5
    assert any("+3.0" in note or "+2.9" in note for note in found.report.notes)


def test_a_course_posing_as_a_heading_is_not_used() -> None:
    simulated = simulate([*K_TURN, *SLALOM], 35.0)
    at = simulated.every(0.2)
    fixes = [
        fix._replace(
            heading_deg=float(wrap_deg((fix.heading_deg or 0.0) + (180.0 if back else 0.0)))
        )
        for fix, back in zip(
            fixes_of(simulated, 0.2, 0.01, heading_sigma_deg=0.3), at.speed_mps < 0.0, strict=True
        )
    ]
    gyro = Motion(gyro=gyro_of(simulated))
    found = estimate(simulated, fixes=fixes, motion=gyro)
    assert any("it is the course" in note for note in found.report.notes)
    assert off_deg(found.trajectory, simulated)[found.trajectory.accepted].max() < 3.0
    with pytest.raises(GnssError, match="use --heading smooth"):
        estimate(simulated, fixes=fixes, motion=gyro, settings=PoseSettings(heading="recorded"))


@pytest.mark.parametrize(("share", "word"), [(0.01, False), (0.1, True), (0.45, True)])
@pytest.mark.parametrize("heading", ["smooth", "recorded"])
def test_where_a_recorded_heading_is_the_other_way_round_it_is_not_used(
    heading: str, share: float, word: bool
) -> None:
    """As while a receiver with two antennas finds its attitude."""
    simulated = simulate([*SLALOM, *SLALOM], 35.0, speed_mps=1.5)
    fixes = fixes_of(simulated, 0.2, 0.01, heading_sigma_deg=0.3)
    around = np.arange(len(fixes)) < share * len(fixes)
    shown = np.asarray(wrap_deg(fixes.heading_deg + 180.0 * around))
    settings = PoseSettings(heading=heading)
    found = estimate(simulated, fixes=fixes.replace(heading_deg=shown), settings=settings)
    assert off_deg(found.trajectory, simulated)[found.trajectory.accepted].max() < 10.0
    by_itself = heading == "smooth"
    assert found.trajectory.accepted.mean() == pytest.approx(
        1.0 - share * (not by_itself), abs=0.02
    )
    told = f"the other way round at {around.sum()} of {len(fixes)} fixes"
    assert any(told in note for note in found.report.notes) == (word or not by_itself)


def test_a_heading_that_turns_around_during_the_drive_is_not_used() -> None:
    """Only in a tenth, with RTK, the drive itself is sure where it points."""
    simulated = simulate([*SLALOM, *SLALOM], 35.0, speed_mps=1.5)
    good, poor = (fixes_of(simulated, 0.2, m, heading_sigma_deg=0.3) for m in (0.01, 0.4))
    sure = np.arange(len(good)) < 0.15 * len(good)
    fixes = good.replace(
        heading_deg=np.asarray(wrap_deg(good.heading_deg + 180.0 * ~sure)),
        lat_deg=np.where(sure, good.lat_deg, poor.lat_deg),
        lon_deg=np.where(sure, good.lon_deg, poor.lon_deg),
        sigma_m=np.where(sure, 0.01, 0.4),
        quality=np.where(sure, 4, 1),
    )
    found = estimate(simulated, fixes=fixes)
    told = r"turns around during the drive, and was not used: it is 0° off .* at 85 % of all"
    assert any(re.search(told, note) for note in found.report.notes)
    with pytest.raises(GnssError, match="cut the log where it does, or use --heading smooth"):
        estimate(simulated, fixes=fixes, settings=PoseSettings(heading="recorded"))


def test_a_constant_heading_that_contradicts_the_drive_is_told() -> None:
    simulated = simulate([Command(30.0, 1.5)], 35.0, speed_mps=1.5)
    for given_deg, told in ((35.0, False), (80.0, True)):
        settings = PoseSettings(heading=f"constant:{given_deg:g}")
        notes = estimate(simulated, settings=settings).report.notes
        assert any("more than 10° off" in note for note in notes) == told
