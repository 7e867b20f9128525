"""The summary of a log and its verdicts."""

from __future__ import annotations

import json

import pytest

from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.poses import ConditioningSummary, Gate
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.summary import FixGap, ReasonCount, summarise
from tests.poses.gnss.sentences import NOON, SECOND


def log() -> list[Fix]:
    """20 s at 5 Hz: no solution for a while, a hole, a shift, some RTK float, few satellites."""
    fixes = [
        Fix(NOON + k * SECOND // 5, 41.65 + round(k * 2.7e-6, 7), -4.72, 700.0, 4, 12)
        for k in range(100)
    ]
    fixes[10:13] = [fix._replace(quality=0) for fix in fixes[10:13]]
    fixes[5] = fixes[5]._replace(satellites=3)
    fixes[20:25] = [fix._replace(quality=5) for fix in fixes[20:25]]
    fixes[60:] = [fix._replace(lat_deg=fix.lat_deg + 1e-3) for fix in fixes[60:]]
    return [*fixes[:30], *fixes[38:]]


def summary_of(fixes: list[Fix]) -> ConditioningSummary:
    columns = FixColumns.of_rows(fixes)
    return summarise(columns, condition(columns))


def test_it_counts_what_was_rejected_and_measures_what_is_left() -> None:
    fixes = log()
    summary = summary_of(fixes)
    assert (summary.fixes, summary.accepted) == (92, 88)
    assert summary.rejected == (
        ReasonCount(
            Gate.QUALITY, 3, fixes[10].time_ns, fixes[12].time_ns,
            "quality 0 (none) is not allowed",
        ),
        ReasonCount(Gate.SATELLITES, 1, fixes[5].time_ns, fixes[5].time_ns, "3 satellites < 5"),
    )  # fmt: skip
    assert summary.quality == ((0, 3), (4, 84), (5, 5))
    assert summary.gaps == (FixGap(fixes[29].time_ns, fixes[29].lat_deg, -4.72, 1.8),)
    (seam,) = summary.seams
    assert (seam.time_ns, seam.lat_deg) == (fixes[52].time_ns, fixes[52].lat_deg)
    assert seam.reason.startswith("the solution has moved: 40 fixes agree on it; jump of 111")
    assert summary.rate_hz == pytest.approx(5.0)
    assert summary.quantum_m == pytest.approx(0.0111, abs=1e-4)
    assert 0.003 <= summary.short_term_sigma_m <= 0.02


def test_it_can_be_written_as_json() -> None:
    fixes = log()
    summary = summary_of(fixes)
    read = json.loads(json.dumps(summary.as_dict()))
    assert read["rejected"][0] == {
        "gate": "quality",
        "fixes": 3,
        "first_ns": fixes[10].time_ns,
        "last_ns": fixes[12].time_ns,
        "example": "quality 0 (none) is not allowed",
    }
    assert read["quality"] == {"none": 3, "RTK fixed": 84, "RTK float": 5}
    assert read["gaps"][0]["seconds"] == 1.8
    assert read["seams"][0]["time_ns"] == fixes[52].time_ns
    assert set(read) == set(summary._fields)


def test_of_nothing_there_is_nothing_to_say() -> None:
    summary = summary_of([])
    assert summary[:7] == (0, 0, (), (), (), (), 0.0)
    single = log()[:1]
    assert summary_of(single).rate_hz == 0.0
