"""The file: everything that a recording says, in order of time."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from fieldgrid.core import (
    ConfigError,
    GnssError,
    NoFramesError,
    RecordingError,
    quoted,
    refuse_input,
)
from fieldgrid.geometry import Trajectory
from fieldgrid.pipeline.convert.drive import (
    fix_messages,
    messages_once,
    motion_messages,
    pose_messages,
)
from fieldgrid.pipeline.convert.frames import Images, frame_messages
from fieldgrid.pipeline.poses import estimate_drive
from fieldgrid.recordings import Drive, DriveOptions, McapWriter, Recording, open_drive


@dataclass(frozen=True, slots=True)
class Converted:
    """What was written: the messages of each topic, the span of time, and remarks."""

    path: Path
    recording: str
    topics: dict[str, int]
    start_ns: int
    stop_ns: int
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "mcap": str(self.path),
            "recording": self.recording,
            "topics": self.topics,
            "start_ns": self.start_ns,
            "stop_ns": self.stop_ns,
            "notes": list(self.notes),
        }


def convert_recording(
    drive: Drive | str | Path,
    out: str | Path,
    options: DriveOptions | None = None,
    *,
    images: Images | str = Images.COMPRESSED,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Converted:
    """Write an MCAP of what a drive holds and what its poses are estimated to be.

    A path is opened with `options` as by `open_drive`: a recording, or a log alone. The file
    appears whole or not at all; no more than one frame is held in memory. Raises MapExistsError
    for a file that is there unless it may be overwritten, and what reading and estimating raise.
    """
    out = Path(out)
    if out.suffix.lower() != ".mcap":
        raise ConfigError(f"{out} is not named as an MCAP; give a name that ends in .mcap.")
    try:
        kind = Images(images)
    except ValueError:
        raise ConfigError(
            f"Images {quoted(images)} cannot be written; give one of {', '.join(Images)}."
        ) from None
    if not isinstance(drive, str | Path):
        return _converted(drive, out, kind, overwrite, progress)
    refuse_input(out, [Path(drive)])
    with open_drive(drive, options) as opened:
        return _converted(opened, out, kind, overwrite, progress)


def _converted(
    drive: Drive,
    out: Path,
    images: Images,
    overwrite: bool,
    progress: Callable[[int, int], None] | None,
) -> Converted:
    recording: Recording | None = None
    try:
        recording = drive.recording()
    except NoFramesError:
        if not len(drive.fixes()):
            raise
    with McapWriter(out, overwrite=overwrite) as writer:
        trajectory, notes = _trajectory(drive)
        streams = [fix_messages(drive.fixes()), motion_messages(drive.motion(), notes)]
        if trajectory is not None:
            streams.append(pose_messages(trajectory))
        if recording is not None and images is not Images.NONE:
            streams.append(frame_messages(recording, images, progress))
        # Of one time, the messages of the first of these streams come first.
        merged = heapq.merge(*streams, key=lambda one: one.time_ns)
        first = next(merged, None)
        if first is None:
            raise RecordingError(
                f"{drive.name} has neither frames nor fixes, so there is nothing to convert; "
                "give another drive."
            )
        last, counts = first, Counter[str]()
        # Image stamps are by the receiver's clock already.
        rig = drive.rig and replace(drive.rig, image_time_offset_ns=0)
        for topic, message in messages_once(rig, trajectory, first.time_ns):
            writer.write(topic, message, first.time_ns, latched=True)
            counts[topic] += 1
        for last in chain([first], merged):
            writer.write(last.topic, last.message, last.time_ns)
            counts[last.topic] += 1
    topics = dict(sorted(counts.items()))
    return Converted(out, drive.name, topics, first.time_ns, last.time_ns, tuple(notes))


def _trajectory(drive: Drive) -> tuple[Trajectory | None, list[str]]:
    """The estimated poses, or a remark on why there are none."""
    notes = list(drive.losses)
    if not len(drive.fixes()):
        return None, [*notes, "There are no fixes, so no poses were written."]
    try:
        return estimate_drive(drive).trajectory, notes
    except GnssError as problem:
        return None, [*notes, f"No poses were written: {problem}"]
