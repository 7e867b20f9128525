"""The first run: another process compiles what frames and the map need."""

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
    monkeypatch.setattr(warming, "_AHEAD", _SAYS_WHO.format(path=str(pipe)))
    _given(monkeypatch, kept=False, cores=2)
    with warming.half_ahead():
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
    with warming.half_ahead(here=here):
        pass


def test_a_build_goes_on_where_there_is_no_place_for_temporary_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile.TemporaryDirectory", refuse)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a process was started"))
    _given(monkeypatch, kept=False, cores=2)
    with warming.half_ahead():
        pass


def test_what_is_compiled_is_what_frames_and_the_map_need(tmp_path: Path) -> None:
    from fieldgrid.binning import bin_pixels
    from fieldgrid.edges import raise_to_steps
    from fieldgrid.ground import collect_heights, follow_ground
    from fieldgrid.layers.ground import add_terrain
    from fieldgrid.layers.moved import add_looks
    from fieldgrid.layers.robust import enter, read_bins, settle
    from fieldgrid.layers.window import gather
    from fieldgrid.mapfile.packing import differences, join, split
    from fieldgrid.odometry.rigid import _refine, _search
    from fieldgrid.transfer import locate

    warming.compile_ahead(str(tmp_path))
    frame = bin_pixels, collect_heights, follow_ground, raise_to_steps, _search, _refine
    layers = locate, add_terrain, add_looks, enter, settle, read_bins, gather
    for one in (*frame, *layers, differences, split, join):
        assert one.compiled().signatures, one
    assert list(tmp_path.iterdir()) == [tmp_path / "map.gpkg"]


def test_the_folder_of_the_other_process_is_gone_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    pipe = tmp_path / "where"
    os.mkfifo(pipe)
    writes = f"import sys; open(sys.argv[1] + '/map', 'w'); open({str(pipe)!r}, 'w').write('there')"
    monkeypatch.setattr(warming, "_AHEAD", writes)
    _given(monkeypatch, kept=False, cores=2)
    with warming.half_ahead():
        assert pipe.read_text() == "there"
        assert len(list(tmp_path.glob("fieldgrid-*/map"))) == 1
    assert list(tmp_path.iterdir()) == [pipe]
