"""Work on items: the same results in the same order by threads and on a cluster."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from fieldgrid.core import ClusterError, MapError, Runner, Threads, runner
from fieldgrid.core.workers.cluster import OnCluster
from tests.core.workers.doing import Arriving, Squaring, arrived

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


@pytest.fixture(scope="module")
def inside() -> Iterator[distributed.Client]:
    """A worker that is a thread of this process."""
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0"
        ) as made,
        distributed.Client(made, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture(params=["threads", "cluster"])
def either(request: pytest.FixtureRequest, inside: distributed.Client) -> Iterator[Runner]:
    if request.param == "threads":
        yield Threads(2)
        return
    yield OnCluster(inside)


@pytest.mark.parametrize("batch", [1, 4])
def test_results_come_in_the_order_of_the_items(either: Runner, batch: int) -> None:
    found = list(either.in_order(Squaring(), iter(range(30)), batch))
    assert found == [number * number for number in range(30)]
    assert list(either.in_order(Squaring(), [], batch)) == []


def test_where_results_are_large_few_are_under_way(inside: distributed.Client) -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for number in range(9):
            taken.append(number)
            yield number

    results = OnCluster(inside).in_order(Squaring(), items(), most=2)
    for number in range(9):
        assert next(results) == number * number
        assert len(taken) <= number + 2
    assert list(results) == []


@pytest.mark.parametrize("batch", [1, 4])
def test_what_work_refuses_is_raised_after_what_came_before(either: Runner, batch: int) -> None:
    results = either.in_order(Squaring(refused=7), range(30), batch)
    found = list(islice(results, 7))
    with pytest.raises(MapError, match=r"7 is damaged\."):
        next(results)
    assert found == [number * number for number in range(7)]
    assert next(iter(either.in_order(Squaring(), [3]))) == 9  # it goes on to serve


def test_a_worker_that_cannot_do_it_ends_the_work(inside: distributed.Client) -> None:
    with pytest.raises(ClusterError, match="25 is not on this worker"):
        list(OnCluster(inside).in_order(Squaring(unable=25), range(30)))


def test_work_that_cannot_be_sent_is_refused(inside: distributed.Client) -> None:
    lock = threading.Lock()
    with pytest.raises(ClusterError, match=r"cannot be done on a cluster .*leave out --scheduler"):
        list(OnCluster(inside).in_order(lambda number: lock, range(3)))


def test_work_arrives_once_for_each_time_it_is_asked_for(inside: distributed.Client) -> None:
    """What it opens as it arrives are the files of that time."""
    for _ in range(2):
        arrived.clear()
        assert list(OnCluster(inside).in_order(Arriving(), range(30))) == list(range(30))
        assert 1 <= len(arrived) <= 2  # one or both threads of the worker


def test_who_stops_asking_leaves_nothing_behind(inside: distributed.Client) -> None:
    found = OnCluster(inside)
    results = found.in_order(Squaring(), range(1000))
    assert next(results) == 0
    results.close()  # type: ignore[attr-defined]
    assert list(found.in_order(Squaring(), range(3))) == [0, 1, 4]
    left = [key for key, state in inside.futures.items() if state.status == "pending"]
    assert [key for key in left if "do_batch" in key] == []


def test_a_worker_that_is_killed_costs_its_task_and_one_that_kills_all_is_told(
    tmp_path: Path,
) -> None:
    once, always = tmp_path / "once", tmp_path / "always"
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
        runner(None, local.scheduler_address) as found,
    ):
        work = Squaring(deadly=5, marks=once)
        assert list(found.in_order(work, range(9))) == [number**2 for number in range(9)]
        assert once.read_text() == "x"
        local.scheduler.allowed_failures = 0
        with pytest.raises(ClusterError, match="has ended every Dask worker that did it; give"):
            list(found.in_order(Squaring(deadly=1, times=9, marks=always), range(3)))
    assert always.read_text() == "x"
