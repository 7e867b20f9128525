"""GNSS logs on disk: which one to take, of which kind it is, and its fixes."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from fieldgrid.core import ConfigError, RecordingError, quoted
from fieldgrid.geometry import FixColumns
from fieldgrid.recordings.drive import Drive
from fieldgrid.recordings.files import DELIMITERS, open_log_bytes
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.readers.foreign import may_hold_nmea, refuse_foreign
from fieldgrid.recordings.readers.isoxml import is_time_log, read_time_log
from fieldgrid.recordings.readers.rtklib import SUFFIXES as SOLUTIONS, is_solution, read_solution
from fieldgrid.recordings.readers.settings_file import RecordingSettings
from fieldgrid.recordings.tables.columns import Columns
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.fix_table import read_fix_table
from fieldgrid.recordings.tables.stream_log import (
    NoStreamError,
    UndatedError,
    looks_like_stream,
    read_stream,
)
from fieldgrid.recordings.tables.tables import COMMENTS, split_header

SUFFIXES = frozenset({".nmea", ".csv", ".tsv", ".ubx"}) | SOLUTIONS
"""File name endings of GNSS logs, in lower case; ``.gz`` may follow."""

_HEAD_BYTES = 1 << 16
_TEXT = re.compile(r"[\t -~\x80-\xff]*")


def find_log(folder: Path, wanted: str | Path | None) -> Path | None:
    """The log in `gnss/` of a recording, the one that is `wanted`, or None when it has none.

    `wanted` is a file name in `gnss/`, a path inside the recording, or a path anywhere.
    """
    present = [path for path in _files(folder / "gnss") if _is_log(path)]
    names = ", ".join(path.name for path in present) or "none"
    if wanted is not None:
        for path in (folder / "gnss" / wanted, folder / wanted, Path(wanted)):
            if path.is_file() or (path.is_dir() and is_time_log(path)):
                return path
        raise RecordingError(
            f"The GNSS log {quoted(wanted)} is neither in {folder / 'gnss'} nor a file of its own; "
            f"the recording has: {names}."
        )
    if len(present) > 1:
        raise RecordingError(f"{folder} has several GNSS logs: {names}; give --gnss NAME.")
    return present[0] if present else None


def log_name(path: Path, folder: Path) -> str:
    """What a log is called in a recording: its path inside it, else its name."""
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


def passed_over(folder: Path) -> str:
    """A sentence on a recording without a log: what lies in `gnss/` and is not taken for one."""
    names = ", ".join(path.name for path in _files(folder / "gnss") if not _is_log(path))
    if not names:
        return "No GNSS log in gnss/."
    return f"No GNSS log in gnss/; passed over: {names[:200]} (name it with --gnss if it is one)."


def _files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []


def _is_log(path: Path) -> bool:
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    if suffixes[-1:] == [".gz"]:
        suffixes.pop()
    return suffixes[-1:] != [] and (
        suffixes[-1] in SUFFIXES or (path.suffix.lower() == ".bin" and is_time_log(path))
    )


def read_fix_log(path: Path, columns: Columns | None = None, epoch_ns: int | None = None) -> FixLog:
    """The fixes of a log, whose kind is told by its content.

    NMEA, UBX or both; a table (`columns` says what its names do not); a solution of RTKLIB; an
    ISO 11783-10 time log (or the folder of a single one). Any but the last may be packed by gzip.
    `epoch_ns` is the day on which sentences begin where none has a date; ConfigError for a log that
    tells its dates.
    """
    if epoch_ns is not None:
        return _read_undated(path, epoch_ns)
    if is_time_log(path):
        return read_time_log(path)
    head = _head(path)
    if not head.strip(b"\0\r\n\t "):
        return FixLog(FixColumns.of([]), (f"{path.name}: the file is empty.",))
    if is_solution(head):
        return read_solution(path, columns)
    is_table = _looks_like_table(head)
    # Sentences in a column are a stream, unless it is said what the columns are.
    if looks_like_stream(head) and (columns is None or not is_table):
        return read_stream(path)
    if may_hold_nmea(path, head):
        with suppress(NoStreamError):
            log = read_stream(path)
            if len(log.fixes):
                return log
    refuse_foreign(path, head)
    if is_table:
        return read_fix_table(path, columns)
    return read_stream(path)  # the receiver may have begun with something else


def _read_undated(path: Path, epoch_ns: int) -> FixLog:
    try:
        read_stream(path)
    except UndatedError:
        return read_stream(path, epoch_ns)
    except NoStreamError:
        pass
    raise ConfigError(
        f"{path} is no NMEA log without dates (of a table, --columns time_epoch=MOMENT says from "
        "when its times count); leave --epoch out."
    )


def _head(path: Path) -> bytes:
    with open_log_bytes(path) as stream:
        return stream.read(_HEAD_BYTES)


def _looks_like_table(head: bytes) -> bool:
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return True
    lines = [line for line in head.splitlines() if line.strip()]
    first, _ = split_header(line.decode("latin-1") for line in lines)
    if _TEXT.fullmatch(first) is None or not any(d in first for d in DELIMITERS):
        return False
    # Damaged sentences and remarks before something else than a table hold commas, too.
    return not first.startswith(("$", "!", *COMMENTS)) or "lat" in first.lower()


def with_log(
    drive: Drive,
    folder: Path,
    log_path: Path | None,
    settings: RecordingSettings,
    options: DriveOptions,
) -> Drive:
    """A drive in a folder with the fixes of a log, or a remark that there is none."""
    if log_path is None:
        options.refuse(f"{folder} has no GNSS log", "epoch_ns")
        return replace(drive, notes=(*drive.notes, passed_over(folder)))
    log = options.in_time(chosen_log(log_path, settings, options), settings.gnss_offset_ns)
    return replace(
        drive,
        log=log,
        gnss_source=log_name(log_path, folder),
        gnss_path=log_path,
        notes=drive.notes + log.notes,
    )


def chosen_log(path: Path, settings: RecordingSettings, options: DriveOptions) -> FixLog:
    """The fixes of a log of a recording, whose columns are as the user says, else the recording;
    ConfigError where the user says it of no table."""
    _refuse_columns(path, options)
    return read_fix_log(path, options.columns or settings.columns, options.epoch_ns)


def _refuse_columns(path: Path, options: DriveOptions) -> None:
    """ConfigError for what is said of the columns of a log that is no table."""
    if options.columns is None:
        return
    head = b"" if is_time_log(path) else _head(path)
    if not (is_solution(head) or _looks_like_table(head)):
        options.refuse(f"{path} is no table", "columns")


def open_log(path: Path, options: DriveOptions) -> Drive:
    """A log as a drive without frames, of whose vehicle nothing is known."""
    options.refuse(f"{path} is a log already, in which none can be picked", "gnss")
    options.refuse_topics(path)
    options.refuse(f"{path} is no recording with images", "mounting", "image_time_offset_ns")
    _refuse_columns(path, options)
    log = options.in_time(read_fix_log(path, options.columns, options.epoch_ns))
    return Drive(
        path=path,
        name=path.stem,
        log=log,
        gnss_source=path.name,
        gnss_path=path,
        notes=log.notes,
    )


FORMAT = Format(
    "GNSS log",
    "a log of NMEA, UBX, RTKLIB or a table, or an ISO 11783-10 time log",
    lambda path: path.is_file() or is_time_log(path),
    open_log,
)
