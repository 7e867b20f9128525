"""The folder in which a live session stores its data beside the map, written and read back.

`MAP.live/` holds `journal` (`kept.journal`), `frames.grids` (a stage file), `frames.points` (points
before gridding, `kept.points_file`) and the pairs by which the cameras are checked at the end. A
frame counts when all files have it, so a kill between two of them loses that frame alone.
"""

from __future__ import annotations

import errno
import re
import threading
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from fieldgrid.core import (
    Closing,
    ConfigError,
    MapError,
    MapWriteError,
    counted,
    holding,
    quoted,
    replacing,
)
from fieldgrid.geometry import Fix, FixColumns, GridSpec, StereoCamera
from fieldgrid.live.given import GIVEN_ROWS, NO_POSES, body_poses
from fieldgrid.live.kept.frame_names import told_apart
from fieldgrid.live.kept.journal import Journal, read_journal
from fieldgrid.live.kept.kept_drive import (
    GRIDS,
    JOURNAL,
    POINTS,
    KeptFrame,
    PushedDrive,
    SessionStart,
    live_folder,
    read_drive,
)
from fieldgrid.live.kept.kept_points import KeptPoints
from fieldgrid.live.kept.pairs import KeptPairs, pair_numbers
from fieldgrid.live.options import POINTS_GB
from fieldgrid.live.pose.sensor_rows import Rows, check_time, fix_to_json, motion_of, rows_to_json
from fieldgrid.maps import StagedFrame, StageFile
from fieldgrid.perception import Refusal
from fieldgrid.pipeline import StagedDrive, StageTimes, found_to_json
from fieldgrid.recordings import FixLog, Image, Recording, with_body_poses

MOST_PAIRS, PAIR_EVERY_NS = 12, 500_000_000
"""Pairs that are kept to check the cameras: every one at first, then every second, and so on; none
of frames that follow faster, since a pair takes as much as a fifth of a frame."""

BEGINS_EVERY = 100
"""Number of frames after which it is written again what the session was begun with: damage to the
beginning does not leave the frames to a session of another rig."""

_OF_PAIRS = re.compile(r"\d{8,}-(left|right)\.png|\.\d{8,}-(left|right)\.png\..{8}\.partial.*")
"""Files of pairs, also such as a kill left half-written."""


class SessionFolder(Closing):
    """The folder of an open session, locked against other processes."""

    def __init__(self, out: Path, about: SessionStart | None, points_gb: float = POINTS_GB) -> None:
        """Open what is there, or begin with `about`; ConfigError where that is of another drive,
        or where nothing is there to go on with. Points take at most `points_gb`."""
        self.out, self.folder = out, live_folder(out)
        self._pairing = threading.Lock()
        self._pairs_every, self._pair_ns = 1, -PAIR_EVERY_NS
        journal = self.folder / JOURNAL
        if about is None and not journal.is_file():
            raise ConfigError(
                f"There is no live session to finish for {out}: {journal} does not exist."
            )
        with ExitStack() as opening:
            try:
                if about is not None:
                    self.folder.mkdir(parents=True, exist_ok=True)
                    journal.touch()
                if not opening.enter_context(holding(journal)):
                    raise MapError(
                        f"Another program maps into {self.folder}; end it, or give another map."
                    )
                self.journal = opening.enter_context(Journal(journal))
                self.stage = opening.enter_context(
                    StageFile(self.folder / GRIDS, out, passes_damage=True)
                )
            except OSError as error:
                if isinstance(error, MapWriteError):
                    raise
                raise _unwritable(self.folder, error) from error
            self.drive = drive = self._begun(about)
            self.points = opening.enter_context(self._points(round(points_gb * 1e9)))
            self._open = opening.pop_all()
        self.unreadable = len(drive.unreadable)
        """How many frames' grids could not be read back, as last read."""
        self.is_resumed = bool(drive.fixes or drive.frames or drive.parts or drive.damaged_bytes)

    def _begun(self, about: SessionStart | None) -> PushedDrive:
        drive = read_drive(self.folder, self.stage.entries)
        if drive is None:
            is_damaged = next(read_journal(self.folder / JOURNAL), None) is not None
            if about is None and is_damaged:
                raise ConfigError(
                    f"The beginning of the session in {self.folder} is damaged. Run the command "
                    "that began it again, with the same rig and settings: it goes on with what is "
                    f"kept, and its end makes the map. Or give it up: fieldgrid live -o {self.out} "
                    "--discard."
                )
            if about is None:
                raise ConfigError(
                    f"{self.folder} holds no session; fieldgrid live -o {self.out} --discard "
                    "removes it."
                )
            self.journal.append("begin", about.to_json())
            self.stage.sync()
            self.journal.sync()
            waiting = self.journal.waiting()  # a full disk takes no beginning
            drive = read_drive(self.folder, self.stage.entries, waiting) or PushedDrive(about)
        if about is not None and (other := about.differs_in(drive.about)):
            raise ConfigError(
                f"{self.folder} holds the session {quoted(drive.about.name)}, which was ended "
                "before it was in the map and cannot go on with this one, which differs in its "
                f"{' and '.join(other)}. Finish it with fieldgrid live -o {self.out} --finish, or "
                "remove it with --discard."
            )
        if drive.cut_at is not None:
            self.journal.append("cut", drive.cut_at)
        return drive

    def _points(self, most_bytes: int) -> KeptPoints:
        """The points of the frames that are there already, and room for others."""
        drive = self.drive
        first_ns = self.stage.entries[drive.frames[0].number].time_ns if drive.frames else None
        reach_m = GridSpec.of(drive.about.settings.grid).reach_m
        try:
            points = KeptPoints(self.folder / POINTS, reach_m, most_bytes, first_ns, drive.frames)
        except OSError as error:
            raise _unwritable(self.folder / POINTS, error) from error
        for part, chunks in drive.parts.items():
            for rows in chunks:
                points.note_rows(part, rows)
        return points

    def add_fix(self, fix: Fix) -> bool:
        """Keep a fix; this and what follows is False while the disk takes nothing. ConfigError for
        a time that no map can have."""
        check_time("a fix", fix.time_ns)
        return self.journal.append("fix", fix_to_json(fix))

    def add_rows(self, part: str, rows: Rows) -> bool:
        """Keep rows of a sensor."""
        self.points.note_rows(part, rows)
        return self.journal.append("rows", rows_to_json(part, rows))

    def add_frame(self, frame: KeptFrame, frame_id: str, times: StageTimes) -> bool:
        """Keep what else is known of a frame that is in the stage file."""
        spent = [round(getattr(times, name), 6) for name in times.__slots__]
        number, found, *points = frame
        if number % BEGINS_EVERY == 0:
            self.journal.append("begin", self.drive.about.to_json())
        return self.journal.append(
            "frame", [number, frame_id, found_to_json(found), spent, *points]
        )

    def add_dropped(self, frame_id: str, time_ns: int) -> bool:
        """Keep that a frame was dropped."""
        return self.journal.append("dropped", [frame_id, time_ns])

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
        with self._pairing, suppress(OSError):
            # Each whole or not there, and the left one last: it tells that there is a pair.
            # OpenCV's own setting takes a third of the time of any that is given to it.
            for side, image in (("right", right), ("left", left)):
                with replacing(self.folder / f"{number:08d}-{side}.png") as draft:
                    draft.write_bytes(cv2.imencode(".png", image)[1].tobytes())
            kept = pair_numbers(self.folder)
            if len(kept) > MOST_PAIRS:
                self._pairs_every *= 2
                for other in kept:
                    if other % self._pairs_every:
                        for side in ("left", "right"):
                            (self.folder / f"{other:08d}-{side}.png").unlink(missing_ok=True)

    def sync(self) -> bool:
        """Return when all of it is on the disk; False where the disk does not take it."""
        taken = 0
        for sync in (self.stage.sync, self.journal.sync, self.points.sync):
            with suppress(OSError):  # MapWriteError, too, is one
                taken += sync() is not False
        return taken == 3

    def what_is_kept(self, then: str) -> str:
        """A sentence on where the drive is, and with what command it goes on (`then`). It writes
        first what waits."""
        journal = self.folder / JOURNAL
        if not journal.exists():
            return f"The drive is in the map {self.out}."
        taken = self.sync()
        if not taken and next(read_journal(journal), None) is None:
            return "Nothing of the drive is kept, since the full disk took none of it."
        count = sum(kind != "begin" for kind, _ in self.journal.waiting())
        lost = f", but for the last {count} records, which the full disk did not take"
        return f"The drive is kept in {self.folder}{lost if count else ''}; {then}."

    def read(self) -> PushedDrive:
        """What was pushed until now."""
        self.stage.recall()
        waiting = self.journal.waiting()  # a full disk took nothing of it
        drive = read_drive(self.folder, self.stage.entries, waiting) or self.drive
        self.unreadable = len(drive.unreadable)
        return drive

    def staged(self, read: PushedDrive | None = None) -> StagedDrive:
        """The frames, as a build has them of its drive; of what was `read`, if that was done."""
        drive = read or self.read()
        numbers = [frame.number for frame in drive.frames]
        entries = [self.stage.entries[number] for number in numbers]
        names = told_apart([entry.frame_id for entry in entries])
        found = [frame.found for frame in drive.frames]
        # No step leads to a frame before which the program was started again.
        found = [one or Refusal.NOT_COMPARED if k else one for k, one in enumerate(found)]
        if not isinstance(drive.about.rig.sensor, StereoCamera):
            found = [None] * len(numbers)
        return StagedDrive(
            _NamedFrames(self.stage, numbers, names),
            [e._replace(frame_id=name) for e, name in zip(entries, names, strict=True)],
            found,
            [bad for _, bad in drive.bad],
            drive.times,
        )

    def recording(self, drive: PushedDrive) -> Recording:
        """What was read as a recording, with the pairs that were kept for its frames.
        RecordingError where poses were to be pushed that cannot be used."""
        about, rig = drive.about, drive.about.rig
        offset_ns = rig.image_time_offset_ns
        staged_ns = [self.stage.entries[number].time_ns - offset_ns for number, *_ in drive.frames]
        times_ns = np.array(sorted(staged_ns + [t for t, _ in drive.bad]), dtype=np.int64)
        notes = about.notes
        if drive.dropped:
            many = counted(drive.dropped, "frame")
            notes += (f"{many} dropped while it was driven.",)
        if drive.damaged_bytes:
            notes += (
                f"{drive.damaged_bytes} bytes of the session's journal were damaged; what they "
                "held is lost. Check the disk.",
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

    @property
    def newest_frame_ns(self) -> int | None:
        """The time of the last frame that is there already, None without, until `forget`."""
        frames = self.drive.frames
        return self.stage.entries[frames[-1].number].time_ns if frames else None

    def forget(self) -> None:
        """Hold no more in memory than what the session was begun with, however long it lasts."""
        self.drive = PushedDrive(self.drive.about)
        self.stage.forget()

    def remove(self) -> None:
        """Remove all of it: the drive is in the map, or is given up. Files of others stay."""
        _remove(self.folder)
        self.close()

    def close(self) -> None:
        """Let go of the folder."""
        self._open.close()


def remove_unread(out: Path) -> bool:
    """Remove the session for a map whatever of it can be read; False where there is none, or where
    another program has it. MapError where the journal is a file of others."""
    journal = live_folder(out) / JOURNAL
    if not journal.is_file():
        return False
    with holding(journal) as is_ours:
        if is_ours:
            next(read_journal(journal), None)
            _remove(journal.parent)
    return is_ours


def _unwritable(path: Path, error: OSError) -> MapWriteError:
    advice = "check the folder and its permissions"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        advice = "free some space there and try again"
    return MapWriteError(f"{path} could not be written ({error.strerror}); {advice}.")


def _remove(folder: Path) -> None:
    """Remove the files of a session. Files of others stay."""
    pairs = [path for path in folder.glob("*") if _OF_PAIRS.fullmatch(path.name)]
    # Without the journal nothing of the rest counts, but for pairs.
    for path in (*pairs, *(folder / name for name in (POINTS, JOURNAL, GRIDS))):
        with suppress(OSError):
            path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


@dataclass(frozen=True, slots=True)
class _NamedFrames:
    """Some of the frames of a stage file, in their order, and what they are called."""

    stage: StageFile
    numbers: list[int]
    names: list[str]

    def __getitem__(self, index: int) -> StagedFrame:
        frame, name = self.stage[self.numbers[index]], self.names[index]
        return frame if frame.frame_id == name else replace(frame, frame_id=name)
