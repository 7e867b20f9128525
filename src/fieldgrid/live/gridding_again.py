"""A session's grids made again at its end, from the points that it has kept: level by the attitude
of the whole drive, and sweeps carried by its trajectory, as a build makes them."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing

from fieldgrid.core import Finding, warning
from fieldgrid.geometry import GridSpec
from fieldgrid.live.kept.kept_drive import PushedDrive
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.maps import StagedFrame, stage
from fieldgrid.perception import LocalGridder, OriginTrack, Refusal
from fieldgrid.pipeline import (
    BadFrame,
    KeptDrive,
    Progress,
    StageTimes,
    Store,
    grid_of,
    side_by_side,
)
from fieldgrid.poses import Attitude

NO_POINTS = "its points were not kept, and how the vehicle leaned was not known while driving"


def gridded_again(
    kept: SessionFolder,
    drive: PushedDrive,
    again: Store[KeptDrive],
    attitude: Attitude | None,
    way: OriginTrack,
    progress: Callable[[Progress], None] | None = None,
) -> tuple[KeptDrive, tuple[Finding, ...], int]:
    """The frames of a session, of what was read of it, with grids that are level by the `attitude`,
    perpendicular to the ground ahead where that is None, of sweeps carried by the vehicle's `way`;
    those that had to be made again are kept in `again`. `progress` is called after each of them.

    Returns them with findings for the report, and the number of frames that are left out, since
    their points are not there to make them as the others are."""
    is_swept = any(frame.is_timed for frame in drive.frames)
    if attitude is None and not is_swept and not any(frame.is_level for frame in drive.frames):
        return drive, (), 0
    settings = kept.about.settings
    gridder = LocalGridder(
        kept.about.rig, GridSpec.of(settings.grid), settings.stereo, settings.density
    )

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

    left_out, as_driven, findings = dict[int, BadFrame](), 0, tuple[Finding, ...]()
    with closing(side_by_side(make, range(len(drive.frames)), os.cpu_count() or 1)) as all_made:
        lost = False
        frames = zip(all_made, drive.frames, strict=True)
        for done, ((made, is_as_driven), frame) in enumerate(frames, start=1):
            if progress is not None:
                progress(Progress(kept.about.name, done, len(drive.frames)))
            if made is None:
                left_out[frame.number] = BadFrame(frame.entry.frame_id, NO_POINTS)
                lost = True
                continue
            as_driven += is_as_driven
            # No step leads over a frame that is left out.
            found = Refusal.NOT_COMPARED if lost and frame.found is not None else frame.found
            again.keep(frame.number, made, found, StageTimes())
            lost = False
    if as_driven:
        count = len(drive.frames) - len(left_out)
        known = ["the attitude"] if attitude is not None else []
        known += ["the motion"] if is_swept else []
        told = warning(
            "points-lost",
            f"The points of {as_driven} of {count} frames were not kept to the end: their "
            f"grids are as they were made while driving, by {' and '.join(known)} known then.",
            "A build from a recording (fieldgrid build RECORDING) makes them by the data of the "
            "whole drive.",
        )
        findings = (told,)
    made_again = again.read()
    made_again.bad, made_again.times = drive.bad | left_out, drive.times
    return made_again, findings, len(left_out)
