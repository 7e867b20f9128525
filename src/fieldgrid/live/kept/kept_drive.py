"""What a live session was begun with and what was pushed, as its journal has it."""

from __future__ import annotations

from collections import Counter
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Datum, Fix, FixColumns, Rig
from fieldgrid.live.kept.frame_names import told_apart
from fieldgrid.live.pose.sensor_rows import Rows, fix_from_json, joined, rows_from_json
from fieldgrid.perception import Refusal
from fieldgrid.pipeline import (
    BAD,
    BEGIN,
    Blob,
    JournalRecord,
    KeptDrive,
    KeptFrames,
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


@dataclass
class PushedDrive(KeptDrive):
    """What was pushed, as it is read back. Without a beginning, which a damage may have taken,
    nothing is taken."""

    about: SessionStart | None = None
    fixes: FixColumns = field(default_factory=lambda: FixColumns.of_rows(()))
    parts: dict[str, list[Rows]] = field(default_factory=dict)
    bad_ns: list[int] = field(default_factory=list)
    """The times of the frames that are bad."""
    pairs: dict[int, tuple[Blob, ...]] = field(default_factory=dict)
    """The images by which the cameras are checked, PNG, by the numbers of their frames."""
    dropped: int = 0
    is_unlevelled: bool = False
    """Whether grids are not to be level, since no points are kept to make them so."""
    _apart: Counter[str] = field(default_factory=Counter)
    """How many of the last rows of each part were not joined."""
    _columns: list[FixColumns] = field(default_factory=list)
    _new: list[Fix] = field(default_factory=list)
    """Fixes that are not made columns yet: so they take ten times the memory."""

    def add_rows(self, part: str, rows: Rows) -> None:
        """Rows behind the others. Those of a long drive are pushed in millions of pieces, which
        take fifty times what is in them: many are joined to one."""
        pieces = self.parts.setdefault(part, [])
        pieces.append(rows)
        self._apart[part] += 1
        if self._apart[part] == PIECES:
            pieces[-PIECES:] = [joined(pieces[-PIECES:])]
            self._apart[part] = 0

    def take(self, record: JournalRecord) -> None:
        """Take the next record of the journal."""
        kind, value, blobs, _ = record
        if kind == "fix":
            self._new.append(fix_from_json(value))
            if len(self._new) == PIECES:
                self._columns.append(FixColumns.of_rows(self._new))
                self._new.clear()
        elif kind == "rows":
            self.add_rows(*rows_from_json(value))
        elif kind == "pair" and None not in map(self.journal.read, blobs):
            self.pairs[value] = blobs
        elif kind == "dropped":
            self.dropped += 1
        elif kind == "unlevelled":
            self.is_unlevelled = True
        elif kind == BEGIN and self.about is None:
            self.about = SessionStart.from_json(value)
        else:
            super().take(record)
            if kind == BAD:
                self.bad_ns.append(value[3])

    def settle(self) -> None:
        """No step leads to a frame over one that is lost, or from before a restart; and each frame
        has a name of its own."""
        super().settle()
        self.fixes = FixColumns.joined([*self._columns, FixColumns.of_rows(self._new)])
        names = told_apart([frame.entry.frame_id for frame in self.frames])
        frames, self.frames = self.frames, KeptFrames()
        before = -1
        for frame, name in zip(frames, names, strict=True):
            entry, found = frame.entry._replace(frame_id=name), frame.found
            if self.frames and not self.bad.keys() >= set(range(before + 1, frame.number)):
                found = Refusal.LOST
            elif self.frames and found is None:
                found = Refusal.NOT_COMPARED
            self.frames.append(frame._replace(entry=entry, found=found))
            before = frame.number

    def let_go(self) -> None:
        """Forget fixes and rows, of which a recording was made."""
        self.fixes, self.parts = FixColumns.of_rows(()), {}


def live_folder(out: Path) -> Path:
    """Where a live session for the map `out` keeps what it has."""
    return work_folder(out)


def live_journal(out: Path) -> Path:
    """The file in it that a live session writes."""
    return work_folder(out) / "live"
