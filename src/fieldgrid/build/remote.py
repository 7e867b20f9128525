"""A share of a drive, staged on another machine: what a worker of `build.cluster` runs."""

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
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.build.parts import PartBytes, Share, part_bytes, write_part
from fieldgrid.build.staging import DriveWork, Looked, stage_frames
from fieldgrid.build.worker import not_importable
from fieldgrid.errors import ClusterError, MapWriteError
from fieldgrid.workers.place import check_is_here

_AT_HOME = "leave out --scheduler"


class Place(NamedTuple):
    """Where a recording lies, for all workers: its absolute path, the size of a file, None of a
    folder, and the folder that a relative path was given from, else empty."""

    path: str
    size: int | None
    given_from: str


class Made(NamedTuple):
    """A share that is staged: its part, how far the camera went, metres, and how long it took."""

    part: PartBytes
    moved_m: float
    took_s: float


def place_of(recording: Path) -> Place:
    """The place of a recording that this machine has."""
    path = recording.absolute()
    size = path.stat().st_size if path.is_file() else None
    return Place(str(path), size, "" if recording.is_absolute() else str(Path.cwd()))


class _Absolute(pickle.Pickler):
    """Makes paths absolute: a worker has another working directory."""

    def reducer_override(self, value: object) -> Any:
        if isinstance(value, Path) and not value.is_absolute():
            return Path, (str(value.absolute()),)
        return NotImplemented


def packed(work: DriveWork) -> bytes:
    """The work on a drive, for a worker. ConfigError when it cannot be sent."""
    data = io.BytesIO()
    try:
        _Absolute(data).dump(work)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise not_importable(error, _AT_HOME) from error
    return data.getvalue()


def stage_share(work: bytes, share: tuple[int, int], place: tuple[str, int | None, str]) -> Made:
    """Stage the frames number `share[0]` to before `share[1]` of a drive, `packed`.

    Raises ClusterError when this machine does not have the recording, or no room for the part.
    """
    start = time.perf_counter()
    where, frames = Place(*place), Share(*share)
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
    return Made(part, sum(moved_m), time.perf_counter() - start)


@lru_cache(maxsize=2)
def _unpacked(work: bytes) -> DriveWork:
    try:
        found: DriveWork = pickle.loads(work)
    except (AttributeError, ImportError) as error:
        raise not_importable(error, _AT_HOME) from error
    return found


def _as_given(looks: Iterable[Looked], place: Place) -> Iterator[Looked]:
    """The same, with paths as they were given: a map names images by them."""
    if not place.given_from:
        yield from looks
        return
    folder = re.compile(rf"(?<![^\s'\"(]){re.escape(os.path.join(place.given_from, ''))}")
    for looked in looks:
        staged, bad = looked.staged, looked.bad
        if staged is not None:
            staged = replace(staged, images=tuple(folder.sub("", name) for name in staged.images))
        if bad is not None:
            bad = bad._replace(reason=folder.sub("", bad.reason))
        yield looked._replace(staged=staged, bad=bad)
