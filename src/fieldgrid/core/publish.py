"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import ctypes
import errno
import glob
import mmap
import os
import secrets
import shutil
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fieldgrid.core.errors import FieldgridError, MapExistsError, MapWriteError
from fieldgrid.core.file_locks import lock
from fieldgrid.core.input_limits import file_bytes

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of linux/fcntl.h and linux/fs.h
NO_HARD_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV}


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Makes what the disk refuses while `path` is written a MapWriteError that names it."""
    try:
        yield
    except OSError as error:
        if isinstance(error, FieldgridError):
            raise
        raise MapWriteError(
            f"{path} could not be written ({error.strerror or error}); check the space on the disk."
        ) from error


@contextmanager
def replacing(
    path: Path,
    *,
    overwrite: bool = True,
    ours: Callable[[Path], bool] | None = None,
    what: str = "",
) -> Iterator[Path]:
    """A file to write in the place of `path`: it takes that name when the block ends well, and is
    gone when it does not. Raises MapExistsError for a file that may not be overwritten,
    MapWriteError where the disk does not take it. `ours` and `what` are those of :class:`Draft`."""
    draft = Draft(path, overwrite=overwrite, ours=ours, what=what)
    try:
        with writing(path):
            yield draft.file
            draft.publish()
    finally:
        draft.discard()


@contextmanager
def made_elsewhere(draft: Path, name: str) -> Iterator[Path]:
    """A path of this name, in a folder of its own beside a draft, for a library that makes its
    file itself, or locks it; what is there when the block ends well becomes the draft's content."""
    with working_beside(draft) as folder:
        yield folder / name
        shutil.copyfile(folder / name, draft)


@contextmanager
def working_beside(draft: Path) -> Iterator[Path]:
    """A folder for what is made on the way to a draft. It goes with the block, or, where the
    program is killed in it, with the draft, when the next one of the same target is made."""
    folder = _workshop(draft)
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def replacing_folder(
    path: Path, *, overwrite: bool, ours: Callable[[Path], bool], what: str
) -> Iterator[Path]:
    """A folder to fill in the place of `path`, as :class:`DraftFolder` says: it takes that name
    when the block ends well, and is gone when it does not."""
    draft = DraftFolder(path, overwrite=overwrite, ours=ours, what=what)
    try:
        with writing(path):
            yield draft.folder
            draft.publish()
    finally:
        draft.discard()


class Draft:
    """A file in the making beside `target`, which is untouched until `publish`.

    `advice` completes the error for a target that exists: what to do other than overwrite. A
    target that `ours` does not recognise as `what` this program writes is never replaced: it may
    be an image of a recording. What a killed program left of an earlier draft of the same target
    is removed.
    """

    def __init__(
        self,
        target: Path,
        *,
        overwrite: bool,
        advice: str = "",
        ours: Callable[[Path], bool] | None = None,
        what: str = "",
    ) -> None:
        self.target = target
        self._overwrite = overwrite
        self._is_synced = False
        self._exists = (
            f"{target} exists already; give another name, {advice}or --overwrite to replace it."
        )
        check_place(target)
        if target.is_dir():
            raise MapExistsError(f"{target} is a folder; give the name of a file.")
        if target.exists() and not target.is_file():
            raise MapExistsError(f"{target} is a pipe or a device; give the name of a file.")
        if os.path.lexists(target) and not overwrite:
            raise MapExistsError(self._exists)
        if ours is not None and target.is_file() and target.stat().st_size and not ours(target):
            raise MapExistsError(
                f"{target} is not {what} that fieldgrid has written, so it is not replaced; give "
                "another name, or remove it first."
            )
        self.place = place = Path(os.path.realpath(target))
        is_held = False
        while not is_held:
            # With the target's ending, by which other programs tell what to write.
            name = f".{place.name}.{secrets.token_hex(4)}.partial{place.suffix}"
            self.file = place.with_name(name)
            held: list[int] = []
            self.discard = weakref.finalize(self, _discard, self.file, held, os.getpid())
            """Remove what was made so far; nothing happens when it is published or gone.

            It is there before the file is, and is called at the exit at the latest: a signal that
            ends the program at any moment leaves no draft."""
            try:
                # Made here, so that it gets the usual permissions and nobody else's file is taken.
                held.append(os.open(self.file, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666))
            except OSError as error:
                self.discard.detach()
                raise _unwritable(target, error) from error
            is_held = hold(held[0], self.file)
        _remove_orphans(place)

    def sync(self) -> None:
        """Have the disk keep what is written until now, so that `publish` need not wait for it."""
        try:
            sync(self.file)
        except OSError as error:
            raise _unwritable(self.target, error) from error
        self._is_synced = True

    def publish(self, *, for_good: bool = True) -> None:
        """Bring the file to its final name, at once and `for_good`, or until the next one that is
        published there is: the folder is synced once then. No file is replaced unasked."""
        try:
            # SQLite would play the journal of an older map back into this one.
            for stray in filter(Path.exists, _companions(self.place)):
                raise MapWriteError(
                    f"{stray} lies beside {self.target}: an older map of that name is in use, or "
                    "its writer was interrupted. Open that map once, or delete the journal."
                )
            if not self._is_synced:
                sync(self.file)
            if self._overwrite:
                self.file.replace(self.place)
            else:
                self._publish_new()
            if for_good:
                sync(self.place.parent)
        except FileExistsError as error:
            raise MapExistsError(self._exists) from error
        except OSError as error:
            if isinstance(error, MapWriteError):
                raise
            raise _unwritable(self.target, error) from error
        finally:
            self.discard()

    def _publish_new(self) -> None:
        try:
            os.link(self.file, self.place)  # fails when the name is taken, unlike a rename
        except OSError as error:
            if error.errno not in NO_HARD_LINKS:
                raise
            # Without hard links: whoever makes the empty file owns the name.
            os.close(os.open(self.place, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            try:
                self.file.replace(self.place)
            except OSError:
                self.place.unlink()
                raise


class DraftFolder:
    """A folder in the making beside `target`, which is untouched until `publish`.

    For what is several files: a shapefile, a Zarr store, a ROS 2 bag, task data. What a folder
    that is overwritten held is gone when it is published, so only a folder that `ours` recognises
    is overwritten.
    """

    def __init__(
        self, target: Path, *, overwrite: bool, ours: Callable[[Path], bool], what: str
    ) -> None:
        self.target = target
        check_place(target)
        if target.exists() and not target.is_dir():
            raise MapExistsError(f"{target} is a file; give the name of a folder.")
        if os.path.lexists(target) and not overwrite:
            raise MapExistsError(
                f"{target} exists already; give another name, or --overwrite to replace it."
            )
        if target.is_dir() and any(target.iterdir()) and not ours(target):
            raise MapExistsError(
                f"{target} holds other things than {what}, so it is not overwritten; give another "
                "name."
            )
        place = Path(os.path.realpath(target))
        is_held = False
        while not is_held:
            self.folder = place.with_name(f".{place.name}.{secrets.token_hex(4)}.partial")
            held: list[int] = []
            self.discard = weakref.finalize(self, _discard, self.folder, held, os.getpid())
            """As that of :class:`Draft`."""
            try:
                self.folder.mkdir()
                held.append(os.open(self.folder, os.O_RDONLY))
            except FileNotFoundError as error:
                if not place.parent.is_dir():
                    self.discard.detach()
                    raise _unwritable(target, error) from error
                continue  # taken for an orphan before it could be opened
            except OSError as error:
                self.discard.detach()
                raise _unwritable(target, error) from error
            is_held = hold(held[0], self.folder)
        _remove_orphans(place)

    def publish(self) -> None:
        """Bring the folder to its final name; what it replaces is removed only then."""
        place = Path(os.path.realpath(self.target))
        old = self.folder.with_name(self.folder.name + ".old")
        try:
            for file in sorted(self.folder.rglob("*")):
                sync(file)
            sync(self.folder)
            if not (place.exists() and _exchanged(self.folder, place)):
                if place.exists():
                    place.rename(old)
                try:
                    self.folder.rename(place)
                except OSError:
                    if old.exists():
                        old.rename(place)
                    raise
            sync(place.parent)
        except OSError as error:
            raise _unwritable(self.target, error) from error
        finally:
            shutil.rmtree(old, ignore_errors=True)
            self.discard()


def _exchanged(one: Path, other: Path) -> bool:
    """Let two names change places, so that neither is missing at any moment; False where the
    system or the file system cannot."""
    change = getattr(ctypes.CDLL(None), "renameat2", None)
    if change is None:  # not Linux
        return False
    here, paths = ctypes.c_int(_AT_FDCWD), (os.fsencode(one), os.fsencode(other))
    return bool(change(here, paths[0], here, paths[1], ctypes.c_uint(_RENAME_EXCHANGE)) == 0)


def hold(descriptor: int, draft: Path) -> bool:
    """Mark a draft as in use, or wait until nobody else does; the system lets go of it when this
    program ends, however it does. False where another program has removed it in the meantime."""
    with suppress(OSError):  # a file system without locks
        lock(descriptor, wait=True)
    try:
        return os.path.samestat(os.fstat(descriptor), draft.stat())
    except FileNotFoundError:
        return False


@contextmanager
def holding(file: Path) -> Iterator[bool]:
    """Holds a file for this program, as :func:`hold` does; False where another one does."""
    descriptor = os.open(file, os.O_RDWR)
    try:
        try:
            lock(descriptor, wait=False)
        except OSError:
            yield False
        else:
            yield True
    finally:
        os.close(descriptor)


def _discard(draft: Path, held: list[int], owner: int) -> None:
    """Remove a draft that this process made: a copy of it by fork() ends without that."""
    if os.getpid() != owner:
        return
    for descriptor in held:
        os.close(descriptor)
    if draft.is_dir():
        shutil.rmtree(draft, ignore_errors=True)
        return
    for stray in (draft, *_companions(draft)):
        with suppress(OSError):  # a broken disk; the next draft tries again
            stray.unlink(missing_ok=True)


def mentions(path: Path, mark: bytes) -> bool:
    """Whether a file holds these bytes somewhere; what cannot be read does not."""
    with suppress(OSError, ValueError):  # ValueError: the file is empty
        file_bytes(path)
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return data.find(mark) >= 0
    return False


def refuse_input(target: Path, inputs: Iterable[Path]) -> None:
    """Raise MapExistsError for a target that is one of the inputs of a command,
    MapWriteError for one that nothing can have the name of."""
    check_place(target)
    for one in inputs:
        if target.exists() and one.exists() and target.samefile(one):
            raise MapExistsError(f"{target} is read here and never replaced; give another name.")


def _remove_orphans(place: Path) -> None:
    """Delete the drafts of a target whose programs are gone: they no longer hold them."""
    drafts = f".{glob.escape(place.name)}.????????.partial"
    for orphan in (
        *place.parent.glob(drafts),  # of folders
        *place.parent.glob(drafts + glob.escape(place.suffix)),
    ):
        with suppress(OSError):
            held = os.open(orphan, os.O_RDONLY)
            try:
                lock(held, wait=False)
                if orphan.is_dir():
                    shutil.rmtree(orphan)
                    continue
                shutil.rmtree(_workshop(orphan), ignore_errors=True)
                for stray in (*_companions(orphan), orphan):
                    stray.unlink(missing_ok=True)
            finally:
                os.close(held)


def _workshop(draft: Path) -> Path:
    return draft.with_name(f"{draft.name}.work")


def _companions(file: Path) -> tuple[Path, ...]:
    return tuple(file.with_name(file.name + end) for end in ("-journal", "-wal", "-shm"))


def sync(path: Path) -> None:
    """Have the disk keep a file, or the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_place(target: Path) -> None:
    """Raise MapWriteError where nothing can be at a place, or be seen there."""
    try:
        target.lstat()
    except FileNotFoundError:
        return
    except OSError as error:
        raise _unwritable(target, error) from error


def _unwritable(target: Path, error: OSError) -> MapWriteError:
    not_written = f"{target} was not written"
    known = {
        errno.ENOSPC: f"The disk is full and {not_written}; free some space.",
        errno.ENOENT: f"{not_written}: its folder does not exist; make it first.",
        errno.ENAMETOOLONG: f"{not_written}: its name is too long; give a shorter one.",
    }
    other = (
        f"{target} could not be written ({error.strerror}); check the folder and its permissions."
    )
    return MapWriteError(known.get(error.errno or 0, other))
