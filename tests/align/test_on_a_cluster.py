"""Aligning on the workers of a cluster: the transforms of one process, bit for bit."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fieldgrid.align import align_map
from fieldgrid.cli import app
from fieldgrid.mapfile import Transform, open_map
from fieldgrid.workers.cluster import Ended
from fieldgrid.workers.remote import OnCluster
from tests.align.field import SPACING_M, Field, write_field

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


def test_a_cluster_of_which_a_worker_is_killed_finds_the_transforms_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    field = Field()
    path = write_field(
        tmp_path / "map.gpkg",
        {
            "june": field.drive([0.0], sigma_m=0.02),
            "july": field.drive([SPACING_M], by=Transform(0.9, -0.7), seed=7, start_s=1e5),
        },
    )
    told, killed, ended = OnCluster._told, list[int](), list[int]()

    def kill_one(self: OnCluster, group: int, what: Any) -> None:
        ended.append(group)
        if not killed and isinstance(what, Ended):
            killed.append(next(iter(local.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)
        told(self, group, what)

    monkeypatch.setattr(OnCluster, "_told", kill_one)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
        open_map(path) as universal,
    ):
        here = align_map(universal, jobs=1)
        assert not ended
        there = align_map(universal, scheduler=local.scheduler_address)
        command = ["align", str(path), "--dry-run", "--scheduler", local.scheduler_address]
        result = CliRunner().invoke(app, command)
    assert here.transforms == there.transforms
    assert repr(here) == repr(there)
    assert killed
    assert len(set(ended)) > 2  # comparing as wholes, and two rounds of comparing finely
    assert result.exit_code == 0, result.output
    both = CliRunner().invoke(app, [*command, "--jobs", "2"])
    assert both.exit_code == 2
    assert "the workers of the --scheduler do the work" in both.output
