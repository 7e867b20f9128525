"""A share of a drive, staged in another process: one of this machine, or of another."""

from __future__ import annotations

import io
import os
import pickle
import platform
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import (
    ClusterError,
    ConfigError,
    FieldgridError,
    check_is_here,
    check_versions,
    versions,
)
from fieldgrid.pipeline.staging.parts import Share
from fieldgrid.pipeline.staging.shares import DriveWork, FrameOutcome, stage_frames
from fieldgrid.recordings import (
    cache_folder,
    copy_of,
    fetch,
    in_cache,
    read_manifest,
    url_of,
)


class RecordingPlace(NamedTuple):
    """Where a recording lies, for workers of other machines: its absolute path, the size of a file,
    None of a folder, and the folder that a relative path was given from, else empty. Of the copy of
    a recording at a URL, that and the version of the copy, else empty: each worker makes its own.
    `wanted` are the versions that a worker has to have."""

    path: Path
    size: int | None
    given_from: str
    url: str
    version: str
    wanted: dict[str, str]


class StagedShare(NamedTuple):
    """A share that is staged: what became of its frames, and how long it took."""

    frames: list[FrameOutcome]
    took_s: float


def place_of(recording: Path) -> RecordingPlace:
    """The place of a recording that this machine has."""
    path = recording.absolute()
    size = path.stat().st_size if path.is_file() else None
    given_from = "" if recording.is_absolute() else str(Path.cwd())
    url = url_of(path)
    version = "" if url is None else read_manifest(path).version
    return RecordingPlace(path, size, given_from, url or "", version, versions())


class _PathPickler(pickle.Pickler):
    """Makes paths absolute: a worker has another working directory, and another cache folder."""

    def reducer_override(self, value: object) -> Any:
        if not isinstance(value, Path):
            return NotImplemented
        if value.is_relative_to(cache_folder()):
            return in_cache, (str(value.relative_to(cache_folder())),)
        return NotImplemented if value.is_absolute() else (Path, (str(value.absolute()),))


def packed(work: DriveWork, place: RecordingPlace | None) -> bytes:
    """The work on a drive, for another process, of another machine where its recording has a
    `place`. ConfigError when it cannot be sent."""
    data = io.BytesIO()
    try:
        (pickle.Pickler if place is None else _PathPickler)(data).dump(work)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"The frames of this drive cannot be given to other processes ({error}); define their "
            "classes in a module that can be imported, or give --jobs 1 and no --scheduler."
        ) from error
    return data.getvalue()


_unpacked = lru_cache(maxsize=2)(pickle.loads)


def stage_share(work: bytes, share: Share, place: RecordingPlace | None) -> StagedShare:
    """Stage a share of a drive, `packed`; on another machine the recording is at a `place`.

    Raises ClusterError when that machine does not have the recording and cannot fetch it.
    """
    start = time.perf_counter()
    if place is not None:
        check_versions(place.wanted)
        if not place.url:
            check_is_here(place.path, place.size, "recordings")
    unpacked: DriveWork = _unpacked(work)
    if place is not None and place.url:
        _fetch(place, unpacked, share)
    with closing(stage_frames(unpacked, *share, jobs=1)) as looks:
        frames = list(looks if place is None else _as_given(looks, place))
    return StagedShare(frames, time.perf_counter() - start)


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


def _as_given(looks: Iterable[FrameOutcome], place: RecordingPlace) -> Iterator[FrameOutcome]:
    """The frames with their paths as they were given: a map names images by them."""
    here, given = place.given_from, ""
    if place.url:
        here, given = str(copy_of(place.url).parent), str(place.path.parent)
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
