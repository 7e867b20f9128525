"""Copies of recordings at URLs: where they lie on this machine, and what is known of them.

That of `s3://vines/2026/june-03` is the folder `CACHE/recordings/s3/vines/2026/june-03`, and a
manifest beside it lists its files. The manifest lies in the copy of `s3://vines/2026`, if there is
one, so no file of a recording may have the name of a manifest, and what a manifest says is checked.
"""

from __future__ import annotations

import glob
import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeGuard

from fieldgrid.core import FieldgridError, RecordingError, let_go, lock, parse_json, replacing
from fieldgrid.recordings.files import is_inside, read_text

CACHE = "FIELDGRID_CACHE"
"""The environment variable that names another cache folder."""

_URL = re.compile(r"([a-z][a-z0-9+.-]+::)*[a-z][a-z0-9+.-]+://")
_OWN_NAME = re.compile(r"\..*\.(fetched\.json|fetching|partial)", re.DOTALL)
_LOG = logging.getLogger(__name__)


def is_url(path: str | Path) -> TypeGuard[str]:
    """Whether this is a URL and not the path of a file or folder."""
    return isinstance(path, str) and _URL.match(path) is not None


def cache_folder() -> Path:
    """Where copies lie: `FIELDGRID_CACHE`, or `fieldgrid` in the user's cache folder."""
    if own := os.environ.get(CACHE):
        return Path(own).absolute()
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fieldgrid"


def in_cache(relative: str) -> Path:
    """The path in this machine's cache folder that is `relative` to it: a path in the cache of
    another machine is pickled as this call."""
    return cache_folder() / relative


def copy_of(url: str) -> Path:
    """Where the copy of a recording at a URL lies, or will. The links of a chained URL, as in
    `zip://june-03::s3://vines/2026.zip`, follow each other from the outermost in; what is inside of
    a file lies beside the copy of that file."""
    copy = cache_folder() / "recordings"
    for number, link in enumerate(reversed(url.split("::"))):
        if number:
            copy = copy.with_name(f"{copy.name}.content")
        parts = [part for part in re.split(r":?/+", link) if part not in {"", "."}]
        copy = copy.joinpath(*map(_safe_name, parts))
    return copy


def url_of(path: Path) -> str | None:
    """The URL that a path is a copy of; None for a recording of this machine."""
    if not path.is_relative_to(cache_folder()):
        return None
    url = read_manifest(path).url
    return url if url and copy_of(url) == Path(os.path.abspath(path)) else None


def digest_of(versions: Mapping[str, str]) -> str:
    """One digest of the versions of files."""
    return hashlib.sha256(json.dumps(sorted(versions.items())).encode()).hexdigest()


class Manifest(NamedTuple):
    """The URL of a copy, the versions of the files that it has by their relative paths, and whether
    these are all files of the URL, of one listing."""

    url: str
    versions: Mapping[str, str]
    is_whole: bool = False

    @property
    def version(self) -> str:
        """A digest of the versions of the files: two copies of one version are alike."""
        return digest_of(self.versions)


def place_in(copy: Path, name: str) -> Path:
    """Where a file of a copy lies; "" is the copy itself, where it is a file."""
    return copy / name if name else copy


def is_own_name(name: str) -> bool:
    """Whether a part of a path has a name of what lies beside copies: of a manifest, a lock or a
    draft. Nothing that is fetched may have it."""
    return any(_OWN_NAME.fullmatch(part) for part in name.split("/"))


def _manifest_file(copy: Path) -> Path:
    return copy.with_name(f".{copy.name}.fetched.json")


def read_manifest(copy: Path) -> Manifest:
    """What is known of a copy; nothing where its manifest is missing or damaged, and nothing of
    files outside of the copy."""
    with suppress(FieldgridError, ValueError):
        found = parse_json(read_text(_manifest_file(copy)))
        if isinstance(found, dict) and isinstance(found.get("files"), dict):
            versions = {
                name: version
                for name, version in found["files"].items()
                if isinstance(version, str) and (not name or is_inside(name))
            }
            return Manifest(str(found.get("url", "")), versions, found.get("whole") is True)
    return Manifest("", {})


def is_whole(copy: Path) -> bool:
    """Whether a copy has all files of its URL, as they were at one time."""
    manifest = read_manifest(copy)
    return manifest.is_whole and all(place_in(copy, name).exists() for name in manifest.versions)


def write_manifest(copy: Path, noted: Manifest) -> None:
    """Note which versions of its files a copy has."""
    manifest = _manifest_file(copy)
    if manifest.is_symlink():
        manifest.unlink()  # it would be followed
    with replacing(manifest) as draft:
        content = {"url": noted.url, "files": noted.versions, "whole": noted.is_whole}
        draft.write_text(json.dumps(content), "utf-8")


@contextmanager
def only_here(copy: Path) -> Iterator[bool]:
    """Keeps other processes of this machine from fetching the same in the block. False where the
    file system has no locks: they only fetch some files twice."""
    copy.parent.mkdir(parents=True, exist_ok=True)
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
    held = os.open(copy.with_name(f".{copy.name}.fetching"), flags, 0o666)
    is_alone = False
    try:
        with suppress(OSError):
            try:
                lock(held, wait=False)
            except BlockingIOError:
                _LOG.warning("waiting for another process that fetches %s", copy)
                lock(held, wait=True)
            is_alone = True
        yield is_alone
    finally:
        let_go(held)


@contextmanager
def drafts_of(copy: Path, *, is_alone: bool) -> Iterator[Path]:
    """A new folder for files of a copy that are not complete yet; it is removed after the block.

    It is on the disk of the copy, and nobody else may write to it: in a cache that several users
    share, a link there could make this user write to another file. What a killed program left is
    removed where no other process fetches the same (`is_alone`).
    """
    place = Path(os.path.realpath(copy))
    if is_alone:
        for left in place.parent.glob(f".{glob.escape(place.name)}.????????.partial"):
            shutil.rmtree(left, ignore_errors=True)
    with TemporaryDirectory(
        prefix=f".{place.name}.", suffix=".partial", dir=place.parent, ignore_cleanup_errors=True
    ) as folder:
        yield Path(folder)


def check_links(copy: Path, names: Iterable[str]) -> None:
    """RecordingError where a link among the folders of a copy leads one of these files out of it:
    other files would be replaced or removed there."""
    top = os.path.realpath(copy)
    for folder in {place_in(copy, name).parent for name in names if name}:
        if not Path(os.path.realpath(folder)).is_relative_to(top):
            raise RecordingError(
                f"{folder} leads out of the copy {copy} by a link, so nothing is fetched into it; "
                "remove the link."
            )


@contextmanager
def writing_copy(copy: Path) -> Iterator[None]:
    """Makes what this machine's disk refuses an error that names the copy."""
    try:
        yield
    except FieldgridError:
        raise
    except OSError as error:
        raise RecordingError(
            f"The copy {copy} cannot be written ({error.strerror or error}); free some space, or "
            f"set {CACHE} to another folder."
        ) from error


def _safe_name(part: str) -> str:
    """A part of a URL as the name of a file: as it is where that can be, else its digest."""
    if re.fullmatch(r"[\w ()+=,@.-]{1,200}", part) and part != ".." and not is_own_name(part):
        return part
    return hashlib.sha256(part.encode("utf-8", "surrogateescape")).hexdigest()[:32]
