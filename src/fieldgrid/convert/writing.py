"""The file: everything that a recording says, in order of time."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldgrid.build import estimate_drive
from fieldgrid.convert.drive import Said, fixes_said, motion_said, poses_said, said_once
from fieldgrid.convert.frames import Images, frames_said
from fieldgrid.errors import ConfigError, GnssError, RecordingError
from fieldgrid.recording import Recording, open_recording
from fieldgrid.ros import McapWriter
from fieldgrid.trajectory import Trajectory


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
    recording: Recording | str | Path,
    out: str | Path,
    *,
    images: Images | str = Images.COMPRESSED,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **opening: Any,
) -> Converted:
    """Write an MCAP of what a recording holds and what its poses are estimated to be.

    A path is opened here, `opening` being what `open_recording` takes. The file appears whole or
    not at all; no more than one frame is held in memory. Raises MapExistsError for a file that is
    there unless it may be overwritten, and what reading and estimating raise.
    """
    out = Path(out)
    if out.suffix.lower() != ".mcap":
        raise ConfigError(f"{out} is not named as an MCAP; give a name that ends in .mcap.")
    try:
        kind = Images(images)
    except ValueError:
        raise ConfigError(
            f"Images {images!r} cannot be written; give one of {', '.join(Images)}."
        ) from None
    if not isinstance(recording, str | Path):
        return _converted(recording, out, kind, overwrite, progress)
    with open_recording(recording, **opening) as drive:
        return _converted(drive, out, kind, overwrite, progress)


def _converted(
    recording: Recording,
    out: Path,
    images: Images,
    overwrite: bool,
    progress: Callable[[int, int], None] | None,
) -> Converted:
    with McapWriter(out, overwrite=overwrite) as writer:
        trajectory, notes = _trajectory(recording)
        counts: Counter[str] = Counter()
        start_ns, stop_ns = 0, 0
        for said in _everything(recording, trajectory, images, progress):
            if not counts:
                start_ns = said.time_ns
                for topic, message in said_once(recording.rig, trajectory, said.time_ns):
                    writer.write(topic, message, said.time_ns, latched=True)
                    counts[topic] += 1
            writer.write(said.topic, said.message, said.time_ns)
            counts[said.topic] += 1
            stop_ns = said.time_ns
        if not counts:
            raise RecordingError(
                f"{recording.name} has neither frames nor fixes, so there is nothing to convert; "
                "give another recording."
            )
    return Converted(
        out, recording.name, dict(sorted(counts.items())), start_ns, stop_ns, tuple(notes)
    )


def _trajectory(recording: Recording) -> tuple[Trajectory | None, list[str]]:
    """The estimated poses, or a remark on why there are none."""
    notes = list(recording.losses)
    if not len(recording.fixes()):
        return None, [*notes, "There are no fixes, so no poses were written."]
    try:
        return estimate_drive(recording).trajectory, notes
    except GnssError as problem:
        return None, [*notes, f"No poses were written: {problem}"]


def _everything(
    recording: Recording,
    trajectory: Trajectory | None,
    images: Images,
    progress: Callable[[int, int], None] | None,
) -> Iterator[Said]:
    """All messages in order of time."""
    streams = [fixes_said(recording.fixes()), motion_said(recording)]
    if trajectory is not None:
        streams.append(poses_said(trajectory))
    if images is not Images.NONE:
        streams.append(frames_said(recording, images, progress))
    return heapq.merge(*streams, key=lambda said: (said.time_ns, said.order))
