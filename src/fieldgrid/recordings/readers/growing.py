"""A plain folder in which the frames of a drive appear while it is driven."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from fieldgrid.core import RecordingError
from fieldgrid.geometry import Datum, Rig
from fieldgrid.recordings.files import delimiter_of
from fieldgrid.recordings.frames.frame_table import (
    TABLE,
    FrameLayout,
    file_time,
    frame_columns,
    needed_columns,
    shot_of_row,
)
from fieldgrid.recordings.frames.frames import Frame
from fieldgrid.recordings.frames.image_format import image_format
from fieldgrid.recordings.frames.images import ImageFile
from fieldgrid.recordings.frames.in_folder import InFolder
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions, together
from fieldgrid.recordings.readers.folder import SESSION, folder_mounting_path
from fieldgrid.recordings.readers.sensors import read_seen
from fieldgrid.recordings.readers.settings_file import (
    SETTINGS,
    RecordingSettings,
    read_session_datum,
    read_settings,
)
from fieldgrid.recordings.stored import FrameKind, PairKind, Shot

_MOST_LINE_BYTES = 4 << 20

_MOST_PROBLEMS = 1000
"""Of wrong rows and names, how many are told one by one each time."""

_PAIRS_TELL = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff"})
_OTHERS_TELL = frozenset({".png"})
"""Endings of files that tell whether they are whole."""


@dataclass(slots=True, eq=False)
class GrowingFolder:
    """A folder of the layout of a recording, and which of its frames were found so far.

    Not safe to call from several threads.
    """

    path: Path
    name: str
    rig: Rig
    datum_hint: Datum | None
    notes: tuple[str, ...]
    kind: FrameKind
    _settings: RecordingSettings
    _layout: FrameLayout
    _in_folder: InFolder
    _is_first: bool = True
    _names: list[set[str]] = field(default_factory=list)
    """Of each folder of the layout, what it held the last time."""
    _alone: list[dict[str, str]] = field(default_factory=list)
    """Of each folder, the files by their stems that have no partner in another yet."""
    _read_bytes: int = 0
    _header: list[str] = field(default_factory=list)
    _delimiter: str = ","
    _lines: int = 0

    def new_shots(self) -> tuple[list[Shot], list[RecordingError]]:
        """The frames that were not there the last time, in order of time, and what is wrong with
        names and rows that are new. Files may be missing yet where the table names them, or be half
        written. OSError where the folder cannot be read, RecordingError for a table that has become
        shorter."""
        table = self.path / (self._settings.frames or TABLE)
        shots: list[Shot] = []
        problems: list[RecordingError] = []
        more = 0
        for found in self._from_table(table) if table.exists() else self._from_names():
            if isinstance(found, Shot):
                shots.append(found)
            elif len(problems) < _MOST_PROBLEMS:
                problems.append(found)
            else:
                more += 1
        if more:
            problems.append(
                RecordingError(f"{self.path} has {more} more new rows or names that are no frames.")
            )
        return sorted(shots), problems

    def frame(self, shot: Shot) -> Frame:
        """The frame, its files unread. The first one tells how many of 16 bits are filled, where
        nothing else does, which is added to the notes."""
        if self._is_first and isinstance(self.kind, PairKind):
            stored, notes = image_format(self.path, [shot], self._settings)
            self.kind = replace(self.kind, image_format=stored)
            self.notes += notes
        self._is_first = False
        return self.kind.frame(self.path, shot)

    def is_whole(self, shot: Shot) -> bool | None:
        """Whether the files of a frame are written to their end; None where they are of a kind
        that does not tell."""
        tells = _PAIRS_TELL if isinstance(self.kind, PairKind) else _OTHERS_TELL
        says: bool | None = True
        for name in shot.files:
            path = self.path / name
            if not path.is_file():
                return False
            if path.suffix.lower() not in tells:
                says = None
            elif not ImageFile(path).is_whole():
                return False
        return says

    def state(self, shot: Shot) -> tuple[tuple[int, int], ...]:
        """Size and time of change of the files of a frame, (-1, 0) of a missing one."""
        found = []
        for name in shot.files:
            try:
                status = (self.path / name).stat()
                found.append((status.st_size, status.st_mtime_ns))
            except OSError:
                found.append((-1, 0))
        return tuple(found)

    def _from_names(self) -> Iterator[Shot | RecordingError]:
        """What the names tell that were not there the last time, once all its files are there."""
        if not self._alone:
            self._names = [set() for _ in self._layout.folders]
            self._alone = [{} for _ in self._layout.folders]
        for k, where in enumerate(self._layout.folders):
            names = set(os.listdir(self.path / where))
            for name in names - self._names[k]:
                stem, suffix = os.path.splitext(name)
                if suffix.lower() in self._layout.suffixes:
                    self._alone[k][stem] = f"{where}/{name}"
            self._names[k] = names
        for stem in set.intersection(*map(set, self._alone)):
            files = tuple(alone.pop(stem) for alone in self._alone)
            try:
                time_ns, _ = file_time(self.path, files[0], self._layout)
                yield Shot(time_ns, stem, files)
            except RecordingError as problem:
                yield problem

    def _from_table(self, table: Path) -> Iterator[Shot | RecordingError]:
        """What the rows tell that end with a new line and were not read yet."""
        with table.open("rb") as file:
            if file.seek(0, os.SEEK_END) < self._read_bytes:
                raise RecordingError(
                    f"{table} has become shorter than what was read of it; begin a new drive in "
                    "another folder."
                )
            file.seek(self._read_bytes)
            while (raw := file.readline(_MOST_LINE_BYTES)).endswith(b"\n"):
                self._read_bytes += len(raw)
                self._lines += 1
                where = f"{table}, line {self._lines}"
                try:
                    yield from self._of_row(raw.decode("utf-8-sig"), where)
                except RecordingError as problem:
                    yield problem
                except (UnicodeDecodeError, csv.Error) as problem:
                    yield RecordingError(f"{where}: {problem}; correct it.")
        if len(raw) == _MOST_LINE_BYTES:
            raise RecordingError(
                f"{table} has a line of more than {_MOST_LINE_BYTES >> 20} MiB, so it is no table "
                "of frames; check the file."
            )

    def _of_row(self, text: str, where: str) -> Iterator[Shot]:
        """The frame of a row; none of the header and of empty rows."""
        if not self._header:
            self._delimiter = delimiter_of(text)
        cells = [cell.strip() for cell in next(csv.reader([text], delimiter=self._delimiter), [])]
        if not self._header:
            header, needed = frame_columns(cells), needed_columns(self._layout)
            if not set(needed) <= set(header):
                raise RecordingError(f"{where} is no header with at least {', '.join(needed)}.")
            self._header = header
        elif any(cells):
            cells += [""] * len(self._header)
            row = dict(zip(self._header, cells, strict=False))
            yield shot_of_row(row, where, self._layout, self._in_folder)


def open_growing(path: str | Path, options: DriveOptions | None = None) -> GrowingFolder:
    """The folder in which frames will appear: `left/` and `right/` (or `depth/`, `disparity/`,
    `clouds/`), with `frames.csv` or times as names, and `calibration/` as a recording has it. Of
    the options, `mounting` and `image_time_offset_ns` count.

    Raises RecordingError for what is no such folder, CalibrationError where it does not say what
    the frames will be of.
    """
    path, options = Path(path), options or DriveOptions()
    if not path.is_dir():
        what = "is no folder" if path.exists() else "does not exist"
        raise RecordingError(f"{path} {what}; give the folder in which images appear.")
    settings = read_settings(path / SETTINGS)
    live = "Fixes that arrive live are moved to the clock of the images by their source alone"
    options.refuse(live, "gnss_offset_ns")
    options.refuse(f"{path} is no bag", "epoch_ns")
    if settings.gnss_offset_ns:
        raise RecordingError(f"{live}; leave gnss_time_offset_s out of {path / SETTINGS}.")
    usual, offset_ns = folder_mounting_path(path), options.offset_or(settings.image_time_offset_ns)
    seen = together(
        lambda: options.find_mounting(usual, path),
        NO_MOUNTING,
        lambda mounting: read_seen(path, settings, mounting, offset_ns, growing=True),
    )
    return GrowingFolder(
        path,
        settings.name or path.resolve().name,
        seen.rig,
        settings.datum or read_session_datum(path / SESSION),
        seen.notes,
        seen.kind,
        settings,
        seen.layout,
        InFolder(path),
    )
