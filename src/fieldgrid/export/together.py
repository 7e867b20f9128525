"""Several files beside each other that are of use together only."""

from __future__ import annotations

import filecmp
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from fieldgrid.errors import MapWriteError
from fieldgrid.publish import Draft


def write_together(
    writers: Mapping[Path, Callable[[Path], None]],
    *,
    overwrite: bool,
    ours: Callable[[Path], bool],
    what: str,
) -> tuple[Path, ...]:
    """Write files by their writers, which are given the file to write, then name all of them.

    The last one is what a program opens, and which refers to the others. Where no more than one
    file differs from what is there already, each takes the place of the old one at once. Else the
    last one is the last to get its name, and what it replaces goes first, so that nobody opens it
    with the files of another.
    When one fails before the first is named, none is changed; later none is left. `ours` and `what`
    tell of the last file whether it may be replaced, as a :class:`Draft` has them. Raises
    MapExistsError when one exists and may not be overwritten, MapWriteError when one cannot be
    written.
    """
    targets = tuple(writers)
    with ExitStack() as stack:
        drafts: list[Draft] = []
        for target in targets:
            check = ours if target == targets[-1] else None
            drafts.append(Draft(target, overwrite=overwrite, ours=check, what=what))
            stack.callback(drafts[-1].discard)
        for draft, write in zip(drafts, writers.values(), strict=True):
            try:
                write(draft.file)
            except OSError as error:
                raise MapWriteError(
                    f"{targets[-1]} could not be written: its {draft.target.name} failed "
                    f"({error.strerror or error}); check the space on the disk."
                ) from error
        _name(drafts, targets)
    return targets


def _name(drafts: Sequence[Draft], targets: Sequence[Path]) -> None:
    # Before anything has gone, so that what programs open is missing for as short as can be.
    for draft in drafts:
        draft.sync()
    changed = [draft for draft in drafts if not _is_there(draft)]
    if len(changed) <= 1:
        # The last one also where it is the same: its time tells when the export was made.
        drafts = [draft for draft in drafts[:-1] if draft in changed] + [drafts[-1]]
        for draft in drafts:
            draft.publish()
        return
    ours = [_identity(draft.file) for draft in drafts]
    if targets[-1].exists():
        targets[-1].unlink()
    try:
        for draft in drafts[:-2]:
            draft.publish(for_good=False)
        for draft in drafts[-2:]:
            draft.publish()
    except BaseException:
        # Also of the one that failed, which may have its name already; never of somebody else's.
        for target, identity in zip(targets, ours, strict=True):
            with suppress(OSError):
                if _identity(target) == identity:
                    target.unlink()
        raise


def _is_there(draft: Draft) -> bool:
    return draft.target.is_file() and filecmp.cmp(draft.file, draft.target, shallow=False)


def _identity(file: Path) -> tuple[int, int]:
    found = file.stat()
    return found.st_dev, found.st_ino
