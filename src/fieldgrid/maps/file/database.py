"""SQLite as this package uses it: how a file is opened, and what its errors mean to a user."""

from __future__ import annotations

import ctypes
import os
import sqlite3
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import MapError, MapWriteError, shortened, sync
from fieldgrid.maps.file import beside

BUSY_TIMEOUT_S = 30.0
"""How long a writer waits for another one, or a reader for a commit to end."""

_TELL_EVERY_S = 1.0

_PAGES_A_STEP = 10_000

MAX_VALUE_BYTES = 16 << 20
"""The largest text or blob that is accepted from a file; the largest written is 8 MB."""


class Patience(NamedTuple):
    """How long a writer waits for another one, seconds; `tell` hears each second how long it has
    waited."""

    limit_s: float = BUSY_TIMEOUT_S
    tell: Callable[[float], None] | None = None


USUAL_PATIENCE = Patience()


class _Connection(sqlite3.Connection):
    """A connection that knows the process that opened it, and the device and number of its file."""

    owner = 0
    file = (0, 0)

    def close(self) -> None:
        super().close()
        with _REGISTER:
            _OPEN.discard(self)


_OPEN: weakref.WeakSet[_Connection] = weakref.WeakSet()
_REGISTER = threading.RLock()


def check_beside(file: Path) -> None:
    """Raise MapError when what lies beside a map as its journal or write-ahead log is not its own.

    Of a map that is open in this process, SQLite has seen that already; to close it once more
    would let go of all locks that the process has on it.
    """
    with _REGISTER:
        if not _is_open(file):
            beside.check(file.resolve())


def whole_bytes(file: Path) -> int:
    """How long a map that could not be opened says that it is; 0 where it is no database."""
    with _REGISTER:
        return 0 if _is_open(file) else beside.whole_bytes(file)


def _is_open(file: Path) -> bool:
    try:
        found = os.stat(file)
    except OSError:
        return False
    return any(one.file == (found.st_dev, found.st_ino) for one in _OPEN)


def _keep_open() -> None:
    """In a copy of the process by fork(): the connections of the other one are never closed here.

    SQLite would take its open transaction for ours, and undo it under the other process.
    """
    for connection in _OPEN:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(connection))


os.register_at_fork(after_in_child=_keep_open)


def is_ours(connection: sqlite3.Connection) -> bool:
    """Whether this process opened it, and it is no copy by fork()."""
    return not isinstance(connection, _Connection) or connection.owner == os.getpid()


def _check_owner(connection: sqlite3.Connection, name: Path) -> None:
    if not is_ours(connection):
        raise MapError(
            f"{name} was opened by another process, of which this one is a copy (fork); open it "
            "again in this process."
        )


def connect(
    file: Path, name: Path, *, writable: bool, patience: Patience = USUAL_PATIENCE
) -> sqlite3.Connection:
    """Open an existing database; `name` is what errors call it, `patience` how long a commit of
    another program is waited for.

    Also a reader opens it for writing, because a writer that was killed leaves a journal that
    the next one to open the file must play back; `query_only` then keeps the reader one.
    """
    with _REGISTER, explained(name, writing=writable):
        check_beside(file)
        connection = sqlite3.connect(
            f"{file.resolve().as_uri()}?mode=rw",
            uri=True,
            timeout=patience.limit_s,
            isolation_level=None,  # transactions begin and end where this package says
            check_same_thread=False,  # a forgotten map may be closed by the garbage collector
            factory=_Connection,
        )
        found = os.stat(file)
        connection.owner, connection.file = os.getpid(), (found.st_dev, found.st_ino)
        _OPEN.add(connection)
    try:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)
        with explained(name, writing=writable):
            # What a hostile file can do is limited: no functions with side effects from its
            # views and triggers, and no page that lies about its cells.
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            # This one reads the schema, for which it waits until a commit has ended.
            _when_free(connection, "PRAGMA cache_size = -16384", patience)
            connection.execute(f"PRAGMA query_only = {0 if writable else 1}")
    except BaseException:
        connection.close()
        raise
    return connection


def keep_one_file(connection: sqlite3.Connection, *, durable: bool) -> None:
    """Choose a rollback journal, so that a map at rest is always this one file.

    A write-ahead log would let readers in during a commit, but leaves two more files beside
    the map while anyone has it open, and copying the map without them loses what they hold.
    A program that edited the map may have switched it to one; this switches it back. EXTRA is
    FULL, and syncs the folder after the journal is gone: without that, a power cut just after a
    commit can bring the journal back, which undoes it.
    """
    connection.execute("PRAGMA journal_mode = DELETE")
    connection.execute(f"PRAGMA synchronous = {'EXTRA' if durable else 'OFF'}")


def clear_journal(path: Path) -> None:
    """Play back and delete the journal that an interrupted writer left beside a map.

    Nothing happens while another program writes it, or where there is none.
    """
    if path.is_file() and path.with_name(f"{path.name}-journal").exists():
        with (
            suppress(MapError),
            closing(connect(path, path, writable=True, patience=Patience(0.0))) as found,
            writing(found, path, Patience(0.0)),
        ):
            pass  # which begins with its recovery, and ends without a journal


@contextmanager
def copied(path: Path, copy: Path) -> Iterator[None]:
    """Copy a map page by page, damaged ones too, to a new file that is on the disk afterwards; on
    an error in the block it is removed. MapWriteError where it cannot be made, or is there already,
    and then it stays.

    By SQLite, which keeps the locks that a transaction of this process has on the file: whoever
    opens and closes it otherwise lets go of them.
    """
    try:
        os.close(os.open(copy, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise MapWriteError(
            f"{copy} could not be made ({error.strerror}), and {path} was not changed; try again, "
            "name another file for the copy of the map, or check the permissions of the folder."
        ) from error
    try:
        with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
            target.execute("PRAGMA journal_mode = OFF")  # which a full disk would leave there
            # In steps, between which a signal is heard.
            source.backup(target, pages=_PAGES_A_STEP, progress=lambda *_: None)
        sync(copy.parent)
        yield
    except BaseException:
        with suppress(OSError):  # on Windows, where a worker has it open
            copy.unlink()
        raise


@contextmanager
def writing(
    connection: sqlite3.Connection, name: Path, patience: Patience = USUAL_PATIENCE
) -> Iterator[None]:
    """One transaction: all of it is in the file afterwards, or, on any error, nothing."""
    _check_owner(connection, name)
    if connection.in_transaction:
        raise MapWriteError(
            f"{name} is being read or changed already, and was not changed; end that first, and "
            "open the map once for each thread."
        )
    with explained(name, writing=True):
        _when_free(connection, "BEGIN IMMEDIATE", patience)
        try:
            # Writes the first page first, by which `beside` tells the journal of this change.
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            connection.execute(f"PRAGMA user_version = {version}")
            yield
            _when_free(connection, "COMMIT", patience)
        except BaseException:
            _roll_back(connection)
            raise


def _when_free(connection: sqlite3.Connection, statement: str, patience: Patience) -> None:
    """Execute a statement that another program may hold up."""
    start = time.monotonic()
    try:
        while True:
            left_s = patience.limit_s - (time.monotonic() - start)
            slice_ms = round(1e3 * min(max(left_s, 0.0), _TELL_EVERY_S))
            connection.execute(f"PRAGMA busy_timeout = {slice_ms}")
            try:
                connection.execute(statement)
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or left_s <= 0.0:
                    raise
                if patience.tell is not None:
                    patience.tell(time.monotonic() - start)
                continue
            return
    finally:
        with suppress(sqlite3.Error):
            connection.execute(f"PRAGMA busy_timeout = {round(1e3 * patience.limit_s)}")


@contextmanager
def reading(connection: sqlite3.Connection, name: Path) -> Iterator[None]:
    """One state of the map for several queries, whatever a writer commits meanwhile."""
    _check_owner(connection, name)
    with explained(name, writing=False):
        if connection.in_transaction:
            yield
            return
        connection.execute("BEGIN")
        try:
            yield
        finally:
            _roll_back(connection)


@contextmanager
def explained(name: Path, *, writing: bool) -> Iterator[None]:
    """Turn SQLite's errors into one sentence about the map called `name`."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise _explanation(error, name, writing) from error


_SENTENCES: tuple[tuple[set[int], bool | None, str], ...] = (
    (
        {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}, False,
        "{name} is being written by another program; try again shortly.",
    ),
    (
        {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}, True,
        "{name} is in use by another program, and was not changed; wait until that one has "
        "finished, or close it, and try again.",
    ),
    (
        {sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_FORMAT}, None,
        "{name} is not a fieldgrid map: it is not an SQLite file. Check the name.",
    ),
    (
        {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_TOOBIG}, None,
        "{name} is damaged ({said}); restore it from a copy, and remove {name.name}-journal "
        "before, if it is there, or build it again.",
    ),
    (
        {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR_DELETE}, False,
        "{name} was left by a writer that was interrupted, and what that had begun cannot be "
        "undone here, since nothing may be written; make the file and its folder writable, or "
        "copy it and {name.name}-journal to a folder that is.",
    ),
    (
        {sqlite3.SQLITE_FULL}, False,
        "The place for temporary files is full, so {name} was not read to the end; free some space "
        "there, or name another folder with SQLITE_TMPDIR.",
    ),
    (
        {sqlite3.SQLITE_FULL}, True,
        "The disk is full and {name} was not changed; free some space and try again.",
    ),
    (
        {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM}, True,
        "{name} cannot be written ({said}); check the permissions of the file and its folder.",
    ),
)  # fmt: skip
"""What SQLite's codes mean to a user: while the map is written, while it is read, or (None)
always."""


def _explanation(error: sqlite3.Error | UnicodeDecodeError, name: Path, writing: bool) -> MapError:
    if isinstance(error, sqlite3.ProgrammingError):
        return MapError(f"{name} is closed ({error}); open it again.")
    said = shortened(error)
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR)
    if isinstance(error, UnicodeDecodeError) or said.startswith("Could not decode to UTF-8"):
        code = sqlite3.SQLITE_CORRUPT  # of text, which has no code
    for codes, when, sentence in _SENTENCES:
        if when in (None, writing) and codes & {code, code & 0xFF}:
            return (MapWriteError if when else MapError)(sentence.format(name=name, said=said))
    if writing:
        return MapWriteError(f"{name} could not be written ({said}) and was not changed.")
    return MapError(f"{name} cannot be read ({said}); check the file.")


def _roll_back(connection: sqlite3.Connection) -> None:
    # After a full disk SQLite has often rolled back by itself.
    with suppress(sqlite3.Error):
        if connection.in_transaction:
            connection.execute("ROLLBACK")
