"""A command by one thread, by two, and by the two workers of a Dask cluster, interleaved:

    python -m benchmarks.cluster MAP.gpkg [ROUNDS [verify|align|LAYER]]

`verify --deep`, `align --dry-run`, or the export of a layer as GeoTIFF. What this program does
itself, in processor time, is what no further worker makes faster. Scheduler and workers are
programs of their own, which stay for all rounds. The ratios of wall times say something on an idle
machine with two cores only; the processor time says anywhere what the way costs. The load of the
machine is printed beside it. The first round compiles.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.peak import peak_mb

if TYPE_CHECKING:
    from distributed import Client

ROUNDS = 3


@contextmanager
def cluster(folder: Path) -> Iterator[str]:
    """A scheduler and two workers of one thread each; gives the scheduler's address."""
    told = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    near = ["--scheduler-file", str(told), "--no-dashboard"]
    commands = [
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", *near],
        [*dask, "worker", *near, "--nworkers", "2", "--nthreads", "1", "--local-directory",
         str(folder / "workers")],
    ]  # fmt: skip
    programs = [subprocess.Popen(one, stderr=subprocess.DEVNULL) for one in commands]
    try:
        from distributed import Client

        while not told.exists():
            if programs[0].poll() is not None:
                raise SystemExit("the scheduler of Dask did not start")
            time.sleep(0.1)
        with Client(scheduler_file=str(told)) as client:
            client.wait_for_workers(2, timeout=60)
            address = str(client.scheduler.address)
        yield address
    finally:
        for program in reversed(programs):
            program.terminate()
            program.wait(30)


def _workers_s(client: Client) -> float:
    """Processor time of all workers so far."""
    return sum(client.run(time.process_time).values())


def _do(what: str, path: Path, folder: Path, given: Mapping[str, Any]) -> None:
    from fieldgrid.export import Selection, export_map
    from fieldgrid.field import align_map
    from fieldgrid.maps import open_map

    with open_map(path) as universal:
        if what == "verify":
            assert universal.verify(deep=True, **given).sound
        elif what == "align":
            align_map(universal, **given)
        else:
            selection = Selection(layer=what, **given)
            export_map(universal, folder / "map.tif", selection, overwrite=True)


def main(path: Path, rounds: int, what: str) -> None:
    """Print the times of each way, and how they compare."""
    from distributed import Client

    with (
        tempfile.TemporaryDirectory() as folder,
        cluster(Path(folder)) as address,
        Client(address, set_as_default=False) as client,
    ):
        ways: dict[str, dict[str, Any]] = {
            "one thread": {"jobs": 1},
            "two threads": {"jobs": 2},
            "two workers of Dask": {"scheduler": address},
        }
        taken: dict[str, list[float]] = {name: [] for name in ways}
        busy: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(rounds):
            for name, given in ways.items():
                start, own_s, far_s = time.perf_counter(), time.process_time(), _workers_s(client)
                _do(what, path, Path(folder), given)
                taken[name].append(time.perf_counter() - start)
                own_s = time.process_time() - own_s
                cpu_s = own_s + _workers_s(client) - far_s
                busy[name].append(cpu_s)
                print(
                    f"{what}, {name}: {taken[name][-1]:.1f} s, processor {cpu_s:.1f} s, of this "
                    f"program {own_s:.1f} s; load {os.getloadavg()[0]:.1f}",
                    flush=True,
                )
    for unit, runs in (("clock", taken), ("processor time", busy)):
        one, two, dask = (float(np.median(found)) for found in runs.values())
        print(
            f"{unit}: one thread beside two {one / two:.2f} x (asked 1.7 by the clock), beside two "
            f"workers of Dask {one / dask:.2f} x; these beside two threads "
            f"{100 * (dask / two - 1):+.0f} % (asked +10 %)"
        )
    print(f"peak memory of this program {peak_mb():.0f} MB")


if __name__ == "__main__":
    name, *more = sys.argv[1:]
    main(Path(name), int(more[0]) if more else ROUNDS, more[1] if more[1:] else "verify")
