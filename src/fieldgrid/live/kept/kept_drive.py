"""What a live session was begun with and what was pushed, as its journal has it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import BuildSettings, MapError
from fieldgrid.geometry import Datum, Fix, Rig
from fieldgrid.live.kept.journal import DAMAGED, Record, read_journal
from fieldgrid.live.kept.points_file import RecordSpan, points_end
from fieldgrid.live.pose.sensor_rows import Rows, fix_from_json, joined, rows_from_json
from fieldgrid.maps import StageEntry
from fieldgrid.perception import Refusal
from fieldgrid.pipeline import BadFrame, StageTimes, StepOutcome, found_from_json, rig_from_config
from fieldgrid.recordings import PoseBody

JOURNAL, GRIDS, POINTS = "journal", "frames.grids", "frames.points"
"""The files in a session's folder."""

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


class KeptFrame(NamedTuple):
    """A frame that was staged: its number in the stage file, the step to it, where its points are
    in theirs, None where they were not kept, whether its grid is level, and whether it is a sweep
    whose points have times."""

    number: int
    found: StepOutcome
    points: RecordSpan | None = None
    is_level: bool = False
    is_timed: bool = False

    def is_within(self, end: int) -> bool:
        """Whether a file of points of `end` bytes has those of the frame."""
        return self.points is None or self.points.start + self.points.size <= end


@dataclass(slots=True)
class PushedDrive:
    """What was pushed, as it is read back."""

    about: SessionStart
    fixes: list[Fix] = field(default_factory=list)
    parts: dict[str, list[Rows]] = field(default_factory=dict)
    frames: list[KeptFrame] = field(default_factory=list)
    bad: list[tuple[int, BadFrame]] = field(default_factory=list)
    dropped: int = 0
    damaged_bytes: int = 0
    """Number of bytes of the journal that cannot be read any more."""
    is_damaged_since: bool = False
    """Whether some of that lies behind the last frame: frames may be lost there."""
    unreadable: list[int] = field(default_factory=list)
    """The numbers of frames whose grids cannot be read any more."""
    cut_at: int | None = None
    """The number of the first frame whose points were lost with the power: it does not count."""
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

    def let_go(self) -> None:
        """Forget fixes and rows, of which a recording was made."""
        self.fixes, self.parts = [], {}


def live_folder(out: Path) -> Path:
    """Where a live session for the map `out` keeps what it has."""
    place = out.resolve()
    return place.with_name(f"{place.name}.live")


def read_drive(
    folder: Path, entries: Sequence[StageEntry], waiting: Iterable[Record] = ()
) -> PushedDrive | None:
    """What a journal holds, and what is `waiting` to be written to it, with the frames that the
    stage file has as well, and the file of points if their points were kept; None without a
    beginning. One that a damage took is written anew behind the rest."""
    drive: PushedDrive | None = None
    before: list[Record] = []
    end = points_end(folder / POINTS)
    try:
        for kind, value in chain(read_journal(folder / JOURNAL), waiting):
            if kind == "begin":
                drive = drive or PushedDrive(SessionStart.from_json(value))
                for record in before:
                    _take(drive, *record, entries)
                before.clear()
            elif drive is None:
                before.append((kind, value))
            else:
                _take(drive, kind, value, entries)
        if drive is not None and end is not None:
            while drive.frames and not drive.frames[-1].is_within(end):
                drive.cut_at = drive.frames.pop().number
    except (KeyError, ValueError, TypeError, IndexError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(
            f"The journal in {folder} is of another version of this program or damaged ({error}); "
            "finish it with the version that wrote it."
        ) from error
    return drive


def _take(drive: PushedDrive, kind: str, value: Any, entries: Sequence[StageEntry]) -> None:
    if kind == "fix":
        drive.fixes.append(fix_from_json(value))
    elif kind == "rows":
        drive.add_rows(*rows_from_json(value))
    elif kind == "frame":
        number, frame_id, found, times, *rest = value
        # A frame that was lost with the power is written anew under the same number.
        _cut(drive, number)
        if number < len(entries) and entries[number].frame_id == frame_id:
            points, *flags = rest or (None,)
            place = None if points is None else RecordSpan(*points)
            step = found_from_json(found)
            is_lost = drive.is_damaged_since or number - 1 in drive.unreadable
            if is_lost and drive.frames and number != drive.frames[-1].number + 1:
                step = Refusal.LOST  # it led from a frame that is lost
            drive.is_damaged_since = False
            drive.frames.append(KeptFrame(number, step, place, *flags))
            drive.times.add(StageTimes(*times))
        else:
            drive.unreadable.append(number)
    elif kind == "cut":
        _cut(drive, value)
    elif kind == "bad":
        time_ns, *bad = value
        drive.bad.append((time_ns, BadFrame(*bad)))
    elif kind == "dropped":
        drive.dropped += 1
    elif kind == DAMAGED:
        drive.damaged_bytes += value
        drive.is_damaged_since = True


def _cut(drive: PushedDrive, number: int) -> None:
    """Frames from this number on do not count any more."""
    while drive.unreadable and drive.unreadable[-1] >= number:
        drive.unreadable.pop()
    while drive.frames and drive.frames[-1].number >= number:
        drive.frames.pop()
