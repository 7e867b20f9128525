"""The files of a recording at a URL, as fsspec lists them, and what its errors mean to a user."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
_GONE = (404, 410)
"""What a web server answers where there is no such file."""
_VERSIONS = (
    *("ETag", "etag", "md5Hash", "content_md5", "checksum", "CRC"),
    *("mtime", "LastModified", "Last-Modified", "last_modified"),
    *("updated", "modified", "modify", "created"),
)
"""What file systems call the version of a file or the time of its last change, best first."""
_DEEPEST = 100
"""How many folders may lie in each other: where a server shows a link as a folder, a circle of them
has no end, and its paths would fill the memory long before their number is too large."""


class RemoteFile(NamedTuple):
    """A file at a URL: where, how many bytes if that is known, and what tells its version."""

    path: str
    size: int | None
    version: str


def listed_files(system: Any, root: str, url: str) -> dict[str, RemoteFile]:
    """The files of the recording by their paths relative to it; "" is the recording itself. Files
    with the names of what lies beside copies (`is_own_name`) are left out, and so is `lost+found`,
    which nobody may list.

    It lists folder by folder: fsspec's own `find` leaves out what it cannot list, without a word.
    """
    about = system.info(root)
    if about["type"] != "directory":
        if url.endswith("/"):
            raise RecordingError(
                f"{url} is no folder whose files can be listed (web servers list none); give the "
                "URL of a bag, a log, or an archive as zip://FOLDER::URL."
            )
        return {"": _remote_file(about)}
    files, folders = dict[str, RemoteFile](), [root.rstrip("/")]
    for folder in folders:
        for info in system.ls(folder, detail=True):
            path = info["name"].rstrip("/")
            if path == folder:
                continue  # some stores keep an empty object for a folder
            place = PurePosixPath(path).relative_to(PurePosixPath(root))
            name = str(place)
            if not is_inside(name):
                raise RecordingError(
                    f"{url} has a file {quoted(name)}, whose name leads out of the recording; "
                    "rename it there."
                )
            if info["type"] == "link":
                raise RecordingError(
                    f"{url} has a link {quoted(name, 200)}, which is not followed; put what it "
                    "leads to there in its place, or remove it."
                )
            if len(place.parts) > _DEEPEST:
                raise RecordingError(
                    f"{url} has folders that lie more than {_DEEPEST} deep in each other, as in "
                    f"{quoted(folder, 200)}; if one of them is a link to a folder that it is in, "
                    "remove it there."
                )
            if info["type"] != "directory":
                if not is_own_name(name):
                    files[name] = _remote_file(info)
            elif place.name != "lost+found":
                folders.append(path)
            check_rows(len(files) + len(folders), url)
    if not files:
        raise RecordingError(f"{url} is an empty folder; give the URL of a recording.")
    return files


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
    return RemoteFile(info["name"], info.get("size"), known)


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
