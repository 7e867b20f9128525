"""Whether the camera measures as many metres as are driven."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import Severity
from fieldgrid.geometry import Steps, Trajectory
from fieldgrid.pipeline.checks.camera_scale import (
    camera_scale,
    scale_findings,
    tells_heights,
)
from fieldgrid.poses import estimate_poses
from fieldgrid.recordings import open_drive
from tests.scenes import paper_rig
from tests.simulated import DATUM, Command, fixes_of, simulate, steps_of

RIG = paper_rig()
STRAIGHT = simulate([Command(40.0, 1.5)], 20.0, speed_mps=1.5)


def driven(stated_m: float = 0.02) -> Trajectory:
    fixes = fixes_of(STRAIGHT, 0.2, 0.01)
    fixes = fixes.replace(sigma_m=np.full(len(fixes), stated_m))
    return estimate_poses(fixes, None, DATUM).trajectory


def scaled(by: float) -> Steps:
    steps = steps_of(STRAIGHT, 0.5)
    return steps._replace(forward_m=by * steps.forward_m, right_m=by * steps.right_m)


@pytest.mark.parametrize(("stated_m", "least"), [(0.02, 0.005), (0.3, 0.0075)])
def test_a_scale_is_no_surer_than_calibration_and_fixes(stated_m: float, least: float) -> None:
    """Steps without noise agree with each other, and share what the parts do not show."""
    found = camera_scale(scaled(1.0), driven(stated_m), heights_told=True)
    assert found is not None
    assert found.ratio == pytest.approx(1.0, abs=0.01)
    assert least < found.sigma < 0.02
    assert not found.is_off


@pytest.mark.parametrize(
    ("by", "severities"),
    [(0.98, []), (1.04, [Severity.WARNING]), (0.92, [Severity.ERROR])],
)
def test_a_baseline_that_is_wrong_is_told_and_stops_a_build_from_a_twentieth(
    by: float, severities: list[Severity]
) -> None:
    found = camera_scale(scaled(by), driven(), heights_told=True)
    assert found is not None
    assert found.ratio == pytest.approx(by, abs=0.01)
    told = list(scale_findings(found, RIG))
    assert [one.severity for one in told] == severities
    if told:
        assert told[0].code == "scale"
        right_m = RIG.camera.baseline_m / found.ratio
        assert f"A baseline of {right_m:.4f} m instead of" in told[0].remedy


def test_a_way_up_a_slope_is_longer_than_its_plan() -> None:
    """Twenty degrees: a camera sees 6 % more than the plan has."""
    trajectory = driven()
    climb = np.tan(np.radians(20.0))
    way_m = np.hypot(trajectory.east_m, trajectory.north_m)
    noise_m = np.random.default_rng(2).normal(0.0, 0.1, len(way_m))
    sloping = replace(trajectory, up_m=climb * way_m + noise_m)
    longer = scaled(1.0 / np.cos(np.radians(20.0)))
    found = camera_scale(longer, sloping, heights_told=True)
    assert found is not None
    assert found.ratio == pytest.approx(1.0, abs=0.01)
    # Without heights it may be a slope, and is not called a fault.
    unknown = camera_scale(longer, trajectory, heights_told=False)
    assert unknown is not None
    assert not unknown.is_off


def test_without_a_camera_or_a_way_there_is_no_scale() -> None:
    assert camera_scale(None, driven(), heights_told=True) is None
    few = Steps(*(column[:6] for column in scaled(1.0)))
    assert camera_scale(few, driven(), heights_told=True) is None


def test_a_log_without_heights_tells_none(tmp_path: Path) -> None:
    """Its fixes have 0 m, all of them."""
    for heights, tells in (("", False), (",alt_m", True)):
        log = tmp_path / "fixes.csv"
        rows = (
            f"{1_308_133_811 + k},{41.65 + k * 1e-6:.8f},-4.72{heights and f',{700 + k / 10}'}"
            for k in range(5)
        )
        log.write_text("\n".join([f"timestamp_utc_s,lat_deg,lon_deg{heights}", *rows]) + "\n")
        with open_drive(log) as drive:
            assert tells_heights(drive.fixes()) == tells
