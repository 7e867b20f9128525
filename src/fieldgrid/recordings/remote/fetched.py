"""Recordings at URLs: copied to this machine by fsspec, and read from there.

Readers seek in files, read them twice and from several processes, so a recording on another
machine (S3, SSH, HTTP, ...) gets a copy here (`copies`). A file that has not changed is not fetched
again. fsspec's own caches would not do: they write a file in its place while it comes, ask for the
version of each file by itself, take all files of the web for unchanged, and keep what is gone.
"""

from __future__ import annotations

import os
import posixpath
import re
import shutil
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from fieldgrid.core import ConfigError, RecordingError
from fieldgrid.recordings.remote.copies import (
    CACHE,
    Manifest,
    cache_folder,
    check_links,
    copy_of,
    drafts_of,
    read_manifest,
    size_of,
    write_manifest,
)
from fieldgrid.recordings.remote.remote_files import (
    check_unfolding,
    listed_files,
    opened,
    told,
    within_time,
)

_SECRET = re.compile(
    r"://[^/@:]*+:[^/@]*+@|[?&][^=?&]*?(token|sig|key|secret|password|credential)", re.IGNORECASE
)
_BATCH = 64
_LISTED_S = 60.0
"""How long a listing of the files at a URL counts for those who fetch some of them."""

Progress = Callable[[int, int], None]
"""Is told how many files are here, and of how many."""


def fetch(
    url: str,
    *,
    progress: Progress | None = None,
    version: str = "",
    wanted: Collection[Path] = (),
) -> Path:
    """The path of a recording at a URL, after its copy is made or brought up to date.

    `progress` is called with the number of files that are here and of all. Files that are no longer
    at the URL are removed from the copy; files that did not come from there stay. Another process
    that fetches the same is waited for. With the `version` that another machine has, nothing is
    asked where this copy has it, too, and only the files are fetched that are `wanted`, by their
    paths in the copy; all, where one of these is no file at the URL. Raises RecordingError for what
    cannot be fetched, LimitError for an archive that unfolds to too much, ConfigError where a
    library is missing.
    """
    if _SECRET.search(url):
        raise ConfigError(
            "A URL with a password or a key would leave it in logs and in the cache; put it into "
            "fsspec's configuration (~/.config/fsspec/conf.json), and leave it out of the URL."
        )
    if "::" not in url and url.lower().endswith(".zip"):
        raise RecordingError(
            f"{url} is an archive; name the folder in it that is the recording, as in "
            f"zip://FOLDER::{url}"
        )
    return _fetched(url, progress or (lambda done, total: None), version, wanted)


def _fetched(url: str, progress: Progress, version: str, wanted: Collection[Path]) -> Path:
    """As `fetch`, also of an archive itself."""
    copy = copy_of(url)
    with told(url):
        noted = read_manifest(copy)
        if noted.version == version and noted.is_here(copy):
            return copy
        system, root, there = (
            _listed_lately(url, time.monotonic() // _LISTED_S) if version else _listed(url)
        )
        if there is None:
            return Path(root)
        names = {os.path.relpath(path, copy) for path in wanted}
        if not names or not names <= there.files.keys():
            names = set(there.files)
        with drafts_of(copy) as drafts:
            missing = [name for name in _cleared(copy, there, drafts) if name in names]
            size = sum(size_of(there.files[name]) or 0 for name in missing)
            free = shutil.disk_usage(drafts).free
            if size > free:
                raise RecordingError(
                    f"{url} has {size / 1e9:.1f} GB to fetch and {cache_folder()} has room for "
                    f"{free / 1e9:.1f} GB; free some, or set {CACHE} to a folder on a larger disk."
                )
            for first in range(0, len(missing), _BATCH):
                progress(len(names) - len(missing) + first, len(names))
                _get(system, root, there, missing[first : first + _BATCH], copy, drafts)
            progress(len(names), len(names))
    return copy


@lru_cache(maxsize=1)
def _listed_lately(url: str, when: float) -> tuple[Any, str, Manifest | None]:
    """What was listed at the same time is not listed again."""
    return _listed(url)


def _listed(url: str) -> tuple[Any, str, Manifest | None]:
    """The file system of a URL, the path in it, and what is there; without the last where that is
    a path of this machine."""
    from fsspec.implementations.local import LocalFileSystem

    folder, _, archive = url.partition("::")
    try:
        system, root = within_time(lambda: opened(url))
    except ValueError:
        # A web server that gives no parts of a file: its archive is copied as a whole.
        if not archive.startswith("http"):
            raise
        whole = _fetched(archive, lambda done, total: None, "", ())
        system, root = opened(f"{folder}::file://{whole}")
    if type(system) is LocalFileSystem:
        return system, root, None
    system.invalidate_cache()  # of listings: another process may have written since
    files = within_time(lambda: listed_files(system, root, url))
    if archive:
        within_time(lambda: check_unfolding(archive, url, files.values()))
    return system, root, Manifest(url, files)


def _cleared(copy: Path, there: Manifest, drafts: Path) -> list[str]:
    """The files that a copy lacks. What it has of them in another version is removed, as is what is
    no longer at the URL, and only then it is noted what is there now."""
    noted = read_manifest(copy)
    absent = [
        name
        for name, version in there.files.items()
        if noted.files.get(name) != version
        or not (copy / name).is_file()
        or (copy / name).stat().st_size != size_of(version)
    ]
    astray = [*(noted.files.keys() - there.files.keys()), *absent]
    check_links(copy, astray)
    for name in astray:
        with suppress(FileNotFoundError, NotADirectoryError, IsADirectoryError):
            (copy / name).unlink()
        with suppress(OSError):  # a folder that has other files
            os.removedirs((copy / name).parent)
    write_manifest(copy, there, drafts)
    return absent


def _get(
    system: Any, root: str, there: Manifest, names: list[str], copy: Path, drafts: Path
) -> None:
    """Fetch some files, and move each to its place when all of its bytes are here."""
    places = [drafts / str(number) for number in range(len(names))]
    paths = [posixpath.join(root, name) if name else root for name in names]
    within_time(
        lambda: system.get(paths, list(map(str, places))),
        lambda: sum(place.stat().st_size for place in drafts.iterdir()),
    )
    for name, place in zip(names, places, strict=True):
        size, expected = place.lstat().st_size, size_of(there.files[name])
        if expected not in (None, size):
            raise RecordingError(
                f"{name or there.url} arrived with {size} of its {expected} bytes; repeat the "
                "command, which goes on from there."
            )
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        place.replace(copy / name)
