"""A map in which any cell of any table holds what it must not: a sentence, never a traceback."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from fieldgrid.errors import DatumError, FieldgridError
from fieldgrid.grids import GridSpec
from fieldgrid.mapfile import MapFile, create_map, open_map
from fieldgrid.mapfile.schema import COUNTED_TABLES, GEOMETRIES, OWN_TABLES
from tests.mapfile.content import content
from tests.mapfile.maps import DATUM, grid_of, pose_at, track

VALUES = ("NULL", "1e300", "'x'", "x'00ff'", "4611686018427387904")
FREE = {
    ("fieldgrid_session", "removed", "NULL"),
    ("fieldgrid_session", "transform", "NULL"),
    *(("density", "id", value) for value in VALUES),
    *(
        (layer, "fid", value)
        for layer in ("trajectory", "frame_position", "footprint")
        for value in VALUES
    ),
    *(("layer_styles", "id", value) for value in VALUES),
    *(("layer_styles", "update_time", value) for value in VALUES),
}
"""What may hold such a value: numbers of rows, and what is left to other programs."""


TABLES = (
    "sqlite_sequence",
    *("gpkg_spatial_ref_sys", "gpkg_contents", "gpkg_tile_matrix", "gpkg_geometry_columns"),
    *("gpkg_tile_matrix_set", "density", "layer_styles", *GEOMETRIES, *OWN_TABLES),
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("damage") / "map.gpkg"
    grid = grid_of(1, GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1))
    with create_map(path, DATUM, cell_m=0.1) as universal:
        for k, name in enumerate("ab"):
            fixes = {"fix": track(3).east_m}
            with universal.add_session(name, trajectory=track(3), inputs=fixes) as session:
                session.add(grid, pose_at(2.043 + 0.3 * k, 3.017, 37.3, time_ns=k))
    return path


def spoil(path: Path, table: str, column: str, value: str) -> bool:
    """Put a value into the last row of a table, past its constraints; whether that changed it."""
    row = f"{table} WHERE rowid = (SELECT max(rowid) FROM {table})"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        before = database.execute(f"SELECT {column} FROM {table}").fetchall()
        (sql,) = database.execute(
            "SELECT sql FROM sqlite_schema WHERE name = ?", (table,)
        ).fetchone()
        database.execute("PRAGMA writable_schema = ON")
        rewrite = "UPDATE sqlite_schema SET sql = ? WHERE name = ?"
        if table != "sqlite_sequence":
            database.execute(rewrite, (sql.replace(" NOT NULL", ""), table))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        with suppress(sqlite3.IntegrityError):  # of the number of a row
            database.execute(f"UPDATE {row.replace(' WHERE', f' SET {column} = {value} WHERE')}")
        database.execute("PRAGMA writable_schema = ON")
        if table != "sqlite_sequence":
            database.execute(rewrite, (sql, table))
    with closing(sqlite3.connect(path)) as database:
        return database.execute(f"SELECT {column} FROM {table}").fetchall() != before


def use(universal: MapFile) -> None:
    """What `sessions`, `query`, `show` and `export` read."""
    for action in (
        lambda: universal.sessions(),
        lambda: universal._repr_html_(),
        lambda: universal.query(2.1, 3.5),
        lambda: universal.read(),
        lambda: universal.read(cell_m=0.25, layers=["max", "ground", "height", "persistence"]),
        lambda: universal.diff("a", "b"),
        lambda: list(universal.frames()),
        lambda: [universal.trajectory(info.name) for info in universal.sessions()],
        lambda: universal.root_sha256,
    ):
        with suppress(FieldgridError):
            action()


@pytest.mark.parametrize("table", TABLES)
def test_any_value_in_any_column_is_a_finding(sound: Path, tmp_path: Path, table: str) -> None:
    with closing(sqlite3.connect(sound)) as database:
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    assert columns
    ours = table in (*OWN_TABLES, "density", "sqlite_sequence")
    passed, path = [], tmp_path / "map.gpkg"
    for column in columns:
        for value in VALUES if ours else ("NULL", "'x'"):
            shutil.copy(sound, path)
            if not spoil(path, table, column, value):
                continue
            with suppress(FieldgridError), open_map(path) as universal:
                found = universal.verify(jobs=1).problems
                assert all(problem.endswith(".") for problem in found), found
                if not found:
                    passed.append((table, column, value))
                use(universal)
    assert set(passed) <= FREE


@pytest.mark.parametrize("table", [*COUNTED_TABLES, "gpkg_contents", "fieldgrid_tile"])
def test_what_is_not_evidence_is_made_again(sound: Path, tmp_path: Path, table: str) -> None:
    damage = [
        ("sqlite_sequence", "seq", f"name = '{table}'"),
        *(("layer_styles", name, "1") for name in ("styleQML", "styleName", "f_table_name")),
        *(("gpkg_contents", name, "1") for name in ("identifier", "description", "last_change")),
        *(("fieldgrid_tile", name, "1") for name in ("zoom", "ty", "data")),
    ]
    for where, column, rows in damage:
        if where not in (table, "sqlite_sequence"):
            continue
        path = tmp_path / "map.gpkg"
        shutil.copy(sound, path)
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute(f"UPDATE {where} SET {column} = 'x' || rowid WHERE {rows}")
        with open_map(path, writable=True) as universal:
            if table not in ("gpkg_contents", "fieldgrid_tile") or where == table:
                assert universal.verify().problems
            universal.repair()
            assert universal.verify().problems == ()
        assert content(path) == content(sound)


def test_the_header_of_the_file_is_checked(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA user_version = 10200")
    with open_map(path, writable=True) as universal:
        (problem,) = universal.verify().problems
        assert "version 10200, and not 10300" in problem
        universal.repair()
        assert universal.verify().sound


def test_no_height_can_overflow_the_sums(tmp_path: Path) -> None:
    with (
        create_map(tmp_path / "map.gpkg", DATUM, cell_m=0.1) as universal,
        universal.add_session("high") as session,
    ):
        for up_m in (1e300, -1e6, float("inf")):
            with pytest.raises(DatumError, match="m up is over 50 km"):
                session.add(grid_of(1), replace(pose_at(0.0, 0.0, 0.0), up_m=up_m))
