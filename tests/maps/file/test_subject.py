"""Verifying a map on the workers of a cluster: what one process finds, and what cannot be."""

from __future__ import annotations

import pickle
import re
import shutil
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from fieldgrid.core import ClusterError, ConfigError
from fieldgrid.core.workers import connecting
from fieldgrid.maps import connect, open_map, reading
from fieldgrid.maps.file.header import read_header
from fieldgrid.maps.writing import sharing
from fieldgrid.maps.writing.subject import Subject
from tests.clusters import Cluster
from tests.maps.file.maps import drive, track, write_map

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(
        tmp_path_factory.mktemp("map") / "map.gpkg",
        [drive(6, step_m=5.0), drive(5, heading_deg=-70.0)],
        trajectory=track(9),
    )


@pytest.fixture(scope="module")
def damaged(sound: Path) -> Path:
    """The same with something wrong at every stage."""
    path = sound.with_name("damaged.gpkg")
    shutil.copy(sound, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for statement in (
            "UPDATE fieldgrid_grid SET data = zeroblob(9) WHERE frame IN (2, 8)",
            "UPDATE fieldgrid_tile SET data = zeroblob(20) "
            "WHERE rowid IN (SELECT rowid FROM fieldgrid_tile LIMIT 2)",
            "DELETE FROM fieldgrid_tile WHERE rowid = (SELECT max(rowid) FROM fieldgrid_tile)",
            "UPDATE density SET tile_data = x'00' WHERE id = 2",
        ):
            assert database.execute(statement).rowcount
    return path


def test_a_cluster_finds_what_one_process_finds(
    sound: Path, damaged: Path, cluster: Cluster
) -> None:
    for path in (sound, damaged):
        with open_map(path) as universal:
            here = universal.verify(1, deep=True)
            there = universal.verify(deep=True, scheduler=cluster.scheduler_address)
        assert here == there
        assert here.sound == (path == sound)


def test_a_worker_that_is_killed_changes_nothing(
    sound: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = cluster.kill_one(monkeypatch)
    with open_map(sound) as universal:
        here = universal.verify(1, deep=True)
        with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
            assert universal.verify(deep=True, scheduler=client) == here
            assert client.status == "running"
    assert ended


@contextmanager
def programs(folder: Path) -> Iterator[str]:
    """`dask scheduler` and `dask worker`, started as a user does; the scheduler's address."""
    dask = [sys.executable, "-m", "dask"]
    with (folder / "worker.log").open("w") as log:
        scheduler = subprocess.Popen(
            [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
        )
        started = [scheduler]
        try:
            assert scheduler.stderr is not None
            found = (re.search(r"Scheduler at:\s+(tcp://\S+)", line) for line in scheduler.stderr)
            address = next(match[1] for match in found if match)
            worker = [*dask, "worker", address, "--nthreads", "2", "--no-dashboard", "--no-nanny"]
            started.append(subprocess.Popen(worker, stderr=log, cwd=folder))
            yield address
        finally:
            for process in reversed(started):
                process.kill()
                process.wait()
            assert scheduler.stderr is not None
            scheduler.stderr.close()


def test_scheduler_and_workers_may_be_programs_of_their_own(damaged: Path, tmp_path: Path) -> None:
    with programs(tmp_path) as address, open_map(damaged) as universal:
        here = universal.verify(1, deep=True)
        assert universal.verify(deep=True, scheduler=address) == here
    assert not here.sound


# --- what cannot be


@pytest.fixture(scope="module")
def inside() -> Iterator[distributed.LocalCluster]:
    """A worker that is a thread of this process."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as made:
        yield made


def test_a_worker_that_cannot_see_the_map_ends_it_and_is_no_problem_of_the_map(
    sound: Path, inside: distributed.LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def check(path: Path, size: int | None, things: str) -> None:
        raise ClusterError(f"{path} does not exist on the worker there; copy the {things}.")

    monkeypatch.setattr(sharing, "check_is_here", check)
    with (
        open_map(sound) as universal,
        pytest.raises(ClusterError, match=r"map\.gpkg does not exist .*; copy the map\."),
    ):
        universal.verify(deep=True, scheduler=inside.scheduler_address)


def sent(path: Path) -> bytes:
    with closing(sqlite3.connect(path)) as connection:
        return pickle.dumps(Subject(connection, path, read_header(connection, path)))


def truncated(path: Path) -> None:
    path.write_bytes(b"1")


def earlier(path: Path) -> None:
    """A copy from before the last change, of the same size."""
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        query = (
            "UPDATE fieldgrid_meta SET value = 'x' || substr(value, 2) WHERE key = 'root_sha256'"
        )
        assert database.execute(query).rowcount == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (Path.unlink, r"does not exist on the worker .*; mount or copy the map to the same path"),
        (truncated, r"has 1 bytes on the worker .*, and \d+ here; mount or copy the map"),
        (earlier, "is another state of the map; mount or copy the map to the same path on every"),
    ],
)
def test_a_worker_with_another_file_is_told(
    sound: Path, tmp_path: Path, change: Callable[[Path], None], said: str
) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    packed = sent(path)
    change(path)
    with pytest.raises(ClusterError, match=said):
        pickle.loads(packed)


def test_sending_a_map_lets_go_of_no_lock(sound: Path, tmp_path: Path) -> None:
    """As opening and closing its file would, although it is being read."""
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    commit = (
        "import sqlite3, sys; sqlite3.connect(sys.argv[1], timeout=0).execute('BEGIN EXCLUSIVE')"
    )
    with closing(connect(path, path, writable=False)) as connection, reading(connection, path):
        header = read_header(connection, path)
        arrived = pickle.loads(pickle.dumps(Subject(connection, path, header)))
        assert arrived.connection is not connection
        done = subprocess.run([sys.executable, "-c", commit, path], capture_output=True, text=True)
    assert "database is locked" in done.stderr


def test_a_worker_that_does_not_know_a_group_is_told(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = sent(sound)
    monkeypatch.setattr(sharing, "GROUPS", {"density": sharing.GROUPS["density"]})
    with pytest.raises(ClusterError, match=r"does not know the channel group '\w+'; start it with"):
        pickle.loads(packed)


def test_a_map_with_a_write_ahead_log_is_refused(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        asked = Subject(connection, path, read_header(connection, path))
        with pytest.raises(ClusterError, match=r"is of the kind 'wal'\. Close .*, or leave"):
            pickle.dumps(asked)


def test_the_sums_of_rows_are_read_here(sound: Path) -> None:
    with open_map(sound) as universal, pytest.raises(ConfigError, match="add --deep, or leave out"):
        universal.verify(scheduler="tcp://127.0.0.1:1")


def test_nobody_at_the_address_is_told_at_once(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "CONNECT_S", 0.2)
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with (
            open_map(sound) as universal,
            pytest.raises(ClusterError, match=f"No Dask scheduler answers at {address} .*; start"),
        ):
            universal.verify(deep=True, scheduler=address)


def test_an_encrypted_address_is_taken_with_the_certificates_of_dasks_configuration(
    sound: Path,
) -> None:
    pytest.importorskip("cryptography")
    security = distributed.Security.temporary()
    known = {
        "distributed.comm.tls.ca-file": security.tls_ca_file,
        "distributed.comm.tls.client.cert": security.tls_client_cert,
        "distributed.comm.tls.client.key": security.tls_client_key,
    }
    with (
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            protocol="tls://",
            security=security,
            dashboard_address=":0",
        ) as made,
        dask.config.set(known),
        open_map(sound) as universal,
    ):
        address = made.scheduler_address
        assert address.startswith("tls://")
        assert universal.verify(deep=True, scheduler=address).sound
