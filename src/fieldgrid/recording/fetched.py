"""Recordings at URLs: copied to this machine by fsspec, and read from there.

Readers seek in files, read them twice and from several processes, so a recording on another
machine (S3, SSH, HTTP, ...) gets a local copy. That of `s3://vines/2026/june-03` is the folder
`CACHE/recordings/s3/vines/2026/june-03`, and a manifest beside it lists its files. A file that has
not changed is not fetched again.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeGuard

from fieldgrid.documents import parse_json
from fieldgrid.errors import ConfigError, FieldgridError, RecordingError, quoted, shortened
from fieldgrid.file_locks import lock
from fieldgrid.limits import Budget, check_rows
from fieldgrid.publish import replacing
from fieldgrid.recording.files import is_inside, read_text

CACHE = "FIELDGRID_CACHE"
"""The environment variable that names another cache folder."""

_URL = re.compile(r"([a-z][a-z0-9+.-]+::)*[a-z][a-z0-9+.-]+://")
_HERE = ("file", "local")
_SECRET = re.compile(r"://[^/@]*:[^/@]*@|[?&][^=]*(token|sig|key|secret|password|credential)", re.I)
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}
_BATCH = 64
_GONE = (404, 410)
"""What a web server answers where there is no such file."""
_LOG = logging.getLogger(__name__)
_VERSIONS = (
    *("ETag", "etag", "md5Hash", "content_md5", "checksum", "CRC"),
    *(
        "mtime",
        "LastModified",
        "Last-Modified",
        "last_modified",
        "updated",
        "modified",
        "modify",
        "created",
    ),
)
"""What file systems call the version of a file or the time of its last change, best first."""


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
    manifest = _read_manifest(path)
    return manifest.url or None


def version_of(copy: Path) -> str:
    """A digest of the versions of the files of a copy: two copies of one version are alike."""
    versions = sorted(_read_manifest(copy).versions.items())
    return hashlib.sha256(json.dumps(versions).encode()).hexdigest()


def fetch(url: str, *, progress: Callable[[int, int], None] | None = None) -> Path:
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
    return _fetched(url, progress or (lambda done, total: None))


def _fetched(url: str, progress: Callable[[int, int], None]) -> Path:
    """The path of what is at a URL, an archive included, after its copy is up to date."""
    with _backend(url):
        system, root = _file_system(url)
        protocols = (system.protocol,) if isinstance(system.protocol, str) else system.protocol
        if not set(protocols).isdisjoint(_HERE):
            return Path(root)
        system.invalidate_cache()  # of listings: another process may have written since
        remote = _listed(system, root, url)
        _check_unfolding(url, remote)
    copy = copy_of(url)
    with _local(copy), _only_here(copy):
        _check_kind(copy, is_file="" in remote)
        _bring_up_to_date(system, remote, copy, url, progress)
    return copy


def _file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    from fsspec.core import url_to_fs

    folder, _, archive = url.partition("::")
    try:
        found: tuple[Any, str] = url_to_fs(url)
    except ValueError:
        # A web server that gives no parts of a file: its archive is copied as a whole.
        if not archive.startswith("http"):
            raise
        found = url_to_fs(f"{folder}::file://{_fetched(archive, lambda done, total: None)}")
    return found


def _bring_up_to_date(
    system: Any,
    remote: Mapping[str, _RemoteFile],
    copy: Path,
    url: str,
    progress: Callable[[int, int], None],
) -> None:
    """Fetch what the copy lacks. The manifest is written after each batch, so that a fetch that is
    interrupted goes on from there."""
    manifest = _read_manifest(copy)
    missing = [name for name, file in remote.items() if not file.is_at(copy, name, manifest)]
    _check_room(url, sum(remote[name].size or 0 for name in missing))
    known = dict(manifest.versions)
    for first in range(0, len(missing), _BATCH):
        progress(len(remote) - len(missing) + first, len(remote))
        names = missing[first : first + _BATCH]
        with _backend(url):
            _fetch_batch(system, remote, names, copy, url)
        known |= {name: remote[name].version for name in names}
        _write_manifest(copy, url, known)
    gone = known.keys() - remote.keys()
    for name in gone:
        _place(copy, name).unlink(missing_ok=True)
    if gone:
        _write_manifest(copy, url, {name: file.version for name, file in remote.items()})
    progress(len(remote), len(remote))


class _RemoteFile(NamedTuple):
    """A file at a URL: where, how many bytes if that is known, and what tells its version."""

    path: str
    size: int | None
    version: str

    def is_at(self, copy: Path, name: str, manifest: _Manifest) -> bool:
        """Whether the copy has this version of the file."""
        if self.size is None or manifest.versions.get(name) != self.version:
            return False
        try:
            return _place(copy, name).stat().st_size == self.size
        except OSError:
            return False


class _Manifest(NamedTuple):
    url: str
    versions: Mapping[str, str]


def _listed(system: Any, root: str, url: str) -> dict[str, _RemoteFile]:
    """The files of the recording, by their paths relative to it; "" is the recording itself."""
    about = system.info(root)
    if about["type"] != "directory":
        if url.endswith("/"):
            raise RecordingError(
                f"{url} is no folder whose files can be listed (web servers list none); give the "
                "URL of a bag, a log, or an archive as zip://FOLDER::URL."
            )
        return {"": _remote_file(about)}
    files = {}
    for count, (path, info) in enumerate(system.find(root, detail=True).items(), start=1):
        check_rows(count, url)
        if path.endswith("/") or path == root:
            continue  # some stores keep an empty object for a folder
        name = str(PurePosixPath(path).relative_to(PurePosixPath(root)))
        if not is_inside(name):
            raise RecordingError(
                f"{url} has a file {quoted(name)}, whose name leads out of the recording; rename "
                "it there."
            )
        files[name] = _remote_file(info)
    if not files:
        raise RecordingError(f"{url} is an empty folder; give the URL of a recording.")
    return files


def _check_unfolding(url: str, files: Mapping[str, _RemoteFile]) -> None:
    """LimitError where files unfold to too much of the archive in which a chained URL finds them,
    before any of it is fetched."""
    _, is_chained, container = url.partition("::")
    if not is_chained:
        return
    from fsspec.core import url_to_fs

    system, root = url_to_fs(container)
    packed = system.info(root).get("size")
    if packed is not None:
        Budget(quoted(url, 200), packed).spend(sum(file.size or 0 for file in files.values()))


def _remote_file(info: Mapping[str, Any]) -> _RemoteFile:
    known = next((f"{key} {info[key]}" for key in _VERSIONS if info.get(key)), "")
    return _RemoteFile(info["name"], info.get("size"), known)


def _fetch_batch(
    system: Any, remote: Mapping[str, _RemoteFile], names: list[str], copy: Path, url: str
) -> None:
    """Fetch some files; each takes its place when all of its bytes are here."""
    places = [_place(copy, name) for name in names]
    drafts = [place.with_name(f".{place.name}.partial") for place in places]
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
    try:
        system.get([remote[name].path for name in names], [str(draft) for draft in drafts])
        for name, draft, place in zip(names, drafts, places, strict=True):
            size, expected = draft.stat().st_size, remote[name].size
            if expected is not None and size != expected:
                raise RecordingError(
                    f"{name or url} arrived with {size} of its {expected} bytes; repeat the "
                    "command, which goes on from there."
                )
            draft.replace(place)
    finally:
        for draft in drafts:
            draft.unlink(missing_ok=True)


def _place(copy: Path, name: str) -> Path:
    return copy / name if name else copy


def _check_kind(copy: Path, *, is_file: bool) -> None:
    if copy.exists() and copy.is_file() != is_file:
        raise RecordingError(
            f"{copy} is a copy of when there was a {'folder' if is_file else 'file'} at the URL, "
            f"and there is a {'file' if is_file else 'folder'} now; remove it."
        )


def _check_room(url: str, size: int) -> None:
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder).free
    if size > free:
        raise RecordingError(
            f"{url} has {size / 1e9:.1f} GB to fetch and {folder} has room for {free / 1e9:.1f} "
            f"GB; free some, or set {CACHE} to a folder on a larger disk."
        )


def _manifest_file(copy: Path) -> Path:
    return copy.with_name(f".{copy.name}.fetched.json")


def _read_manifest(copy: Path) -> _Manifest:
    """What is known of a copy; nothing where its manifest is missing or damaged."""
    with suppress(FieldgridError, ValueError):
        found = parse_json(read_text(_manifest_file(copy)))
        if isinstance(found, dict) and isinstance(found.get("files"), dict):
            return _Manifest(str(found.get("url", "")), found["files"])
    return _Manifest("", {})


def _write_manifest(copy: Path, url: str, versions: Mapping[str, str]) -> None:
    with replacing(_manifest_file(copy)) as draft:
        draft.write_text(json.dumps({"url": url, "files": versions}), "utf-8")


@contextmanager
def _only_here(copy: Path) -> Iterator[None]:
    """Keeps other processes of this machine from fetching the same in the block; where the file
    system has no locks, they only fetch some files twice."""
    copy.parent.mkdir(parents=True, exist_ok=True)
    held = os.open(copy.with_name(f".{copy.name}.fetching"), os.O_RDWR | os.O_CREAT, 0o666)
    try:
        with suppress(OSError):
            try:
                lock(held, wait=False)
            except BlockingIOError:
                _LOG.warning("waiting for another process that fetches %s", copy)
                lock(held, wait=True)
        yield
    finally:
        os.close(held)


def _safe_name(part: str) -> str:
    """A part of a URL as the name of a file: as it is where that can be, else its digest."""
    if re.fullmatch(r"[\w ()+=,@.-]{1,200}", part) and part != "..":
        return part
    return hashlib.sha256(part.encode("utf-8", "surrogateescape")).hexdigest()[:32]


@contextmanager
def _backend(url: str) -> Iterator[None]:
    """Makes what fsspec and its file systems raise an error that says what to do."""
    try:
        yield
    except FieldgridError:
        raise
    except ImportError as error:
        raise ConfigError(
            f"{quoted(url, 200)} needs a library that is not installed ({shortened(error)}); run: "
            "pip install 'fieldgrid[remote]', and the one named here."
        ) from error
    except FileNotFoundError as error:
        if _is_unreachable(error.__cause__):
            raise _unreadable(url, error.__cause__) from error
        raise RecordingError(
            f"{quoted(url, 200)} does not exist; give the URL of a recording, a bag or a log."
        ) from error
    except Exception as error:  # each file system raises errors of its own (botocore, paramiko)
        if isinstance(error, OSError) and error.errno in _FULL:
            raise  # the disk of this machine
        raise _unreadable(url, error) from error


def _is_unreachable(cause: BaseException | None) -> bool:
    """Whether what made a file system say that a file does not exist is another thing: fsspec says
    so of a web server that refuses or is not there."""
    status = getattr(cause, "status", None)
    if isinstance(status, int):
        return status not in _GONE
    return isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError)


def _unreadable(url: str, error: BaseException | None) -> RecordingError:
    copy = copy_of(url)
    kept = f", or read the copy of before at {copy}" if copy.exists() else ""
    why = shortened(error) if error is not None else ""
    return RecordingError(
        f"{quoted(url, 200)} cannot be read ({why or type(error).__name__}); "
        f"check the URL, the connection and your credentials{kept}."
    )


@contextmanager
def _local(copy: Path) -> Iterator[None]:
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
