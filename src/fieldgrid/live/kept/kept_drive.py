"""What was pushed to a live session, as its journal has it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.live.kept.frame_names import told_apart
from fieldgrid.live.pose.sensor_rows import Rows, fix_from_json, joined, rows_from_json
from fieldgrid.perception import Refusal
from fieldgrid.pipeline import (
    Blob,
    JournalRecord,
    KeptDrive,
    KeptFrames,
    work_folder,
)

PIECES = 1000
"""Number of pieces of rows that are joined to one."""


@dataclass
class PushedDrive(KeptDrive):
    """What was pushed, as it is read back. Without a beginning, which a damage may have taken,
    nothing is taken."""

    fixes: FixColumns = field(default_factory=lambda: FixColumns.of_rows(()))
    parts: dict[str, list[Rows]] = field(default_factory=dict)
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
        else:
            super().take(record)

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
