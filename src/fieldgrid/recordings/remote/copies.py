"""Copies of recordings at URLs: where they lie on this machine, and what is known of them.

That of `s3://vines/june-03` is `CACHE/recordings/s3_vines_june-03.DIGEST/june-03`. What is known of
it lies beside it, where nothing of another URL is: a manifest of the files that were at the URL
when it was last listed. A file of the copy that the manifest names is whole and of that listing.
"""

from __future__ import annotations

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
from typing import Any, NamedTuple, TypeGuard

from fieldgrid.core import FieldgridError, RecordingError, let_go, lock, parse_json
from fieldgrid.recordings.files import is_inside, read_text

CACHE = "FIELDGRID_CACHE"
"""The environment variable that names another cache folder."""

_MANIFEST = ".fetched.json"
_URL = re.compile(r"([a-z][a-z0-9+.-]+::)*[a-z][a-z0-9+.-]+://")
_VERSIONS = (
    *("ETag", "etag", "md5Hash", "content_md5", "checksum", "CRC"),
    *("mtime", "LastModified", "Last-Modified", "last_modified"),
    *("updated", "modified", "modify", "created"),
)
"""What file systems call the version of a file or the time of its last change, best first."""
_LOG = logging.getLogger(__name__)


def is_url(path: str | Path) -> TypeGuard[str]:
    """Whether this is a URL and not the path of a file or folder."""
    return isinstance(path, str) and _URL.match(path) is not None


def cache_folder() -> Path:
    """Where copies lie: `FIELDGRID_CACHE`, or `fieldgrid` in the user's cache folder."""
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get(CACHE) or of_user / "fieldgrid").absolute()


def in_cache(relative: str) -> Path:
    """The path in this machine's cache folder that is `relative` to it: a path in the cache of
    another machine is pickled as this call."""
    return cache_folder() / relative


def copy_of(url: str) -> Path:
    """Where the copy of a recording at a URL lies, or will, with the name that it has there."""
    url = url.rstrip("/")
    digest = hashlib.sha256(url.encode("utf-8", "surrogateescape")).hexdigest()[:16]
    told = re.sub(r"[^a-zA-Z0-9.@+-]+", "_", url)[-100:]
    name = re.sub(r"[^\w ()+=,@.-]", "_", url.partition("::")[0].rpartition("/")[2])[-60:]
    return cache_folder() / "recordings" / f"{told}.{digest}" / (name.lstrip(".") or "recording")


def url_of(path: Path) -> str | None:
    """The URL that a path is a copy of; None for a recording of this machine."""
    url = read_manifest(path).url
    return url if url and copy_of(url) == Path(os.path.abspath(path)) else None


class Manifest(NamedTuple):
    """A URL, and the files that are there: the version of each (`file_version`), by its path in the
    copy; "" is the copy itself, where it is a file."""

    url: str
    files: Mapping[str, str]

    @property
    def version(self) -> str:
        """A digest of the versions of all files: two copies of one version are alike."""
        return hashlib.sha256(json.dumps(sorted(self.files.items())).encode()).hexdigest()

    def is_here(self, copy: Path) -> bool:
        """Whether the copy has all files."""
        return bool(self.files) and all((copy / name).exists() for name in self.files)


def file_version(info: Mapping[str, Any]) -> str:
    """The version of a file by what fsspec tells of it: its size in bytes, as far as that is known,
    and what names its content, or the time of its last change."""
    told = next((f"{key} {info[key]}" for key in _VERSIONS if info.get(key)), "")
    return f"{info.get('size')} {told}"


def size_of(version: str) -> int | None:
    """The size of a file of a version, bytes."""
    size = version.partition(" ")[0]
    return int(size) if size.isdecimal() else None


def read_manifest(copy: Path) -> Manifest:
    """What is known of a copy; nothing where its manifest is missing or damaged."""
    with suppress(FieldgridError, ValueError):
        match parse_json(read_text(copy.with_name(_MANIFEST))):
            case {"url": str(url), "files": dict(files)} if all(
                isinstance(version, str) and (not name or is_inside(name))
                for name, version in files.items()
            ):
                return Manifest(url, files)
    return Manifest("", {})


def write_manifest(copy: Path, manifest: Manifest, drafts: Path) -> None:
    """Note what is at the URL of a copy."""
    draft = drafts / _MANIFEST
    draft.write_text(json.dumps(manifest._asdict()), "utf-8")
    draft.replace(copy.with_name(_MANIFEST))  # a link there is not followed


@contextmanager
def drafts_of(copy: Path) -> Iterator[Path]:
    """A new folder for files of a copy that are not complete yet; it is removed after the block.

    Nobody else may write to it: in a cache that several users share, a link there could make this
    user write to another file. Another process of this machine that fetches the same is waited for,
    and what a killed one left is removed; where the file system has no locks, some files are
    fetched twice.
    """
    copy.parent.mkdir(parents=True, exist_ok=True)
    held = os.open(copy.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        with suppress(OSError):
            try:
                lock(held, wait=False)
            except BlockingIOError:
                _LOG.warning("waiting for another process that fetches %s", copy)
                lock(held, wait=True)
            for left in copy.parent.glob(".*.partial"):
                shutil.rmtree(left, ignore_errors=True)
        with TemporaryDirectory(".partial", ".", copy.parent, ignore_cleanup_errors=True) as folder:
            yield Path(folder)
    finally:
        let_go(held)


def check_links(copy: Path, names: Iterable[str]) -> None:
    """RecordingError where a link among the folders of a copy leads one of these files out of it:
    other files would be replaced or removed there."""
    top = os.path.realpath(copy.parent)
    for folder in {(copy / name).parent for name in names}:
        if not Path(os.path.realpath(folder)).is_relative_to(top):
            raise RecordingError(
                f"{folder} leads out of the copy {copy} by a link, so nothing is fetched into it; "
                "remove the link."
            )
