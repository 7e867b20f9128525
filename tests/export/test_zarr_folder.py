"""A Zarr store whose writing fails: nothing is written once the error is out."""

from __future__ import annotations

import asyncio
import errno
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import zarr
from zarr.storage import LocalStore

from fieldgrid.export.cells.zarr_folder import zarr_folder


def write_cells(folder: Path, values: npt.NDArray[np.uint16]) -> None:
    with zarr_folder(folder) as store:
        group = zarr.open_group(store, mode="w", zarr_format=2)
        made = group.create_array("cells", shape=values.shape, chunks=(10, 10), dtype="u2")
        made[...] = values
        zarr.consolidate_metadata(store)


def test_nothing_is_written_after_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 16 chunks, of which Zarr writes ten at a time, one finds the disk full at once; the others
    are slow, and would bring the folder back after it was removed."""
    written, begun, ended = LocalStore.set, list[str](), list[str]()

    async def full(self: LocalStore, key: str, value: Any) -> None:
        is_chunk = key.startswith("cells/") and key[-1].isdigit()
        if key == "cells/0.0":
            while not begun:
                await asyncio.sleep(0)
            raise OSError(errno.ENOSPC, "No space left on device")
        if is_chunk:
            begun.append(key)
            await asyncio.sleep(0.05)
        await written(self, key, value)
        if is_chunk:
            ended.append(key)

    monkeypatch.setattr(LocalStore, "set", full)
    with pytest.raises(OSError, match="No space left"):
        write_cells(tmp_path, np.ones((40, 40), np.uint16))
    assert sorted(ended) == sorted(begun)  # none still writes
    assert 0 < len(begun) < 15  # and those that waited for their turn never did


def test_what_was_written_is_whole(tmp_path: Path) -> None:
    values = np.arange(1600, dtype=np.uint16).reshape(40, 40)
    write_cells(tmp_path, values)
    assert np.array_equal(zarr.open_group(tmp_path, mode="r")["cells"][...], values)
