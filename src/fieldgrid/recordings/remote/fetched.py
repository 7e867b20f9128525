"""Recordings at URLs: copied to this machine by fsspec, and read from there.

Readers seek in files, read them twice and from several processes, so a recording on another
machine (S3, SSH, HTTP, ...) gets a copy here (`copies`). A file that has not changed is not fetched
again.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import ConfigError, RecordingError
from fieldgrid.recordings.remote.copies import (
    CACHE,
    Manifest,
    cache_folder,
    check_links,
    copy_of,
    digest_of,
    drafts_of,
    only_here,
    place_in,
    read_manifest,
    write_manifest,
    writing_copy,
)
from fieldgrid.recordings.remote.remote_files import (
    RemoteFile,
    check_unfolding,
    from_backend,
    listed_files,
)

_HERE = ("file", "local")
_SECRET = re.compile(r"://[^/@]*:[^/@]*@|[?&][^=]*(token|sig|key|secret|password|credential)", re.I)
_BATCH = 64
_LISTED_S = 60.0
"""How long a listing of the files at a URL counts for those who fetch some of them."""


Progress = Callable[[int, int], None]
"""Is told how many files are here, and of how many."""


def _unseen(done: int, total: int) -> None:
    """Show nothing."""


class _Listing(NamedTuple):
    """The files of a recording at a URL, by their paths relative to it, and when they were listed,
    by the monotonic clock."""

    url: str
    system: Any
    files: Mapping[str, RemoteFile]
    at_s: float

    @property
    def version(self) -> str:
        """Digest of the versions of all files; equals that of the manifest of a complete copy."""
        return digest_of({name: file.version for name, file in self.files.items()})


_listings: dict[str, _Listing] = {}
"""The last listing of each URL of which some files were fetched."""


def fetch(url: str, *, progress: Progress | None = None) -> Path:
    """The path of a recording at a URL, after its copy is made or brought up to date.

    `progress` is called with the number of files that are here and of all. Files that are no longer
    at the URL are removed from the copy; files that did not come from there stay. Another process
    that fetches the same is waited for. Raises RecordingError for what cannot be fetched,
    LimitError for an archive that unfolds to too much, ConfigError where a library is missing.
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
    return _fetched(url, progress or _unseen)


def fetch_some(url: str, version: str, paths: Collection[Path]) -> bool:
    """Bring some files of the copy of a recording up to date, by their paths in it; the others stay
    where they are. False, and nothing is done, where these are not files of this version of the
    recording, or it lies in an archive. Errors as in `fetch`."""
    if "::" in url:  # an archive may have to be fetched to be listed
        return False
    found = _listings.get(url)
    if found is None or found.version != version or time.monotonic() - found.at_s > _LISTED_S:
        listing = _listing(url)
        if isinstance(listing, Path) or listing.version != version:
            return False
        found = _listings[url] = listing
    copy = copy_of(url)
    names = [path.relative_to(copy).as_posix() for path in paths if path.is_relative_to(copy)]
    if len(names) < len(paths) or not found.files.keys() >= set(names):
        return False
    _bring_up_to_date(found, names, _unseen)
    return True


def _fetched(url: str, progress: Progress) -> Path:
    """The path of what is at a URL, an archive included, after its copy is up to date."""
    found = _listing(url)
    if isinstance(found, Path):
        return found
    _bring_up_to_date(found, found.files, progress)
    return copy_of(url)


def _listing(url: str) -> _Listing | Path:
    """What is at a URL; the path of what is on this machine."""
    with from_backend(url):
        from fsspec.core import url_to_fs

        folder, _, archive = url.partition("::")
        try:
            system, root = url_to_fs(url)
        except ValueError:
            # A web server that gives no parts of a file: its archive is copied as a whole.
            if not archive.startswith("http"):
                raise
            system, root = url_to_fs(f"{folder}::file://{_fetched(archive, _unseen)}")
        protocols = (system.protocol,) if isinstance(system.protocol, str) else system.protocol
        if not set(protocols).isdisjoint(_HERE):
            return Path(root)
        system.invalidate_cache()  # of listings: another process may have written since
        files = listed_files(system, root, url)
        check_unfolding(url, files)
    return _Listing(url, system, files, time.monotonic())


def _bring_up_to_date(listing: _Listing, wanted: Collection[str], progress: Progress) -> None:
    """Fetch what the copy lacks of the files that are wanted, and remove what is at the URL no
    longer."""
    copy, is_file = copy_of(listing.url), "" in listing.files
    with writing_copy(copy), only_here(copy) as is_alone:
        if copy.exists() and copy.is_file() != is_file:
            raise RecordingError(
                f"{copy} is a copy of when there was a {'folder' if is_file else 'file'} at the "
                f"URL, and there is a {'file' if is_file else 'folder'} now; remove it."
            )
        with drafts_of(copy, is_alone=is_alone) as drafts:
            _fetch_missing(listing, copy, drafts, wanted, progress)


def _fetch_missing(
    listing: _Listing, copy: Path, drafts: Path, wanted: Collection[str], progress: Progress
) -> None:
    """The manifest is written after each batch, so that a fetch that is interrupted goes on from
    there."""
    url, remote, noted = listing.url, listing.files, read_manifest(copy)
    missing = [name for name in wanted if not _is_here(remote[name], copy, name, noted)]
    size = sum(remote[name].size or 0 for name in missing)
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder).free
    if size > free:
        raise RecordingError(
            f"{url} has {size / 1e9:.1f} GB to fetch and {folder} has room for {free / 1e9:.1f} "
            f"GB; free some, or set {CACHE} to a folder on a larger disk."
        )
    known = dict(noted.versions)
    gone = known.keys() - remote.keys()
    check_links(copy, [*missing, *gone])
    for first in range(0, len(missing), _BATCH):
        progress(len(wanted) - len(missing) + first, len(wanted))
        names = missing[first : first + _BATCH]
        fetched = _fetch_batch(listing, names, drafts)
        if noted.is_whole:  # from here on it mixes two versions
            write_manifest(copy, noted._replace(is_whole=False))
        for name, draft in fetched.items():
            place = place_in(copy, name)
            place.parent.mkdir(parents=True, exist_ok=True)
            draft.replace(place)
            known[name] = remote[name].version
        noted = Manifest(url, dict(known))
        write_manifest(copy, noted)
    for name in gone:
        with suppress(FileNotFoundError, NotADirectoryError, IsADirectoryError):
            place_in(copy, name).unlink()
        del known[name]
    done = Manifest(url, known, known == {name: file.version for name, file in remote.items()})
    if done != noted:
        write_manifest(copy, done)
    progress(len(wanted), len(wanted))


def _is_here(file: RemoteFile, copy: Path, name: str, manifest: Manifest) -> bool:
    """Whether the copy has this version of a file."""
    place = place_in(copy, name)
    is_known = file.size is not None and manifest.versions.get(name) == file.version
    return is_known and place.exists() and place.stat().st_size == file.size


def _fetch_batch(listing: _Listing, names: list[str], folder: Path) -> dict[str, Path]:
    """Fetch some files; returns where they are, by name, when all of their bytes are here."""
    drafts = {name: folder / str(number) for number, name in enumerate(names)}
    with from_backend(listing.url):
        paths = [listing.files[name].path for name in names]
        listing.system.get(paths, list(map(str, drafts.values())))
        for name, draft in drafts.items():
            size, expected = draft.lstat().st_size, listing.files[name].size
            if expected is not None and size != expected:
                raise RecordingError(
                    f"{name or listing.url} arrived with {size} of its {expected} bytes; repeat "
                    "the command, which goes on from there."
                )
    return drafts
