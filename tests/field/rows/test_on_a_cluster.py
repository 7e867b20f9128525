"""Finding rows in a map that the workers of a cluster read: the rows of one process."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.field import find_rows
from fieldgrid.maps.views import blocks as blocks_module
from tests.clusters import Cluster
from tests.field.rows.fields import straight, view_of, write_map

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


def test_a_cluster_of_which_a_worker_is_killed_finds_the_rows_of_one_process(
    tmp_path: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = view_of(straight(4, 30.0, 2.5, 25.0), missing=[(1, 10.0, 13.0)])
    path = write_map(tmp_path / "field.gpkg", rows)
    monkeypatch.setattr(blocks_module, "_ROWS", 256)
    monkeypatch.setattr(blocks_module, "_COLUMNS", 256)
    ended = cluster.kill_one(monkeypatch)
    here = find_rows(path, jobs=1)
    assert not ended
    there = find_rows(path, scheduler=cluster.scheduler_address)
    command = ["rows", str(path), "--scheduler", cluster.scheduler_address]
    result = CliRunner().invoke(app, command)
    assert ended
    assert len(here.rows) == 4
    assert pickle.dumps(there) == pickle.dumps(here)
    assert result.exit_code == 0, result.output
    assert result.stdout == CliRunner().invoke(app, ["rows", str(path), "--jobs", "2"]).stdout
    both = CliRunner().invoke(app, [*command, "--jobs", "2"])
    assert both.exit_code == 2
    assert "the workers of the --scheduler do the work" in both.output
