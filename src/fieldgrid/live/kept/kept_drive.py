"""What a live session was begun with and what was pushed, as its journal has it."""

from __future__ import annotations

from collections import Counter
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

from fieldgrid.core import BuildSettings, MapError
from fieldgrid.geometry import Datum, Fix, FixColumns, Rig
from fieldgrid.live.kept.frame_names import told_apart
from fieldgrid.live.pose.sensor_rows import Rows, fix_from_json, joined, rows_from_json
from fieldgrid.perception import Refusal
from fieldgrid.pipeline import (
    DAMAGED,
    FRAME,
    BadFrame,
    Blob,
    Journal,
    KeptFrame,
    KeptFrames,
    StageTimes,
    kept_frame,
    rig_from_config,
    work_folder,
)
from fieldgrid.recordings import PoseBody

PIECES = 1000
"""Number of pieces of rows that are joined to one."""


_IN_WORDS = {
    "name": "name",
    "rig": "rig",
    "settings": "settings",
    "datum": "datum",
    "datum_hint": "datum",
    "append": "use of --append",
    "source_sha256": "log of fixes",
    "notes": "source of data",
    "poses": "poses of another program",
}
"""The parts of what a session is begun with, as errors call them."""


@dataclass(frozen=True, slots=True)
class SessionStart:
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
            "rig": self.rig.as_dict(),
            "settings": self.settings.model_dump(mode="json"),
            "datum": _datum_to_json(self.datum),
            "datum_hint": _datum_to_json(self.datum_hint),
            "append": self.append,
            "source": self.source,
            "source_sha256": self.source_sha256,
            "notes": list(self.notes),
            "poses": None if self.poses is None else list(astuple(self.poses)),
        }

    def differs_in(self, earlier: SessionStart) -> tuple[str, ...]:
        """What is other than where an earlier session was begun, in words; nothing where this is
        that session again. What is checked at its end may differ, and so may the address of a
        receiver, which a plug may change; replayed logs are told apart by their content."""
        ours, theirs = self.to_json(), earlier.to_json()
        for one in (ours, theirs):
            del one["settings"]["checks"]
            del one["source"]
        other = {_IN_WORDS[part] for part, value in ours.items() if value != theirs[part]}
        return tuple(words for words in dict.fromkeys(_IN_WORDS.values()) if words in other)

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> SessionStart:
        """The start of a session of a value that `to_json` made."""
        # A session that was begun by an earlier version has no entry of poses.
        name, axes, point = value.get("poses") or (None, "", None)
        body = None if name is None else PoseBody(name, axes, point and tuple(point))
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
            body,
        )


def _datum_to_json(datum: Datum | None) -> list[float] | None:
    return None if datum is None else [datum.lat_deg, datum.lon_deg, datum.height_m]


@dataclass(slots=True)
class PushedDrive:
    """What was pushed, as it is read back."""

    about: SessionStart
    frames: KeptFrames = field(default_factory=KeptFrames)
    fixes: FixColumns = field(default_factory=lambda: FixColumns.of_rows(()))
    parts: dict[str, list[Rows]] = field(default_factory=dict)
    bad: list[tuple[int, BadFrame]] = field(default_factory=list)
    pairs: dict[int, tuple[Blob, ...]] = field(default_factory=dict)
    """The images by which the cameras are checked, PNG, by the numbers of their frames."""
    dropped: int = 0
    damaged_bytes: int = 0
    """Number of bytes of the journal that cannot be read any more."""
    unreadable: int = 0
    """The number of frames whose grids cannot be read any more."""
    is_unlevelled: bool = False
    """Whether grids are not to be level, since no points are kept to make them so."""
    times: StageTimes = field(default_factory=StageTimes)
    _apart: Counter[str] = field(default_factory=Counter)
    """How many of the last rows of each part were not joined."""

    def add_rows(self, part: str, rows: Rows) -> None:
        """Rows behind the others. Those of a long drive are pushed in millions of pieces, which
        take fifty times what is in them: many are joined to one."""
        pieces = self.parts.setdefault(part, [])
        pieces.append(rows)
        self._apart[part] += 1
        if self._apart[part] == PIECES:
            pieces[-PIECES:] = [joined(pieces[-PIECES:])]
            self._apart[part] = 0

    def add_frame(self, frame: KeptFrame, times: StageTimes) -> None:
        """The next frame. No step leads to it over one that is lost, or from before a restart."""
        self.times.add(times)
        if self.frames and frame.number != self.frames[-1].number + 1:
            frame = frame._replace(found=Refusal.LOST)
        elif self.frames and frame.found is None:
            frame = frame._replace(found=Refusal.NOT_COMPARED)
        self.frames.append(frame)

    def let_go(self) -> None:
        """Forget fixes and rows, of which a recording was made."""
        self.fixes, self.parts = FixColumns.of_rows(()), {}


def live_folder(out: Path) -> Path:
    """Where a live session for the map `out` keeps what it has."""
    return work_folder(out)


def live_journal(out: Path) -> Path:
    """The file in it that a live session writes."""
    return work_folder(out) / "live"


def read_drive(journal: Journal) -> PushedDrive | None:
    """What a journal holds, with the frames whose grids can be read; None without a beginning. One
    that a damage took is written anew behind the rest."""
    starts = (record.value for record in journal.records() if record.kind == "begin")
    if (start := next(starts, None)) is None:
        return None
    try:
        drive = PushedDrive(SessionStart.from_json(start), KeptFrames())
        fixes, columns = list[Fix](), list[FixColumns]()
        for record in journal.records():
            kind, value, blobs, _ = record
            if kind == "fix":
                fixes.append(fix_from_json(value))
                if len(fixes) == PIECES:  # they take ten times the memory of columns
                    columns.append(FixColumns.of_rows(fixes))
                    fixes.clear()
            elif kind == "rows":
                drive.add_rows(*rows_from_json(value))
            elif kind == FRAME and journal.read(blobs[0]) is None:
                drive.unreadable += 1
            elif kind == FRAME:
                drive.add_frame(*kept_frame(record))
            elif kind == "pair" and None not in map(journal.read, blobs):
                drive.pairs[value] = blobs
            elif kind == "bad":
                time_ns, *bad = value
                drive.bad.append((time_ns, BadFrame(*bad)))
            elif kind == "dropped":
                drive.dropped += 1
            elif kind == "unlevelled":
                drive.is_unlevelled = True
            elif kind == DAMAGED:
                drive.damaged_bytes += value
        drive.fixes = FixColumns.joined([*columns, FixColumns.of_rows(fixes)])
        names = told_apart([frame.entry.frame_id for frame in drive.frames])
        frames, drive.frames = drive.frames, KeptFrames()
        for frame, name in zip(frames, names, strict=True):
            drive.frames.append(frame._replace(entry=frame.entry._replace(frame_id=name)))
    except (KeyError, ValueError, TypeError, IndexError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(
            "The journal of the drive is of another version of this program or damaged "
            f"({error}); finish it with the version that wrote it."
        ) from error
    return drive
