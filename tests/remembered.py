"""What was worked out before in a run of the tests is not worked out again.

Matching a pair, finding its corners, reading a log and estimating poses take most of the time of
a build, and hundreds of tests that are about something else do that with the same few images and
logs of the example. All of it depends on nothing but its arguments, or on the content of a file.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import StereoSettings
from fieldgrid.perception import features, step, stereo, vertical_shifts
from fieldgrid.pipeline import poses, repose
from fieldgrid.pipeline.checks import doubt
from fieldgrid.pipeline.inspection import frame_pass, measures
from fieldgrid.pipeline.mounting import frame_probe
from fieldgrid.pipeline.staging import perception, shares as staging
from fieldgrid.poses import drive, estimate_poses, levelled
from fieldgrid.poses.attitude.estimate import estimate_attitude
from fieldgrid.poses.faults.clock import search as clock_search
from fieldgrid.poses.smoother.batch import refine, smooth
from fieldgrid.recordings.calibration import loading as calibration, opencv as calibration_opencv
from fieldgrid.recordings.calibration.yaml_text import load_yaml
from fieldgrid.recordings.tables import logs
from fieldgrid.recordings.tables.stream_log import read_stream
from tests.once import RUN_FOLDER

KEPT_BYTES = 200 << 20

USES: tuple[tuple[Callable[..., Any], tuple[object, ...]], ...] = (
    (features, (doubt, frame_probe, frame_pass, perception, staging)),
    (step, (perception,)),
    (vertical_shifts, (measures,)),
    (smooth, (drive,)),
    (refine, (clock_search, drive)),
    (estimate_attitude, (levelled,)),
    (estimate_poses, (poses, repose)),
)
"""Functions that give the same for the same arguments, and the modules that call them."""

READERS: tuple[tuple[Callable[[Path], Any], tuple[object, ...]], ...] = (
    (load_yaml, (calibration, calibration_opencv)),
    (read_stream, (logs,)),
)
"""Functions that give the same for files of the same name and content."""

LARGEST_FILE_BYTES = 1 << 20

_make_matcher = stereo.make_matcher


def shared_folder() -> Path | None:
    """Where the processes of a run share what they remember; none where the run has one process,
    or its files do not lie in memory."""
    in_memory = os.environ.get(RUN_FOLDER)
    if in_memory is None or "PYTEST_XDIST_WORKER" not in os.environ:
        return None
    return Path(in_memory) / "remembered"


class Memory:
    """Results by what they were worked out from, the oldest forgotten first; for all threads.

    Processes that are given the same folder share them there, each so many bytes.
    """

    def __init__(self, most_bytes: int = KEPT_BYTES, folder: Path | None = None) -> None:
        self._most_bytes = most_bytes
        self._folder = folder
        self._written_bytes = 0
        self._known: dict[bytes, bytes] = {}
        self._bytes = 0
        self._lock = threading.Lock()

    def of(self, work: Callable[..., Any], about: object, *arguments: Any, **named: Any) -> Any:
        """What `work` makes of its arguments, which with `about` tell all that it depends on.

        Each caller has a result of its own, to do with what it likes.
        """
        key = hashlib.sha256(pickle.dumps((about, arguments, named), 5)).digest()
        kept = self._known.get(key)
        if kept is None:
            kept = self._of_others(key)
            if kept is None:
                kept = pickle.dumps(work(*arguments, **named), 5)
                self._share(key, kept)
            with self._lock:
                self._bytes += len(kept) - len(self._known.pop(key, b""))
                self._known[key] = kept
                while self._bytes > self._most_bytes:
                    self._bytes -= len(self._known.pop(next(iter(self._known))))
        return pickle.loads(kept)

    def _of_others(self, key: bytes) -> bytes | None:
        if self._folder is None:
            return None
        try:
            return (self._folder / key.hex()).read_bytes()
        except OSError:
            return None

    def _share(self, key: bytes, result: bytes) -> None:
        with self._lock:
            self._written_bytes += len(result)
            if self._folder is None or self._written_bytes > self._most_bytes:
                return
        draft = self._folder / f"{key.hex()}.{os.getpid()}-{threading.get_ident()}"
        # Some tests let no file grow beyond a size; the others work it out for themselves then.
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True)
            draft.write_bytes(result)
            draft.replace(self._folder / key.hex())

    def remembered(self, work: Callable[..., Any]) -> Callable[..., Any]:
        """The same function with this memory."""

        def recall(*arguments: Any, **named: Any) -> Any:
            return self.of(work, work.__qualname__, *arguments, **named)

        return recall

    def remembered_of_file(self, read: Callable[..., Any]) -> Callable[..., Any]:
        """The same reader of files with this memory."""

        def recall(path: Path, *given: Any) -> Any:
            if not path.is_file() or path.stat().st_size > LARGEST_FILE_BYTES:
                return read(path, *given)
            about = read.__qualname__, path.name, path.read_bytes(), *given
            return self.of(lambda: read(path, *given), about)

        return recall


class Matcher:
    """What `stereo.make_matcher` makes, with a memory."""

    def __init__(self, memory: Memory, settings: StereoSettings, num_disparities: int) -> None:
        self._memory = memory
        self._about = "matcher", settings.model_dump_json(), num_disparities
        self._matcher = _make_matcher(settings, num_disparities)

    def compute(self, left: Any, right: Any) -> Any:
        return self._memory.of(self._matcher.compute, self._about, left, right)


MEMORY = Memory(folder=shared_folder())
"""That of this process."""


@contextmanager
def worked_out_once(memory: Memory = MEMORY) -> Iterator[None]:
    """Within it, this process remembers; processes that it starts do not know."""

    def make_matcher(settings: StereoSettings, num_disparities: int) -> Matcher:
        return Matcher(memory, settings, num_disparities)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stereo, "make_matcher", make_matcher)
        for work, users in USES:
            for user in users:
                patch.setattr(user, work.__name__, memory.remembered(work))
        for read, users in READERS:
            for user in users:
                patch.setattr(user, read.__name__, memory.remembered_of_file(read))
        yield
