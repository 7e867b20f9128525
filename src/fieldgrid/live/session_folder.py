"""The folder in which a live session stores its data beside the map, written and read back.

`MAP.live/` holds `journal` (`live.journal`), `frames.grids` (a stage file) and the pairs by which
the cameras are checked at the end. A frame counts when both files have it, so a kill between the
two loses that frame alone.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fieldgrid.build import BadFrame
from fieldgrid.build.parts import found_from_json, found_to_json
from fieldgrid.build.report import StageTimes
from fieldgrid.build.rig_config import rig_from_config, rig_to_config
from fieldgrid.build.staging import Found, Staged
from fieldgrid.closing import Closing
from fieldgrid.errors import ConfigError, MapError, MapWriteError
from fieldgrid.fixes import Fix, FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.live.given import GIVEN_ROWS, NO_POSES, body_poses
from fieldgrid.live.journal import Journal, read_journal
from fieldgrid.live.pairs import KeptPairs, pair_numbers
from fieldgrid.live.sensor_rows import (
    Rows,
    fix_from_json,
    fix_to_json,
    motion_of,
    rows_from_json,
    rows_to_json,
)
from fieldgrid.mapfile import StagedFrame, StageEntry, StageFile
from fieldgrid.odometry import Refusal
from fieldgrid.publish import holding, replacing
from fieldgrid.recording import FixLog, Image, Recording
from fieldgrid.recording.given_poses import with_body_poses
from fieldgrid.recording.pose_source import PoseBody
from fieldgrid.rig import Lidar, Rig, StereoCamera
from fieldgrid.settings import BuildSettings

MOST_PAIRS, PAIR_EVERY_NS = 12, 500_000_000
"""Pairs that are kept to check the cameras: every one at first, then every second, and so on; none
of frames that follow faster, since a pair takes as much as a third of a frame."""

_JOURNAL, _FRAMES = "journal", "frames.grids"


@dataclass(frozen=True, slots=True)
class About:
    """What a session was begun with."""

    name: str
    rig: Rig
    settings: BuildSettings
    datum: Datum | None = None
    datum_hint: Datum | None = None
    append: bool = False
    source: str = "live"
    source_sha256: str = ""
    notes: tuple[str, ...] = ()
    """Remarks on where the data come from, for the report."""
    poses: PoseBody | None = None
    """Whose poses are pushed, None where they are estimated."""

    def to_json(self) -> dict[str, Any]:
        """As a value that JSON has."""
        return {
            "name": self.name,
            "rig": rig_to_config(self.rig),
            "settings": self.settings.model_dump(mode="json"),
            "datum": _datum_to_json(self.datum),
            "datum_hint": _datum_to_json(self.datum_hint),
            "append": self.append,
            "source": self.source,
            "source_sha256": self.source_sha256,
            "notes": list(self.notes),
            "poses": None if self.poses is None else list(astuple(self.poses)),
        }

    def goes_on(self, earlier: About) -> bool:
        """Whether this is the same session again; what is checked at its end may differ."""
        ours, theirs = self.to_json(), earlier.to_json()
        for one in (ours, theirs):
            del one["settings"]["checks"]
        return ours == theirs

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> About:
        """The same again."""
        return cls(
            value["name"],
            rig_from_config(value["rig"], value["name"]),
            BuildSettings.model_validate(value["settings"]),
            Datum(*value["datum"]) if value["datum"] else None,
            Datum(*value["datum_hint"]) if value["datum_hint"] else None,
            value["append"],
            value["source"],
            value["source_sha256"],
            tuple(value["notes"]),
            _body_from_json(value.get("poses")),
        )


def _body_from_json(value: list[Any] | None) -> PoseBody | None:
    """None, too, of a session that was begun before there were any."""
    if value is None:
        return None
    name, axes, point = value
    return PoseBody(name, axes, None if point is None else tuple(point))


def _datum_to_json(datum: Datum | None) -> list[float] | None:
    return None if datum is None else [datum.lat_deg, datum.lon_deg, datum.height_m]


@dataclass(slots=True)
class Drive:
    """What was pushed, as it is read back."""

    about: About
    fixes: list[Fix] = field(default_factory=list)
    parts: dict[str, list[Rows]] = field(default_factory=dict)
    frames: list[tuple[int, Found]] = field(default_factory=list)
    """Of each frame that was staged: its number in the stage file, and the step to it."""
    bad: list[tuple[int, BadFrame]] = field(default_factory=list)
    dropped: int = 0
    as_seen: set[str] = field(default_factory=set)
    """Clouds that were taken as they were seen."""
    times: StageTimes = field(default_factory=StageTimes)


def live_folder(out: Path) -> Path:
    """Where a live session for the map `out` keeps what it has."""
    place = out.resolve()
    return place.with_name(f"{place.name}.live")


def read_drive(folder: Path, entries: Sequence[StageEntry]) -> Drive | None:
    """What a journal holds, with the frames that the stage file has as well; None without a
    beginning: then nothing was pushed."""
    drive: Drive | None = None
    try:
        for kind, value in read_journal(folder / _JOURNAL):
            if kind == "begin":
                drive = drive or Drive(About.from_json(value))
            elif drive is not None:
                _take(drive, kind, value, entries)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(
            f"The journal in {folder} is of another version of this program or damaged ({error}); "
            "finish it with the version that wrote it."
        ) from error
    return drive


def _take(drive: Drive, kind: str, value: Any, entries: Sequence[StageEntry]) -> None:
    if kind == "fix":
        drive.fixes.append(fix_from_json(value))
    elif kind == "rows":
        part, rows = rows_from_json(value)
        drive.parts.setdefault(part, []).append(rows)
    elif kind == "frame":
        number, frame_id, found, times = value
        # A frame that was lost with the power is written anew under the same number.
        while drive.frames and drive.frames[-1][0] >= number:
            drive.frames.pop()
        if number < len(entries) and entries[number].frame_id == frame_id:
            drive.frames.append((number, found_from_json(found)))
            drive.times.add(StageTimes(*times))
    elif kind == "bad":
        time_ns, *bad = value
        drive.bad.append((time_ns, BadFrame(*bad)))
    elif kind == "dropped":
        drive.dropped += 1
    elif kind == "as seen":
        drive.as_seen.add(str(value))


class SessionFolder(Closing):
    """The folder of an open session, locked against other processes."""

    def __init__(self, out: Path, about: About | None) -> None:
        """Open what is there, or begin with `about`; ConfigError where that is of another drive,
        or where nothing is there to go on with."""
        self.out, self.folder = out, live_folder(out)
        self._open = ExitStack()
        self._pairing = threading.Lock()
        self._pairs_every, self._pair_ns = 1, -PAIR_EVERY_NS
        journal = self.folder / _JOURNAL
        if about is None and not journal.is_file():
            raise ConfigError(
                f"There is no live session to finish for {out}: {journal} does not exist."
            )
        try:
            if about is not None:
                self.folder.mkdir(parents=True, exist_ok=True)
                journal.touch()
            if not self._open.enter_context(holding(journal)):
                raise MapError(
                    f"Another program maps into {self.folder}; end it, or give another map."
                )
            self.journal = self._open.enter_context(Journal(journal))
            self.stage = self._open.enter_context(StageFile(self.folder / _FRAMES, out))
        except OSError as error:
            self._open.close()
            if isinstance(error, MapWriteError):
                raise
            raise MapWriteError(
                f"{self.folder} could not be written ({error.strerror}); check the folder and its "
                "permissions."
            ) from error
        except BaseException:
            self._open.close()
            raise
        try:
            self.drive = self._begun(about)
        except BaseException:
            self._open.close()
            raise
        self.is_resumed = bool(self.drive.fixes or self.drive.frames or self.drive.parts)

    def _begun(self, about: About | None) -> Drive:
        drive = read_drive(self.folder, self.stage.entries)
        if drive is None:
            if about is None:
                raise ConfigError(f"{self.folder} holds no session; remove it.")
            self.journal.append("begin", about.to_json())
            self.sync()
            return Drive(about)
        if about is not None and not about.goes_on(drive.about):
            raise ConfigError(
                f"{self.folder} holds the session {drive.about.name!r}, which was ended before it "
                "was in the map, of another rig or other settings; finish it with fieldgrid live "
                f"-o {self.out} --finish, or remove it with --discard."
            )
        return drive

    def add_fix(self, fix: Fix) -> bool:
        """Keep a fix; this and what follows is False while the disk takes nothing."""
        return self.journal.append("fix", fix_to_json(fix))

    def add_rows(self, part: str, rows: Rows) -> bool:
        """Keep rows of a sensor."""
        return self.journal.append("rows", rows_to_json(part, rows))

    def add_frame(self, number: int, frame_id: str, found: Found, times: StageTimes) -> bool:
        """Keep what else is known of the frame of this number in the stage file."""
        spent = [round(getattr(times, name), 6) for name in times.__slots__]
        return self.journal.append("frame", [number, frame_id, found_to_json(found), spent])

    def add_bad(self, time_ns: int, bad: BadFrame) -> bool:
        """Keep that a frame could not be read."""
        return self.journal.append("bad", [time_ns, *bad])

    def add_dropped(self, frame_id: str, time_ns: int) -> bool:
        """Keep that a frame was dropped."""
        return self.journal.append("dropped", [frame_id, time_ns])

    def add_as_seen(self, frame_id: str) -> bool:
        """Keep that nothing told how the vehicle went while a cloud was taken."""
        return self.journal.append("as seen", frame_id)

    def claim_pair(self, number: int, time_ns: int) -> bool:
        """Whether the pair of this frame is one by which the cameras are checked, and is to be
        added; none is of the frames just after it."""
        is_due = number % self._pairs_every == 0 and abs(time_ns - self._pair_ns) >= PAIR_EVERY_NS
        if is_due:
            self._pair_ns = time_ns
        return is_due

    def add_pair(self, number: int, left: Image, right: Image) -> None:
        """Keep a pair, and fewer of the others; one that the disk refuses is not kept. It may wait
        for the disk, and may be called from any thread."""
        fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
        with self._pairing, suppress(OSError):
            # Each whole or not there, and the left one last: it tells that there is a pair.
            for side, image in (("right", right), ("left", left)):
                with replacing(self.folder / f"{number:08d}-{side}.png") as draft:
                    draft.write_bytes(cv2.imencode(".png", image, fast)[1].tobytes())
            kept = pair_numbers(self.folder)
            if len(kept) > MOST_PAIRS:
                self._pairs_every *= 2
                for other in kept:
                    if other % self._pairs_every:
                        for side in ("left", "right"):
                            (self.folder / f"{other:08d}-{side}.png").unlink(missing_ok=True)

    @property
    def lost(self) -> int:
        """Records that no longer fitted into memory while the disk was full."""
        return self.journal.lost

    def sync(self) -> bool:
        """Return when all of it is on the disk; False where the disk does not take it."""
        try:
            self.stage.sync()
        except MapWriteError:
            return False
        return self.journal.sync()

    def _read(self) -> Drive:
        self.stage.recall()
        return read_drive(self.folder, self.stage.entries) or self.drive

    def staged(self) -> Staged:
        """The frames, as a build has them of its drive."""
        drive = self._read()
        numbers = [number for number, _ in drive.frames]
        found = [one for _, one in drive.frames]
        # No step leads to a frame before which the program was started again.
        found = [one or Refusal.NOT_COMPARED if k else one for k, one in enumerate(found)]
        if not isinstance(drive.about.rig.sensor, StereoCamera):
            found = [None] * len(numbers)
        return Staged(
            _Numbered(self.stage, numbers),
            [self.stage.entries[number] for number in numbers],
            found,
            [bad for _, bad in drive.bad],
            drive.times,
        )

    def recording(self) -> Recording:
        """The drive as a recording, with the pairs that were kept for its frames. RecordingError
        where poses were to be pushed that cannot be used."""
        drive = self._read()
        about, rig = drive.about, drive.about.rig
        offset_ns = rig.image_time_offset_ns
        staged_ns = [self.stage.entries[number].time_ns - offset_ns for number, _ in drive.frames]
        times_ns = np.array(sorted(staged_ns + [t for t, _ in drive.bad]), dtype=np.int64)
        notes = about.notes
        if drive.dropped:
            notes += (f"{drive.dropped} frames were dropped while it was driven.",)
        if isinstance(rig.sensor, Lidar) and drive.frames:
            names = [self.stage.entries[number].frame_id for number, _ in drive.frames]
            as_seen = sum(name in drive.as_seen for name in names)
            notes += (
                "Points with times were carried to the stamps of their clouds by the motion that "
                f"was known while driving, but for {as_seen} of {len(names)} clouds.",
            )
        recording = Recording(
            path=self.folder,
            name=about.name,
            kind="live session",
            log=FixLog(FixColumns.of_rows(drive.fixes), (), motion_of(drive.parts)),
            gnss_source=about.source,
            gnss_hash=about.source_sha256,
            rig=rig,
            datum_hint=about.datum_hint,
            notes=notes,
            source=KeptPairs(self.folder, times_ns),
        )
        if about.poses is None:
            return recording
        given = body_poses(about.poses, drive.parts.get(GIVEN_ROWS) or [NO_POSES])
        return with_body_poses(recording, given, about.poses).recording()

    def forget(self) -> None:
        """Hold no more in memory than what the session was begun with, however long it lasts."""
        self.drive = Drive(self.drive.about)
        self.stage.forget()

    def remove(self) -> None:
        """Remove all of it: the drive is in the map, or is given up."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.close()

    def close(self) -> None:
        """Let go of the folder."""
        self._open.close()


@dataclass(frozen=True, slots=True)
class _Numbered:
    """Some of the frames of a stage file, in their order."""

    stage: StageFile
    numbers: list[int]

    def __getitem__(self, index: int) -> StagedFrame:
        return self.stage[self.numbers[index]]
