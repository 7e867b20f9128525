"""A Dask cluster in a process of its own, which a process of the tests starts once.

No threads of a scheduler are in a process that tests fork, and starting workers, which import
everything, took more than most tests of them.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from fieldgrid.core.workers import cluster

if TYPE_CHECKING:
    from distributed import Client


class Cluster:
    """Two workers of one thread, processes of this machine, started again when they die."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.scheduler_address = self._line()
        self.pids: list[int] = []
        self._killed: list[int] = []

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the cluster has ended"
        return line.strip()

    def complete(self) -> None:
        """Waits until all workers are there, others in place of those that were killed."""
        assert self._process.stdin is not None
        print(*self._killed, file=self._process.stdin, flush=True)
        self.pids, self._killed = [int(one) for one in self._line().split()], []

    def kill(self) -> int:
        """Kills a worker, once after each `complete`; its process."""
        assert not self._killed
        os.kill(self.pids[0], signal.SIGKILL)
        self._killed.append(self.pids[0])
        return self.pids[0]

    def kill_one(self, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
        """Kills a worker when the first task has ended; the results of the tasks that end."""
        usual, ended = cluster.result_of, list[Any]()

        def kill_one(future: Future[Any], client: Client) -> Any:
            result = usual(future, client)
            if not ended:
                self.kill()
            ended.append(result)
            return result

        monkeypatch.setattr(cluster, "result_of", kill_one)
        return ended


@contextmanager
def started() -> Iterator[Cluster]:
    with subprocess.Popen(
        [sys.executable, "-m", "tests.cluster_process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[1],
    ) as process:  # which ends at the end of its input
        yield Cluster(process)
