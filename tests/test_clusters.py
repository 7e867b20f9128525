"""What tests of a killed worker rest on: each finds all workers alive, and kills one of them."""

from __future__ import annotations

from tests.clusters import Cluster


def test_a_killed_worker_is_no_worker_of_the_next_test(cluster: Cluster) -> None:
    for _ in range(2):
        killed = cluster.kill()
        cluster.complete()
        assert len(cluster.pids) == 2
        assert killed not in cluster.pids
