"""The camera's ways beside the receiver's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.core import MeasuredValue
from fieldgrid.geometry import FixColumns, Mount
from fieldgrid.pipeline.mounting.gnss_check import GnssCheck, check_against_gnss, remarks
from fieldgrid.poses import Ways
from fieldgrid.recordings import FixLog, Recording
from tests.pipeline.mounting.drives import rendered
from tests.simulated import Command, fixes_of, simulate, time_ns

PERIOD_S = 0.5


def straight(scale: float, heading_off_deg: float | None = None) -> tuple[Recording, Ways]:
    """A drive of 60 m, and what a camera with a wrong baseline would have seen of it."""
    truth = simulate([Command(40.0, 1.5)], 40.0, speed_mps=1.5)
    sigma = None if heading_off_deg is None else 0.1
    log = fixes_of(truth, noise_m=0.01, heading_sigma_deg=sigma)
    if heading_off_deg is not None:
        log = log.replace(heading_deg=log.heading_deg + heading_off_deg)
    drive = replace(rendered(Mount(2.0, 18.0), frames=2), log=FixLog(log))
    n = int(40.0 / PERIOD_S)
    zeros = np.zeros(n)
    return drive, Ways(np.arange(1, n + 1), np.full(n, 1.5 * PERIOD_S * scale), zeros, zeros, zeros)


def test_gentle_curves_are_compared_by_their_chords() -> None:
    curvature, distance_m = 0.045, 1.5 * PERIOD_S
    truth = simulate([Command(40.0, 1.5, curvature)], speed_mps=1.5)
    drive = straight(1.0)[0]
    rig = replace(drive.rig, rear_axle_forward_m=drive.rig.antenna.forward_m)
    drive = replace(drive, rig=rig, log=FixLog(fixes_of(truth)))
    n = int(40.0 / PERIOD_S)
    turn_deg = np.full(n, math.degrees(distance_m * curvature))
    arcs = Ways(
        np.arange(1, n + 1), np.full(n, distance_m), np.zeros(n), turn_deg, np.full(n, curvature)
    )
    found = check(drive, arcs)
    assert found.scale is not None
    assert found.scale.value == pytest.approx(1.0, abs=0.0015)


def check(drive: Recording, steps: Ways) -> GnssCheck:
    times = time_ns(np.arange(len(steps.stop) + 1) * PERIOD_S)
    found = check_against_gnss(drive, times, steps)
    assert isinstance(found, GnssCheck)
    return found


@pytest.mark.parametrize("scale", [1.0, 1.05, 0.9])
def test_a_wrong_baseline_shows_in_the_ways(scale: float) -> None:
    found = check(*straight(scale))
    assert found.scale is not None
    assert found.scale.value == pytest.approx(scale, abs=0.01)
    assert found.course_off_deg is None
    said = remarks(found)
    if scale == 1.0:
        assert said == []
    else:
        (sentence,) = said
        assert ("too long" in sentence) is (scale > 1.0)
        assert "baseline" in sentence


def test_a_recorded_heading_is_held_against_the_course() -> None:
    found = check(*straight(1.0, heading_off_deg=2.0))
    assert found.course_off_deg is not None
    assert found.course_off_deg.value == pytest.approx(-2.0, abs=0.2)
    (sentence,) = remarks(found)
    assert "off the recorded heading" in sentence


def test_what_is_within_its_error_needs_no_remark() -> None:
    assert remarks(GnssCheck(MeasuredValue(1.03, 0.02), MeasuredValue(0.6, 0.3))) == []
    assert remarks(GnssCheck(None, None)) == []


def test_curves_gaps_and_lone_fixes_are_not_compared() -> None:
    drive, steps = straight(1.0)
    curved = steps._replace(curvature_per_m=np.full(len(steps.stop), 0.2))
    assert check(drive, curved).scale is None
    lone = steps._replace(stop=steps.stop * 2)
    assert check(drive, lone._replace(stop=lone.stop % 70)).scale is None
    without = replace(drive, log=FixLog(FixColumns.of([])))
    assert check_against_gnss(without, time_ns(np.zeros(1)), steps) == (
        "No fixes, so nothing was compared with them."
    )
    log = drive.fixes()
    refused = log.replace(quality=np.zeros(len(log), dtype=np.int64))
    said = check_against_gnss(replace(drive, log=FixLog(refused)), time_ns(np.zeros(1)), steps)
    assert isinstance(said, str)
    assert said.startswith("Nothing was compared with the fixes: ")
