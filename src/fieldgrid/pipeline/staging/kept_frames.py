"""Staged frames of a drive in its journal: those of a build, of one that goes on, and of a session
that is still driven.

`MAP.work/` beside the map holds a journal for each drive on its way into the map.
"""

from __future__ import annotations

import marshal
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from fieldgrid.core import Closing, MapError, holding
from fieldgrid.geometry import Steps
from fieldgrid.maps import (
    StagedFrame,
    StageEntry,
    damaged_frame,
    frame_of_record,
    frame_record,
    unwritable,
)
from fieldgrid.perception import CameraStep, Refusal, steps_of
from fieldgrid.pipeline.report import BadFrame, StageTimes
from fieldgrid.pipeline.staging.drive_start import DriveStart, check_same
from fieldgrid.pipeline.staging.journal import DAMAGED, Blob, Journal, JournalRecord
from fieldgrid.pipeline.staging.perception import StepOutcome

FRAME, BAD, BEGIN = "frame", "bad", "begin"
"""The kinds of the records of frames, of those that cannot be read, and of what a drive was begun
with."""


class KeptFrame(NamedTuple):
    """A frame of a journal: its number in the drive, the camera's step to it, and where its points
    are, if they were kept. Of a session, whether its grid is level, and whether it is of a sweep
    whose points have times."""

    number: int
    entry: StageEntry
    found: StepOutcome
    points: Blob | None = None
    is_level: bool = False
    is_timed: bool = False


def work_folder(out: Path) -> Path:
    """Where drives are kept on their way into the map `out`."""
    place = out.resolve()
    return place.with_name(f"{place.name}.work")


def drop_journal(path: Path) -> None:
    """Remove a journal, and its folder where nothing else is in it."""
    with suppress(OSError):
        path.unlink(missing_ok=True)
        path.parent.rmdir()


class KeptFrames(Sequence[KeptFrame]):
    """Frames of a journal, packed: objects take four times as much, which counts on long drives."""

    def __init__(self) -> None:
        self._rows: list[bytes] = []

    def append(self, frame: KeptFrame) -> None:
        """Put a frame behind the others."""
        number, entry, found, points, *flags = frame
        row = number, tuple(entry), found_to_json(found), points and tuple(points), *flags
        self._rows.append(marshal.dumps(row))

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: Any) -> Any:
        number, entry, found, points, *flags = marshal.loads(self._rows[index])
        found, points = found_from_json(found), points and Blob(*points)
        return KeptFrame(number, StageEntry(*entry), found, points, *flags)


@dataclass
class KeptDrive:
    """The frames of a drive that its journal has, in order, with the bad ones by their numbers.
    `frames` say of each what is known without reading its cells."""

    journal: Journal
    start: DriveStart | None = None
    """What it was begun with; None where that is damaged."""
    frames: KeptFrames = field(default_factory=KeptFrames)
    bad: dict[int, BadFrame] = field(default_factory=dict)
    bad_ns: list[int] = field(default_factory=list)
    """The times of the frames that are bad, of a session."""
    times: StageTimes = field(default_factory=StageTimes)
    damaged_bytes: int = 0
    """Number of bytes of the journal that cannot be read any more."""
    unreadable: int = 0
    """The number of frames whose grids cannot be read any more."""

    def take(self, record: JournalRecord) -> None:
        """Take the next record of the journal."""
        kind, value, blobs, start = record
        if kind == BEGIN and self.start is None:
            self.start = DriveStart.from_json(value)
        elif kind == BAD:
            self.bad[value[0]] = BadFrame(*value[1:3])
            self.bad_ns.append(value[3])
        elif kind == DAMAGED:
            self.damaged_bytes += value
        elif kind == FRAME and self.journal.read(blobs[0]) is None:
            self.unreadable += 1
        elif kind == FRAME:
            number, said, found, times, *flags = value
            entry = StageEntry(said[0], said[1], said[-1], start)
            points = blobs[1] if len(blobs) > 1 else None
            self.frames.append(KeptFrame(number, entry, found_from_json(found), points, *flags))
            self.times.add(StageTimes(**times))

    def settle(self) -> None:
        """All records were taken: put frames in order; of several of one number the last one
        counts."""
        frames, self.frames = self.frames, KeptFrames()
        places = {frame.number: k for k, frame in enumerate(frames)}
        for number in sorted(places):
            self.frames.append(frames[places[number]])
        self.bad = dict(sorted(self.bad.items()))

    def __getitem__(self, index: int) -> StagedFrame:
        """A frame by its place; MapError when it was damaged since it was written."""
        entry = self.frames[index].entry
        record = self.journal.at(entry.start)
        cells = None if record is None else self.journal.read(record.blobs[0])
        if record is None or cells is None:
            raise damaged_frame(entry)
        return replace(frame_of_record(record.value[1], cells), frame_id=entry.frame_id)

    def steps(self) -> tuple[Steps, Counter[str]]:
        """The camera's steps, and why there is none between other neighbours."""
        found = [one.found for one in islice(self.frames, 1, None) if one.found is not None]
        refused = Counter(one.value for one in found if isinstance(one, Refusal))
        return steps_of([frame.entry.time_ns for frame in self.frames], found), refused


_Drive = TypeVar("_Drive", bound=KeptDrive)


class Store(Closing, Generic[_Drive]):
    """The journal `file` of a drive on its way into the map `out`, held against other programs.

    MapError where another program has it, MapWriteError where there can be none.
    """

    def __init__(self, out: Path, file: str, kind: type[_Drive]) -> None:
        self.out, self.path, self._kind = out, work_folder(out) / file, kind
        with ExitStack() as opening:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self.path.touch()
                if not opening.enter_context(holding(self.path)):
                    raise MapError(
                        f"Another program puts a drive into {out} by {self.path}; wait until it "
                        "has finished, end it, or give another map."
                    )
                self.journal = opening.enter_context(Journal(self.path))
            except OSError as error:
                raise unwritable(out, error) from error
            self._open = opening.pop_all()

    @cached_property
    def drive(self) -> _Drive:
        """The drive with all that the journal held when it was asked for first."""
        return self.read()

    def read(self) -> _Drive:
        """The drive with all that the journal holds: whole, cut, or still growing. MapError for a
        journal of another version."""
        drive = self._kind(self.journal)
        try:
            for record in self.journal.records():
                drive.take(record)
            drive.settle()
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise MapError(
                "The journal of the drive is of another version of this program or damaged "
                f"({error}); finish it with the version that wrote it."
            ) from error
        return drive

    def begin(self, start: DriveStart, ways: str) -> None:
        """Begin the drive, or go on with it. ConfigError where it was begun as another one, with
        the `ways` to go on."""
        if self.drive.start is None:
            self.journal.append(BEGIN, start.to_json())
            self.journal.sync()
            self.drive.start = start
        check_same(self.path, self.drive.start, [start], ways)

    def keep(
        self,
        number: int,
        staged: StagedFrame,
        found: StepOutcome,
        times: StageTimes,
        flags: Sequence[bool] = (),
        points: bytes = b"",
    ) -> None:
        """Keep a frame. MapWriteError where the disk does not take it."""
        said, cells = frame_record(staged)
        spent = {name: round(value, 6) for name, value in asdict(times).items() if value}
        value = [number, said, found_to_json(found), spent, *flags]
        if not self.journal.append(FRAME, value, cells, *([points] if points else [])):
            raise unwritable(self.out, self.journal.problem) from self.journal.problem

    def keep_bad(self, number: int, bad: BadFrame, time_ns: int = 0) -> None:
        """Keep that a frame cannot be read; what the disk does not take waits for it."""
        self.journal.append(BAD, [number, *bad, time_ns])

    def remove(self) -> None:
        """Let go of it and remove it: the drive is in the map, or is given up."""
        drop_journal(self.path)
        self.close()

    def close(self) -> None:
        """Let go of it."""
        self._open.close()


def found_to_json(found: StepOutcome) -> Any:
    """What became of a step of the camera, as a value that JSON has."""
    if isinstance(found, CameraStep):
        return [*map(float, found[:-1]), int(found.inliers)]
    return None if found is None else found.value


def found_from_json(said: Any) -> StepOutcome:
    """The step of the camera of a value that `found_to_json` made; ValueError or TypeError for
    others."""
    if isinstance(said, str):
        return Refusal(said)
    return None if said is None else CameraStep(*said)
