"""Several files beside each other that are of use together only."""

from __future__ import annotations

import filecmp
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from functools import partial
from pathlib import Path

from fieldgrid.core import Draft, MapWriteError, writing
from fieldgrid.export.name_set import NameSet, held_set, show


def is_zip(file: Path, check: Callable[[zipfile.ZipFile], bool]) -> bool:
    """Whether a file is a zip archive that can be read and of which `check` holds."""
    try:
        with zipfile.ZipFile(file) as archive:
            return check(archive)
    except (OSError, KeyError, IndexError, ValueError, zipfile.BadZipFile, zlib.error):
        return False


def text_writer(text: str) -> Callable[[Path], object]:
    """What writes a text to a file, for `write_together`."""
    return partial(Path.write_text, data=text, encoding="utf-8")


def write_together(
    writers: Mapping[Path, Callable[[Path], object]],
    *,
    overwrite: bool,
    ours: Callable[[Path], bool],
    what: str,
    gone: Sequence[Path] = (),
) -> tuple[Path, ...]:
    """Write files by their writers, which are given the file to write, then name all of them.

    The last one is what a program opens, and which refers to the others. Where it replaces another
    one, all names change at once: a program that is killed leaves the old files or the new ones.
    Files of an earlier set that are in `gone` go with it. Where the file system has no links, the
    old one that programs open goes first, and the new one comes last, so that nobody opens it with
    files of the other set. When one fails before the first is named, none is changed. `ours` and
    `what` tell of the last file whether it may be replaced, as a :class:`Draft` has them. Raises
    MapExistsError when one exists and may not be overwritten, MapWriteError when one cannot be
    written.
    """
    targets = tuple(writers)
    # Without overwriting no name changes, but a killed program may have left links.
    is_set = overwrite or any(map(os.path.islink, targets))
    holding = held_set(targets[-1]) if is_set else nullcontext()
    with holding as held, ExitStack() as stack:
        drafts: list[Draft] = []
        for target in targets:
            drafts.append(
                Draft(
                    target,
                    overwrite=overwrite,
                    ours=ours if target == targets[-1] else None,
                    what=what,
                )
            )
            stack.callback(drafts[-1].discard)
        for draft, write in zip(drafts, writers.values(), strict=True):
            try:
                write(draft.file)
            except OSError as error:
                raise MapWriteError(
                    f"{targets[-1]} could not be written: its {draft.target.name} failed "
                    f"({error.strerror or error}); check the space on the disk."
                ) from error
        # Before anything has changed, so that names are links for as short as can be.
        for draft in drafts:
            draft.sync()
        if not overwrite:
            _publish(drafts)
        else:
            # A link of the user's own making stays.
            there = [path for path in gone if path.is_file() and not path.is_symlink()]
            _replace(drafts, there, held)
    return targets


def _replace(drafts: Sequence[Draft], gone: Sequence[Path], held: NameSet | None) -> None:
    main = drafts[-1].target
    changed = [
        draft
        for draft in drafts
        if not (draft.target.is_file() and filecmp.cmp(draft.file, draft.target, shallow=False))
    ]
    if not gone and len(changed) <= 1:
        # The last one also where it is the same: its time tells when the export was made.
        for draft in [draft for draft in drafts[:-1] if draft in changed] + [drafts[-1]]:
            draft.publish()
        return
    places = [draft.place for draft in drafts] + [
        Path(os.path.realpath(path.parent)) / path.name for path in gone
    ]
    if held and main.exists() and all(place.parent == held.name.parent for place in places):
        with writing(main):
            files = {draft.place.name: draft.file for draft in drafts}
            if show(held, files, [path.name for path in gone]):
                return
    # The file that programs open is missing while the others change.
    for old in (drafts[-1].place, *gone):
        try:
            old.unlink(missing_ok=True)
        except OSError as error:
            raise MapWriteError(
                f"{main} could not be written: {old.name} could not be removed "
                f"({error.strerror}); check the folder and its permissions."
            ) from error
    _publish(drafts)


def _publish(drafts: Sequence[Draft]) -> None:
    identities = [_identity(draft.file) for draft in drafts]
    try:
        for number, draft in enumerate(drafts, 1):
            draft.publish(for_good=number > len(drafts) - 2)
    except BaseException:
        # Also of the one that failed, which may have its name already; never of somebody else's.
        for draft, identity in zip(drafts, identities, strict=True):
            with suppress(OSError):
                if _identity(draft.place) == identity:
                    draft.place.unlink()
        raise


def _identity(file: Path) -> tuple[int, int]:
    found = file.stat()
    return found.st_dev, found.st_ino
