"""The first run: another process compiles what frames need."""

import os
import subprocess
from pathlib import Path

import pytest

from fieldgrid.cli import warming
from fieldgrid.kernel import Kernel
from fieldgrid.workers import order

_SAYS_WHO = "import os, signal; open({path!r}, 'w').write(str(os.getpid())); signal.pause()"


def _given(monkeypatch: pytest.MonkeyPatch, *, kept: bool, cores: int) -> None:
    monkeypatch.setattr(Kernel, "is_kept", lambda _: kept)
    monkeypatch.setattr(order, "cores", lambda: cores)


def test_another_process_compiles_where_nothing_is_kept_and_is_gone_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe = tmp_path / "who"
    os.mkfifo(pipe)
    monkeypatch.setattr(warming, "_FRAMES", _SAYS_WHO.format(path=str(pipe)))
    _given(monkeypatch, kept=False, cores=2)
    with warming.frames_ahead():
        number = int(pipe.read_text())  # waits for the process
        os.kill(number, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


@pytest.mark.parametrize(
    ("kept", "cores", "here"), [(True, 2, True), (False, 1, True), (False, 2, False)]
)
def test_none_is_started_where_it_would_not_help(
    kept: bool, cores: int, here: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        pytest.fail("a process was started")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    _given(monkeypatch, kept=kept, cores=cores)
    with warming.frames_ahead(here=here):
        pass


def test_what_is_compiled_is_what_frames_need() -> None:
    from fieldgrid.binning import bin_pixels
    from fieldgrid.edges import raise_to_steps
    from fieldgrid.ground import collect_heights, follow_ground
    from fieldgrid.odometry.rigid import _refine, _search

    warming.compile_frames()
    for one in (bin_pixels, collect_heights, follow_ground, raise_to_steps, _search, _refine):
        assert one.compiled().signatures, one
