"""The journal in which a live session stores its data beside the map, written and read back.

`MAP.work/live` is a journal as those of a build (`pipeline`), with all that was pushed in it:
sensor data, grids, points before gridding and the pairs by which the cameras are checked at the
end.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fieldgrid.core import (
    ConfigError,
    Int64,
    MapWriteError,
    counted,
)
from fieldgrid.geometry import Fix, GridSpec
from fieldgrid.live.given import GIVEN_ROWS, NO_POSES, body_poses
from fieldgrid.live.kept.kept_drive import (
    PushedDrive,
    live_folder,
    live_journal,
)
from fieldgrid.live.kept.kept_points import KeptPoints
from fieldgrid.live.kept.points import unpacked
from fieldgrid.live.options import POINTS_GB
from fieldgrid.live.pose.sensor_rows import Rows, check_time, fix_to_json, motion_of, rows_to_json
from fieldgrid.live.pushed import PushedSource
from fieldgrid.maps import StagedFrame
from fieldgrid.perception import LocalGridder, Sweep
from fieldgrid.pipeline import (
    BadFrame,
    Blob,
    DriveStart,
    GridInput,
    Journal,
    KeptFrame,
    StageTimes,
    StepOutcome,
    Store,
    drop_journal,
)
from fieldgrid.recordings import FixLog, Frame, Image, Recording, StereoFrame, with_body_poses

MOST_PAIRS, PAIR_EVERY_NS = 12, 500_000_000
"""Pairs by which the cameras are checked: of every frame at first, then of every second, and so on;
none of frames that follow faster, since a pair takes as much as a fifth of a frame."""


AGAIN = "again"
"""The journal of the grids that the end makes again."""


class SessionFolder(Store[PushedDrive]):
    """The folder of an open session, locked against other processes."""

    def __init__(self, out: Path, about: DriveStart | None, points_gb: float = POINTS_GB) -> None:
        """Open what is there, or begin with `about`; ConfigError where that is of another drive,
        or where nothing is there to go on with. Points take at most `points_gb`."""
        self.folder, path = live_folder(out), live_journal(out)
        if about is None and not path.is_file():
            raise ConfigError(
                f"There is no live session to finish for {out}: {path} does not exist."
            )
        super().__init__(out, path.name, PushedDrive)
        drop_journal(path.with_name(AGAIN))  # of an end that was killed
        try:
            drive, self.about = self.drive, self._begun(about)
        except BaseException:
            self.close()
            raise
        self.points = self._points(round(points_gb * 1e9))
        numbers = [-1, *drive.bad, *(frame.number for frame in drive.frames)]
        self._number = max(numbers) + 1
        self._pairs, self._pair_ns = list(drive.pairs), -PAIR_EVERY_NS
        self.newest_frame_ns = drive.frames[-1].entry.time_ns if drive.frames else None
        """The time of the last frame that is there already, None without."""
        self.is_resumed = bool(
            len(drive.fixes) or drive.frames or drive.parts or drive.damaged_bytes
        )

    def _begun(self, about: DriveStart | None) -> DriveStart:
        """What the session was begun with, or is begun with now."""
        again = f"fieldgrid live -o {self.out}"
        if about is not None:
            self.begin(about, f"Finish it with {again} --finish, or remove it with --discard.")
        begun = self.drive.start
        if begun is None and next(self.journal.records(), None) is None:
            raise ConfigError(f"{self.folder} holds no session; {again} --discard removes it.")
        if begun is None:
            raise ConfigError(
                f"The beginning of the session in {self.folder} is damaged. Run the command that "
                "began it again, with the same rig and settings: it goes on with what is kept, and "
                f"its end makes the map. Or give it up: {again} --discard."
            )
        return begun

    def _points(self, most_bytes: int) -> KeptPoints:
        """What decides on the points of the frames to come, by those that are there already."""
        drive = self.drive
        points = KeptPoints(
            self.folder,
            GridSpec.of(self.about.settings.grid).reach_m,
            most_bytes,
            drive.frames[0].entry.time_ns if drive.frames else None,
            held_bytes=sum(frame.points.size for frame in drive.frames if frame.points),
            is_levelling=not drive.is_unlevelled and bool(drive.frames or most_bytes),
        )
        if not points.is_levelling and not drive.is_unlevelled:
            self.journal.append("unlevelled", None)
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

    def add_frame(
        self,
        staged: StagedFrame,
        found: StepOutcome,
        times: StageTimes,
        seen: GridInput,
        *,
        is_level: bool,
    ) -> int:
        """Keep a frame, and its points where they are to be kept; its number. MapWriteError where
        the disk does not take it."""
        journal, points = self.journal, self.points
        was_levelling = points.is_levelling
        packed = points.packed(seen, staged.time_ns)
        if was_levelling and not points.is_levelling:
            journal.append("unlevelled", None)
        flags = is_level, isinstance(seen, Sweep) and seen.after_s is not None
        kept = staged, found, times, flags
        try:
            self.keep(self._number, *kept, packed)
        except MapWriteError:
            if not packed:
                raise
            points.refused(f"{self.folder} could not be written ({journal.problem.strerror})")
            packed = b""
            self.keep(self._number, *kept)
        points.kept(len(packed))
        self._number += 1
        return self._number - 1

    def add_bad(self, frame: Frame, problem: str) -> None:
        """Keep that a frame cannot be used."""
        self.keep_bad(self._number, BadFrame(frame.frame_id, problem), frame.time_ns)
        self._number += 1

    def add_dropped(self, frame_id: str, time_ns: int) -> bool:
        """Keep that a frame was dropped."""
        return self.journal.append("dropped", [frame_id, time_ns])

    def claim_pair(self, number: int, time_ns: int) -> bool:
        """Whether the pair of this frame is one by which the cameras are checked, and is to be
        added; none is of the frames just after it."""
        is_due = number % _apart(self._pairs) == 0 and abs(time_ns - self._pair_ns) >= PAIR_EVERY_NS
        if is_due:
            self._pair_ns = time_ns
            self._pairs.append(number)
        return is_due

    def add_pair(self, number: int, left: Image, right: Image) -> None:
        """Keep a pair; one that the disk refuses is not kept. It may wait for the disk, and may be
        called from any thread."""
        # OpenCV's own setting takes a third of the time of any that is given to it.
        png = (cv2.imencode(".png", image)[1].tobytes() for image in (left, right))
        self.journal.append("pair", number, *png)

    def points_of(self, frame: KeptFrame, gridder: LocalGridder) -> GridInput | None:
        """The points of a frame; None where they were not kept or are damaged."""
        packed = None if frame.points is None else self.journal.read(frame.points)
        return None if packed is None else unpacked(packed, gridder)

    def what_is_kept(self, then: str) -> str:
        """A sentence on where the drive is, and with what command it goes on (`then`). It writes
        first what waits."""
        if not self.path.exists():
            return f"The drive is in the map {self.out}."
        taken, count = self.journal.sync(), self.journal.waits()
        if not taken and count and sum(1 for _ in self.journal.records()) == count:
            return "Nothing of the drive is kept, since the full disk took none of it."
        lost = f", but for the last {count} records, which the full disk did not take"
        return f"The drive is kept in {self.folder}{lost if count else ''}; {then}."

    def recording(self, drive: PushedDrive) -> Recording:
        """What was read as a recording, with the pairs that were kept for its frames.
        RecordingError where poses were to be pushed that cannot be used."""
        about, rig = self.about, self.about.rig
        offset_ns = rig.image_time_offset_ns
        staged_ns = [frame.entry.time_ns - offset_ns for frame in drive.frames]
        times_ns = np.array(sorted(staged_ns + drive.bad_ns), dtype=np.int64)
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
            log=FixLog(drive.fixes, (), motion_of(drive.parts)),
            gnss_source=about.source,
            gnss_hash=about.source_sha256,
            rig=rig,
            datum_hint=about.datum_hint,
            notes=notes,
            source=_KeptPairs(self.journal, drive.pairs, times_ns),
        )
        if about.poses is None:
            return recording
        given = body_poses(about.poses, drive.parts.get(GIVEN_ROWS) or [NO_POSES])
        return with_body_poses(recording, given, about.poses).recording()

    def forget(self) -> None:
        """Hold no more in memory than what the session was begun with, however long it lasts: all
        that was pushed is read again when it is asked for."""
        del self.drive


def _apart(numbers: list[int]) -> int:
    """How far apart frames are whose pairs count, so that these are few."""
    apart = 1
    while sum(number % apart == 0 for number in numbers) > MOST_PAIRS:
        apart *= 2
    return apart


@dataclass(frozen=True, slots=True)
class _KeptPairs:
    """A `FrameSource` of a drive whose images are gone, but for some pairs: a frame is the nearest
    of these, which is enough to check the cameras."""

    journal: Journal
    pairs: dict[int, tuple[Blob, ...]]
    times_ns: Int64

    @property
    def roles(self) -> tuple[str, ...]:
        """The roles of the images of a pair."""
        return "left", "right"

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """For each frame the nearest pair."""
        apart = _apart(list(self.pairs))
        numbers = [number for number in self.pairs if number % apart == 0]
        for number in range(start, stop) if numbers else ():
            nearest = min(numbers, key=lambda other: abs(other - number))
            left, right = (
                PushedSource(f"{nearest}/{role}", self._image(blob))
                for role, blob in zip(self.roles, self.pairs[nearest], strict=True)
            )
            size_px = left.values.shape[::-1]
            yield StereoFrame(str(number), int(self.times_ns[number]), left, right, size_px)

    def _image(self, blob: Blob) -> Image:
        data = self.journal.read(blob)
        assert data is not None, "it was whole when the session was read"
        image: Image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        return image
