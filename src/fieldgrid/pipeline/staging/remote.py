"""A share of a drive, staged on another machine: what a worker of `cluster` runs."""

from __future__ import annotations

import io
import os
import pickle
import platform
import re
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import ClusterError, FieldgridError, MapWriteError, check_is_here
from fieldgrid.pipeline.staging.parts import Share, part_bytes, write_part
from fieldgrid.pipeline.staging.shares import DriveWork, FrameOutcome, stage_frames
from fieldgrid.pipeline.staging.worker import not_importable, unpacked
from fieldgrid.recordings import (
    cache_folder,
    copy_of,
    fetch,
    in_cache,
    read_manifest,
    url_of,
)

_AT_HOME = "leave out --scheduler"


class RecordingPlace(NamedTuple):
    """Where a recording lies, for all workers: its absolute path, the size of a file, None of a
    folder, and the folder that a relative path was given from, else empty. Of the copy of a
    recording at a URL, that and the version of the copy, else empty: each worker makes its own."""

    path: str
    size: int | None
    given_from: str
    url: str
    version: str


class StagedShare(NamedTuple):
    """A share that is staged: its part, how far the camera went, metres, and how long it took."""

    part: tuple[bytes, bytes]
    moved_m: float
    took_s: float


def place_of(recording: Path) -> RecordingPlace:
    """The place of a recording that this machine has."""
    path = recording.absolute()
    size = path.stat().st_size if path.is_file() else None
    given_from = "" if recording.is_absolute() else str(Path.cwd())
    url = url_of(path)
    if url is None:
        return RecordingPlace(str(path), size, given_from, "", "")
    return RecordingPlace(str(path), size, given_from, url, read_manifest(path).version)


class _PathPickler(pickle.Pickler):
    """Makes paths absolute: a worker has another working directory, and another cache folder."""

    def reducer_override(self, value: object) -> Any:
        if not isinstance(value, Path):
            return NotImplemented
        if value.is_relative_to(cache_folder()):
            return in_cache, (str(value.relative_to(cache_folder())),)
        return NotImplemented if value.is_absolute() else (Path, (str(value.absolute()),))


def packed(work: DriveWork) -> bytes:
    """The work on a drive, for a worker. ConfigError when it cannot be sent."""
    data = io.BytesIO()
    try:
        _PathPickler(data).dump(work)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise not_importable(error, _AT_HOME) from error
    return data.getvalue()


def stage_share(
    work: bytes, share: tuple[int, int], place: tuple[str, int | None, str, str, str]
) -> StagedShare:
    """Stage the frames number `share[0]` to before `share[1]` of a drive, `packed`.

    Raises ClusterError when this machine does not have the recording and cannot fetch it, or has no
    room for the part.
    """
    start = time.perf_counter()
    where, frames = RecordingPlace(*place), Share(*share)
    if where.url:
        _fetch(where, _unpacked(work), frames)
    else:
        check_is_here(Path(where.path), where.size, "recordings")
    moved_m: list[float] = []
    with tempfile.TemporaryDirectory(prefix="fieldgrid-") as name:
        folder = Path(name)
        with closing(stage_frames(_unpacked(work), *frames, jobs=1)) as looks:
            try:
                write_part(folder, folder, frames, _as_given(looks, where), moved_m.append)
            except MapWriteError as error:
                raise ClusterError(
                    f"The worker on {platform.node()} has no room: {error}"
                ) from error
        part = part_bytes(folder, frames)
    return StagedShare(part, sum(moved_m), time.perf_counter() - start)


def _files_of(work: DriveWork, share: Share) -> set[Path]:
    """The files of the frames of a share, and of the one before it; none where they are not files
    of their own."""
    try:
        taken = list(work.taken(max(share.first - 1, 0), share.last))
    except (FieldgridError, OSError):  # a bag, which is not here yet
        return set()
    return {Path(source.name) for frame in taken for source in frame.sources}


def _fetch(place: RecordingPlace, work: DriveWork, share: Share) -> None:
    """Have the files of the frames of a share here, or all where frames that are bad are passed
    over, since others may be needed then. ClusterError where that cannot be."""
    wanted = set() if work.skips_bad else _files_of(work, share)
    try:
        copy = fetch(place.url, version=place.version, wanted=wanted)
    except FieldgridError as error:
        raise ClusterError(f"The worker on {platform.node()} has no copy: {error}") from error
    if read_manifest(copy).version != place.version:
        raise ClusterError(
            f"{place.url} has changed since this build began; build it again when it is at rest."
        )


_unpacked = lru_cache(maxsize=2)(partial(unpacked, remedy=_AT_HOME))


def _as_given(looks: Iterable[FrameOutcome], place: RecordingPlace) -> Iterator[FrameOutcome]:
    """The frames with their paths as they were given: a map names images by them."""
    here, given = place.given_from, ""
    if place.url:
        here, given = str(copy_of(place.url).parent), str(Path(place.path).parent)
    if here == given:
        yield from looks
        return
    folder = re.compile(rf"(?<![^\s'\"(]){re.escape(os.path.join(here, ''))}")
    given = os.path.join(given, "")

    def as_given(text: str) -> str:
        return folder.sub(lambda _: given, text)

    for looked in looks:
        staged, bad = looked.staged, looked.bad
        if staged is not None:
            staged = replace(staged, images=tuple(map(as_given, staged.images)))
        if bad is not None:
            bad = bad._replace(reason=as_given(bad.reason))
        yield looked._replace(staged=staged, bad=bad)
