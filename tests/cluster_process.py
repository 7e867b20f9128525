"""The process of `tests.clusters`: the address of its scheduler, then, for each line of processes
that were killed, those of its workers when all are there."""

from __future__ import annotations

import multiprocessing
import sys
import time
from multiprocessing import forkserver
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from distributed import LocalCluster

WORKERS = 2


def main() -> None:
    # A worker is a copy of a process that has imported all before, also in place of a killed one.
    multiprocessing.get_context("forkserver").set_forkserver_preload(
        [
            "distributed",
            "fieldgrid.field.align.alignment",
            "fieldgrid.maps.farm.farm",
            "fieldgrid.field.rows.find",
        ]
    )
    forkserver.ensure_running()
    import dask
    import distributed

    dask.config.set(
        {
            "distributed.worker.multiprocessing-method": "forkserver",
            # It lasts as long as the tests, mostly idle: no watching of itself many times a second.
            "distributed.worker.profile.enabled": False,
            "distributed.admin.tick.interval": "1s",
            "distributed.admin.system-monitor.interval": "10s",
        }
    )
    with distributed.LocalCluster(
        n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as local:
        print(local.scheduler_address, flush=True)
        for line in sys.stdin:
            print(*_complete(local, set(map(int, line.split()))), flush=True)


def _complete(local: LocalCluster, killed: set[int]) -> set[int]:
    """The processes of the workers when all that the scheduler knows are living. Neither it nor the
    worker's nanny has noticed at once that one was killed."""
    while True:
        local.wait_for_workers(WORKERS)
        known = local.scheduler_info["workers"]
        nannies = local.workers.values()
        pids = {nanny.pid for nanny in nannies if nanny.worker_address in known} - killed
        if len(pids) == WORKERS and None not in pids:
            return pids
        time.sleep(0.05)


if __name__ == "__main__":
    main()
