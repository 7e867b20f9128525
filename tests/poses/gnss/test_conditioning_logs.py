"""Conditioning of real drives, whose tables are read here as they are."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import pytest

from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.poses import ConditioningSummary, Gate, estimate_poses
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.summary import summarise
from tests.poses.gnss.judged import Judged, judge

SharedData = Callable[[str], Path]

TRACTOR_QUALITY = {"RTK Fixed": 4, "RTK Float": 5, "DGPS": 2, "Invalid": 0}


def rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(encoding="latin-1", newline="") as table:
        yield from csv.DictReader(table)


def nanoseconds(seconds: float) -> int:
    return round(seconds * 1e9)


def iso_ns(text: str) -> int:
    moment = datetime.fromisoformat(text[:26])
    return nanoseconds((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp())


def judged(fixes: list[Fix]) -> tuple[list[Judged], ConditioningSummary]:
    log = FixColumns.of_rows(fixes)
    return judge(fixes), summarise(log, condition(log))


def counts(summary: ConditioningSummary) -> dict[Gate, int]:
    return {reason.gate: reason.fixes for reason in summary.rejected}


@pytest.mark.parametrize(
    ("name", "repeated", "missed"),
    [
        ("00_boundary_log_20260804_115620", 0.51, 0.04),  # rows at 20 Hz and more, fixes at 10
        ("62_Collins_polygon_1_20260727_144657", 0.004, 0.04),  # rows at 5 Hz
        ("headvalid_straight_15m_20260805_114856", 0.50, 0.05),
        ("stationary_engine_on_20260805", 0.0, 0.04),
    ],
)
def test_of_a_real_tractor_only_repeats_are_rejected(
    name: str, repeated: float, missed: float, shared_data: SharedData
) -> None:
    table = rows(shared_data(f"gnss/tractor2025/compact/{name}.csv"))
    fixes = [
        Fix(
            iso_ns(row["time"]), float(row["lat"]), float(row["lon"]), 0.0,
            TRACTOR_QUALITY[row["fix_quality"]], int(row["numSV"]), float(row["hdop"]),
            float(row["diff_age"]) if row["diff_age"] else None,
            speed_mps=float(row["speed_mps"] or "nan"),
        )
        for row in table
    ]  # fmt: skip
    verdicts, summary = judged(fixes)
    # The same drive elsewhere on Earth is the same drive.
    moved = [fix._replace(lon_deg=fix.lon_deg + 80.0) for fix in fixes]
    assert [one.gate for one in judged(moved)[0]] == [one.gate for one in verdicts]
    assert set(counts(summary)) <= {Gate.REPEAT, Gate.QUALITY}
    assert counts(summary).get(Gate.REPEAT, 0) / len(fixes) == pytest.approx(repeated, abs=0.02)
    assert summary.seams == ()
    assert summary.quantum_m == pytest.approx(0.0185, abs=1e-4)
    assert 0.005 <= summary.short_term_sigma_m <= 0.02
    used = [fix for fix, verdict in zip(fixes, verdicts, strict=True) if verdict.ok]
    moving = [
        (a.lat_deg, a.lon_deg) == (b.lat_deg, b.lon_deg)
        for a, b in pairwise(used)
        if (b.speed_mps or 0.0) > 0.3
    ]
    assert sum(moving) <= missed * len(moving)  # they stood for up to 70 % of the rows


def test_the_jumps_of_a_real_tractor_are_found(shared_data: SharedData) -> None:
    path = shared_data("gnss/padova_tractor/padova_part1_0650_0828.csv")
    for told in (True, False):
        fixes = [
            Fix(
                iso_ns(row["time"]), float(row["lat"]), float(row["lon"]), 0.0, 1,
                speed_mps=float(row["gnss_speed_mps"]) if told else None,
            )
            for row in rows(path)
            if row["lat"]
        ]  # fmt: skip
        verdicts, summary = judged(fixes)
        jumps = [k for k, verdict in enumerate(verdicts) if verdict.gate is Gate.JUMP]
        assert 3 <= len(jumps) <= 12
        assert verdicts[jumps[0]].reason.startswith("jump of 28.75 m in 1.00 s implies 29 m/s")
        assert summary.accepted >= len(fixes) - 15
        assert summary.seams == ()


def test_a_harvester_with_stamps_in_whole_seconds_is_kept(shared_data: SharedData) -> None:
    for path in sorted(shared_data("gnss/isoxml_harvester/csv").glob("*.csv")):
        fixes = [
            Fix(
                nanoseconds(float(row["t_days1980_s"])), float(row["lat"]), float(row["lon"]), 0.0,
                4, speed_mps=float(row["drive_speed_0p1kmh"] or "nan") / 36.0,
            )
            for row in rows(path)
            if row["lat"]
        ]  # fmt: skip
        _, summary = judged(fixes)
        assert summary.accepted >= 0.99 * len(fixes), path.name
        assert summary.seams == ()
        assert summary.quantum_m == pytest.approx(0.0111, abs=1e-4)


def test_the_steps_of_a_lawn_tractor_between_two_solutions(shared_data: SharedData) -> None:
    (path,) = shared_data("gnss/lawn_tractor_5hz").glob("*.csv")
    fixes = [
        Fix(nanoseconds(float(r["timestamp_seconds"])), float(r["lat"]), float(r["lng"]), 0.0, 4)
        for r in rows(path)
    ]
    verdicts, summary = judged(fixes)
    assert [verdicts[k].gate for k in (2706, 2707, 2790)] == [Gate.JUMP] * 3
    assert summary.accepted >= 0.997 * len(fixes)


def test_cars_and_rovers_are_kept_whole(shared_data: SharedData) -> None:
    for path in sorted(shared_data("kitti_oxts").glob("*.csv")):
        for told in (True, False):
            fixes = [
                Fix(
                    iso_ns(r["timestamp"]), float(r["lat"]), float(r["lon"]), float(r["alt"]), 4,
                    sigma_m=float(r["pos_accuracy"]),
                    speed_mps=math.hypot(float(r["vf"]), float(r["vl"])) if told else None,
                )
                for r in rows(path)
            ]  # fmt: skip
            _, summary = judged(fixes)
            if path.stem.endswith("0093"):  # without satellites, 170 m down in half a minute
                estimate = estimate_poses(FixColumns.of_rows(fixes))
                assert not estimate.trajectory.accepted.any()
            else:
                assert (summary.accepted, summary.seams) == (len(fixes), ()), path.name
    for path in sorted(shared_data("gnss/acorn_rover").glob("*.csv")):
        fixes = [
            Fix(
                nanoseconds(float(r["time_stamp"])), float(r["lat"]), float(r["lon"]),
                float(r["height_m"]), 4,
            )
            for r in rows(path)
        ]  # fmt: skip
        assert judged(fixes)[1].accepted == len(fixes)


def test_the_rows_of_a_real_vineyard_are_kept_whole(shared_data: SharedData) -> None:
    def time_ns(text: str) -> int:
        *moment, millisecond = (int(part) for part in text.split("-"))
        year, month, day, hour, minute, second = moment
        whole = datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp()
        return nanoseconds(whole) + millisecond * 1_000_000

    fixes = [
        Fix(time_ns(r["Computer_Time"]), float(r["Latitude"]), float(r["Longitude"]), 0.0, 4)
        for r in rows(shared_data("vineyard_gnss_rows/Image_GPS.csv"))
    ]
    verdicts, summary = judged(fixes)
    assert all(verdict.ok for verdict in verdicts)
    assert len(summary.gaps) >= 10  # pauses of up to 84 s
