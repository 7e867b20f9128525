"""Aligning on the workers of a cluster: the answer of one process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.align import align_map
from fieldgrid.mapfile import Transform, open_map
from tests.align.field import SPACING_M, Field, write_field

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    field = Field()
    by = Transform(0.9, -0.7)
    drives = {
        "june": field.drive([0.0], sigma_m=0.02),
        "july": field.drive([0.0, SPACING_M], by=by, seed=7, start_s=1e5),
    }
    return write_field(tmp_path_factory.mktemp("map") / "map.gpkg", drives)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A worker that is a thread of this process; what it does travels all the same."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0"
    ) as made:
        yield made.scheduler_address


def test_a_cluster_aligns_as_one_process_does(path: Path, address: str) -> None:
    with open_map(path) as universal:
        here = align_map(universal, rounds=1, jobs=2)
        there = align_map(universal, rounds=1, scheduler=address)
    assert here.transforms
    assert here.transforms == there.transforms
    for one, other in zip(here.pairs, there.pairs, strict=True):
        assert (one.a, one.b, one.matches) == (other.a, other.b, other.matches)
        assert one.sigma_m == other.sigma_m
        assert np.array_equal(one.after_m, other.after_m)
