"""A session is warm before its first frame, whatever it sees with."""

from __future__ import annotations

import subprocess
import sys

import pytest

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import GridSpec, Rig
from fieldgrid.live.pushed import warm_up
from fieldgrid.perception import LocalGridder
from tests.conftest import HANGS_S, TWO_LANES
from tests.scenes import depth_rig, lidar_rig, paper_rig

KERNELS_LEFT = """
import sys
from fieldgrid.pipeline import perceive_frame
from fieldgrid.geometry import GridSpec
from fieldgrid.core.kernels import Kernel
from fieldgrid.live.pushed import warm_up
from fieldgrid.perception import LocalGridder
from fieldgrid.perception import step
from fieldgrid.recordings import open_recording
from fieldgrid.live.pose.fixed_lag import FixedLagSmoother
from fieldgrid.live.warming import warm_up_poses
from fieldgrid.core import BuildSettings

compiled = Kernel.compiled
def noted(kernel):
    if kernel._compiled is None:
        print(kernel.__name__)
    return compiled(kernel)

with open_recording(sys.argv[1], gnss="gnss_rtk.nmea") as recording:
    gridder = LocalGridder(recording.rig, GridSpec.of(BuildSettings().grid))
    warm_up(gridder, odometry=True)
    warm_up_poses(recording.rig, BuildSettings())
    Kernel.compiled = noted
    trailing = FixedLagSmoother(recording.rig, BuildSettings(), None, 20.0)
    for fix in list(recording.fixes())[:100]:
        trailing.add_fix(fix)
    trailing.asked(trailing.newest_ns).estimate()
    first, second = (perceive_frame(f, gridder, odometry=True) for f in recording.frames(0, 2))
    step(first.features, second.features, recording.rig)
"""


@pytest.mark.parametrize("rig", [paper_rig(), depth_rig(), lidar_rig(2000.0)])
def test_a_frame_of_level_ground_goes_all_the_way(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    gridder = LocalGridder(rig, GridSpec.of(BuildSettings().grid))
    made: list[int] = []
    for name in ("from_coded", "from_cloud"):
        real = getattr(LocalGridder, name)

        def counted(*arguments: object, real: object = real) -> object:
            grid, ground = real(*arguments)  # type: ignore[operator]
            made.append(int(grid.observed.sum()))
            return grid, ground

        monkeypatch.setattr(LocalGridder, name, counted)
    warm_up(gridder, odometry=True)
    (cells,) = made
    assert cells > 500


def test_the_first_frames_wait_for_no_kernel() -> None:
    """In a process of its own: in this one others have compiled them."""
    done = subprocess.run(
        [sys.executable, "-c", KERNELS_LEFT, str(TWO_LANES)],
        capture_output=True, text=True, timeout=HANGS_S, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
