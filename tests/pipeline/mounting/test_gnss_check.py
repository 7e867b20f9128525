"""The camera's ways beside the receiver's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.core import MeasuredValue
from fieldgrid.geometry import FixColumns, Mount
from fieldgrid.pipeline.checks.camera_scale import CameraScale
from fieldgrid.pipeline.mounting.gnss_check import GnssCheck, check_against_gnss, remarks
from fieldgrid.poses import Ways
from fieldgrid.recordings import FixLog, Recording
from tests.pipeline.mounting.drives import rendered
from tests.simulated import Command, fixes_of, simulate, time_ns

PERIOD_S = 0.5
RIG = rendered(Mount(2.0, 18.0), frames=2).rig


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
    assert found.scale.ratio == pytest.approx(1.0, abs=0.0015)


def check(drive: Recording, steps: Ways) -> GnssCheck:
    times = time_ns(np.arange(len(steps.stop) + 1) * PERIOD_S)
    found = check_against_gnss(drive, times, steps)
    assert isinstance(found, GnssCheck)
    return found


@pytest.mark.parametrize("scale", [1.0, 1.05, 0.9])
def test_a_wrong_baseline_shows_in_the_ways(scale: float) -> None:
    drive, ways = straight(scale)
    found = check(drive, ways)
    assert found.scale is not None
    assert found.scale.ratio == pytest.approx(scale, abs=0.01)
    assert found.course_off_deg is None
    said = remarks(found, drive.rig)
    assert [f"A baseline of {0.2 / scale:.2f}" in sentence for sentence in said] == (
        [] if scale == 1.0 else [True]
    )


def test_a_recorded_heading_is_held_against_the_course() -> None:
    found = check(*straight(1.0, heading_off_deg=2.0))
    assert found.course_off_deg is not None
    assert found.course_off_deg.value == pytest.approx(-2.0, abs=0.2)
    (sentence,) = remarks(found, RIG)
    assert "off the recorded heading" in sentence


def test_what_is_within_its_error_needs_no_remark() -> None:
    close = GnssCheck(CameraScale(1.04, 0.02, 60.0), MeasuredValue(0.6, 0.3))
    assert remarks(close, RIG) == []
    assert remarks(GnssCheck(None, None), RIG) == []


def test_few_ways_and_no_good_fixes_are_not_compared() -> None:
    drive, ways = straight(1.0)
    few = Ways(*(column[:6] for column in ways))
    assert check(drive, few).scale is None
    without = replace(drive, log=FixLog(FixColumns.of([])))
    assert check_against_gnss(without, time_ns(np.zeros(1)), ways) == (
        "No fixes, so nothing was compared with them."
    )
    log = drive.fixes()
    refused = log.replace(quality=np.zeros(len(log), dtype=np.int64))
    said = check_against_gnss(replace(drive, log=FixLog(refused)), time_ns(np.zeros(1)), ways)
    assert isinstance(said, str)
    assert said.startswith("Nothing was compared with the fixes: ")
