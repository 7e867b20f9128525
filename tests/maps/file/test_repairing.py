"""Repairing a map on the workers of a cluster: the bits of one process, and what cannot be."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.core import ClusterError, ConfigError, MapError, MapWriteError
from fieldgrid.core.workers import connecting
from fieldgrid.maps import Patience, open_map
from fieldgrid.maps.file import database
from tests.clusters import Cluster
from tests.maps.file.content import content
from tests.maps.file.maps import drive, track, write_map

distributed = pytest.importorskip("distributed")

# Sockets and loops of Dask's own, which it closes in its own time.
pytestmark = [pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")]

FORMAT_2 = Path(__file__).with_name("format2.gpkg")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(
        tmp_path_factory.mktemp("map") / "map.gpkg",
        [drive(6, step_m=5.0), drive(5, heading_deg=-70.0)],
        trajectory=track(9),
    )


@pytest.fixture
def spoiled(sound: Path, tmp_path: Path) -> Path:
    """The same with tiles and pictures that do not follow from its frames."""
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("DELETE FROM density")
        database.execute("UPDATE fieldgrid_tile SET data = zeroblob(9)")
    return path


def test_a_cluster_of_which_a_worker_is_killed_repairs_to_the_bits_of_one_process(
    sound: Path,
    spoiled: Path,
    cluster: Cluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ended = cluster.kill_one(monkeypatch)
    keep, before = tmp_path / "kept.gpkg", content(spoiled)
    with open_map(spoiled, writable=True) as universal:
        assert universal.repair(keep=keep, scheduler=cluster.scheduler_address) == ()
        assert universal.verify(1, deep=True).sound
    assert ended
    assert content(spoiled) == content(sound)
    assert content(keep) == before
    assert {path.name for path in tmp_path.iterdir()} == {"map.gpkg", "kept.gpkg"}


def test_the_command_repairs_on_a_cluster(sound: Path, spoiled: Path, cluster: Cluster) -> None:
    address = ["--scheduler", cluster.scheduler_address]
    result = CliRunner().invoke(app, ["repair", str(spoiled), *address])
    kept = spoiled.with_name("map.before-repair.gpkg")
    assert result.stdout == f"repaired {spoiled}; as it was: {kept}\n", result.output
    assert content(spoiled) == content(sound)
    for given, said in (
        (["--in-place"], "the copy of the map that is kept; leave out"),
        (["--upgrade"], "the copy of the map that is kept; leave out"),
        (["--jobs", "2"], "the workers of the --scheduler do the work"),
    ):
        refused = CliRunner().invoke(app, ["repair", str(spoiled), *address, *given])
        assert refused.exit_code == 2
        assert said in refused.output


def test_damaged_evidence_is_refused_and_leaves_no_copy(
    spoiled: Path, cluster: Cluster, tmp_path: Path
) -> None:
    with closing(sqlite3.connect(spoiled, isolation_level=None)) as database:
        database.execute("UPDATE fieldgrid_grid SET data = zeroblob(9) WHERE frame = 2")
    before = spoiled.read_bytes()
    with (
        open_map(spoiled, writable=True) as universal,
        pytest.raises(MapError, match="cannot be repaired, because its evidence is damaged"),
    ):
        universal.repair(keep=tmp_path / "kept.gpkg", scheduler=cluster.scheduler_address)
    assert spoiled.read_bytes() == before
    assert list(tmp_path.iterdir()) == [spoiled]


@pytest.fixture
def one() -> Iterator[str]:
    """The address of a scheduler with one worker, which has done all that was done before."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as made:
        yield made.scheduler_address


def rot(path: Path) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("UPDATE fieldgrid_grid SET data = zeroblob(9) WHERE frame = 2")


def test_a_frame_that_is_damaged_since_the_last_repair_is_not_sealed(
    sound: Path, one: str, tmp_path: Path
) -> None:
    """Although its copy has the name, size and state of the one that was repaired before."""
    path, keep = Path(shutil.copy(sound, tmp_path / "map.gpkg")), tmp_path / "kept.gpkg"
    with open_map(path, writable=True) as universal:
        assert universal.repair(keep=keep, scheduler=one) == ()
    keep.unlink()
    shutil.copy(sound, path)
    rot(path)
    before = path.read_bytes()
    with (
        open_map(path, writable=True) as universal,
        pytest.raises(MapError, match="its evidence is damaged"),
    ):
        universal.repair(keep=keep, scheduler=one)
    assert path.read_bytes() == before


def test_a_map_that_was_refused_and_restored_is_repaired(
    spoiled: Path, one: str, tmp_path: Path
) -> None:
    restored, keep = spoiled.read_bytes(), tmp_path / "kept.gpkg"
    rot(spoiled)
    with (
        open_map(spoiled, writable=True) as universal,
        pytest.raises(MapError, match="its evidence is damaged"),
    ):
        universal.repair(keep=keep, scheduler=one)
    spoiled.write_bytes(restored)
    with open_map(spoiled, writable=True) as universal:
        assert universal.repair(keep=keep, scheduler=one) == ()


def test_an_older_format_is_to_be_upgraded_first(cluster: Cluster, tmp_path: Path) -> None:
    path = Path(shutil.copy(FORMAT_2, tmp_path / "old.gpkg"))
    with (
        open_map(path, writable=True) as universal,
        pytest.raises(ConfigError, match=r"format 2, which .* cannot fold; .*repair --upgrade"),
    ):
        universal.repair(keep=tmp_path / "kept.gpkg", scheduler=cluster.scheduler_address)
    assert path.read_bytes() == FORMAT_2.read_bytes()
    assert list(tmp_path.iterdir()) == [path]


def test_without_a_copy_or_a_cluster_nothing_is_done(
    spoiled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "CONNECT_S", 0.2)
    before = spoiled.read_bytes()
    with open_map(spoiled, writable=True) as universal:
        with pytest.raises(ConfigError, match=r"read the copy that is kept .*; leave out --in-p"):
            universal.repair(scheduler="tcp://127.0.0.1:1")
        with pytest.raises(ClusterError, match="No Dask scheduler answers"):
            universal.repair(keep=tmp_path / "kept.gpkg", scheduler="tcp://127.0.0.1:1")
    assert spoiled.read_bytes() == before
    assert list(tmp_path.iterdir()) == [spoiled]


def test_a_file_that_is_there_already_is_no_place_for_the_copy(
    spoiled: Path, tmp_path: Path
) -> None:
    mine = tmp_path / "mine.gpkg"
    mine.write_text("mine")
    with (
        open_map(spoiled, writable=True) as universal,
        pytest.raises(MapWriteError, match=r"mine\.gpkg could not be made .*name another file"),
    ):
        universal.repair(keep=mine)
    assert mine.read_text() == "mine"


def test_a_copy_that_another_repair_made_while_this_one_waited_is_not_removed(
    spoiled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "_TELL_EVERY_S", 0.01)
    keep = tmp_path / "kept.gpkg"
    with closing(sqlite3.connect(spoiled, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")

        def goes_on(waited_s: float) -> None:
            if other.in_transaction:
                keep.write_text("the other's")
                other.execute("ROLLBACK")

        with (
            open_map(spoiled, writable=True, patience=Patience(tell=goes_on)) as universal,
            pytest.raises(
                MapWriteError,
                match=r"kept\.gpkg could not be made \(File exists\), and .* try again",
            ),
        ):
            universal.repair(keep=keep)
    assert keep.read_text() == "the other's"


def test_a_link_to_nowhere_is_no_place_for_the_copy_and_stays(
    spoiled: Path, tmp_path: Path
) -> None:
    link = spoiled.with_name("map.before-repair.gpkg")
    link.symlink_to(tmp_path / "missing" / "map.gpkg")
    with (
        open_map(spoiled, writable=True) as universal,
        pytest.raises(MapWriteError, match="File exists"),
    ):
        universal.repair(keep=link)
    assert link.is_symlink()
    result = CliRunner().invoke(app, ["repair", str(spoiled)])
    kept = spoiled.with_name("map.before-repair-2.gpkg")
    assert result.stdout == f"repaired {spoiled}; as it was: {kept}\n", result.output
    assert link.is_symlink()


def test_an_interrupt_after_the_commit_leaves_the_copy(
    spoiled: Path, sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep, before, when_free = tmp_path / "kept.gpkg", content(spoiled), database._when_free

    def interrupted(connection: sqlite3.Connection, statement: str, patience: Patience) -> None:
        when_free(connection, statement, patience)
        if statement == "COMMIT":
            raise KeyboardInterrupt

    with open_map(spoiled, writable=True) as universal, monkeypatch.context() as patched:
        patched.setattr(database, "_when_free", interrupted)
        with pytest.raises(KeyboardInterrupt):
            universal.repair(keep=keep)
    assert content(spoiled) == content(sound)
    assert content(keep) == before


def test_a_copy_that_cannot_be_removed_does_not_hide_why(
    spoiled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On Windows, where a worker has it open."""

    def held(path: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "in use", str(path))

    rot(spoiled)
    with open_map(spoiled, writable=True) as universal, monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", held)
        with pytest.raises(MapError, match="its evidence is damaged"):
            universal.repair(keep=tmp_path / "kept.gpkg")
