"""Names beside each other that come to stand for other files all at once.

While they change, each name is a link to `.MAIN.set/now/NAME`, and `now` is a link to the folder
`old` or `new` beside it. Replacing `now` changes them all. So a program that is killed leaves the
old files behind all names, or the new ones. At the end, or when the next program takes the set
after a kill, files take the places of the links.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISREG
from typing import NamedTuple

from fieldgrid.core import NO_HARD_LINKS, MapWriteError, hold, let_go, lock_within, sync, writing

WAIT_S = 30.0
"""How long another program that writes the same set is waited for."""

_MODE = 0o755  # of folders that no other user changes while this program works in them
_OLD, _NEW, _NOW, _SPARE = "old", "new", "now", "spare"


class NameSet(NamedTuple):
    """The folder of a set that is held: its name, and a path to the folder itself.

    Who may rename things in a shared folder can put another folder in its place meanwhile. Then
    `inside` still leads to the one that is held, where the system has /proc, so that nothing is
    written or removed elsewhere. What names lead to is up to whoever may rename them, always.
    """

    name: Path
    inside: Path


@contextmanager
def held_set(main: Path) -> Iterator[NameSet | None]:
    """Holds the set of files of which programs open `main`: its folder for links, in which
    :func:`show` works. Another program that writes the same set waits.

    None where there can be no such folder, or where it is not one that this program makes: a link,
    a folder of another user, or one with other things in it; nothing there is touched. Raises
    MapWriteError where another program has the set for too long, where names are links into a
    folder that cannot be used, and where the disk does not take what a killed program left to do.
    """
    folder = Path(os.path.realpath(main.parent)) / f".{main.name}.set"
    descriptor = _held(folder)
    if descriptor is None:
        _refuse_links(folder, main)
        yield None
        return
    held = NameSet(folder, _inside(descriptor, folder))
    try:
        if not _is_ours(held.inside):
            _refuse_links(folder, main)
            yield None
            return
        with writing(main):
            try:
                _settle(held)  # what a killed program left
            except PermissionError as error:  # another user cannot put files in its place
                raise _left(held.name, main) from error
        try:
            yield held
        finally:
            with writing(main):
                _settle(held)
    finally:
        with suppress(OSError):  # what another program has put there stays
            folder.rmdir()
        let_go(descriptor)


def show(held: NameSet, new: Mapping[str, Path], gone: Sequence[str]) -> bool:
    """Give files their names beside the folder of a set, and take names away, all at once.

    `new` has the file of each name, in the same folder and on the disk for good. False where the
    file system has no links: then nothing has changed.
    """
    folder, beside, names = held.inside, held.name.parent, (*new, *gone)
    try:
        for part in (_OLD, _NEW):
            (folder / part).mkdir(_MODE)
        for name, file in new.items():
            os.link(file, folder / _NEW / name)
        for name in names:
            if (beside / name).exists():
                os.link(beside / name, folder / _OLD / name)
        (folder / _NOW).symlink_to(_OLD)
    except OSError as error:
        if error.errno not in NO_HARD_LINKS:
            raise
        return False
    # Each of these is on the disk before the next begins, in case the power fails.
    for made in (folder / _OLD, folder / _NEW, folder):
        sync(made)
    for name in names:
        _replace_by_link(beside / name, f"{held.name.name}/{_NOW}/{name}", folder)
    sync(beside)
    _replace_by_link(folder / _NOW, _NEW, folder)
    sync(folder)
    return True


def _replace_by_link(place: Path, to: str, folder: Path) -> None:
    spare = folder / _SPARE
    spare.symlink_to(to)
    spare.replace(place)


def _settle(held: NameSet) -> None:
    """Put the files that links of a set lead to in their places, and empty its folder.

    A link that leads to nothing goes: its name is only in the other half of the set, or somebody
    has deleted the folder.
    """
    folder, links = held.inside, _links_into(held.name)
    for link in links:
        name = Path(os.readlink(link)).name
        if (folder / _NOW / name).is_file():
            (folder / _SPARE).unlink(missing_ok=True)
            os.link(folder / os.readlink(folder / _NOW) / name, folder / _SPARE)
            (folder / _SPARE).replace(link)
        else:
            link.unlink()
    if links:
        sync(held.name.parent)
    for part in [path for path in folder.iterdir() if path.name in (_OLD, _NEW, _NOW, _SPARE)]:
        if part.is_symlink() or not part.is_dir():
            part.unlink()
            continue
        for file in part.iterdir():
            file.unlink()
        part.rmdir()


def _links_into(folder: Path) -> list[Path]:
    """The names beside the folder of a set that are links of this program into it."""
    with os.scandir(folder.parent) as entries:
        links = [folder.parent / entry.name for entry in entries if entry.is_symlink()]
    return [link for link in links if _leads_into(folder, link)]


def _leads_into(folder: Path, link: Path) -> bool:
    parts = Path(os.readlink(link)).parts
    # A file system may take one case of a name for the other.
    if len(parts) != 3 or parts[1] != _NOW or parts[2].casefold() != link.name.casefold():
        return False
    if parts[0] == folder.name:
        return True
    with suppress(OSError):
        return os.path.samestat(folder.with_name(parts[0]).lstat(), folder.lstat())
    return False


def _is_ours(folder: Path) -> bool:
    """Whether a folder has nothing in it but what :func:`show` makes."""
    for path in folder.iterdir():
        if path.name in (_OLD, _NEW):
            is_folder = path.is_dir() and not path.is_symlink()
            if not is_folder or any(not S_ISREG(one.lstat().st_mode) for one in path.iterdir()):
                return False
        elif path.name == _NOW:
            if not path.is_symlink() or os.readlink(path) not in (_OLD, _NEW):
                return False
        elif path.name != _SPARE or not (path.is_symlink() or path.is_file()):
            return False
    return True


def _refuse_links(folder: Path, main: Path) -> None:
    """MapWriteError where names lead into a folder that this program may not use."""
    links: list[Path] = []
    with suppress(OSError):  # no such folder, which the export will say
        links = _links_into(folder)
    if links:
        raise _left(folder, main)


def _left(folder: Path, main: Path) -> MapWriteError:
    return MapWriteError(
        f"{main} could not be written: files beside it are links into {folder}, which a crashed "
        "export of another user has left, or which holds other things; let that user export "
        f"again, or copy what you need with its content and remove {folder}."
    )


def _held(folder: Path) -> int | None:
    """A descriptor of the folder, made where it is missing, that holds it; None where the file
    system does not have it, and where it is not a folder of this user."""
    while True:
        is_new = False
        try:
            with suppress(FileExistsError):
                folder.mkdir(_MODE)
                is_new = True
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:
            if not folder.parent.is_dir():
                return None
            continue  # another program has ended in this moment
        except OSError:
            return None
        try:
            if os.fstat(descriptor).st_uid != os.geteuid():
                if is_new:  # on a file system that makes all files those of one user
                    folder.rmdir()
                let_go(descriptor)
                return None
            _wait(descriptor, folder)
            if hold(descriptor, folder):
                return descriptor
        except BaseException:
            let_go(descriptor)
            raise
        let_go(descriptor)


def _wait(descriptor: int, folder: Path) -> None:
    """Wait for another program to let go of the folder. MapWriteError where it does not."""
    try:
        is_ours = lock_within(descriptor, WAIT_S)
    except OSError:  # a file system without locks
        return
    if not is_ours:
        raise MapWriteError(
            f"{folder} is in use: another program has been exporting to the same name for over "
            f"{WAIT_S:.0f} s; wait for it or end it, or give another name."
        )


def _inside(descriptor: int, folder: Path) -> Path:
    """A path to an open folder that stays its own when the folder is renamed, where there is one;
    else its name."""
    own = Path(f"/proc/self/fd/{descriptor}")
    with suppress(OSError):
        if os.path.samestat(own.stat(), os.fstat(descriptor)):
            return own
    return folder
