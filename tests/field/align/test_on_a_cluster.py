"""Aligning on the workers of a cluster: the transforms of one process, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.field import align_map
from fieldgrid.maps import Transform, open_map
from tests.clusters import Cluster
from tests.field.align.field import SPACING_M, Field, write_field

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


def test_a_cluster_of_which_a_worker_is_killed_finds_the_transforms_of_one_process(
    tmp_path: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    field = Field()
    path = write_field(
        tmp_path / "map.gpkg",
        {
            "june": field.drive([0.0], sigma_m=0.02),
            "july": field.drive([SPACING_M], by=Transform(0.9, -0.7), seed=7, start_s=1e5),
        },
    )
    ended = cluster.kill_one(monkeypatch)
    with open_map(path) as universal:
        here = align_map(universal, jobs=1)
        assert not ended
        there = align_map(universal, scheduler=cluster.scheduler_address)
        command = ["align", str(path), "--dry-run", "--scheduler", cluster.scheduler_address]
        result = CliRunner().invoke(app, command)
    assert here.transforms == there.transforms
    assert repr(here) == repr(there)
    assert ended
    # Comparing as wholes, and two rounds of comparing finely.
    assert result.exit_code == 0, result.output
    both = CliRunner().invoke(app, [*command, "--jobs", "2"])
    assert both.exit_code == 2
    assert "the workers of the --scheduler do the work" in both.output
