"""Files that nobody vouches for: read within bounds, with errors that name them."""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import os
import re
import stat
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePath
from typing import BinaryIO, cast

from fieldgrid.core import (
    MAX_TIME_NS,
    MIN_TIME_NS,
    FieldgridError,
    RecordingError,
    UnfoldBudget,
    bounded_lines,
    check_rows,
    quoted,
)

MAX_TEXT_BYTES = 256 << 20
MAX_FRAME_BYTES = 1 << 30
"""More than any image or sweep has."""
MAX_LOG_BYTES = 2 << 30
"""The most that a log may hold, unpacked: a day of raw measurements, not a bomb."""

DELIMITERS = ",;\t|"

_SUSPECT = re.compile(r"\.\.|[\0\\:]")
_SECONDS = re.compile(r"(\d{1,12})(?:\.(\d+))?")


def check_regular(path: Path, error: type[FieldgridError] = RecordingError) -> int:
    """The size in bytes of a regular file; a missing one, a folder or a pipe is an error."""
    if "\0" in str(path):
        raise error(f"{quoted(path)} cannot be read: it holds a NUL; correct the path.")
    with _reading(path, error):
        status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path} is not a regular file; put the file itself there.")
    return status.st_size


def is_inside(name: str) -> bool:
    """Whether a path that a recording names stays in it: the recording may come from elsewhere,
    and must not reach for other files of the reader."""
    if name and name[0] != "/" and not _SUSPECT.search(name):
        return True  # most names, and much faster
    return bool(name) and not (
        PurePath(name).is_absolute() or ".." in PurePath(name).parts or "\0" in name
    )


def read_bytes(
    path: Path, max_bytes: int = MAX_TEXT_BYTES, error: type[FieldgridError] = RecordingError
) -> bytes:
    """The content of a regular file of at most `max_bytes`."""
    _check_size(path, max_bytes, error)
    with _reading(path, error), path.open("rb") as file:
        # Python makes room for all that is asked for, before it reads.
        return file.read(min(os.fstat(file.fileno()).st_size + 1, max_bytes))


def read_text(
    path: Path, max_bytes: int = MAX_TEXT_BYTES, error: type[FieldgridError] = RecordingError
) -> str:
    """The content of a UTF-8 text file, with or without a byte order mark."""
    with _reading(path, error):
        return read_bytes(path, max_bytes, error).decode("utf-8-sig")


def read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line of a UTF-8 text file, read as it is asked for."""
    _check_size(path, MAX_TEXT_BYTES, RecordingError)
    with _reading(path), path.open(encoding="utf-8-sig") as file:
        for number, line in enumerate(bounded_lines(file, path), start=1):
            check_rows(number, path)
            yield number, line


@contextmanager
def open_log_bytes(path: Path) -> Iterator[BinaryIO]:
    """A log as a stream of bytes, unpacked where it is packed by gzip, whatever its name."""
    size = _check_size(path, MAX_LOG_BYTES, RecordingError)
    with _reading(path), path.open("rb") as file:
        is_packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        unpacked = io.BufferedReader(_Unpacked(file, path, size), 1 << 16) if is_packed else file
        yield cast(BinaryIO, unpacked)


class _Unpacked(io.RawIOBase):
    """What a gzip file holds, which ends with an error where a log can no longer be meant."""

    def __init__(self, file: BinaryIO, path: Path, packed_bytes: int) -> None:
        super().__init__()
        self._source, self._path = gzip.GzipFile(fileobj=file), path
        self._budget, self._left = UnfoldBudget(path, packed_bytes, is_log=True), MAX_LOG_BYTES

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: object) -> int:
        view = memoryview(buffer).cast("B")  # type: ignore[arg-type]
        data = self._source.read(len(view))
        self._budget.spend(len(data))
        self._left -= len(data)
        if self._left < 0:
            raise RecordingError(
                f"{self._path} has more than {MAX_LOG_BYTES} bytes, unpacked; cut it into drives."
            )
        view[: len(data)] = data
        return len(data)


def read_table(
    path: Path,
    required: Sequence[str],
    named: Callable[[list[str]], list[str]] = list,
) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and columns of each row of a CSV file; short and empty cells are ''. `named`
    gives columns the names that are meant."""
    _check_size(path, MAX_TEXT_BYTES, RecordingError)
    with _reading(path), path.open(encoding="utf-8-sig", newline="") as file:
        lines = bounded_lines(file, path)
        first = next(lines, "")
        rows = csv.reader(chain([first], lines), delimiter=delimiter_of(first))
        header = named([name.strip() for name in next(rows, [])])
        for name in required:
            if name not in header:
                raise RecordingError(
                    f"{path} has no column {name}; its header must have at least "
                    f"{', '.join(required)}. It has: {', '.join(header)[:200]}."
                )
        for row in rows:
            cells = [cell.strip() for cell in row] + [""] * len(header)
            if any(cells):
                yield rows.line_num, dict(zip(header, cells, strict=False))


def delimiter_of(header: str) -> str:
    """What parts the columns of a table: comma, or the semicolon, tab or bar that spreadsheets of
    countries with a decimal comma write."""
    return max(DELIMITERS, key=header.count)


def parse_time_ns(row: dict[str, str]) -> int:
    """UTC nanoseconds of the column time_ns, or of timestamp_utc_s exactly, with a decimal point
    or comma.

    Seconds are never a float on the way, which would be off by 100 ns. ValueError says what
    is wrong, without the file.
    """
    column = "time_ns" if row.get("time_ns") else "timestamp_utc_s"
    if not {"time_ns", "timestamp_utc_s"} & row.keys():
        names = ", ".join(row)[:200]
        raise ValueError(f"no column is time_ns or timestamp_utc_s, but {names}")
    text = row.get(column, "").replace(",", ".")
    match = _SECONDS.fullmatch(text)
    if column == "time_ns":
        time_ns = int(text) if text.isdecimal() and len(text) <= 20 else -1
    elif match is not None:
        fraction = (match[2] or "").ljust(9, "0")[:9]
        time_ns = int(match[1]) * 1_000_000_000 + int(fraction)
    else:
        time_ns = -1
    if not MIN_TIME_NS <= time_ns <= MAX_TIME_NS:
        unit = "nanoseconds" if column == "time_ns" else "seconds"
        raise ValueError(
            f"{column} {quoted(text)} is no UTC time after 1980 in {unit} since 1970, without "
            "exponent"
        )
    return time_ns


def _check_size(path: Path, max_bytes: int, error: type[FieldgridError]) -> int:
    size = check_regular(path, error)
    if size > max_bytes:
        raise error(
            f"{path} has {size} bytes, more than the {max_bytes} that such a file can need; "
            "check that it is the right file."
        )
    return size


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """A file that one part of a frame is; its bytes are read when they are needed."""

    path: Path

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def data(self) -> bytes:
        """The content, of at most `MAX_FRAME_BYTES`."""
        return read_bytes(self.path, MAX_FRAME_BYTES)

    def sha256(self) -> str:
        """The hash of the file."""
        return hashlib.sha256(self.data()).hexdigest()


@contextmanager
def _reading(path: Path, error: type[FieldgridError] = RecordingError) -> Iterator[None]:
    """Makes what goes wrong with a file an error that names it."""
    try:
        yield
    except UnicodeDecodeError as problem:
        raise error(
            f"{path} is not UTF-8 text: byte {problem.start} cannot be decoded; "
            "save it as UTF-8, or restore it if it is damaged."
        ) from problem
    except csv.Error as problem:
        raise error(
            f"{path} is not a CSV file: {problem}; correct or export it again."
        ) from problem
    except (EOFError, zlib.error, gzip.BadGzipFile) as problem:
        raise error(
            f"{path} is a damaged gzip file: {problem}; pack it again, or unpack what is whole."
        ) from problem
    except OSError as problem:
        why = problem.strerror or str(problem)
        raise error(f"{path} cannot be read: {why}; check the path and the disk.") from problem
