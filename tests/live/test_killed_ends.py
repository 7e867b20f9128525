"""An end of a session that is killed at any of its steps, and started again: nothing is lost, no
drive is in the map twice, and the map is that of a build."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

from fieldgrid.core import BuildSettings, ConfigError, Draft, MapExistsError
from fieldgrid.live import finish, finish_session, live_folder, replay
from fieldgrid.maps import open_map
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.writing import session
from fieldgrid.maps.writing.placing import FoldedTiles
from fieldgrid.pipeline import Store, build_map
from fieldgrid.pipeline.staging import kept_frames
from fieldgrid.recordings import open_recording
from tests.live.making import begin
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")

KILLED = 7


def dies(at: int = 1, *, after: bool = False) -> Callable[[Any], Callable[..., Any]]:
    """Makes a function end its process at a call, before or after what it does."""

    def dying(function: Any) -> Callable[..., Any]:
        calls = [0]

        def called(*arguments: Any, **options: Any) -> Any:
            calls[0] += 1
            if calls[0] == at and not after:
                os._exit(KILLED)
            result = function(*arguments, **options)
            if calls[0] == at:
                os._exit(KILLED)
            return result

        return called

    return dying


STEPS: dict[str, tuple[Any, str, Any]] = {
    "the journal was read": (finish, "NewSession", dies()),
    "grids are made again": (Store, "keep", dies(3)),
    "before frames are placed": (FoldedTiles, "__init__", dies()),
    "frames are placed": (FoldedTiles, "cells", dies(2)),
    "before the commit": (session, "sum_up", dies(after=True)),
    "after the commit": (Pyramid, "settle", dies()),
    "before the map is published": (Draft, "publish", dies()),
    "after the map was published": (Draft, "publish", dies(after=True)),
    "before what was kept is removed": (kept_frames, "drop_journal", dies()),
}
IS_IN_THE_MAP = list(STEPS)[list(STEPS).index("after the map was published") :]


def killed(out: Path, step: str) -> None:
    """An end in a process that dies at a step."""
    holder, name, dying = STEPS[step]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # threads of OpenCV do not live on in a fork
    child = os.fork()
    if child == 0:
        try:
            setattr(holder, name, dying(getattr(holder, name)))
            finish_session(out)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    cv2.setNumThreads(threads)
    assert os.waitstatus_to_exitcode(status) == KILLED, step


@pytest.fixture(scope="module")
def kept(leaning_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a session that has ended without its map."""
    out = tmp_path_factory.mktemp("kept") / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    return live_folder(out)


@pytest.mark.parametrize("step", STEPS)
def test_an_end_that_is_killed_is_completed_by_the_next(
    step: str, kept: Path, leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    shutil.copytree(kept, live_folder(out))
    killed(out, step)
    assert out.exists() is (step in IS_IN_THE_MAP)
    if step in IS_IN_THE_MAP:
        assert content(out) == content(built_level)
        refused = pytest.raises(MapExistsError, match=r"-o .* --finish completes it")
        with open_recording(leaning_drive) as recording, refused:
            begin(recording, out)
    finish_session(out)
    assert content(out) == content(built_level)
    assert not live_folder(out).exists()
    assert [path.name for path in tmp_path.iterdir()] == ["m.gpkg"]


@pytest.mark.parametrize("step", ["before the commit", "after the commit"])
def test_an_end_that_is_killed_adds_its_drive_once(
    step: str, kept: Path, short_drive: Path, leaning_drive: Path, built: Path, tmp_path: Path
) -> None:
    """Into a map that has another one."""
    both, out = tmp_path / "both.gpkg", tmp_path / "m.gpkg"
    other = shutil.copytree(short_drive, tmp_path / "other", symlinks=True)
    for path in (both, out):
        build_map([other], path, BuildSettings())
    build_map([leaning_drive], both, BuildSettings(), append=True)
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out, append=True)
        replay(live, recording, rate=None)
        live.stop()
        killed(out, step)
        if step == "after the commit":
            with pytest.raises(ConfigError, match="--finish completes it"):
                begin(recording, out, append=True)
    finish_session(out)
    assert content(out) == content(both)  # also the coarser tiles, which a commit leaves for later
    assert not live_folder(out).exists()
    with open_map(out) as universal:
        assert [one.name for one in universal.sessions()] == ["other", "drive"]
        assert universal.verify(deep=True).sound
