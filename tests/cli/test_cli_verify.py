"""`fieldgrid verify` on a cluster."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from fieldgrid.core.workers import connecting
from tests.cli.conftest import Run
from tests.maps.file.maps import drive, write_map

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


@pytest.fixture
def map_(tmp_path: Path) -> Path:
    return write_map(tmp_path / "map.gpkg", [drive(3)])


def test_the_workers_verify_a_map(fieldgrid: Run, map_: Path) -> None:
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as made:
        said = fieldgrid("verify", map_, "--deep", "--scheduler", made.scheduler_address)
    assert said.output() == fieldgrid("verify", map_, "--deep").output()


def test_a_scheduler_that_is_not_there(
    fieldgrid: Run, map_: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "CONNECT_S", 0.2)
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        said = fieldgrid("verify", map_, "--deep", "--scheduler", address)
    assert f"No Dask scheduler answers at {address} (" in said.sentence()
    assert "start one there with: dask scheduler, or check address and firewall" in said.err


def test_what_a_scheduler_excludes(fieldgrid: Run, map_: Path) -> None:
    said = fieldgrid("verify", map_, "--scheduler", "tcp://a:1")
    assert "it is for --deep; add that" in said.usage()
    said = fieldgrid("verify", map_, "--deep", "--jobs", 2, "--scheduler", "tcp://a:1")
    assert "the workers of the --scheduler do the work" in said.usage()
