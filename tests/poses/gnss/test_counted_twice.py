"""A clock that is set back is found, and rows in another order are not taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import GnssError, Int64, PoseSettings
from fieldgrid.geometry import FixColumns, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.fused import conditioned
from fieldgrid.poses.gates.counted_twice import counted_twice
from tests.simulated import DATUM, SECOND, Command, fixes_of, simulate

DRIVE = simulate(
    [c for k in range(3) for c in (Command(25.0, 1.5), Command(9.0, 1.2, 0.3 * (-1) ** k))],
    40.0,
    speed_mps=1.5,
)
LOG = fixes_of(DRIVE, 0.2, 0.01)
MIDDLE = len(LOG) // 2
RANDOM = np.random.default_rng(4)


def set_back(by_s: float, row: int = MIDDLE) -> FixColumns:
    later = np.arange(len(LOG)) >= row
    return LOG.replace(time_ns=LOG.time_ns - round(by_s * SECOND) * later)


@pytest.mark.parametrize("by_s", [1.0, 6.1, 18.0])
def test_seconds_that_are_counted_twice_are_found(by_s: float) -> None:
    twice, (span,) = counted_twice(set_back(by_s))
    rows = round(by_s * 5.0)
    expected = np.abs(np.arange(len(LOG)) - MIDDLE + 0.5) < rows
    np.testing.assert_array_equal(twice, expected)
    assert span.rows == 2 * rows
    assert span.seconds == pytest.approx(by_s, abs=0.25)
    assert span.start_ns == LOG.time_ns[MIDDLE] - round(by_s * SECOND)


def test_twice_set_back_is_found_twice() -> None:
    time_ns = set_back(3.0).time_ns - 4 * SECOND * (np.arange(len(LOG)) >= MIDDLE + 100)
    twice, spans = counted_twice(LOG.replace(time_ns=time_ns))
    assert len(spans) == 2
    assert np.count_nonzero(twice) == 2 * (15 + 20)


def late_rows(most: float) -> Int64:
    return np.argsort(np.arange(len(LOG)) + RANDOM.uniform(0.0, most, len(LOG)))


def a_part_late() -> Int64:
    """A buffer that is written after what followed it."""
    return np.r_[0:100, 150:300, 100:150, 300 : len(LOG)]


def halves_exchanged() -> Int64:
    return np.r_[MIDDLE : len(LOG), 0:MIDDLE]


def written_twice() -> Int64:
    return np.r_[0 : len(LOG), 0 : len(LOG)]


@pytest.mark.parametrize(
    "rows",
    [
        late_rows(6.0),
        late_rows(30.0),
        a_part_late(),
        halves_exchanged(),
        written_twice(),
        np.arange(400),
    ],
)
def test_rows_in_another_order_are_left_alone(rows: Int64) -> None:
    twice, spans = counted_twice(LOG[rows])
    assert not twice.any()
    assert spans == ()


def test_every_other_row_of_a_packet_may_come_late() -> None:
    """Of a receiver that scatters by decimetres, so that the rows do not lie on one path."""
    log = fixes_of(DRIVE, 0.2, 0.3)
    packets = np.arange(len(log) // 12 * 12).reshape(-1, 12)
    rows = np.concatenate([packets[:, ::2], packets[:, 1::2]], axis=1).ravel()
    twice, spans = counted_twice(log[rows])
    assert not twice.any()
    assert spans == ()


def test_a_log_in_no_order_is_left_alone() -> None:
    """To compare each pass with all before it would take hours of a large file."""

    def passes(count: int) -> FixColumns:
        rows, number = np.tile(np.arange(20), count), np.repeat(np.arange(count), 20)
        log = LOG[rows]
        return log.replace(lat_deg=log.lat_deg + 2e-5 * number, time_ns=log.time_ns + number)

    assert counted_twice(passes(5))[0].mean() > 0.9
    assert not counted_twice(passes(201))[0].any()


def test_single_stamps_far_off_are_left_alone() -> None:
    time_ns = LOG.time_ns.copy()
    time_ns[[100, 200]] += np.array([7200, -7200]) * SECOND
    assert not counted_twice(LOG.replace(time_ns=time_ns))[0].any()


def test_a_drive_whose_clock_is_set_back_is_used_but_for_these_seconds() -> None:
    """In order of time its positions alternate: every pose was refused."""
    log = set_back(10.0)
    estimate = estimate_poses(log, None, DATUM)
    (note,) = (one for one in estimate.report.notes if "counts" in one)
    assert "The log counts 9.8 s twice, at two places (first 41 s after its start)" in note
    assert "These 100 fixes were not used" in note
    order = np.argsort(log.time_ns, kind="stable")
    truth = DRIVE.at((LOG.time_ns[order] - LOG.time_ns[0]) / 1e9)
    track, rows = estimate.trajectory, estimate.fix_row
    used = track.accepted[rows]
    assert used.mean() > 0.7
    off = np.abs(wrap_deg(track.heading_deg[rows] - np.degrees(truth.heading_rad)))[used]
    assert np.mean(off <= 3.0 * track.heading_sigma_deg[rows][used]) > 0.98
    away = np.hypot(track.east_m[rows] - truth.east_m, track.north_m[rows] - truth.north_m)
    assert away[used].max() < 0.1


def test_a_drive_of_which_nothing_is_left_is_told_to_be_cut() -> None:
    estimate = estimate_poses(set_back(18.0, 100)[np.arange(200)], None, DATUM)
    assert not estimate.trajectory.accepted.any()
    note = estimate.report.notes[-1]
    assert "the log counts its time twice, at two places; cut the log where its clock goes" in note


def test_two_logs_of_the_same_time_are_refused_with_what_helps() -> None:
    lat_deg = np.r_[LOG.lat_deg, LOG.lat_deg + 2e-5]
    both = LOG[np.r_[0 : len(LOG), 0 : len(LOG)]].replace(lat_deg=lat_deg)
    with pytest.raises(GnssError, match="cut the log where its clock goes back or another log"):
        conditioned(both, PoseSettings(), DATUM)
