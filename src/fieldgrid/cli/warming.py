"""The first run on a machine, which compiles: said on the screen, and done on two cores."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from fieldgrid.cli import output
from fieldgrid.kernel import when_compiling

_FRAMES = "from fieldgrid.cli.warming import compile_frames; compile_frames()"


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
def frames_ahead(*, here: bool = True) -> Iterator[None]:
    """While this process compiles what poses need, let another one compile what frames need, where
    frames are staged `here`, on this machine.

    Numba compiles one function at a time in a process. Where there is a single core, the code is
    kept already, or there is no place to keep it, nothing is started; what is not ready at the end
    is given up.
    """
    from fieldgrid.binning import bin_pixels
    from fieldgrid.workers.order import cores

    if not here or cores() < 2 or bin_pixels.cache_folder() is None or bin_pixels.is_kept():
        yield
        return
    process = subprocess.Popen(
        [sys.executable, "-c", _FRAMES],
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


def compile_frames() -> None:
    """Compile what frames of a stereo camera go through, and keep the code."""
    from fieldgrid.live.pushed import warm_up
    from fieldgrid.localgrid import LocalGridder
    from fieldgrid.rig import LeverArm, Mount, Rig, StereoCamera

    camera = StereoCamera(640, 480, 500.0, 319.5, 239.5, 0.12)
    rig = Rig(camera, Mount(height_m=1.2, tilt_deg=15.0), LeverArm(0.0, 0.0, 2.0))
    warm_up(LocalGridder(rig), odometry=True)
