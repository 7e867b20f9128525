"""Where the camera looks beside where the vehicle goes, injected and found again."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, Motion, Steps
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.faults.camera_yaw import CameraYaw, yaw_findings
from tests.simulated import DATUM, SLALOM, Command, Drive, fixes_of, simulate, steps_of

ROWS = [Command(20.0, 1.5), *SLALOM, Command(20.0, 1.5), Command(10.0, -1.0), Command(20.0, 1.5)]


def turned(steps: Steps, yaw_deg: float) -> Steps:
    """Steps as a camera sees them that looks so far to the right of what is declared."""
    sin, cos = np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg))
    forward_m = cos * steps.forward_m + sin * steps.right_m
    right_m = cos * steps.right_m - sin * steps.forward_m
    return steps._replace(forward_m=forward_m, right_m=right_m)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate(ROWS, 20.0, speed_mps=1.5)


def seen(drive: Drive, steps: Steps | None) -> CameraYaw | None:
    motion = Motion(steps=steps)
    return estimate_poses(
        fixes_of(drive, 0.2, 0.01), Carrier(0.0), DATUM, motion=motion
    ).report.camera_yaw


@pytest.mark.parametrize("yaw_deg", [-3.0, 0.0, 1.2])
@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_looks_aside_is_measured(drive: Drive, yaw_deg: float, seed: int) -> None:
    found = seen(drive, turned(steps_of(drive, noise=1.0, seed=seed), yaw_deg))
    assert found is not None
    assert found.off_deg == pytest.approx(yaw_deg, abs=4.0 * found.sigma_deg)
    assert found.sigma_deg < 0.3
    assert found.is_off == (yaw_deg != 0.0)
    assert found.turned_deg == 0.0
    assert len(list(yaw_findings(found))) == (yaw_deg != 0.0)


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_camera_that_is_pushed_is_told(drive: Drive, share: float) -> None:
    steps = steps_of(drive, noise=1.0, seed=5)
    at, pushed = int(share * len(steps.start_ns)), turned(steps, 2.5)
    halves = zip(steps, pushed, strict=True)
    mixed = Steps._make(np.concatenate([one[:at], two[at:]]) for one, two in halves)
    found = seen(drive, mixed)
    assert found is not None
    assert 1.0 < found.turned_deg < 3.0
    assert len(list(yaw_findings(found))) == 1


def test_without_steps_there_is_none(drive: Drive) -> None:
    assert seen(drive, None) is None
