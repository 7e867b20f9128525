"""The first run: another process compiles what frames need."""

import os
import time
from pathlib import Path

import pytest

from fieldgrid.cli import warming
from fieldgrid.kernel import Kernel
from fieldgrid.mapfile import workers

_SAYS_WHO = "import os, pathlib, sys, time; pathlib.Path({path!r}).write_text(str(os.getpid()))"


def _started(kept: bool, cores: int, path: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether a process is started; it must have gone when the block ends."""
    code = _SAYS_WHO.format(path=str(path)) + "; time.sleep(600)"
    monkeypatch.setattr(warming, "_FRAMES", code)
    monkeypatch.setattr(Kernel, "is_kept", lambda _: kept)
    monkeypatch.setattr(workers, "cores", lambda: cores)
    with warming.frames_ahead():
        if kept or cores == 1:
            return path.exists()
        until = time.monotonic() + 60.0
        while not (path.exists() and path.read_text()):
            assert time.monotonic() < until, "no process was started"
            os.sched_yield()
    with pytest.raises(ProcessLookupError):
        os.kill(int(path.read_text()), 0)
    return True


def test_another_process_compiles_where_nothing_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _started(False, 2, tmp_path / "who", monkeypatch)


@pytest.mark.parametrize(("kept", "cores"), [(True, 2), (False, 1)])
def test_none_is_started_where_it_would_not_help(
    kept: bool, cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not _started(kept, cores, tmp_path / "who", monkeypatch)


def test_what_is_compiled_is_what_frames_need() -> None:
    from fieldgrid.binning import bin_pixels
    from fieldgrid.ground import collect_heights, follow_ground, raise_to_steps
    from fieldgrid.odometry.rigid import _refine, _search

    warming.compile_frames()
    for one in (bin_pixels, collect_heights, follow_ground, raise_to_steps, _search, _refine):
        assert one.compiled().signatures, one
