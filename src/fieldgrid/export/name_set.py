"""Names beside each other that come to stand for other files all at once.

While they change, each name is a link to `.MAIN.set/now/NAME`, and `now` is a link to the folder
`old` or `new` beside it. Replacing `now` changes them all. So a program that is killed leaves the
old files behind all names, or the new ones. At the end, or when the next program takes the set
after a kill, files take the places of the links.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from fieldgrid.publish import NO_HARD_LINKS, hold, sync, writing

_OLD, _NEW, _NOW, _SPARE = "old", "new", "now", "spare"


@contextmanager
def held_set(main: Path) -> Iterator[Path | None]:
    """Holds the set of files of which programs open `main`: its folder for links, in which
    :func:`show` works. Another program that writes the same set waits.

    None where there can be no such folder. Raises MapWriteError where the disk does not take what
    a killed program left to do.
    """
    folder = Path(os.path.realpath(main.parent)) / f".{main.name}.set"
    descriptor = _held(folder)
    if descriptor is None:
        yield None
        return
    try:
        with writing(main):
            _settle(folder)
        try:
            yield folder
        finally:
            with writing(main):
                _settle(folder)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(descriptor)


def show(folder: Path, new: Mapping[str, Path], gone: Sequence[str]) -> bool:
    """Give files their names beside the folder of a set, and take names away, all at once.

    `new` has the file of each name, in the same folder and on the disk for good. False where the
    file system has no links: then nothing has changed.
    """
    beside, names = folder.parent, (*new, *gone)
    try:
        for part in (_OLD, _NEW):
            (folder / part).mkdir()
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
        _replace_by_link(beside / name, f"{folder.name}/{_NOW}/{name}", folder)
    sync(beside)
    _replace_by_link(folder / _NOW, _NEW, folder)
    sync(folder)
    return True


def _replace_by_link(place: Path, to: str, folder: Path) -> None:
    spare = folder / _SPARE
    spare.symlink_to(to)
    spare.replace(place)


def _settle(folder: Path) -> None:
    """Put the files that links of a set lead to in their places, and empty its folder."""
    if (folder / _NOW).is_symlink():
        for link in [path for path in folder.parent.iterdir() if _leads_into(folder, path)]:
            if link.exists():
                (folder / _SPARE).unlink(missing_ok=True)
                os.link(link.resolve(), folder / _SPARE)
                (folder / _SPARE).replace(link)
            else:  # a name that is only in the other half of the set
                link.unlink()
        sync(folder.parent)
    for part in folder.iterdir():
        if part.is_dir() and not part.is_symlink():
            shutil.rmtree(part)
        else:
            part.unlink()


def _leads_into(folder: Path, path: Path) -> bool:
    return path.is_symlink() and Path(os.readlink(path)).parts[:1] == (folder.name,)


def _held(folder: Path) -> int | None:
    """A descriptor of the folder, made where it is missing, that holds it; None where the file
    system does not have it."""
    with suppress(OSError):
        while True:
            folder.mkdir(exist_ok=True)
            try:
                descriptor = os.open(folder, os.O_RDONLY)
            except FileNotFoundError:
                continue  # another program has ended in this moment
            if hold(descriptor, folder):
                return descriptor
            os.close(descriptor)
    return None
