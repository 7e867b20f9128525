"""Who does the work of a command: threads of this process, or the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fieldgrid.core.workers.order import Runner, Threads

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def runner(jobs: int | None, scheduler: str | Client | None = None) -> Iterator[Runner]:
    """The workers of the Dask scheduler at an address, or of a client, until the end of the block;
    threads without one. ClusterError when no scheduler answers."""
    if scheduler is None:
        yield Threads(jobs)
        return
    from fieldgrid.core.workers.cluster import OnCluster
    from fieldgrid.core.workers.connecting import connected

    with connected(scheduler) as client:
        yield OnCluster(client)
