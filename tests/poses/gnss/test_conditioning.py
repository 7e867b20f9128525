"""The verdicts on fixes, each with its reason, and how sure a fix is."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from pydantic import ValidationError

from fieldgrid.core import GateLimits, GnssError, Quality
from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.poses import Gate
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.summary import summarise
from fieldgrid.poses.gates.verdict import DEFAULT_LIMITS
from tests.poses.gnss.judged import Judged, judge
from tests.poses.gnss.sentences import NOON, SECOND, read

SharedData = Callable[[str], Path]

# --- how sure a fix is

GOOD = Fix(NOON, 41.65, -4.72, 787.4, 4, 12, 0.7, 1.5)


@pytest.mark.parametrize(
    ("quality", "sigma_m", "expected"),
    [
        (4, None, 0.02),
        (5, None, 0.25),
        (2, None, 0.5),
        (9, None, 0.5),
        (1, None, 1.5),
        (4, 0.013, 0.013),
        (2, 0.27, 0.27),
        (4, 0.00001, 0.01),  # millimetres written for metres
        (2, 0.0003, 0.05),
        (1, 44.0, 44.0),  # who says that it is bad is believed
        (4, 0.0, 0.02),
        (4, math.nan, 0.02),
    ],
)
def test_position_sigma(quality: int, sigma_m: float | None, expected: float) -> None:
    fix = GOOD._replace(quality=quality, sigma_m=sigma_m)
    assert fix.position_sigma_m == pytest.approx(expected)


# --- verdicts


def drive(
    count: int, *, speed_mps: float = 1.5, period_s: float = 0.2, told: bool = True
) -> list[Fix]:
    """Fixes of a drive due north at 5 Hz."""
    return [
        GOOD._replace(
            time_ns=NOON + round(k * period_s * SECOND),
            lat_deg=41.65 + north_deg(k * period_s * speed_mps),
            quality=2,
            sigma_m=0.3,
            speed_mps=speed_mps if told else None,
        )
        for k in range(count)
    ]


def north_deg(metres: float) -> float:
    return metres / 111_073.0


def moved(fixes: list[Fix], epochs: Iterable[int], metres: float) -> list[Fix]:
    """The fixes, those of some epochs moved north."""
    chosen = set(epochs)
    return [
        fix._replace(lat_deg=fix.lat_deg + north_deg(metres)) if k in chosen else fix
        for k, fix in enumerate(fixes)
    ]


def rejected(fixes: list[Fix], limits: GateLimits = DEFAULT_LIMITS) -> list[int]:
    verdicts = judge(fixes, limits)
    assert len(verdicts) == len(fixes)
    assert all(v.reason for v in verdicts if not v.ok)
    return [k for k, verdict in enumerate(verdicts) if not verdict.ok]


@pytest.mark.parametrize("told", [True, False])
def test_a_clean_drive_is_accepted_whole(told: bool) -> None:
    assert rejected(drive(100, told=told)) == []
    assert rejected(drive(100, speed_mps=11.5, told=told)) == []


def test_noise_within_the_told_accuracy_is_no_jump() -> None:
    standing = drive(100, speed_mps=0.0)
    assert rejected(moved(standing, range(0, 100, 3), 1.0)) == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"quality": 6}, "quality 6 (estimated) is not allowed"),
        ({"quality": 0}, "quality 0 (none) is not allowed"),
        ({"satellites": 4}, "4 satellites < 5"),
        ({"hdop": 5.2}, "HDOP 5.2 > 4"),
        ({"quality": 4, "age_s": 31.0}, "differential age 31 s > 30 s"),
        ({"quality": 2, "age_s": 301.0}, "differential age 301 s > 300 s"),
        ({"quality": 9, "age_s": 301.0}, "differential age 301 s > 300 s"),
        ({"lat_deg": math.nan}, "not all numbers"),
        ({"height_m": math.inf}, "not all numbers"),
        ({"lat_deg": 91.0}, "are not on Earth"),
        ({"lon_deg": -180.5}, "are not on Earth"),
        ({"height_m": 20_000.0}, "height 20000.0 m is outside"),
        ({"lat_deg": 0.0, "lon_deg": 0.0}, "latitude 0, longitude 0"),
        ({"time_ns": 2**62}, "is in no year from"),
        ({"time_ns": -(2**62)}, "is in no year from"),
    ],
)
def test_each_gate_says_why(change: dict[str, float], reason: str) -> None:
    bad = GOOD._replace(**change)
    (verdict,) = judge([bad])
    assert not verdict.ok
    assert reason in verdict.reason
    # It must not keep the good ones around it from being judged.
    after = GOOD._replace(time_ns=NOON + 2 * SECOND)
    between = bad if "time_ns" in change else bad._replace(time_ns=NOON + SECOND)
    assert rejected([GOOD, between, after]) == [1]
    assert rejected([between, after]) == [0]


@pytest.mark.parametrize(
    "change",
    [
        {"satellites": None, "hdop": None, "age_s": None},
        {"satellites": 5},
        {"hdop": 4.0},
        {"age_s": 30.0},
        {"quality": 1, "age_s": 999.0},  # no correction is used, so its age says nothing
        {"quality": 2, "age_s": 300.0},  # SBAS and PPP live on corrections of minutes ago
        {"quality": 9, "age_s": 300.0},
    ],
)
def test_what_is_just_good_enough_passes(change: dict[str, float]) -> None:
    assert rejected([GOOD._replace(**change)]) == []


def test_limits_can_be_set() -> None:
    limits = GateLimits(allowed_quality=frozenset({4}), min_satellites=6)
    fixes = [GOOD._replace(time_ns=NOON + k, quality=q) for k, q in enumerate((4, 5))]
    assert rejected(fixes, limits) == [1]
    assert rejected([GOOD._replace(satellites=5)], limits) == [0]


def test_time_must_increase() -> None:
    fixes = drive(10)
    fixes[4] = fixes[4]._replace(time_ns=fixes[3].time_ns)
    verdicts = judge(fixes)
    assert [k for k, v in enumerate(verdicts) if not v.ok] == [4]
    assert verdicts[4].reason == "time is that of the last accepted fix"


@pytest.mark.parametrize("told_sigma_m", [0.3, None])
@pytest.mark.parametrize("metres", [5.2, -5.2])
@pytest.mark.parametrize("length", [1, 2, 7])
def test_multipath_is_rejected_and_left_again(
    length: int, metres: float, told_sigma_m: float | None
) -> None:
    epochs = range(40, 40 + length)
    # A jump back is met by the vehicle, which could have driven there before it ends.
    fixes = [fix._replace(sigma_m=told_sigma_m) for fix in moved(drive(100), epochs, metres)]
    assert rejected(fixes) == list(epochs)


def test_a_jump_says_how_large_it_is() -> None:
    verdict = judge(moved(drive(20), [10], 5.0))[10]
    assert verdict.gate is Gate.JUMP
    assert verdict.reason == (
        "jump of 5.30 m in 0.20 s implies 27 m/s; "
        "5.00 m off the way driven, where speed and accuracy explain 2.13 m"
    )


def test_a_jump_too_fast_for_any_vehicle_is_rejected_without_a_speed() -> None:
    assert rejected(moved(drive(50, told=False), [20], 15.0)) == [20]


def test_the_rest_of_a_jump_carries_on_from_it() -> None:
    verdicts = judge(moved(drive(100), range(40, 43), 5.0))
    assert verdicts[40].reason.startswith("jump of 5.30 m")
    assert verdicts[41].reason == "carries on from the jump 1 fix before"
    assert verdicts[42].reason == "carries on from the jump 2 fixes before"
    assert {verdicts[k].gate for k in (40, 41, 42)} == {Gate.JUMP}


def test_two_jumps_in_a_row_are_told_apart() -> None:
    verdicts = judge(moved(moved(drive(100), [40, 41], 5.0), [42, 43], -9.0))
    assert verdicts[42].reason.startswith("jump of 8.10 m")
    assert verdicts[43].reason == "carries on from the jump 1 fix before"


def centimetres(fixes: list[Fix]) -> list[Fix]:
    return [fix._replace(quality=4, sigma_m=None, speed_mps=None) for fix in fixes]


def aside(fix: Fix, metres: float) -> Fix:
    return fix._replace(
        lon_deg=fix.lon_deg + north_deg(metres) / math.cos(math.radians(fix.lat_deg))
    )


def test_a_fix_aside_would_need_a_turn_that_no_vehicle_makes() -> None:
    fixes = centimetres(drive(60))
    fixes[30] = aside(fixes[30], 0.6)
    verdict = judge(fixes)[30]
    assert rejected(fixes) == [30]
    assert verdict.gate is Gate.TURN_RATE
    assert verdict.reason.startswith("course would turn by 64° in 0.20 s at 1.5 m/s; 0.60 m off")


def test_a_fix_that_stays_behind_would_need_brakes_that_no_vehicle_has() -> None:
    fixes = centimetres(drive(60, speed_mps=10.0))
    verdict = judge(moved(fixes, [30], -1.8))[30]
    assert rejected(moved(fixes, [30], -1.8)) == [30]
    assert verdict.gate is Gate.ACCELERATION
    assert verdict.reason.startswith("speed would go from 10.0 to 1.0 m/s in 0.20 s; 1.80 m off")


def test_a_fix_off_the_way_by_less_than_a_step_explains_is_rejected_for_both_steps() -> None:
    verdicts = judge(moved(drive(20), [10], 1.9))
    assert rejected(moved(drive(20), [10], 1.9)) == [10]
    assert verdicts[10].reason == "lies 1.90 m off the way between its neighbours"


def test_a_vehicle_may_brake_turn_and_reverse() -> None:
    """At 10 Hz with 2 cm: full braking, a turn on the spot's edge, a three-point turn."""
    speed = [6.0] * 50 + [max(0.0, 6.0 - 0.4 * k) for k in range(30)] + [1.5] * 60 + [-1.2] * 60
    turn = [0.0] * 80 + [1.0] * 60 + [-1.0] * 60  # radians a second
    noise = np.random.default_rng(7).normal(0.0, 0.02, (200, 2))
    fixes, east, north, heading = [], 0.0, 0.0, 0.3
    for k in range(200):
        heading += 0.1 * turn[k]
        east += 0.1 * speed[k] * math.sin(heading)
        north += 0.1 * speed[k] * math.cos(heading)
        fix = GOOD._replace(
            time_ns=NOON + k * SECOND // 10, lat_deg=41.65 + north_deg(north + noise[k, 0])
        )
        fixes.append(aside(fix, east + noise[k, 1]))
    assert rejected(fixes) == []


def test_a_solution_that_has_moved_is_followed_from_a_marked_seam() -> None:
    fixes = moved(drive(100), range(40, 100), 30.0)
    verdicts = judge(fixes)
    assert rejected(fixes) == []
    assert verdicts[40].gate is Gate.SEAM
    assert verdicts[40].reason.startswith("the solution has moved: 60 fixes agree on it; jump of")
    assert {v for k, v in enumerate(verdicts) if k != 40} == {Judged(True)}


@pytest.mark.parametrize(
    ("period_s", "before", "after"),
    [(0.2, 30, 15), (0.2, 15, 30), (1.0, 20, 10), (0.02, 200, 150), (0.02, 150, 200)],
)
def test_a_move_needs_fixes_enough_and_time_enough(
    period_s: float, before: int, after: int
) -> None:
    """10 fixes and 3 s, be they the ones before it or those after it."""

    def seams(before: int, after: int) -> list[int]:
        fixes = drive(before + after, period_s=period_s)
        verdicts = judge(moved(fixes, range(before, before + after), 60.0))
        return [k for k, v in enumerate(verdicts) if v.gate is Gate.SEAM]

    assert seams(before, after) == [before]
    if before > after:
        assert seams(before, after - 2) == []
    else:
        assert seams(before - 2, after) == []


def test_an_excursion_is_rejected_below_twice_that() -> None:
    fixes = drive(200)
    assert rejected(moved(fixes, range(50, 77), 30.0)) == list(range(50, 77))
    longer = judge(moved(fixes, range(50, 79), 30.0))
    assert [k for k, v in enumerate(longer) if v.gate is Gate.SEAM] == [50, 79]


@pytest.mark.parametrize("wrong", [1, 3, 9])
def test_wrong_first_fixes_do_not_lock_the_others_out(wrong: int) -> None:
    fixes = moved(drive(100), range(wrong), 400.0)
    verdicts = judge(fixes)
    assert rejected(fixes) == list(range(wrong))
    later = 100 - wrong
    assert verdicts[0] == Judged(
        False, Gate.ALONE, f"stands alone: {later} later fixes agree elsewhere"
    )


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("gap_s", [6, 8, 3 * 3600])
def test_a_fix_after_a_dropout_is_accepted_at_once(gap_s: int, told: bool) -> None:
    fixes = drive(5 * gap_s + 200 if gap_s < 60 else 400, told=told)
    if gap_s < 60:
        fixes = [*fixes[:100], *fixes[100 + 5 * gap_s :]]
    else:
        fixes[200:] = [f._replace(time_ns=f.time_ns + gap_s * SECOND) for f in fixes[200:]]
    assert rejected(fixes) == []
    # It starts in full drive: what it did before the dropout says nothing of it.
    car = drive(20, speed_mps=0.0, told=told) + [
        fix._replace(time_ns=fix.time_ns + (4 + gap_s) * SECOND)
        for fix in drive(20, speed_mps=15.0, told=told)
    ]
    assert rejected(centimetres(car)) == []
    # It stood before and after, and drove in between.
    parked = drive(20, speed_mps=0.0, told=told)
    elsewhere = [f._replace(time_ns=f.time_ns + 12 * SECOND) for f in parked]
    assert rejected(parked + moved(elsewhere, range(20), 30.0)) == []


def test_speeds_that_the_track_contradicts_are_not_believed() -> None:
    stuck = [fix._replace(speed_mps=0.0) for fix in centimetres(drive(100, speed_mps=9.0))]
    assert rejected(stuck) == []


@pytest.mark.parametrize("speed_mps", [math.nan, math.inf, -3.0])
def test_an_impossible_speed_is_none(speed_mps: float) -> None:
    fixes = [fix._replace(speed_mps=speed_mps) for fix in drive(60)]
    assert rejected(moved(fixes, [30], 6.0)) == [30]


def test_a_confident_sigma_does_not_lock_a_noisy_receiver_out() -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.13, 300)
    fixes = [
        fix._replace(lat_deg=fix.lat_deg + north_deg(noise[k]), quality=4, sigma_m=0.001)
        for k, fix in enumerate(drive(300, told=False))
    ]
    assert len(rejected(fixes)) <= 3


def test_a_step_between_qualities_is_explained_by_the_worse_one() -> None:
    """RTK that falls back to plain GPS and returns: nobody has jumped."""
    fixes = [fix._replace(quality=4, sigma_m=None) for fix in drive(300)]
    fixes[100:200] = [fix._replace(quality=1) for fix in moved(fixes[100:200], range(100), 4.0)]
    assert rejected(fixes) == []
    short = [fix._replace(quality=4, sigma_m=None) for fix in drive(300)]
    short[100] = moved(short, [100], 5.0)[100]._replace(quality=1)
    assert rejected(short) == []


def test_of_two_that_disagree_the_better_ones_are_kept() -> None:
    fixes = [fix._replace(quality=4, sigma_m=None) for fix in drive(400)]
    fixes[100:200] = [fix._replace(quality=1) for fix in moved(fixes[100:200], range(100), 25.0)]
    assert rejected(fixes) == list(range(100, 200))


def test_bad_fixes_that_stay_elsewhere_are_followed_in_the_end() -> None:
    fixes = [fix._replace(quality=4, sigma_m=None) for fix in drive(400)]
    for count, seams in ((50, []), (60, [300])):
        later = range(300, 300 + count)
        mixed = [
            fix._replace(quality=1) if k in later else fix
            for k, fix in enumerate(moved(fixes[: 300 + count], later, 25.0))
        ]
        verdicts = judge(mixed)
        assert [k for k, v in enumerate(verdicts) if v.gate is Gate.SEAM] == seams


def test_stamps_rounded_to_the_second_are_not_taken_for_jumps() -> None:
    """A fix every 1.3 s, stamped with the second it falls into."""
    steady = centimetres(drive(300, period_s=1.3, speed_mps=9.0))
    rounded = [fix._replace(time_ns=fix.time_ns // SECOND * SECOND) for fix in steady]
    assert rejected(rounded) == []


def test_jumps_that_do_not_agree_are_no_move() -> None:
    fixes = drive(100)
    fixes = moved(moved(fixes, range(40, 70, 2), 40.0), range(41, 70, 2), -40.0)
    assert rejected(fixes) == list(range(40, 70))  # 6 s, and 15 fixes on either side


def test_no_fix_has_no_verdict() -> None:
    assert judge([]) == []


def test_across_the_180th_meridian_a_drive_is_one() -> None:
    fixes = [
        fix._replace(lon_deg=(179.9999705 + k * 1e-6 + 180.0) % 360.0 - 180.0)
        for k, fix in enumerate(drive(60, told=False))
    ]
    assert min(fix.lon_deg for fix in fixes) < 0.0 < max(fix.lon_deg for fix in fixes)
    assert rejected(fixes) == []


def test_the_first_gate_that_a_fix_fails_gives_the_reason() -> None:
    """Each change undoes the gate before, so the next one speaks."""
    fixes = drive(30)
    bad = fixes[10]._replace(
        lat_deg=41.65 + north_deg(400.0), height_m=math.nan, quality=6, satellites=2, hdop=9.0,
        age_s=999.0, time_ns=fixes[9].time_ns,
    )  # fmt: skip
    found = []
    for change in (
        {}, {"height_m": 787.4}, {"quality": 4}, {"satellites": 9}, {"hdop": 1.0}, {"age_s": 1.0},
        {"time_ns": fixes[10].time_ns},
    ):  # fmt: skip
        bad = bad._replace(**change)
        found.append(judge([*fixes[:10], bad, *fixes[11:]])[10].gate)
    assert found == [
        Gate.PLACE, Gate.QUALITY, Gate.SATELLITES, Gate.HDOP, Gate.AGE, Gate.TIME, Gate.JUMP,
    ]  # fmt: skip


@given(
    st.dictionaries(
        st.integers(0, 119),
        st.tuples(st.floats(25.0, 5e4), st.floats(-math.pi, math.pi)),
        max_size=6,
    ),
    st.booleans(),
    st.sampled_from([0.0, 1.5, 8.0]),
)
@example({0: (25.0, 0.0), 1: (25.0, 0.0), 3: (25.0, 0.0)}, False, 0.0)
@example({0: (25.0, 0.0), 6: (25.0, 1.0), 8: (26.0, 0.0)}, False, 0.0)
@settings(max_examples=60, deadline=None)
def test_wild_fixes_put_in_change_no_other_verdict(
    wild: dict[int, tuple[float, float]], told: bool, speed_mps: float
) -> None:
    intact = drive(120, told=told, speed_mps=speed_mps)
    fixes, is_wild = [], []
    for k, fix in enumerate(intact):
        fixes.append(fix)
        is_wild.append(False)
        if k in wild:
            metres, angle = wild[k]
            (off,) = moved([fix], [0], metres * math.cos(angle))
            off = aside(off, metres * math.sin(angle))
            fixes.append(off._replace(time_ns=fix.time_ns + SECOND // 10))
            is_wild.append(True)
    assert rejected(fixes) == [k for k, wrong in enumerate(is_wild) if wrong]


@given(
    st.lists(
        st.builds(
            Fix,
            st.integers(-(2**63), 2**63 - 1) | st.integers(NOON, NOON + 10 * SECOND),
            st.floats(-95.0, 95.0) | st.sampled_from([41.0, 41.00001, math.nan]),
            st.floats(-190.0, 190.0) | st.sampled_from([-4.0, -4.00001, math.inf]),
            st.floats() | st.just(100.0),
            st.sampled_from(Quality),
            heading_quality=st.none(),
            satellites=st.none() | st.integers(0, 99),
            speed_mps=st.none() | st.floats(),
            sigma_m=st.none() | st.floats(),
        ),
        max_size=40,
    )
)
@settings(max_examples=150, deadline=None)
def test_whatever_the_fixes_the_verdicts_can_be_used(fixes: list[Fix]) -> None:
    fixes = sorted(fixes, key=lambda fix: fix.time_ns)
    verdicts = judge(fixes)
    assert len(verdicts) == len(fixes)
    times = [f.time_ns for f, v in zip(fixes, verdicts, strict=True) if v.ok]
    assert all(a < b for a, b in pairwise(times))
    for verdict in verdicts:
        assert bool(verdict.reason) == (verdict.gate is not Gate.NONE)
        assert (verdict.ok) == (verdict.gate in (Gate.NONE, Gate.SEAM))
    log = FixColumns.of_rows(fixes)
    assert summarise(log, condition(log)).accepted == len(times)


@pytest.mark.parametrize(
    "values",
    [{"moved_fixes": 1}, {"max_hdop": 0.0}, {"allowed_quality": []}, {"sigmas": -1}, {"typo": 1}],
)
def test_limits_that_cannot_be_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        GateLimits(**values)


# --- real logs


def test_no_disturbance_of_the_decimetre_log_gets_through(shared_data: SharedData) -> None:
    folder = shared_data("vineyard_two_lanes")
    log = read(folder / "gnss" / "gnss_sf1.nmea")
    assert (len(log.fixes), log.no_position, log.bad_checksum, log.broken) == (403, 15, 2, 4)
    error = {
        int(row["timestamp_utc_s"].replace(".", "")) * 1_000_000: (
            float(row["err_E"]),
            float(row["err_N"]),
        )
        for row in csv.DictReader(
            (folder / "truth" / "gnss_sf1_errors.csv").read_text().splitlines()
        )
    }
    events = json.loads((folder / "truth" / "gnss_sf1_events.json").read_text())
    start_ns = min(error)
    disturbed = {
        start_ns + (event["first_epoch"] + k) * SECOND // 5
        for event in events
        if event["type"] == "multipath_jump"
        for k in range(event["n_epochs"])
    }

    def beyond_bias_m(time_ns: int) -> float:
        """Error of a fix less the slow bias: the median of the calm fixes within 5 s."""
        calm = [e for t, e in error.items() if abs(t - time_ns) < 5 * SECOND and t not in disturbed]
        bias = [median(values) for values in zip(*calm, strict=True)]
        return math.dist(error[time_ns], bias)

    verdicts = judge(log.fixes)
    accepted = [f.time_ns for f, v in zip(log.fixes, verdicts, strict=True) if v.ok]
    assert [t for t in accepted if beyond_bias_m(t) > 1.5] == []
    assert len(accepted) == 403 - len(disturbed)  # and nothing good was lost


def test_nothing_of_the_centimetre_log_is_rejected(shared_data: SharedData) -> None:
    log = read(shared_data("vineyard_two_lanes") / "gnss" / "gnss_rtk.nmea")
    assert (len(log.fixes), log.bad_checksum + log.broken) == (437, 0)
    assert rejected(log.fixes) == []


def test_real_receivers_are_understood(shared_data: SharedData) -> None:
    corpus = shared_data("gnss/gpsd_corpus")
    rtk = read(corpus / "nmea-rtk.log").fixes
    assert (len(rtk), rtk[0].quality) == (122, 2)
    compass = read(corpus / "skytraq-PX1172RH_DS.log").fixes
    assert compass[0].heading_deg == pytest.approx(-115.72)
    for path in sorted(corpus.glob("*.log")):
        with suppress(GnssError):  # some have no date, which is the one thing to complain of
            judge(read(path).fixes)
