"""The files of a recording at a URL, as fsspec lists them, and what its errors mean to a user."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import PurePosixPath
from typing import Any, NamedTuple

from fieldgrid.core import (
    ConfigError,
    FieldgridError,
    RecordingError,
    UnfoldBudget,
    check_rows,
    quoted,
    shortened,
)
from fieldgrid.recordings.files import is_inside
from fieldgrid.recordings.remote.copies import copy_of, is_own_name, is_whole

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}
_REFUSED = {errno.EACCES, errno.EPERM}
_GONE = (404, 410)
"""What a web server answers where there is no such file."""
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
_LINK = ("type", "size", "uid", "gid", "mtime")
"""What a listing says of a link itself, wherever it is met; the time of access changes."""
_DEEPEST = 100
"""How many folders may lie in each other: where a server shows a link as a folder, a circle of them
has no end, and its paths would fill the memory long before their number is too large."""
_LOG = logging.getLogger(__name__)


class RemoteFile(NamedTuple):
    """A file at a URL: where, how many bytes if that is known, what tells its version, and whether
    a link leads to it."""

    path: str
    size: int | None
    version: str
    is_link: bool


class RemoteFiles(NamedTuple):
    """The files of a recording at a URL, by their paths relative to it; "" is the recording itself.
    What is in the folders `unlisted`, relative to it as well, this user may not see."""

    files: dict[str, RemoteFile]
    unlisted: tuple[str, ...] = ()


class _Walk(NamedTuple):
    """What is listed, of which URL; the folders that refuse it are added to `unlisted`."""

    system: Any
    root: str
    url: str
    unlisted: list[str]


def listed_files(system: Any, root: str, url: str) -> RemoteFiles:
    """The files of the recording. Files with the names of what lies beside copies (`is_own_name`)
    are left out."""
    about = system.info(root)
    if about["type"] != "directory":
        if url.endswith("/"):
            raise RecordingError(
                f"{url} is no folder whose files can be listed (web servers list none); give the "
                "URL of a bag, a log, or an archive as zip://FOLDER::URL."
            )
        return RemoteFiles({"": _remote_file(about)})
    files, walk = {}, _Walk(system, root, url, [])
    for count, (path, info) in enumerate(_followed(walk, root), start=1):
        check_rows(count, url)
        if path.endswith("/") or path == root:
            continue  # some stores keep an empty object for a folder
        name = _below(root, path)
        if not is_inside(name):
            raise RecordingError(
                f"{url} has a file {quoted(name)}, whose name leads out of the recording; rename "
                "it there."
            )
        if not is_own_name(name):
            files[name] = _remote_file(info)
    if not files:
        raise RecordingError(f"{url} is an empty folder; give the URL of a recording.")
    return RemoteFiles(files, tuple(_below(root, folder) for folder in walk.unlisted))


def _below(root: str, path: str) -> str:
    return str(PurePosixPath(path).relative_to(PurePosixPath(root)))


def _followed(
    walk: _Walk, top: str, *, folders: bool = True
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """All files below a folder, and those that links in it lead to: SSH lists a link as such, with
    the size of its name. A link that leads nowhere is left out, and so is one to a folder that is
    found behind such a link, or that the link itself is in: with `..` or `/` in place of a folder
    of images, all that the server has would be fetched."""
    system = walk.system
    for path, listed in _found(walk, top).items():
        if listed.get("type") != "link":
            yield path, listed
            continue
        try:
            info = system.info(path)
        except FileNotFoundError:
            continue
        if info["type"] != "directory":
            yield path, {**info, "name": path, "is_link": True}
        elif folders and _is_around(system, path, listed):
            _LOG.warning(
                "%s is left out: it is a link to a folder that it is in itself; let it lead to the "
                "folder that is meant",
                quoted(path, 200),
            )
        elif folders:
            yield from _followed(walk, path, folders=False)


def _found(walk: _Walk, top: str) -> Mapping[str, Mapping[str, Any]]:
    """All files below a folder, by their paths. Folders that may not be listed, such as the
    `lost+found` of a disk, are added to `unlisted`: fsspec's own `find` leaves out all that it
    cannot list, without a word, where it lists folder by folder."""
    if not _lists_by_folder(walk.system):
        found: Mapping[str, Mapping[str, Any]] = walk.system.find(top, detail=True)
        return found
    files, folders = {}, [top]
    for folder in folders:
        for info in _listed(walk, folder):
            path = info["name"]
            if info["type"] == "directory" and path.rstrip("/") != folder.rstrip("/"):
                folders.append(path.rstrip("/"))
            else:
                files[path] = info
        check_rows(len(files) + len(folders), walk.url)
    return dict(sorted(files.items()))


def _lists_by_folder(system: Any) -> bool:
    """Whether fsspec finds the files below a folder by listing one folder after the other."""
    from fsspec import AbstractFileSystem
    from fsspec.asyn import AsyncFileSystem
    from fsspec.implementations.dirfs import DirFileSystem

    while isinstance(system, DirFileSystem):  # it asks the file system that it is a folder of
        system = system.fs
    kind = type(system)
    if isinstance(system, AsyncFileSystem) and kind._find is not AsyncFileSystem._find:
        return False
    return kind.find is AbstractFileSystem.find


def _listed(walk: _Walk, folder: str) -> Sequence[Mapping[str, Any]]:
    """What is in a folder; nothing, with a warning, where this user may not list it. All else that
    fails, such as a connection that is lost, would leave files out that belong to the recording."""
    if len(PurePosixPath(_below(walk.root, folder)).parts) > _DEEPEST:
        raise RecordingError(
            f"{walk.url} has folders that lie more than {_DEEPEST} deep in each other, as in "
            f"{quoted(folder, 200)}; if one of them is a link to a folder that it is in, remove it "
            "there."
        )
    try:
        listed: Sequence[Mapping[str, Any]] = walk.system.ls(folder, detail=True)
    except FileNotFoundError as error:
        if folder == walk.root or _is_unreachable(error.__cause__):
            raise
        raise RecordingError(
            f"The folder {quoted(folder, 200)} was gone before it was listed; repeat the command "
            "when the recording is at rest."
        ) from error
    except OSError as error:
        is_refused = isinstance(error, PermissionError) or error.errno in _REFUSED
        if folder == walk.root or not is_refused:
            raise
        walk.unlisted.append(folder)
        _LOG.warning(
            "the folder %s cannot be listed (%s), so its files are left out; allow reading it "
            "there if they belong to the recording",
            quoted(folder, 200),
            shortened(error),
        )
        return ()
    return listed


def _is_around(system: Any, path: str, listed: Mapping[str, Any]) -> bool:
    """Whether a link leads to a folder that it is in itself: then the link is met again behind it.
    File systems of SSH do not say where a link leads."""
    link = PurePosixPath(path)
    for folder in link.parents:
        again = link / link.relative_to(folder)
        found = []
        with suppress(Exception):  # there is no such folder: each file system has its own errors
            found = system.ls(str(again.parent), detail=True)
        for info in found:
            is_same = all(info.get(key) == listed.get(key) for key in _LINK)
            if is_same and PurePosixPath(info["name"]) == again:
                return True
    return False


def check_unfolding(url: str, files: Mapping[str, RemoteFile]) -> None:
    """LimitError where files unfold to too much of the archive in which a chained URL finds them,
    before any of it is fetched."""
    _, is_chained, container = url.partition("::")
    if not is_chained:
        return
    from fsspec.core import url_to_fs

    system, root = url_to_fs(container)
    packed = system.info(root).get("size")
    if packed is not None:
        UnfoldBudget(quoted(url, 200), packed).spend(sum(file.size or 0 for file in files.values()))


def _remote_file(info: Mapping[str, Any]) -> RemoteFile:
    known = next((f"{key} {info[key]}" for key in _VERSIONS if info.get(key)), "")
    return RemoteFile(info["name"], info.get("size"), known, info.get("is_link", False))


@contextmanager
def from_backend(url: str) -> Iterator[None]:
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
    kept = f", or read the copy of before at {copy}" if is_whole(copy) else ""
    why = shortened(error) if error is not None else ""
    return RecordingError(
        f"{quoted(url, 200)} cannot be read ({why or type(error).__name__}); "
        f"check the URL, the connection and your credentials{kept}."
    )
