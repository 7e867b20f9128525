"""The frames of a plain folder: by `frames.csv`, or by the names of the files."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path, PurePath
from typing import NamedTuple

from fieldgrid.core import RecordingError, counted, quoted
from fieldgrid.recordings.files import is_inside, parse_time_ns, read_table
from fieldgrid.recordings.frames.images import SUFFIXES
from fieldgrid.recordings.frames.in_folder import InFolder
from fieldgrid.recordings.stored import Shot, checked_shots
from fieldgrid.recordings.tables.times import NO_TIME, TimeScale, guess_scale, to_utc_ns

TimeOf = Callable[[Path], int]
"""The time of a file that its name does not tell, UTC in nanoseconds; RecordingError without."""

TABLE = "frames.csv"

MAX_FRAMES = 500_000
"""Half a day at ten frames a second. Each takes some 400 bytes."""


class FrameLayout(NamedTuple):
    """How one kind of frame lies in a folder: its columns in the table, the folder of each, the
    endings of its files, what a frame and a file are called, what else tells a file's time,
    whether files that the table names may be missing, and whether all frames are still to come."""

    columns: tuple[str, ...]
    folders: tuple[str, ...]
    suffixes: Collection[str]
    what: str
    file: str = "image"
    time_of: TimeOf | None = None
    incomplete: bool = False
    growing: bool = False

    def is_in(self, folder: Path) -> bool:
        """Whether all the folders are there."""
        return all((folder / name).is_dir() for name in self.folders)


PAIRS = FrameLayout(("left", "right"), ("left", "right"), SUFFIXES, "stereo pair")


_DATE = re.compile(r"20\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])")
"""How a date begins that is written without marks. As a count since 1970 it is after 2033."""

FEWEST_ROWS, MOST_ASTRAY = 10, 0.02
"""Of a table with fewer rows, or of which more are not in order of time, nothing is told of one."""


def read_frames(
    folder: Path, table: str | None = None, layout: FrameLayout = PAIRS
) -> tuple[tuple[Shot, ...], tuple[str, ...]]:
    """The frames of a folder in order of time, and remarks.

    `table` is the table to read, inside the folder; else `frames.csv` if there is one.
    """
    if layout.growing:
        return (), ()
    path = folder / (table or TABLE)
    shots: list[Shot] = []
    if table is not None or path.exists():
        in_folder = InFolder(folder)
        for line, row in read_table(path, needed_columns(layout), named=frame_columns):
            if len(shots) == MAX_FRAMES:
                raise RecordingError(
                    f"{path} lists more than {MAX_FRAMES} frames; split it into several recordings."
                )
            shots.append(shot_of_row(row, f"{path}, line {line}", layout, in_folder))
        checked = checked_shots(shots, folder, layout.what, incomplete=layout.incomplete)
        notes = _out_of_order(shots, path)
        if in_folder.elsewhere:
            notes += (
                f"{path.name} names files in {in_folder.elsewhere}, which is not here; those of "
                "the same names in the recording are taken.",
            )
        return checked, notes
    listings = [_files(folder / name, layout.suffixes) for name in layout.folders]
    common = set.intersection(*(set(listing) for listing in listings))
    notes = ()
    for stem in sorted(common):
        names = [found[stem] for found in listings]
        files = tuple(f"{where}/{n}" for where, n in zip(layout.folders, names, strict=True))
        time_ns, scale = file_time(folder, files[0], layout)
        if scale is not None and not shots:
            notes = (f"The names of the files are times: {scale.describe()}.",)
        shots.append(Shot(time_ns, stem, files))
    alone = sum(len(listing) for listing in listings) - len(listings) * len(common)
    if alone:
        notes += (f"{counted(alone, 'image')} without a partner skipped.",)
    return checked_shots(shots, folder, layout.what), notes


def _out_of_order(shots: Sequence[Shot], path: Path) -> tuple[str, ...]:
    """A remark on frames whose stamps do not fit between those around them in a table that is in
    order of time but for them."""
    astray = [
        at
        for before, at, after in zip(shots, shots[1:], shots[2:], strict=False)
        if before.time_ns <= after.time_ns and not before.time_ns <= at.time_ns <= after.time_ns
    ]
    if not astray or len(shots) < FEWEST_ROWS or len(astray) > max(1, MOST_ASTRAY * len(shots)):
        return ()
    return (
        f"Frames that stand in {path.name} between such as were taken at another time: "
        f"{len(astray)}, the first of them {astray[0].frame_id}. They are used where their stamps "
        "say; if these are wrong, leave their rows out.",
    )


def needed_columns(layout: FrameLayout) -> tuple[str, ...]:
    """The columns that no table of such frames lacks, besides that of the time."""
    return ("frame_id", *layout.columns)


def frame_columns(header: list[str]) -> list[str]:
    """The columns of a table of frames, in which `id` is that of the frame unless there is
    a `frame_id`."""
    if "frame_id" in header or header.count("id") != 1:
        return header
    return ["frame_id" if name == "id" else name for name in header]


def shot_of_row(
    row: dict[str, str], where: str, layout: FrameLayout, in_folder: Callable[[str], str]
) -> Shot:
    """The frame that a row of a table tells; `where` is what an error calls the row, `in_folder`
    gives the path of a file in the recording."""
    for column in needed_columns(layout):
        if not row[column]:
            raise RecordingError(f"{where}: {column} is empty; fill it or remove the row.")
    # Windows parts paths by backslashes.
    files = tuple(in_folder(row[column].replace("\\", "/")) for column in layout.columns)
    for name in files:
        if not is_inside(name):
            raise RecordingError(
                f"{where}: {quoted(name)} leads out of the recording; give a path inside its "
                "folder, where a link may stand for files that lie elsewhere (ln -s THEIR_FOLDER "
                f"{layout.folders[0]})."
            )
    try:
        time_ns = parse_time_ns(row)
    except ValueError as problem:
        raise RecordingError(f"{where}: {problem}; correct it.") from problem
    return Shot(time_ns, row["frame_id"], files)


def file_time(folder: Path, file: str, layout: FrameLayout) -> tuple[int, TimeScale | None]:
    """The time of a frame in UTC nanoseconds, by the name of its first file in nanoseconds, by what
    else tells it, or by the name in another unit, whose scale is told then."""
    stem = PurePath(file).stem
    try:
        return parse_time_ns({"time_ns": stem}), None
    except ValueError:
        scale = guess_scale("", [stem], decimal_comma=False)
    time_ns = NO_TIME
    # 2024060100001 is a date with a count.
    if scale is not None and scale.places is not None and _DATE.match(stem) is None:
        time_ns = int(to_utc_ns([stem], scale, decimal_comma=False)[0])
    if layout.time_of is not None:
        try:
            return layout.time_of(folder / file), None
        except RecordingError:
            if time_ns == NO_TIME:
                raise
    if time_ns == NO_TIME:
        raise RecordingError(
            f"{folder} has no {TABLE}, and the {layout.file} name {PurePath(file).name} is no UTC "
            f"time in s, ms, us or ns; add {TABLE} with frame_id, timestamp_utc_s, "
            f"{', '.join(layout.columns)}."
        )
    return time_ns, scale


def _files(folder: Path, suffixes: Collection[str]) -> dict[str, str]:
    """Names of the files of a folder by their stem."""
    files: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in suffixes:
            if path.stem in files:
                raise RecordingError(
                    f"{folder} has both {files[path.stem]} and {path.name}; remove one."
                )
            files[path.stem] = path.name
    return files
