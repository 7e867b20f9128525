"""Work on many items on the workers of a Dask cluster: here, and what a worker runs."""

from __future__ import annotations

import ctypes
import pickle
import platform
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar
from uuid import uuid4

import cv2
import numpy as np

from fieldgrid.core.errors import ClusterError, FieldgridError
from fieldgrid.core.workers.connecting import first_line
from fieldgrid.core.workers.order import cores, in_turn
from fieldgrid.version import software_version

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

NO_WORKERS_S = 60.0
"""How long a scheduler may be without a worker."""

_AHEAD = 6
"""Batches that are under way or wait for one before them, for each thread of a worker."""


class OnCluster:
    """The workers of a Dask cluster (a `Runner`)."""

    def __init__(self, client: Client) -> None:
        self.here = cores()
        self._client = client
        await_workers(client)

    def in_order(
        self,
        work: Callable[[_Item], _Result],
        items: Iterable[_Item],
        batch: int = 1,
        most: int | None = None,
    ) -> Iterator[_Result]:
        """The results of work on items, in their order. What work raises of items ends it; so does
        ClusterError where workers cannot do it."""
        executor = self._client.get_executor(pure=False)
        # A task of its own, so that it is sent once to each worker.
        sent = self._client.submit(bytes, packed((uuid4().hex, work)), pure=False)
        left, wanted = iter(items), versions()
        batches = iter(lambda: tuple(islice(left, batch)), ())
        ahead = _AHEAD * sum(self._client.nthreads().values())
        done = in_turn(
            lambda some: executor.submit(do_batch, sent, wanted, packed(some)),
            batches,
            ahead if most is None else min(ahead, most - 1),
            partial(result_of, client=self._client),
        )
        for results, error in done:
            yield from results
            if error is not None:
                raise error


def await_workers(client: Client) -> None:
    """Wait until a scheduler has a worker. ClusterError when it gets none."""
    try:
        client.wait_for_workers(1, timeout=NO_WORKERS_S)
    except TimeoutError:
        address = client.scheduler.address
        raise ClusterError(
            f"The Dask scheduler {address} has had no worker for {NO_WORKERS_S:g} s; "
            f"start some with: dask worker {address}"
        ) from None


def result_of(future: Future[_Result], client: Client) -> _Result:
    """What became of a task. ClusterError where the cluster could not do it; what the task itself
    raised is raised."""
    address = client.scheduler.address
    try:
        return future.result()
    except FieldgridError:
        raise
    except CancelledError:
        raise ClusterError(
            f"The Dask scheduler {address} is gone, or has given up the tasks of this program; "
            "start it again."
        ) from None
    except Exception as error:
        if is_death(error):
            raise ClusterError(
                "A task has ended every Dask worker that did it; give the workers more memory, or "
                "leave out --scheduler."
            ) from error
        if isinstance(error, ImportError | RuntimeError):  # on a worker, or on the scheduler
            raise ClusterError(
                f"The Dask cluster {address} cannot run the tasks of this program "
                f"({type(error).__name__}: {first_line(error)}); give scheduler and workers the "
                "Python and the packages that this program has."
            ) from error
        raise


def is_death(error: BaseException | None) -> bool:
    """Whether a task has no result since the processes that did it have died."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def packed(work: object) -> bytes:
    """Work or items for a worker. ClusterError when they cannot be sent."""
    try:
        return pickle.dumps(work)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise ClusterError(
            f"This cannot be done on a cluster ({error}); leave out --scheduler."
        ) from error


def do_batch(
    work: bytes, wanted: dict[str, str], items: bytes
) -> tuple[list[Any], FieldgridError | None]:
    """What a worker makes of some items, up to the first that work refuses, and that refusal.

    `work` is packed with a name that no other has: so the same work is unpacked once, and reads the
    files that are there then. ClusterError when the worker cannot do the work, as where it lacks a
    file.
    """
    check_versions(wanted)
    done, call = list[Any](), _unpacked(work)
    for item in pickle.loads(items):
        try:
            done.append(call(item))
        except ClusterError:
            raise
        except FieldgridError as error:
            return done, error
    return done, None


@lru_cache(maxsize=2)
def _unpacked(work: bytes) -> Callable[[Any], Any]:
    found: Callable[[Any], Any]
    _, found = pickle.loads(work)
    return found


def versions() -> dict[str, str]:
    """The versions of this package and of those that it computes with, by name: what the bits of a
    result depend on beside its inputs."""
    return {
        "fieldgrid": software_version(),
        "NumPy": np.__version__,
        "OpenCV": cv2.__version__,
        "Numba": version("numba"),
        "SciPy": version("scipy"),
    }


def check_versions(wanted: dict[str, str]) -> None:
    """Make this process ready for work of a program with these versions. ClusterError where its own
    are others."""
    found = versions()
    for library, needed in wanted.items():
        if found.get(library) != needed:
            raise ClusterError(
                f"The worker on {platform.node()} has {library} {found.get(library)}, not {needed};"
                f" install there what this program has, fieldgrid {wanted['fieldgrid']} with its "
                "requirements."
            )
    keep_freed_memory()


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES, _LARGE_BYTES = 64 << 20, 32 << 20


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """Let this process use again what it has freed, up to 64 MB, as glibc does by itself.

    Dask's nanny starts workers so that each array of 128 kB or more goes back to the system, and
    is asked for again, page by page: verifying a map took more than twice the processor time.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    mallopt = ctypes.CDLL(None).mallopt
    mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
