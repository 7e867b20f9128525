"""Work on many items by threads, with the results in their order.

By threads because what is heavy runs outside the interpreter's lock.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Runner(Protocol):
    """Who does work on items.

    On a cluster `work` is pickled, and so are items and results: what it needs of a file it is to
    open itself where it arrives. `here` is how many threads of this process may work beside that.
    """

    here: int

    def in_order(
        self,
        work: Callable[[_Item], _Result],
        items: Iterable[_Item],
        batch: int = 1,
        most: int | None = None,
    ) -> Iterator[_Result]:
        """The results of work on items, in their order. `batch` of them travel together; at most
        `most` such batches are under way or wait here, where results are large. Nothing works on
        once nobody holds the iterator."""


class Threads:
    """`jobs` threads of this process, one a core when not given (a :class:`Runner`)."""

    def __init__(self, jobs: int | None = None) -> None:
        self.here = cores() if jobs is None else jobs

    def in_order(
        self,
        work: Callable[[_Item], _Result],
        items: Iterable[_Item],
        batch: int = 1,
        most: int | None = None,
    ) -> Generator[_Result, None, None]:
        """The results of work on items, in their order, few more than the threads at a time. One
        thread works while the caller does only where results are large, and so `most` is given."""
        if self.here < 2 and most is None:
            return (work(item) for item in items)
        return by_threads(work, items, self.here, self.here)


def by_threads(
    work: Callable[[_Item], _Result], items: Iterable[_Item], threads: int, ahead: int
) -> Generator[_Result, None, None]:
    """The results of work on items, in their order; at most `ahead` of them are under way or wait
    while another is taken. Close it when it is not taken to its end: its threads end then."""
    pool = ThreadPoolExecutor(threads, thread_name_prefix="fieldgrid")
    try:
        yield from in_turn(lambda item: pool.submit(work, item), items, ahead)
    finally:
        pool.shutdown(cancel_futures=True)


def in_turn(
    submit: Callable[[_Item], Future[_Result]],
    items: Iterable[_Item],
    ahead: int,
    take: Callable[[Future[_Result]], _Result] = Future.result,
) -> Generator[_Result, None, None]:
    """The results of what is submitted of items, in their order; at most `ahead` of them are under
    way or wait while another is taken. Closed, it takes back the rest."""
    waiting: deque[Future[_Result]] = deque()
    try:
        for item in items:
            waiting.append(submit(item))
            if len(waiting) > ahead:
                yield take(waiting.popleft())
        while waiting:
            yield take(waiting.popleft())
    finally:
        for future in waiting:
            future.cancel()


def cores() -> int:
    """How many threads are worth having."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
