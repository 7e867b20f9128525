"""A Zarr store in a folder that can be removed when writing it has failed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def zarr_folder(folder: Path) -> Iterator[Any]:
    """A Zarr store in a folder, to write.

    Zarr writes from threads of its own, and goes on in the others when one fails. Here none begins
    to write after the first error, and none still writes when the error comes out.
    """
    from zarr.storage import LocalStore

    changed = threading.Condition()
    errors: list[BaseException] = []
    writing = 0

    class Store(LocalStore):
        async def set(self, key: str, value: Any) -> None:
            nonlocal writing
            with changed:
                if errors:
                    raise errors[0]
                writing += 1
            try:
                await super().set(key, value)
            except BaseException as error:
                errors.append(error)
                raise
            finally:
                with changed:
                    writing -= 1
                    changed.notify_all()

    try:
        yield Store(folder)
    except BaseException as error:
        with changed:
            errors.append(error)
            changed.wait_for(lambda: writing == 0)
        raise
