"""The files of a recording at a URL, as fsspec lists them, and what its errors mean to a user."""

from __future__ import annotations

import errno
import re
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from pathlib import PurePosixPath
from threading import Thread
from typing import Any, TypeVar

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
from fieldgrid.recordings.remote.copies import (
    CACHE,
    cache_folder,
    copy_of,
    file_version,
    read_manifest,
    size_of,
)

_T = TypeVar("_T")
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}
_GONE = (404, 410)
"""What a web server answers where there is no such file."""
_DEEPEST = 100
"""How many folders may lie in each other: where a server shows a link as a folder, a circle of them
has no end, and its paths would fill the memory long before their number is too large."""
_PATIENCE_S, _LEAST_BYTES_PER_S = 300.0, 10_000.0
"""How long a server may take for an answer, and how fast its files have to come after that."""


def opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it. Of a web server only what it gives by the
    scheme of the URL, or by https: a redirect could lead to what others can read and change."""
    from fsspec.core import url_to_fs

    schemes = {link.partition("://")[0] for link in url.split("::")} & {"http", "https"}
    system, root = url_to_fs(url, **{scheme: {"get_client": _web_client} for scheme in schemes})
    return system, root


async def _web_client(**options: Any) -> Any:
    import aiohttp

    async def check_redirect(session: Any, context: Any, about: Any) -> None:
        target = about.url.join(type(about.url)(about.response.headers.get("Location", "")))
        if target.scheme not in (about.url.scheme, "https"):
            raise ConnectionError(f"the server redirects to {quoted(target.scheme)}")

    watch = aiohttp.TraceConfig()
    watch.on_request_redirect.append(check_redirect)
    limit = aiohttp.ClientTimeout(total=None)  # `within_time` has a better one
    return aiohttp.ClientSession(trace_configs=[watch], **{"timeout": limit, **options})


def within_time(call: Callable[[], _T], fetched: Callable[[], int] = lambda: 0) -> _T:
    """What a call to a server gives. TimeoutError where it takes longer than an answer may, and
    than the bytes may that are `fetched` so far.

    Many file systems wait without end, so a thread calls; one that is given up ends with the
    program.
    """
    answer: Future[_T] = Future()

    def ask() -> None:
        try:
            answer.set_result(call())
        except BaseException as error:  # noqa: BLE001 - it is raised again below
            answer.set_exception(error)

    start = time.monotonic()
    Thread(target=ask, name="fieldgrid-fetch", daemon=True).start()
    while not wait([answer], timeout=1.0).done:
        if time.monotonic() - start > _PATIENCE_S + fetched() / _LEAST_BYTES_PER_S:
            raise TimeoutError(f"less than {_LEAST_BYTES_PER_S / 1000.0:g} kB a second came")
    return answer.result()


def listed_files(system: Any, root: str, url: str) -> dict[str, str]:
    """The versions of the files of a recording by their paths relative to it; "" is the recording
    itself. Without `lost+found`, which nobody may list.

    It lists folder by folder: fsspec's own `find` leaves out what it cannot list, without a word.
    """
    about = system.info(root)
    if about["type"] != "directory":
        if url.endswith("/"):
            raise RecordingError(
                f"{url} is no folder whose files can be listed (web servers list none); give the "
                "URL of a bag, a log, or an archive as zip://FOLDER::URL."
            )
        return {"": file_version(about)}
    files, folders = dict[str, str](), [root.rstrip("/")]
    for folder in folders:
        for info in system.ls(folder, detail=True):
            path = info["name"].rstrip("/")
            place = PurePosixPath(path).relative_to(PurePosixPath(root))
            name = str(place)
            if not is_inside(name) or info["type"] == "link":
                raise RecordingError(
                    f"{url} has a link, or a name that leads out of it, {quoted(name, 200)}, which "
                    "is not followed; put the file itself there in its place, or remove it."
                )
            if len(place.parts) > _DEEPEST:
                raise RecordingError(
                    f"{url} has folders that lie more than {_DEEPEST} deep in each other, as in "
                    f"{quoted(folder, 200)}; if one of them is a link to a folder that it is in, "
                    "remove it there."
                )
            if path == folder or place.name == "lost+found":
                continue  # an empty object can stand for a folder
            if info["type"] == "directory":
                folders.append(path)
            else:
                files[name] = file_version(info)
            check_rows(len(files) + len(folders), url)
    if not files:
        raise RecordingError(f"{url} is an empty folder; give the URL of a recording.")
    return files


def check_unfolding(archive: str, url: str, versions: Iterable[str]) -> None:
    """LimitError where files of these versions are too much for the archive that they are in."""
    system, root = opened(archive)
    packed = system.info(root).get("size")
    if packed is not None:
        budget = UnfoldBudget(quoted(url, 200), packed)
        budget.spend(sum(size_of(version) or 0 for version in versions))


@contextmanager
def told(url: str) -> Iterator[None]:
    """Makes what fsspec, its file systems and this machine's disk raise while a URL is fetched an
    error that says what to do."""
    copy, named = copy_of(url), quoted(url, 200)
    try:
        yield
    except FieldgridError:
        raise
    except ImportError as error:
        raise ConfigError(
            f"{named} needs a library that is not installed ({shortened(error)}); run: "
            "pip install 'fieldgrid[remote]', and the one named here."
        ) from error
    except Exception as error:  # each file system raises errors of its own (botocore, paramiko)
        problem: BaseException = error
        cause, kept = error.__cause__, ""
        is_own = isinstance(error, OSError) and (
            error.errno in _FULL or str(error.filename).startswith(str(cache_folder()))
        )
        if isinstance(error, FileNotFoundError) and not is_own:
            # fsspec says so, too, of a web server that refuses or is not reached.
            is_told = isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError)
            if cause is None or (not is_told and getattr(cause, "status", 404) in _GONE):
                raise RecordingError(
                    f"{named} does not exist; give the URL of a recording, a bag or a log."
                ) from error
            problem = cause
        # Servers redirect to addresses that hold keys.
        why = shortened(re.sub(r"\?[^\s'\"]+", "?...", str(problem))) or type(problem).__name__
        if is_own:
            raise RecordingError(
                f"The copy {copy} cannot be written ({why}); free some space, remove the copy, or "
                f"set {CACHE} to another folder."
            ) from error
        if read_manifest(copy).is_here(copy):
            kept = f", or read the copy of before at {copy}"
        raise RecordingError(
            f"{named} cannot be read ({why}); check the URL, the connection and your "
            f"credentials{kept}."
        ) from error
