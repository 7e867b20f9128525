"""Work on several cores: threads, since what is heavy here runs outside the interpreter's lock."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def cores() -> int:
    """How many threads are worth having."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_order(
    work: Callable[[_Item], _Result], items: Iterable[_Item], jobs: int | None = None
) -> Iterator[_Result]:
    """The results of work on items, in their order, few more than `jobs` of them at a time."""
    count = cores() if jobs is None else jobs
    if count < 2:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(count, thread_name_prefix="fieldgrid-map")
    waiting: deque[Future[_Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
