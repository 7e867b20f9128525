"""The first run on a machine, which compiles: said on the screen, and done on two cores."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fieldgrid.cli import output
from fieldgrid.kernel import when_compiling

if TYPE_CHECKING:
    from fieldgrid.rig import StereoCamera

_AHEAD = "import sys; from fieldgrid.cli.warming import compile_ahead; compile_ahead(sys.argv[1])"


def tell_of_compiling() -> None:
    """Say it on a terminal when the inner loops have to be compiled."""

    def say() -> None:
        if output.shows_progress():
            output.message(
                "compiling the inner loops for this machine, which takes up to a minute; "
                "later runs load them"
            )

    when_compiling(say)


@contextmanager
def half_ahead(*, here: bool = True) -> Iterator[None]:
    """While this process compiles what poses need, let another one compile what frames and the map
    need, where frames are staged `here`, on this machine.

    Numba compiles one function at a time in a process. Where there is a single core, the code is
    kept already, or there is no place to keep it or for temporary files, nothing is started; what
    is not ready at the end is given up.
    """
    from fieldgrid.binning import bin_pixels
    from fieldgrid.workers.order import cores

    if not here or cores() < 2 or bin_pixels.cache_folder() is None or bin_pixels.is_kept():
        yield
        return
    try:
        place = tempfile.TemporaryDirectory(prefix="fieldgrid-", ignore_cleanup_errors=True)
    except OSError:  # a build can do without, the other process cannot
        yield
        return
    with place as folder:
        process = subprocess.Popen(
            [sys.executable, "-c", _AHEAD, folder],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            # Ctrl-C is for the command, which ends this process.
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        try:
            yield
        finally:
            process.kill()
            process.wait()


def compile_ahead(folder: str) -> None:
    """Compile one half of what a build needs, and keep the code: what a frame of a stereo camera
    goes through, the motion between two of them, and the map, of which one is made in a folder.

    The other half are poses, and finding and comparing corners. What a build needs last comes last
    here, too: the command gets there when this is nearly done, and compiles little of the same.
    """
    from fieldgrid.geodesy import Datum
    from fieldgrid.live.pushed import warm_up
    from fieldgrid.localgrid import LocalGridder
    from fieldgrid.mapfile import create_map
    from fieldgrid.rig import LeverArm, Mount, Rig, StereoCamera
    from fieldgrid.rotations import Tilt
    from fieldgrid.trajectory import Pose

    camera = StereoCamera(640, 480, 500.0, 319.5, 239.5, 0.12)
    rig = Rig(camera, Mount(height_m=1.2, tilt_deg=15.0), LeverArm(0.0, 0.0, 2.0))
    staged = warm_up(LocalGridder(rig), odometry=False, tilt=Tilt(0.0, 0.0))
    _follow_points(camera)
    with (
        create_map(Path(folder, "map.gpkg"), Datum(45.0, 5.0, 200.0)) as made,
        made.add_session("drive") as session,
    ):
        for k in range(2):  # so far apart that the map has levels above its tiles
            pose = Pose(k, 0.0, 50.0 * k, 0.0, 0.0, 0.1, 0.5, 1.0)
            session.add_staged(replace(staged, frame_id=str(k), time_ns=k), pose)


def _follow_points(camera: StereoCamera) -> None:
    """Find the motion of points that do not move."""
    import numpy as np

    from fieldgrid.odometry.rigid import Lens, refine, search

    low, high = (0.0, 0.0, 5.0), (camera.width_px, camera.height_px, 50.0)
    px = np.random.default_rng(0).uniform(low, high, (200, 3))
    lens = Lens(camera.focal_px, camera.cx_px, camera.cy_px, camera.focal_baseline_px_m)
    depth_m = lens.focal_baseline_px_m / px[:, 2]
    right, down = (px[:, :2] - (lens.cx_px, lens.cy_px)).T / lens.focal_px
    points_m = np.stack([right * depth_m, down * depth_m, depth_m], axis=1)
    found = search(points_m, points_m, px, lens)
    assert found is not None
    refine(found, points_m, px, px, np.ones((len(px), 2)), lens)
