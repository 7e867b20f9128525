"""A session's grids made again at its end, from the points that it has kept: level by the attitude
of the whole drive, and sweeps carried by its trajectory, as a build makes them."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing

from fieldgrid.core import warning
from fieldgrid.live.kept.kept_drive import PushedDrive
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.maps import StagedFrame, stage
from fieldgrid.perception import Refusal
from fieldgrid.pipeline import (
    BadFrame,
    KeptDrive,
    NewSession,
    Progress,
    StageTimes,
    Store,
    grid_of,
    side_by_side,
)

NO_POINTS = "its points were not kept, and how the vehicle leaned was not known while driving"


def gridded_again(
    kept: SessionFolder,
    drive: PushedDrive,
    again: Store[KeptDrive],
    session: NewSession,
    progress: Callable[[Progress], None] | None = None,
) -> KeptDrive:
    """The frames of what was read of a live session, with grids as those of the new `session` of a
    map: level by its attitude, perpendicular to the ground ahead without one, of sweeps carried by
    the vehicle's way; those that had to be made again are kept in `again`. `progress` is called
    after each of them. Frames whose points are not there to make them as the others are, are among
    the bad ones."""
    attitude, way, gridder = session.work.attitude, session.work.way, session.work.gridder
    is_swept = any(frame.is_timed for frame in drive.frames)
    if attitude is None and not is_swept and not any(frame.is_level for frame in drive.frames):
        return drive

    def make(number: int) -> tuple[StagedFrame | None, bool]:
        """A frame, None where it cannot be as the others are, and whether its grid is that of while
        driving."""
        frame, was = drive.frames[number], drive[number]
        tilt = None if attitude is None else attitude.tilt_at(was.time_ns)
        seen = kept.points_of(frame, gridder)
        if seen is None:
            return was if frame.is_level == (tilt is not None) else None, True
        grid, ground = grid_of(seen, was.time_ns, gridder, tilt, way)
        made = stage(
            grid,
            was.frame_id,
            was.time_ns,
            images=was.images,
            images_sha256=was.images_sha256,
            ground_found=ground.refined,
            channels=ground.channels(),
        )
        return made, False

    as_driven, count, is_lost = 0, len(drive.frames), False
    with closing(side_by_side(make, range(count), os.cpu_count() or 1)) as all_made:
        frames = zip(all_made, drive.frames, strict=True)
        for done, ((made, is_as_driven), frame) in enumerate(frames, start=1):
            if progress is not None:
                progress(Progress(session.name, done, count))
            if made is None:
                again.keep_bad(frame.number, BadFrame(frame.entry.frame_id, NO_POINTS))
            else:
                as_driven += is_as_driven
                # No step leads over a frame that is left out.
                no_step = is_lost and frame.found is not None
                found = Refusal.NOT_COMPARED if no_step else frame.found
                again.keep(frame.number, made, found, StageTimes())
            is_lost = made is None
    made_again = again.read()
    if as_driven:
        known = ["the attitude"] if attitude is not None else []
        known += ["the motion"] if is_swept else []
        told = warning(
            "points-lost",
            f"The points of {as_driven} of {len(made_again.frames)} frames were not kept to the "
            "end: their grids are as they were made while driving, by "
            f"{' and '.join(known)} known then.",
            "A build from a recording (fieldgrid build RECORDING) makes them by the data of the "
            "whole drive.",
        )
        session.report.findings += (told,)
    made_again.bad, made_again.times = drive.bad | made_again.bad, drive.times
    return made_again
