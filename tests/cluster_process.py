"""The process of `tests.clusters`: the address of its scheduler, then, for each line that it reads,
the processes of its workers when all are there."""

from __future__ import annotations

import multiprocessing
import sys
from multiprocessing import forkserver

WORKERS = 2


def main() -> None:
    # A worker is a copy of a process that has imported all before, also in place of a killed one.
    multiprocessing.get_context("forkserver").set_forkserver_preload(
        ["distributed", "fieldgrid.align", "fieldgrid.farm", "fieldgrid.rows"]
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
        for _ in sys.stdin:
            local.wait_for_workers(WORKERS)
            print(*(nanny.pid for nanny in local.workers.values()), flush=True)


if __name__ == "__main__":
    main()
