"""Work on many items on the workers of a Dask cluster: here, and what a worker runs."""

from __future__ import annotations

import pickle
import sqlite3
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from itertools import count, islice
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from uuid import uuid4

from fieldgrid.core.closing import Closing
from fieldgrid.core.errors import ClusterError, FieldgridError
from fieldgrid.core.workers.cluster import Cluster, Task, TaskResult, WorkersDied
from fieldgrid.core.workers.order import cores

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_WAITING = 2
"""Batches that may wait for one before them, for each that is handed out: what they take here is
bounded, and a slow one holds nobody up."""

_TICK_S = 0.5


class _ItemError(NamedTuple):
    """What work raised that says something of its items, not of the worker."""

    error: Exception


class OnCluster(Closing):
    """The workers of a Dask cluster (a `Runner`)."""

    def __init__(self, client: Client) -> None:
        self.here = cores()
        self._groups = count()
        self._ended: dict[int, SimpleQueue[TaskResult | BaseException]] = {}
        self._cluster = Cluster(
            client,
            f"{__name__}:do_batch",
            lambda ended: self._told(ended.task.group, ended),
            self._told,
        )

    def in_order(
        self,
        work: Callable[[_Item], _Result],
        items: Iterable[_Item],
        batch: int = 1,
        most: int | None = None,
    ) -> Iterator[_Result]:
        """The results of work on items, in their order. What work raises of items ends it; so does
        ClusterError where workers cannot do it."""
        group = next(self._groups)
        ended = self._ended[group] = SimpleQueue[TaskResult | BaseException]()
        name, left, numbers = type(work).__name__.lower(), iter(items), count()
        done: dict[int, list[Any]] = {}
        waiting: deque[int] = deque()
        self._cluster.begin(group, packed((uuid4().hex, work)))
        try:
            while True:
                at_a_time = (1 + _WAITING) * self._cluster.ahead
                while len(waiting) < min(at_a_time, most or at_a_time):
                    some = tuple(islice(left, batch))
                    if not some:
                        break
                    waiting.append(next(numbers))
                    self._cluster.add([Task(group, name, (waiting[-1], packed(some)))])
                if not waiting:
                    return
                while waiting[0] not in done:
                    done.update([_next(ended)])
                for result in done.pop(waiting.popleft()):
                    if isinstance(result, _ItemError):
                        raise result.error
                    yield result
        finally:
            self._cluster.drop(group)
            del self._ended[group]

    def _told(self, group: int, what: TaskResult | BaseException) -> None:
        ended = self._ended.get(group)
        if ended is not None:  # else the group was dropped meanwhile
            ended.put(what)

    def close(self) -> None:
        """Take back all that is not done; what a worker is at it does to the end of the batch."""
        self._cluster.close()


def _next(ended: SimpleQueue[TaskResult | BaseException]) -> tuple[int, list[Any]]:
    """The next batch that is done, by its number."""
    while True:
        try:
            found = ended.get(timeout=_TICK_S)  # so that Ctrl-C is heard everywhere
        except Empty:
            continue
        if isinstance(found, BaseException):
            raise found
        if isinstance(found.error, WorkersDied):
            raise ClusterError(
                "A task has ended every Dask worker that did it; give the workers more memory, or "
                "leave out --scheduler."
            )
        if found.error is not None:
            raise found.error
        return found.task.arguments[0], found.value


def packed(work: object) -> bytes:
    """Work or items for a worker. ClusterError when they cannot be sent."""
    try:
        return pickle.dumps(work)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise ClusterError(
            f"This cannot be done on a cluster ({error}); leave out --scheduler."
        ) from error


def do_batch(work: bytes, number: int, items: bytes) -> list[Any]:
    """What a worker makes of some items, up to the first that work refuses.

    `work` is packed with the name of its group, which no other has: so the same work is unpacked
    once a group, and reads the files that are there then. ClusterError when the worker cannot do
    the work, as where it lacks a file.
    """
    del number
    done, call = list[Any](), _unpacked(work)
    for item in pickle.loads(items):
        try:
            done.append(call(item))
        except ClusterError:
            raise
        except sqlite3.OperationalError as error:  # of this worker's disk, or a lock
            raise OSError(str(error)) from error
        except (FieldgridError, sqlite3.DatabaseError, UnicodeDecodeError) as error:
            done.append(_ItemError(error))
            break
    return done


@lru_cache(maxsize=2)
def _unpacked(work: bytes) -> Callable[[Any], Any]:
    found: Callable[[Any], Any]
    _, found = pickle.loads(work)
    return found
