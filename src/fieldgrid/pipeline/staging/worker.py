"""A process that stages shares of drives for a build; started by `pool`, never by hand.

It takes pickled orders from its standard input and writes pickled answers to its standard output.
When the build ends, however it does, the input ends, and the process with it.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import closing
from pathlib import Path
from queue import SimpleQueue
from typing import Any, BinaryIO, NamedTuple

from fieldgrid.core import ConfigError, FieldgridError
from fieldgrid.pipeline.staging.parts import Share, write_part
from fieldgrid.pipeline.staging.shares import DriveWork, stage_frames


class ShareOrder(NamedTuple):
    """A share to stage. `work` is the drive's, pickled, empty when the process has had it."""

    drive: int
    work: bytes
    share: Share
    folder: Path
    out: Path


Answer = float | FieldgridError | RuntimeError | None
"""A frame is staged: the distance of the camera since the frame before, metres. Then, for the
share: None where its part is written, or why it cannot be staged, a RuntimeError with the traceback
of what nobody foresaw."""


def main() -> None:
    """Do what is ordered until the orders end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the build says when to end
    # What a library prints must not get among the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    orders: SimpleQueue[ShareOrder] = SimpleQueue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, orders), daemon=True).start()
    works: dict[int, DriveWork] = {}

    def answer(what: Answer) -> None:
        pickle.dump(what, answers)
        answers.flush()

    while True:
        order = orders.get()
        try:
            if order.work:
                works = {order.drive: unpacked(order.work)}
            work = works[order.drive]
            with closing(stage_frames(work, *order.share, jobs=1)) as looks:
                write_part(order.folder, order.out, order.share, looks, answer)
            answer(None)
        except BrokenPipeError:
            os._exit(1)
        except FieldgridError as error:
            answer(error)
        except Exception:  # noqa: BLE001 - the build raises it
            answer(RuntimeError(traceback.format_exc()))


def unpacked(work: bytes, remedy: str = "give --jobs 1") -> DriveWork:
    """The work on a drive that was pickled; ConfigError where this Python lacks a class of it."""
    try:
        found: DriveWork = pickle.loads(work)
    except (AttributeError, ImportError) as error:
        raise not_importable(error, remedy) from error
    return found


def not_importable(error: Exception, remedy: str = "give --jobs 1") -> ConfigError:
    """The error for frames of a class that only the program that made them knows."""
    return ConfigError(
        f"The frames of this drive cannot be given to other processes ({error}); define their "
        f"classes in a module that can be imported, or {remedy}."
    )


def _listen(stream: BinaryIO, orders: SimpleQueue[Any]) -> None:
    """Takes the orders; the process ends with them, whatever it is at."""
    try:
        while True:
            orders.put(pickle.load(stream))
    except BaseException:  # noqa: BLE001 - the build is gone
        os._exit(1)
