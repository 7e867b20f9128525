"""Builds on a Dask cluster: the same bits, workers that die, and what cannot be."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from fieldgrid.core import ClusterError, ConfigError
from fieldgrid.core.workers import cluster, connecting
from fieldgrid.maps import open_map
from fieldgrid.pipeline import PartlyBuiltError, Progress, drives
from fieldgrid.pipeline.staging import parts, remote
from fieldgrid.recordings import Drive, DriveOptions, open_drive
from tests.conftest import make_small_drive
from tests.pipeline.drives import failing
from tests.pipeline.drives.making import (
    MakeDrive,
    build,
    content,
    count_staged,
    damage,
    frames_left,
    pipeline_threads,
)

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [
    pytest.mark.usefixtures("worked_out_afresh"),
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
]


@pytest.fixture(autouse=True)
def small_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "SHARE_FRAMES", 2)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """Two drives, one with a frame that cannot be read, and the map of them, built in one process
    from their relative paths."""
    folder = tmp_path_factory.mktemp("two")
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        paths = [
            make_small_drive(Path("first"), range(3, 9)),
            make_small_drive(Path("second"), range(40, 45)),
        ]
        damage(paths[0] / "left" / "000005.jpg")
        build(paths, folder / "whole.gpkg", jobs=1, skip_bad=1)
    return paths, folder / "whole.gpkg"


@pytest.fixture
def there(two: tuple[list[Path], Path], monkeypatch: pytest.MonkeyPatch) -> tuple[list[Path], Path]:
    """The same, in their folder."""
    monkeypatch.chdir(two[1].parent)
    return two


@pytest.fixture(scope="module")
def local() -> Iterator[distributed.LocalCluster]:
    """A worker, a process of this machine with two threads, started again when it dies."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=":0"
    ) as made:
        yield made


@pytest.mark.long
def test_an_interrupted_build_takes_its_tasks_back_and_goes_on_at_home(
    there: tuple[list[Path], Path],
    local: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    paths, whole = there
    out = tmp_path / "m.gpkg"

    def interrupt(now: Progress) -> None:
        if now.frames_done:
            raise KeyboardInterrupt

    with distributed.Client(local, set_as_default=False) as client:
        with pytest.raises(KeyboardInterrupt):
            build(paths, out, scheduler=client, skip_bad=1, progress=interrupt)
        assert client.status == "running"
        # One may have ended just before.
        assert not [key for key, state in client.futures.items() if state.status == "pending"]
    done = frames_left(out)
    assert done
    staged = count_staged(monkeypatch)
    build(paths, out, jobs=1, skip_bad=1, resume=True)
    assert sum(staged) == 11 - done
    assert content(out) == content(whole)
    assert list(tmp_path.iterdir()) == [out]


def test_a_cluster_gives_the_same_bits_also_when_a_worker_is_killed(
    there: tuple[list[Path], Path],
    local: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    paths, whole = there
    monkeypatch.setattr(drives, "open_drive", failing.opening("first", 4, 1, tmp_path / "marks"))
    out, seen = tmp_path / "m.gpkg", list[Progress]()
    reports = build(paths, out, scheduler=local.scheduler_address, skip_bad=1, progress=seen.append)
    assert (tmp_path / "marks").read_text() == "x"
    assert content(out) == content(whole)
    assert [bad.frame_id for bad in reports[0].bad] == ["000005"]
    assert reports[0].bad[0].reason.startswith("first/left/000005.jpg")
    last = {now.session: (now.frames_done, now.frames_total) for now in seen}
    assert last == {"first": (6, 6), "second": (5, 5)}
    assert {path.name for path in tmp_path.iterdir()} == {"m.gpkg", "marks"}
    assert pipeline_threads() == []


@pytest.mark.long
def test_a_recording_that_kills_workers_is_named_and_left_out(
    there: tuple[list[Path], Path],
    local: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the shares that its workers had beside it, none is."""
    paths, _ = there
    monkeypatch.setattr(local.scheduler, "allowed_failures", 0)
    monkeypatch.setattr(drives, "open_drive", failing.opening("second", 2, 99, tmp_path / "marks"))
    with (
        distributed.Client(local, set_as_default=False) as client,
        pytest.raises(PartlyBuiltError) as told,
    ):
        build(paths, tmp_path / "m.gpkg", scheduler=client, skip_bad=1)
    (failed,) = told.value.failed
    assert failed[0] == "second"
    assert (tmp_path / "marks").read_text() == "xx"  # beside others, and alone
    assert "Frames 2 to 3 of second have ended every process that staged them" in failed[1]
    with open_map(tmp_path / "m.gpkg") as universal:
        assert [info.name for info in universal.sessions()] == ["first"]
    assert {path.name for path in tmp_path.iterdir()} == {"m.gpkg", "marks"}


# --- what cannot be


@pytest.fixture(scope="module")
def inside() -> Iterator[distributed.LocalCluster]:
    """A worker that is a thread of this process."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as made:
        yield made


def test_a_worker_of_another_version_ends_the_build(
    there: tuple[list[Path], Path],
    inside: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = remote.versions
    monkeypatch.setattr(remote, "versions", lambda: {**usual(), "OpenCV": "9.9"})
    said = rf"The worker on .* has OpenCV {cv2.__version__}, not 9\.9; install there .* fieldgrid "
    with pytest.raises(ClusterError, match=said):
        build(there[0], tmp_path / "m.gpkg", scheduler=inside.scheduler_address, skip_bad=1)
    assert list(tmp_path.iterdir()) == []


def moved(path: str | Path, options: DriveOptions | None) -> Drive:
    """`open_drive`, but the drive is elsewhere afterwards."""
    found = open_drive(path, options)
    Path(path).rename(f"{path}-moved")
    return found


def test_a_worker_without_the_recording_ends_the_build(
    make_drive: MakeDrive,
    inside: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Although bad frames may be left out: it does not pass for frames that cannot be read."""
    drive = make_drive()
    monkeypatch.setattr(drives, "open_drive", moved)
    with pytest.raises(ClusterError, match=r"drive does not exist on the worker .*; mount or copy"):
        build([drive], tmp_path / "m.gpkg", scheduler=inside.scheduler_address, skip_bad=1.0)
    assert [path.name for path in tmp_path.iterdir()] == ["drive-moved"]


def test_a_worker_with_another_file_of_that_name_is_told(tmp_path: Path) -> None:
    bag = tmp_path / "drive.mcap"
    bag.write_bytes(b"1234")
    place = remote.place_of(bag)
    bag.write_bytes(b"12")
    with pytest.raises(ClusterError, match=r"has 2 bytes on the worker .*, and 4 here; mount or"):
        remote.stage_share(b"", parts.Share(0, 2), place)


def test_frames_that_cannot_be_sent_are_refused(
    make_drive: MakeDrive,
    inside: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def opened(path: str | Path, options: DriveOptions | None) -> Drive:
        class Here(failing.Killing):
            pass

        found = open_drive(path, options).recording()
        return replace(found, source=Here(found.source, 0, 0, tmp_path / "marks", os.getpid()))

    monkeypatch.setattr(drives, "open_drive", opened)
    with pytest.raises(ConfigError, match=r"cannot be given .* and no --scheduler\."):
        build([make_drive()], tmp_path / "m.gpkg", scheduler=inside.scheduler_address)
    assert [path.name for path in tmp_path.iterdir()] == ["drive"]


def test_a_defect_on_a_worker_ends_the_build_with_its_traceback(
    make_drive: MakeDrive,
    inside: distributed.LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote, "stage_frames", lambda *_, **__: 1 // 0)
    with pytest.raises(ZeroDivisionError) as told:
        build([make_drive()], tmp_path / "m.gpkg", scheduler=inside.scheduler_address)
    assert "stage_share" in {entry.name for entry in told.traceback}


def test_a_scheduler_that_goes_away_ends_the_build(make_drive: MakeDrive, tmp_path: Path) -> None:
    out = tmp_path / "m.gpkg"
    scheduler = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    )

    def end(now: Progress) -> None:
        if now.frames_done:
            scheduler.close()

    said = r"The Dask scheduler .* is gone.*; start it again\. What was staged is kept .* --resume"
    with pytest.raises(ClusterError, match=said):
        build([make_drive()], out, scheduler=scheduler.scheduler_address, progress=end)
    assert frames_left(out)


def test_a_scheduler_without_workers_is_not_waited_for_without_end(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "NO_WORKERS_S", 0.1)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as empty,
        pytest.raises(ClusterError, match=r"no worker for 0.1 s; start some with: dask work"),
    ):
        build([make_drive()], tmp_path / "m.gpkg", scheduler=empty.scheduler_address)


@pytest.mark.parametrize("address", ["here", "tcp://", "tcp://127.0.0.1:99999"])
def test_an_address_that_is_none(
    address: str, make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "CONNECT_S", 0.2)
    with pytest.raises(
        ClusterError, match=rf"No Dask scheduler answers at {address} \(.+\); start"
    ):
        build([make_drive()], tmp_path / "m.gpkg", scheduler=address)
    assert [path.name for path in tmp_path.iterdir()] == ["drive"]
