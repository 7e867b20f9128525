"""Reading a map, and exporting it, on the workers of a cluster: the bits of one process."""

from __future__ import annotations

import pickle
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.core import ClusterError, ConfigError, Threads
from fieldgrid.export import Selection, export_map
from fieldgrid.maps import Farm, Mark, Readable, open_map
from fieldgrid.maps.views import (
    blocks as blocks_module,
    content as content_module,
    read as reading_module,
)
from fieldgrid.maps.writing import sharing
from tests.clusters import Cluster
from tests.maps.file.maps import drive, track, write_map

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]

LAYERS = ("count", "max", "traversability")


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two maps side by side."""
    folder = tmp_path_factory.mktemp("farm")
    write_map(
        folder / "a.gpkg", [drive(6, step_m=5.0), drive(5, heading_deg=-70.0)], trajectory=track(9)
    )
    write_map(folder / "b.gpkg", [drive(4, heading_deg=40.0)], trajectory=track(5))
    return folder


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks_module, "_ROWS", 256)
    monkeypatch.setattr(blocks_module, "_COLUMNS", 256)


def everything(source: Readable, scheduler: Any = None, **asked: Any) -> list[tuple[Any, ...]]:
    """All blocks of a view and of its overviews, in their order."""
    found: list[tuple[Any, ...]] = []
    with source.read_blocks(layers=LAYERS, scheduler=scheduler, **asked) as blocks:
        found += [
            (view.window, view.marks, *arrays(view.density, view.observed, view.layers))
            for view in blocks.views
        ]
    part = Selection(scheduler=scheduler, beside=LAYERS, **asked)
    with part.blocks(source, smallest_px=64) as blocks:
        assert len(blocks.levels) > 1
        found += [
            (one.lattice, one.window, *arrays(one.density, one.observed, one.layers))
            for one in blocks.views
        ]
    return found


def arrays(*held: Any) -> list[Any]:
    density, observed, layers = held
    return [
        (name, values.dtype.str, values.tobytes())
        for name, values in {"density": density, "observed": observed, **layers}.items()
    ]


@pytest.mark.parametrize("cell_m", [None, 0.1, 0.12])
def test_a_cluster_reads_what_one_process_reads(
    farm: Path, cell_m: float | None, cluster: Cluster
) -> None:
    with open_map(farm / "a.gpkg") as universal, Farm(farm) as both:
        for source in (universal, both):
            here = everything(source, jobs=1, cell_m=cell_m)
            assert len(here) > 4
            assert everything(source, cluster.scheduler_address, cell_m=cell_m) == here


def test_a_worker_that_is_killed_costs_no_block(
    farm: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_map(farm / "a.gpkg") as universal:
        here = everything(universal)
        ended = cluster.kill_one(monkeypatch)
        assert everything(universal, cluster.scheduler_address) == here
    assert ended


def test_marks_are_those_of_the_map(farm: Path, tmp_path: Path, cluster: Cluster) -> None:
    path = tmp_path / "marked.gpkg"
    path.write_bytes((farm / "a.gpkg").read_bytes())
    drawn = ["--kind", "keepout", "--polygon", "0,0;8,0;8,8"]
    result = CliRunner().invoke(app, ["mark", str(path), *drawn])
    assert result.exit_code == 0, result.output
    with open_map(path) as universal:
        here = everything(universal)
        assert any(isinstance(mark, Mark) for block in here for mark in block[1])
        assert everything(universal, cluster.scheduler_address) == here


def test_an_export_by_the_command_has_the_same_bytes(
    farm: Path, tmp_path: Path, cluster: Cluster
) -> None:
    for name, more in (
        ("here", ["--jobs", "1"]),
        ("there", ["--scheduler", cluster.scheduler_address]),
    ):
        result = CliRunner().invoke(
            app,
            [
                "export",
                str(farm / "a.gpkg"),
                str(tmp_path / f"{name}.tif"),
                *more,
                "--layer",
                "max",
            ],
        )
        assert result.exit_code == 0, result.output
    assert (tmp_path / "here.tif").read_bytes() == (tmp_path / "there.tif").read_bytes()


def test_as_many_threads_read_as_are_asked_for(farm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int | None] = []

    class Counted(Threads):
        def __init__(self, jobs: int | None = None) -> None:
            asked.append(jobs)
            super().__init__(jobs)

    for module in (content_module, reading_module):
        monkeypatch.setattr(module, "Threads", Counted)
    with open_map(farm / "a.gpkg") as universal, Farm(farm) as both:
        for source in (universal, both):
            for layers in ((), ("count",)):
                source.read(layers=layers, jobs=3)
                with source.read_blocks(layers=layers, jobs=3) as blocks:
                    assert list(blocks.views)
    assert len(asked) > 8
    assert set(asked) == {3}


# --- what cannot be


def test_a_format_that_needs_all_at_once_is_refused_on_a_cluster(
    farm: Path, tmp_path: Path
) -> None:
    selection = Selection(scheduler="tcp://127.0.0.1:1")
    with (
        open_map(farm / "a.gpkg") as universal,
        pytest.raises(ConfigError, match="which one process reads; leave out --scheduler, or"),
    ):
        export_map(universal, tmp_path / "map.yaml", selection)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("what", ["map", "farm"])
def test_a_worker_that_lacks_what_is_asked_for_is_told(
    what: str, farm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in farm.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with open_map(tmp_path / "a.gpkg") as universal, Farm(tmp_path) as both:
        source = universal if what == "map" else both
        with source.content() as content, source.read_blocks() as blocks:
            request = blocks_module.Request(
                blocks.lattice, blocks.window, universal.transfer, layers=("max",)
            )
        packed = pickle.dumps(partial(blocks_module._block_views, content, request))
    with monkeypatch.context() as patched:
        patched.setattr(sharing, "LAYERS", {})
        with pytest.raises(ClusterError, match="does not know the layer 'max'; start it with"):
            pickle.loads(packed)(request.window)
    (tmp_path / "a.gpkg").unlink()
    with pytest.raises(ClusterError, match=r"a\.gpkg does not exist on the worker .*; mount or"):
        pickle.loads(packed)
