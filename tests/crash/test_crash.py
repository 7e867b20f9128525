"""A few of the deaths and failures of `make crash`, which has hundreds."""

from __future__ import annotations

import multiprocessing
import os
import re
import shutil
from itertools import islice
from multiprocessing.synchronize import Barrier
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.maps import open_map
from tests.crash.damages import Trial, in_cells, run_random
from tests.crash.failures import run_in_child
from tests.crash.kills import run_kills
from tests.crash.live import run_kills as kill_live
from tests.crash.operations import make
from tests.crash.writers import run_writers
from tests.maps.file.content import ANONYMOUS, content
from tests.maps.file.maps import CELL_M, DATUM, drive, write_map, write_session


@pytest.mark.parametrize("kills", [4, pytest.param(12, marks=pytest.mark.long)])
def test_a_writer_killed_at_random_loses_nothing_that_it_acknowledged(
    tmp_path: Path, kills: int
) -> None:
    hit = run_kills(kills, seed=5, folder=tmp_path)
    assert hit.total() == kills


@pytest.mark.long
def test_a_live_session_killed_at_random_loses_one_frame_at_most(tmp_path: Path) -> None:
    hit = kill_live(6, seed=5, folder=tmp_path)
    assert hit.total() >= 6


@pytest.mark.long
def test_no_call_that_fails_or_is_the_last_tears_a_map() -> None:
    if shutil.which("cc") is None and shutil.which("gcc") is None:
        pytest.skip("there is no C compiler (cc) to make calls fail with")
    done = run_in_child("tests.crash.failures", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "every map verified" in done.stdout
    refused = re.search(r"full disk: refused (\d+)", done.stdout)
    assert refused
    assert int(refused[1]) >= 6


def _append(path: Path, name: str, start: Barrier) -> None:
    start.wait()
    for k in range(3):
        with open_map(path, datum=DATUM, cell_m=CELL_M) as universal:
            write_session(universal, f"{name}{k}", drive(4, heading_deg=ord(name) + 10.0 * k))
    os._exit(0)


def test_four_writers_at_once_lose_nothing_and_readers_see_whole_states(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    make(path)
    fork = multiprocessing.get_context("fork")
    start = fork.Barrier(4)
    writers = [fork.Process(target=_append, args=(path, name, start)) for name in "abcd"]
    for writer in writers:
        writer.start()
    seen = 0
    while any(writer.is_alive() for writer in writers):
        with open_map(path) as universal:
            names = {info.name for info in universal.sessions()}
            stored = universal.read(universal.bounds)
            # Between the two more sessions may come: each by itself is one state.
            now = {info.name for info in universal.sessions()}
            if names == now:
                anew = universal.read(stored.bounds, sessions=sorted(names))
                if {info.name for info in universal.sessions()} == names:
                    np.testing.assert_array_equal(stored.density, anew.density)
                    seen += 1
    assert [writer.exitcode for writer in writers] == [0] * 4
    assert seen > 0
    frames = [drive(3, heading_deg=30.0)] + [
        drive(4, heading_deg=ord(name) + 10.0 * k) for name in "abcd" for k in range(3)
    ]
    once = write_map(tmp_path / "once.gpkg", frames)
    kinds = [kind for kind in ANONYMOUS if kind != "extents"]
    assert content(path, *kinds) == content(once, *kinds)
    with open_map(path) as universal:
        assert universal.verify(deep=True).sound
        assert len(universal.sessions()) == 13


@pytest.mark.parametrize("damages", [6, pytest.param(20, marks=pytest.mark.long)])
def test_damaged_maps_are_found_or_say_what_they_said(tmp_path: Path, damages: int) -> None:
    trial = Trial(tmp_path)
    total = run_random(trial, damages, seed=4)
    assert trial.failures == []
    assert total.total() >= 0.8 * damages  # one may hit what is zero already
    cells = islice(in_cells(trial.whole), 0, 10_000, 40_000 // damages - 1)
    assert all(trial.try_one(damaged) != "NOT AS ASKED" for damaged in cells)


@pytest.mark.long
def test_power_cuts_leave_old_or_new() -> None:
    done = run_in_child("tests.crash.power", "130", "5")
    assert "nothing acknowledged was lost" in done.stdout, done.stderr


@pytest.mark.long
def test_a_map_that_is_not_synced_does_not_pass_the_power_cuts() -> None:
    done = run_in_child("tests.crash.power", "400", "5", "careless")
    assert "AssertionError" in done.stderr or "Error" in done.stderr


@pytest.mark.long
def test_exports_that_are_killed_leave_old_or_new() -> None:
    done = run_in_child("tests.crash.exports", "4", "5")
    assert "exports of" in done.stdout, done.stderr


@pytest.mark.long
def test_many_writers_lose_nothing(tmp_path: Path) -> None:
    assert run_writers(5, 4, tmp_path) > 0
