"""Short stretches of drives that are declared rightly: `python -m benchmarks.stretches`.

Nothing of their antennas, stamps, clocks and cameras is to be denied. Each rendered drive is
estimated over stretches that begin anywhere and last 6 to 70 s, with its gyro, with its camera, and
with both; a line tells of each whose positions count as less sure for a denial, and one of how many
they are.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.heading_honesty import RENDERED
from benchmarks.heading_scores import DATA
from fieldgrid.core import FieldgridError
from fieldgrid.geometry import Motion
from fieldgrid.pipeline import visual_odometry
from fieldgrid.pipeline.checks.camera_scale import camera_scale
from fieldgrid.poses import estimate_poses
from fieldgrid.recordings import open_recording
from tests.told import codes

SEED, STRETCHES = 5, 40
DENIALS = {
    "antenna-place",
    "antenna-or-stamps",
    "fixes-stamped",
    "contradiction",
    "clock-offset",
}


def report() -> Iterator[str]:
    """A line for each denial, and their count."""
    random = np.random.default_rng(SEED)
    made = refused = denied = 0
    by_camera = np.zeros(7, dtype=np.int64)
    for name, logs in RENDERED:
        if not (DATA / name).exists():
            yield f"{name}: absent"
            continue
        steps = None
        for log in logs:
            with open_recording(DATA / name, log) as drive:
                fixes, motion, rig = drive.fixes(), drive.motion(), drive.rig
                datum, steps = drive.datum_hint, steps or visual_odometry(drive)
            motions = motion, Motion(steps=steps), motion._replace(steps=steps)
            at_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
            for k in range(STRETCHES):
                lasts_s = random.uniform(6.0, 70.0)
                from_s = random.uniform(0.0, max(at_s[-1] - lasts_s, 0.0))
                some = fixes[(at_s >= from_s) & (at_s < from_s + lasts_s)]
                try:
                    found = estimate_poses(some, rig, datum, motion=motions[k % 3])
                except FieldgridError:
                    refused += 1
                    continue
                made += 1
                notes = [one for one in found.report.findings if one.code in DENIALS]
                denied += bool(notes)
                what = ("gyro", "camera", "both")[k % 3]
                told = found.report
                scale = camera_scale(motions[k % 3].steps, found.trajectory, heights_told=True)
                doubts = (
                    told.clock_change is not None,
                    told.contradiction is not None and told.contradiction.is_certain,
                    told.camera_yaw is not None and told.camera_yaw.is_off,
                    scale is not None and scale.is_off,
                    scale is not None and scale.stops,
                    "leaps" in codes(told),
                    "drift" in codes(told),
                )
                by_camera += np.array(doubts)
                for note in notes:
                    yield f"{name} {log}, {what}, {lasts_s:.0f} s from {from_s:.0f} s: {note}"
    yield f"{made} stretches (and {refused} refused), {denied} denied falsely"
    yield "told falsely by the camera: " + ", ".join(
        f"{what} {count}"
        for what, count in zip(
            (
                "clock-jump",
                "frames-misplaced",
                "camera-yaw",
                "scale",
                "stops",
                "leaps",
                "drifts",
            ),
            by_camera.tolist(),
            strict=True,
        )
    )


if __name__ == "__main__":
    for line in report():
        print(line, flush=True)
