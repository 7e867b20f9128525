"""What becomes of the file: made at once, never half, and refused when it is not ours."""

from __future__ import annotations

import errno
import gc
import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, DatumError, MapError, MapExistsError, MapWriteError, publish
from fieldgrid.geometry import Datum
from fieldgrid.maps import MapFile, Patience, Transfer, create_map, open_map, read_datum
from fieldgrid.maps.file import database
from fieldgrid.maps.tiles.pyramid import Pyramid
from tests.maps.file.maps import CELL_M, DATUM, drive, write_map, write_session


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def session_names(path: Path) -> list[str]:
    with open_map(path) as universal:
        universal.read()
        return [info.name for info in universal.sessions()]


def add(
    path: Path,
    name: str = "more",
    datum: Datum = DATUM,
    patience: Patience = database.USUAL_PATIENCE,
) -> None:
    with open_map(path, datum=datum, patience=patience) as universal:
        write_session(universal, name, drive(4, heading_deg=120.0))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_map(tmp_path / "map.gpkg", [drive(4)])


# --- making one


def break_after_a_session(universal: MapFile) -> None:
    with universal.add_session("one"):
        pass
    raise RuntimeError


def test_a_map_appears_when_its_block_ends_and_not_before(tmp_path: Path) -> None:
    path = tmp_path / "a b?#%ä.gpkg"
    with open_map(path, datum=DATUM, cell_m=CELL_M, transfer=Transfer.AREA) as universal:
        write_session(universal, "one", drive(3))
        assert universal.read().observed.any()
        (partial,) = names_in(tmp_path)
        assert partial.startswith(f".{path.name}.")
        assert partial.endswith(".partial.gpkg")
    assert names_in(tmp_path) == [path.name]
    with open_map(str(path)) as universal:
        assert (universal.datum, universal.cell_m) == (DATUM, CELL_M)
        assert universal.transfer is Transfer.AREA
    assert read_datum(path) == DATUM
    mask = os.umask(0o022)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize("end", ["error", "empty", "forgotten", "discarded", "error in session"])
def test_a_map_that_is_given_up_leaves_nothing(tmp_path: Path, end: str) -> None:
    if end == "error":
        with pytest.raises(RuntimeError), create_map(tmp_path / "x", DATUM) as universal:
            break_after_a_session(universal)
    elif end == "empty":
        with create_map(tmp_path / "x", DATUM):
            pass
    elif end == "error in session":
        with (
            pytest.raises(KeyboardInterrupt),
            create_map(tmp_path / "x", DATUM) as universal,
            universal.add_session("one"),
        ):
            raise KeyboardInterrupt
    else:
        universal = create_map(tmp_path / "x", DATUM)
        with universal.add_session("one"):
            pass
        if end == "discarded":
            universal.discard()
            universal.close()
        del universal
        gc.collect()
    assert names_in(tmp_path) == []


def test_an_existing_map_is_replaced_only_when_asked(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(MapExistsError, match=r"another name, --append .*--overwrite") as caught:
        create_map(path, DATUM)
    assert isinstance(caught.value, FileExistsError)
    with pytest.raises(RuntimeError), create_map(path, DATUM, overwrite=True) as universal:
        break_after_a_session(universal)
    assert path.read_bytes() == before
    with create_map(path, DATUM, cell_m=CELL_M, overwrite=True) as universal:
        write_session(universal, "new", drive(2))
        assert path.read_bytes() == before
    assert session_names(path) == ["new"]
    assert names_in(path.parent) == ["map.gpkg"]


def test_of_two_that_make_one_map_the_second_is_told(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    late = create_map(path, DATUM, cell_m=CELL_M)
    write_session(late, "late", drive(1))
    write_map(path, [drive(2)])
    with pytest.raises(MapExistsError, match="exists already"):
        late.close()
    assert session_names(path) == ["0"]
    assert names_in(tmp_path) == ["map.gpkg"]


@pytest.mark.parametrize("taken", [False, True])
def test_without_hard_links_the_name_is_still_taken_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taken: bool
) -> None:
    def no_links(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(publish.os, "link", no_links)
    path = tmp_path / "map.gpkg"
    universal = create_map(path, DATUM, cell_m=CELL_M)
    write_session(universal, "one", drive(2))
    if taken:
        path.write_text("mine")
        with pytest.raises(MapExistsError):
            universal.close()
        assert path.read_text() == "mine"
    else:
        universal.close()
        assert session_names(path) == ["one"]
    assert names_in(tmp_path) == ["map.gpkg"]


def test_a_journal_of_an_older_map_is_not_played_into_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    universal = create_map(path, DATUM, cell_m=CELL_M)
    write_session(universal, "one", drive(2))
    stray = tmp_path / "map.gpkg-journal"
    stray.write_bytes(b"old")
    with pytest.raises(MapWriteError, match=r"map\.gpkg-journal lies beside"):
        universal.close()
    assert names_in(tmp_path) == [stray.name]


def test_a_folder_that_is_missing_full_or_closed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(MapWriteError, match="folder does not exist"):
        create_map(tmp_path / "no" / "map.gpkg", DATUM)
    with pytest.raises(MapExistsError, match="is a folder"):
        create_map(tmp_path, DATUM, overwrite=True)
    for code, words in ((errno.EACCES, "permissions"), (errno.ENOSPC, "disk is full")):

        def refuse(*_: object, code: int = code) -> int:
            raise OSError(code, os.strerror(code))

        monkeypatch.setattr(publish.os, "open", refuse)
        with pytest.raises(MapWriteError, match=words):
            create_map(tmp_path / "map.gpkg", DATUM)
        monkeypatch.undo()
    assert names_in(tmp_path) == []


# --- adding to one


def test_a_map_keeps_its_datum_cells_and_rule(path: Path) -> None:
    before = path.read_bytes()
    for other in (
        Datum(DATUM.lat_deg + 2e-9, DATUM.lon_deg, DATUM.height_m),
        Datum(DATUM.lat_deg, DATUM.lon_deg - 2e-9, DATUM.height_m),
        Datum(DATUM.lat_deg, DATUM.lon_deg, DATUM.height_m + 0.002),
    ):
        with pytest.raises(DatumError, match="for good"):
            open_map(path, datum=other)
    with pytest.raises(ConfigError, match=r"cells of 0\.1 m, not 0\.25 m; leave"):
        open_map(path, datum=DATUM, cell_m=0.25)
    with pytest.raises(ConfigError, match=r"the centre rule, not area; leave"):
        open_map(path, datum=DATUM, transfer=Transfer.AREA)
    assert path.read_bytes() == before
    close = Datum(DATUM.lat_deg + 5e-10, DATUM.lon_deg, DATUM.height_m + 0.0005)
    with open_map(path, datum=close, cell_m=0.1, transfer=Transfer.CENTRE) as universal:
        assert universal.datum == DATUM
    add(path, datum=close)
    assert session_names(path) == ["0", "more"]
    assert names_in(path.parent) == ["map.gpkg"]


def test_a_reader_sees_the_last_committed_state_while_a_session_is_written(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    update = Pyramid.change

    def look_while_updating(*arguments: object, **options: object) -> None:
        update(*arguments, **options)  # type: ignore[arg-type]
        seen.append(session_names(path))

    with open_map(path, datum=DATUM) as universal, open_map(path) as reader:
        before = reader.read()
        monkeypatch.setattr(Pyramid, "change", look_while_updating)
        with universal.add_session("more") as session:
            session.add(*drive(1, heading_deg=120.0)[0])
            assert session_names(path) == ["0"]
            np.testing.assert_array_equal(reader.read().density, before.density)
        assert seen == [["0"]]
        assert [info.name for info in reader.sessions()] == ["0", "more"]


def test_a_second_writer_waits(path: Path) -> None:
    def write(name: str) -> None:
        for k in range(4):
            add(path, f"{name}{k}")

    threads = [threading.Thread(target=write, args=(name,)) for name in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(session_names(path)) == 1 + 12
    once = write_map(path.with_name("once.gpkg"), [drive(4), *[drive(4, heading_deg=120.0)] * 12])
    np.testing.assert_array_equal(open_map(path).read().density, open_map(once).read().density)


def test_a_writer_that_waited_in_vain_says_so(path: Path) -> None:
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(MapWriteError, match=r"in use by another program.*not changed"):
        add(path, patience=Patience(0.05))
    other.execute("COMMIT")
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(MapError, match="being written by another program"):
        open_map(path, patience=Patience(0.05)).read()
    other.close()
    assert session_names(path) == ["0"]


def test_a_full_disk_leaves_the_map_as_it_was(path: Path) -> None:
    before = path.read_bytes()
    with open_map(path, datum=DATUM) as universal:
        (pages,) = universal._connection.execute("PRAGMA page_count").fetchone()
        universal._connection.execute(f"PRAGMA max_page_count = {pages + 2}")
        with pytest.raises(MapWriteError, match="disk is full") as caught:
            write_session(universal, "more", drive(9, heading_deg=120.0))
        assert isinstance(caught.value, OSError)
        assert [info.name for info in universal.sessions()] == ["0"]
    assert path.read_bytes() == before


def test_a_new_map_on_a_full_disk_is_not_half_there(tmp_path: Path) -> None:
    universal = create_map(tmp_path / "map.gpkg", DATUM, cell_m=CELL_M)
    universal._connection.execute("PRAGMA max_page_count = 30")
    with pytest.raises(MapWriteError, match="disk is full"), universal:
        write_session(universal, "one", drive(9))
    assert names_in(tmp_path) == []


PROGRAM = """
    import os, resource, signal, sys
    from pathlib import Path
    from fieldgrid.core import MapWriteError
    from fieldgrid.maps import create_map, open_map
    from fieldgrid.maps.tiles.pyramid import Pyramid
    from tests.maps.file.maps import CELL_M, DATUM, drive, write_session
    path = Path(sys.argv[1])
"""


def run(program: str, path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(PROGRAM) + textwrap.dedent(program), str(path)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=Path(__file__).resolve().parents[3],
    )


def test_a_file_that_may_not_grow_leaves_the_map_as_it_was(path: Path) -> None:
    before = path.read_bytes()
    done = run(
        """
        limit = path.stat().st_size + 20_000
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        try:
            with open_map(path, datum=DATUM) as universal:
                write_session(universal, "more", drive(20, heading_deg=120.0))
        except MapWriteError as error:
            print("refused:", error)
        """,
        path,
    )
    assert done.stdout.startswith("refused: "), done.stderr
    assert "was not changed" in done.stdout
    assert session_names(path) == ["0"]
    assert path.read_bytes() == before
    assert names_in(path.parent) == ["map.gpkg"]
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_a_repair_whose_copy_does_not_fit_leaves_nothing(path: Path) -> None:
    before = path.read_bytes()
    done = run(
        """
        limit = path.stat().st_size // 3
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        try:
            with open_map(path, writable=True) as universal:
                universal.repair(keep=path.with_name("kept.gpkg"))
        except MapWriteError as error:
            print("refused:", error)
        """,
        path,
    )
    assert done.stdout.startswith("refused: "), done.stderr
    assert path.read_bytes() == before
    assert names_in(path.parent) == ["map.gpkg"]


@pytest.mark.parametrize("new", [False, True])
def test_a_writer_that_is_killed_leaves_the_map_as_it_was(path: Path, new: bool) -> None:
    before = open_map(path).read()
    target = path.with_name("new.gpkg") if new else path
    done = run(
        """
        update = Pyramid.change
        def update_and_die(*arguments, **options):
            update(*arguments, **options)
            os.kill(os.getpid(), signal.SIGKILL)
        with open_map(path, datum=DATUM, cell_m=CELL_M) as universal:
            universal._connection.execute("PRAGMA cache_size = 5")  # so pages reach the file
            Pyramid.change = update_and_die
            write_session(universal, "more", drive(20, heading_deg=120.0))
        """,
        target,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert target.exists() is not new
    if not new:
        assert names_in(path.parent) == ["map.gpkg", "map.gpkg-journal"]
    assert session_names(path) == ["0"]
    np.testing.assert_array_equal(open_map(path).read().density, before.density)
    if not new:
        assert names_in(path.parent) == ["map.gpkg"]
        add(path)
        assert session_names(path) == ["0", "more"]


def test_a_map_that_may_not_be_written_can_be_read(path: Path) -> None:
    with open_map(path, datum=DATUM) as universal:
        # What a read-only file answers; the permissions themselves do not bind root.
        universal._connection.execute("PRAGMA query_only = 1")
        with pytest.raises(MapWriteError, match="check the permissions"):
            write_session(universal, "more", drive(1))
    assert session_names(path) == ["0"]


def test_a_map_left_in_write_ahead_mode_becomes_one_file_again(path: Path) -> None:
    other = sqlite3.connect(path)
    assert other.execute("PRAGMA journal_mode = WAL").fetchone() == ("wal",)
    other.close()
    assert session_names(path) == ["0"]
    add(path)
    with path.open("rb") as file:
        file.seek(18)
        assert file.read(2) == b"\x01\x01"  # the header's rollback mode; 2 is write-ahead
    assert names_in(path.parent) == ["map.gpkg"]


# --- refusing one


def test_a_map_that_is_not_there_is_not_made_by_reading(tmp_path: Path) -> None:
    for ask in (open_map, read_datum):
        with pytest.raises(MapError, match="There is no map"):
            ask(tmp_path / "map.gpkg")
    with pytest.raises(MapError, match="is a folder, a pipe or a device"):
        open_map(tmp_path)
    assert names_in(tmp_path) == []


def test_files_of_others_are_refused(tmp_path: Path, path: Path) -> None:
    (tmp_path / "empty").touch()
    (tmp_path / "text").write_text("not a database, " * 100)
    for name, statements in (
        ("database", ["CREATE TABLE fieldgrid_meta (key TEXT, value TEXT)"]),
        ("geopackage", ["PRAGMA application_id = 0x47504B47", "CREATE TABLE gpkg_contents (a)"]),
    ):
        other = sqlite3.connect(tmp_path / name)
        for statement in statements:
            other.execute(statement)
        other.close()
    for name in ("empty", "text", "database", "geopackage"):
        before = (tmp_path / name).read_bytes()
        for datum in (None, DATUM):
            with pytest.raises(MapError, match="is not a fieldgrid map"):
                open_map(tmp_path / name, datum=datum)
        assert (tmp_path / name).read_bytes() == before


def changed(path: Path, *statements: str) -> Path:
    copy = path.with_name("changed.gpkg")
    shutil.copy(path, copy)
    other = sqlite3.connect(copy, isolation_level=None)
    other.execute("PRAGMA writable_schema = ON")
    for statement in statements:
        other.execute(statement)
    other.close()
    return copy


def test_a_newer_format_is_refused_by_both_numbers(path: Path) -> None:
    newer = changed(path, "UPDATE fieldgrid_meta SET value = '7' WHERE key = 'format_version'")
    with pytest.raises(MapError, match=r"format version 7.*up to 4; update fieldgrid"):
        open_map(newer)


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM fieldgrid_meta WHERE key = 'cell_m'",
        "UPDATE fieldgrid_meta SET value = 'x' WHERE key = 'format_version'",
        "UPDATE fieldgrid_meta SET value = '91' WHERE key = 'datum_lat_deg'",
        "UPDATE fieldgrid_meta SET value = '-1' WHERE key = 'cell_m'",
        "UPDATE fieldgrid_meta SET value = 'best' WHERE key = 'transfer'",
        "UPDATE fieldgrid_meta SET value = '[1, 2]' WHERE key = 'data_window'",
        "UPDATE fieldgrid_meta SET value = '[1, 2, -3, 4]' WHERE key = 'data_window'",
        "DROP TABLE fieldgrid_tile",
        "DROP TABLE trajectory",
        "UPDATE fieldgrid_tile SET data = zeroblob(100)",
        "UPDATE fieldgrid_tile SET data = 'text'",
        "UPDATE fieldgrid_grid SET data = zeroblob(10)",
        "UPDATE fieldgrid_frame SET status = 'fine'",
        "UPDATE fieldgrid_frame SET images = '{'",
        "UPDATE fieldgrid_frame SET east_m = 'x'",
        "UPDATE fieldgrid_session SET config = '['",
        "UPDATE fieldgrid_session SET grid_cell_m = 1e-9",
        "UPDATE fieldgrid_session SET grid_width_m = 'wide'",
    ],
)
def test_damage_inside_is_an_error_of_ours(path: Path, statement: str) -> None:
    damaged = changed(path, statement)
    with pytest.raises(MapError, match="damaged"):
        read_everything(damaged)


def read_everything(path: Path) -> None:
    with open_map(path) as universal:
        universal.sessions()
        for frame in universal.frames(with_grid=True):
            frame.grid()
        universal.read()
        universal.read(cell_m=0.3)


def test_a_file_cut_short_or_overwritten_is_an_error_of_ours(path: Path) -> None:
    whole = path.read_bytes()
    read_everything(path)
    damaged = path.with_name("damaged.gpkg")
    for size in range(0, len(whole), len(whole) // 40):
        damaged.write_bytes(whole[:size])
        with pytest.raises(MapError):
            read_everything(damaged)
    random = np.random.default_rng(1)
    refused = 0
    for _ in range(60):
        noise = bytearray(whole)
        start = int(random.integers(0, len(whole) - 4096))
        noise[start : start + 2048] = random.bytes(2048)
        damaged.write_bytes(noise)
        try:
            read_everything(damaged)
        except MapError:
            refused += 1
    assert refused > 10  # the rest hit what is only shown: pictures and layers


def test_a_hostile_view_in_place_of_a_table_is_refused(path: Path) -> None:
    hostile = changed(
        path,
        "DROP TABLE fieldgrid_session",
        "CREATE VIEW fieldgrid_session AS WITH RECURSIVE n(i) AS "
        "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, i AS name FROM n",
    )
    with pytest.raises(MapError, match="no table fieldgrid_session"):
        open_map(hostile)


def test_a_closed_map_says_so(path: Path) -> None:
    universal = open_map(path)
    universal.close()
    universal.close()
    with pytest.raises(MapError, match="is closed"):
        universal.read()


def test_what_a_killed_writer_left_of_a_new_map_goes_with_the_next_one(tmp_path: Path) -> None:
    done = run(
        """
        with open_map(path, datum=DATUM, cell_m=CELL_M) as universal:
            write_session(universal, "one", drive(3))
            os.kill(os.getpid(), signal.SIGKILL)
        """,
        tmp_path / "map.gpkg",
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert any(name.endswith(".partial.gpkg") for name in names_in(tmp_path))
    other = create_map(tmp_path / "map.gpkg.gpkg", DATUM, cell_m=CELL_M)
    mine = create_map(tmp_path / "map.gpkg", DATUM, cell_m=CELL_M)
    late = create_map(tmp_path / "map.gpkg", DATUM, cell_m=CELL_M)  # leaves the living ones alone
    for universal in (late, other, mine):
        write_session(universal, "one", drive(1))
    late.discard()
    other.close()
    mine.close()
    assert names_in(tmp_path) == ["map.gpkg", "map.gpkg.gpkg"]


def test_a_journal_that_was_never_needed_is_not_in_the_way_of_a_new_map(path: Path) -> None:
    path.with_name("map.gpkg-journal").write_bytes(bytes(512))
    write_map(path.with_name("other.gpkg"), [drive(1)])
    with create_map(path, DATUM, cell_m=CELL_M, overwrite=True) as universal:
        write_session(universal, "new", drive(2))
    assert session_names(path) == ["new"]
    assert names_in(path.parent) == ["map.gpkg", "other.gpkg"]


def test_a_format_of_before_the_first_release_is_refused_with_what_to_do(path: Path) -> None:
    older = changed(path, "UPDATE fieldgrid_meta SET value = '1' WHERE key = 'format_version'")
    with pytest.raises(MapError, match=r"format version 1, .*build it again from its recordings"):
        open_map(older)
