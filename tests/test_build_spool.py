"""Local grids that wait on disk for their poses: what was put is what comes back."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fieldgrid.build import spool as spooling
from fieldgrid.build.spool import Spool
from fieldgrid.errors import MapError, MapWriteError
from fieldgrid.grids import GridSpec, LocalGrid

SPEC = GridSpec(width_m=2.0, length_m=3.0, cell_m=0.1)
NOISY_ERRORS = [errno.EIO, errno.EACCES]


def grid(seed: int, spec: GridSpec = SPEC) -> LocalGrid:
    """Noise where something was seen, 0 elsewhere."""
    random = np.random.default_rng(seed)
    observed = random.random(spec.shape) < random.random()
    density = random.integers(0, 256, spec.shape).astype(np.uint8)
    return LocalGrid(spec, np.where(observed, density, np.uint8(0)), observed)


def put(spool: Spool, k: int, own: LocalGrid) -> None:
    hashes = (f"{k:064x}", f"{k + 1:064x}")
    spool.put(f"frame {k}", 10**18 - k, (f"l{k}.png", f"r{k}.png"), hashes, k % 3 == 0, own)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 10**6), max_size=12))
def test_frames_come_back_in_their_order_as_they_were(tmp_path: Path, seeds: list[int]) -> None:
    """As often as one asks, also when an earlier look was not finished."""
    grids = [grid(seed) for seed in seeds]
    with Spool(SPEC, tmp_path / "map.gpkg") as spool:
        for k, own in enumerate(grids):
            assert len(spool) == k
            put(spool, k, own)
        next(iter(spool), None)
        for _ in range(2):
            found = list(spool)
            assert [one.frame_id for one in found] == [f"frame {k}" for k in range(len(grids))]
            for k, (one, own) in enumerate(zip(found, grids, strict=True)):
                assert one.time_ns == 10**18 - k
                assert one.images == (f"l{k}.png", f"r{k}.png")
                assert one.images_sha256 == (f"{k:064x}", f"{k + 1:064x}")
                assert one.ground_refined == (k % 3 == 0)
                assert one.grid.spec == SPEC
                assert one.grid.density.dtype == np.uint8
                assert np.array_equal(one.grid.density, own.density)
                assert np.array_equal(one.grid.observed, own.observed)
        time_ns, ground = spool.frames()
        assert time_ns.tolist() == [10**18 - k for k in range(len(grids))]
        assert ground.tolist() == [k % 3 == 0 for k in range(len(grids))]
        assert (time_ns.dtype, ground.dtype) == (np.int64, np.bool_)


def test_nothing_put_is_nothing() -> None:
    with Spool(SPEC, Path("map.gpkg")) as spool:
        assert list(spool) == []
        assert [column.size for column in spool.frames()] == [0, 0]


@pytest.mark.parametrize("fails", [True, False])
def test_afterwards_it_is_closed_and_leaves_nothing(fails: bool, tmp_path: Path) -> None:
    """Also when the drive ended in an error."""
    spool = Spool(SPEC, tmp_path / "map.gpkg")
    try:
        with spool as same:
            assert same is spool
            put(spool, 0, grid(1))
            assert list(tmp_path.iterdir()) == []  # it has no name
            if fails:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        assert fails
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="closed file"):
        next(iter(spool))
    with pytest.raises(ValueError, match="closed file"):
        put(spool, 1, grid(2))
    spool.close()  # once more does no harm


def test_it_lies_beside_the_map_also_through_a_link(tmp_path: Path) -> None:
    """Where the map really is, there has to be room anyway."""
    disk, desk = tmp_path / "disk", tmp_path / "desk"
    disk.mkdir()
    desk.mkdir()
    (disk / "map.gpkg").touch()
    (desk / "map.gpkg").symlink_to(disk / "map.gpkg")
    places = []
    real: Callable[..., Any] = spooling.tempfile.TemporaryFile

    def noting(**options: Any) -> Any:
        places.append(options["dir"])
        return real(**options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spooling.tempfile, "TemporaryFile", noting)
        Spool(SPEC, desk / "map.gpkg").close()
    assert places == [disk.resolve()]


class Limited:
    """A file that takes `room` bytes, `most` at once, and then fails."""

    def __init__(self, file: Any, room: int, most: int, error: int = errno.ENOSPC) -> None:
        self._file, self._room, self._most, self._error = file, room, most, error

    def write(self, data: memoryview) -> int:
        taken = min(self._room, self._most, len(data))
        if not taken:
            raise OSError(self._error, os.strerror(self._error))
        self._room -= taken
        return int(self._file.write(data[:taken]))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def limit(spool: Spool, room: int, most: int = 10**9, error: int = errno.ENOSPC) -> Limited:
    """Put the limit before the spool's own file."""
    limited = Limited(spool._file, room, most, error)
    spool._file = limited  # type: ignore[assignment]
    return limited


def test_a_disk_that_takes_a_little_at_a_time_gets_everything(tmp_path: Path) -> None:
    with Spool(SPEC, tmp_path / "map.gpkg") as spool:
        limit(spool, 10**9, most=7)
        for k in range(3):
            put(spool, k, grid(k))
        for k, one in enumerate(spool):
            assert np.array_equal(one.grid.density, grid(k).density)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, *NOISY_ERRORS])
@pytest.mark.parametrize("room", [0, 100])
def test_a_full_disk_is_told_with_what_to_do(error: int, room: int, tmp_path: Path) -> None:
    with Spool(SPEC, tmp_path / "map.gpkg") as spool:
        put(spool, 0, grid(0))
        limit(spool, room, error=error)
        with pytest.raises(MapWriteError) as caught:
            put(spool, 1, grid(1))
        # What was put before is still there; the frame that did not fit is not.
        assert len(spool) == 1
        assert [one.frame_id for one in spool] == ["frame 0"]
    told = str(caught.value)
    assert str(tmp_path / "map.gpkg") in told
    assert os.strerror(error) in told
    assert ("permissions" if error in NOISY_ERRORS else "free some space") in told
    assert isinstance(caught.value.__cause__, OSError)


def test_a_damaged_file_is_told_with_the_frame(tmp_path: Path) -> None:
    with Spool(SPEC, tmp_path / "map.gpkg") as spool:
        put(spool, 0, grid(0))
        put(spool, 1, grid(1))
        spool._file.seek(20)
        spool._file.write(b"\xff" * 40)
        with pytest.raises(MapError, match="frame 0"):
            next(iter(spool))


def test_in_no_folder_there_is_no_spool(tmp_path: Path) -> None:
    with pytest.raises(MapWriteError, match=r"map\.gpkg \(No such file .*check the folder"):
        Spool(SPEC, tmp_path / "nowhere" / "map.gpkg")
