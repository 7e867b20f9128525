"""A session's grids made again at its end, from the points that it has kept: level by the attitude
of the whole drive, and sweeps carried by its trajectory, as a build makes them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

from fieldgrid.attitude import Attitude
from fieldgrid.build import BadFrame, Progress
from fieldgrid.build.perception import carried, side_by_side
from fieldgrid.build.staging import Found, Staged
from fieldgrid.depth import CodedDepth
from fieldgrid.live.kept_drive import KeptFrame
from fieldgrid.live.points_file import Seen
from fieldgrid.live.session_folder import SessionFolder
from fieldgrid.localgrid import LocalGridder
from fieldgrid.mapfile import StagedFrame, StageFile, stage
from fieldgrid.odometry import Refusal
from fieldgrid.rig import Lidar
from fieldgrid.rotations import Tilt
from fieldgrid.sweep import Way

NO_POINTS = "its points were not kept, and how the vehicle leaned was not known while driving"


class GriddedAgain(NamedTuple):
    """The frames of a session as its map is to have them, and remarks for the report."""

    staged: Staged
    notes: tuple[str, ...]


class _Made(NamedTuple):
    """A frame, None where it cannot be as the others are, and whether it is one of while
    driving."""

    staged: StagedFrame | None
    as_driven: bool


def gridded_again(
    kept: SessionFolder,
    file: StageFile,
    attitude: Attitude | None,
    way: Way,
    progress: Callable[[Progress], None] | None = None,
) -> GriddedAgain:
    """The frames of a session with grids that are level by the `attitude`, perpendicular to the
    ground ahead where that is None, of sweeps carried by the vehicle's `way`; those that had to be
    made again are in the `file`. `progress` is called after each of them."""
    staged, drive = kept.staged(), kept.read()
    # Sweeps whose points have times keep their points, too.
    is_swept = isinstance(drive.about.rig.sensor, Lidar) and kept.points.is_levelling
    if attitude is None and not is_swept and not any(frame.is_level for frame in drive.frames):
        return GriddedAgain(staged, ())
    settings = drive.about.settings
    gridder = LocalGridder(drive.about.rig, settings.grid.spec(), settings.stereo, settings.density)

    def make(frame: KeptFrame) -> _Made:
        was = kept.stage[frame.number]
        tilt = None if attitude is None else attitude.tilt_at(was.time_ns)
        seen = kept.points.read(frame.points, gridder)
        if seen is not None:
            return _Made(_again(was, seen, gridder, tilt, way), False)
        return _Made(was if frame.is_level == (tilt is not None) else None, True)

    found: list[Found] = []
    bad, as_driven = list(staged.bad), set[str]()
    with closing(side_by_side(make, drive.frames, os.cpu_count() or 1)) as all_made:
        lost = False
        frames = zip(all_made, staged.entries, staged.found, strict=True)
        for done, (made, entry, step) in enumerate(frames, start=1):
            if progress is not None:
                progress(Progress(drive.about.name, done, len(drive.frames)))
            if made.staged is None:
                bad.append(BadFrame(entry.frame_id, NO_POINTS))
                lost = True
                continue
            if made.as_driven:
                as_driven.add(entry.frame_id)
            file.append(made.staged)
            # No step leads over a frame that is left out.
            found.append(Refusal.NOT_COMPARED if lost and step is not None else step)
            lost = False
    made_again = replace(staged, frames=file, entries=file.entries, found=found, bad=bad)
    return GriddedAgain(made_again, tuple(_notes(as_driven, len(found), is_swept)))


def _again(
    was: StagedFrame, seen: Seen, gridder: LocalGridder, tilt: Tilt | None, way: Way
) -> StagedFrame:
    if isinstance(seen, CodedDepth):
        grid, ground = gridder.from_coded(seen, tilt)
    else:
        points_m = carried(seen, was.time_ns, gridder.rig, way)
        grid, ground = gridder.from_cloud(points_m, tilt)
    return stage(
        grid,
        was.frame_id,
        was.time_ns,
        images=was.images,
        images_sha256=was.images_sha256,
        ground_found=ground.refined,
        channels=ground.channels(),
    )


def _notes(as_driven: set[str], frames: int, is_swept: bool) -> Iterator[str]:
    """Which frames a build would have made otherwise."""
    if as_driven:
        yield (
            f"The points of {len(as_driven)} of {frames} frames were not kept to the end: their "
            "grids are as they were made while driving, by the attitude"
            f"{' and the motion' if is_swept else ''} known then. A build from a recording "
            "(fieldgrid live --finish-from RECORDING) makes them by those of the whole drive."
        )
