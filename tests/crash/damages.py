"""A map of which bytes, pages or cells of tables were damaged: found, or without consequence.

    python -m tests.crash.damages 10000 [--seed 1] [--cells 0:2000:1]

damages so many maps at random, and then each cell of each table in ten ways; of these, the range
that is given, so that they can be tried in parts. Of each it is asked
that opening or `verify` says so in a sentence, or that every command says what it said before; that
a repair that reports success gives the bits of the undamaged map; and that one that is refused
changes nothing. No traceback, no more than 20 s, no more than 500 MB.
"""

from __future__ import annotations

import argparse
import resource
import signal
import sqlite3
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import AnyArray, FieldgridError
from fieldgrid.geometry import (
    DROP_CHANNEL,
    FOOT_CHANNEL,
    GROUND_CHANNEL,
    STEP_CHANNEL,
    TOP_CHANNEL,
    Feature,
    GridSpec,
)
from fieldgrid.maps import Mark, MarkKind, create_map, open_map
from tests.crash.outputs import outputs
from tests.maps.file.maps import DATUM, grid_of, pose_at, track

PAGE = 4096
LONGEST_S = 20
MOST_KB = 500_000
MOST_CHARACTERS = 1500
MOST_FAILURES = 25

ABSOLUTE = ("NULL", "1e300", "'x'", "x'00ff'", "4611686018427387904", "-1", "''")
"""Values that are put into any cell; three more follow from what it held."""


class Damaged(NamedTuple):
    """A damaged map, and what was done to it."""

    what: str
    place: str
    data: bytes


def make(path: Path) -> None:
    """A small map with two drives, one that was removed, marks, a drive that was shifted, frames
    with all channels of terrain, and features that were found in it."""
    spec = GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1)
    grid = grid_of(1, spec)
    with create_map(path, DATUM, cell_m=0.1) as universal:
        for k, name in enumerate("abc"):
            fixes = {"fix": track(3).east_m}
            with universal.add_session(name, trajectory=track(3), inputs=fixes) as session:
                pose = replace(pose_at(2.043 + 0.3 * k, 3.017, 37.3, time_ns=k), up_m=0.4)
                session.add(grid, pose, channels=terrain(spec))
    with open_map(path, writable=True) as universal:
        universal.set_transform("b", 0.25, -0.5, 3.0)
        universal.remove_session("c")
        corners = ((1.0, 1.0), (2.0, 1.0), (1.0, 2.0))
        universal.add_marks(
            [Mark(MarkKind.KEEPOUT, corners, "pond", created="2026-01-01T00:00:00Z")]
        )
        row = Feature("row", shapely.LineString([(1.0, 1.0), (4.0, 2.0)]), {"id": "R1", "cells": 9})
        universal.keep_features([row], universal.root_sha256)


def terrain(spec: GridSpec) -> dict[str, AnyArray]:
    """Channels of a frame over rising ground, with a step, a drop and something that hangs."""
    rise = np.broadcast_to(np.arange(spec.n_y)[:, None], spec.shape)
    seen = np.arange(spec.n_x) % 3
    return {
        GROUND_CHANNEL: (2 * rise + seen).astype(np.int16),
        STEP_CHANNEL: (10 * seen + rise).astype(np.uint8),
        DROP_CHANNEL: (8 * seen + rise).astype(np.uint8),
        TOP_CHANNEL: np.full(spec.shape, 12, np.uint8) + seen.astype(np.uint8),
        FOOT_CHANNEL: np.full(spec.shape, 4, np.uint8) + seen.astype(np.uint8),
    }


class Trial:
    """Tries damaged maps against the whole one, and keeps those that are not as asked."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "map.gpkg"
        make(self._path)
        self.whole = self._path.read_bytes()
        self.failures: list[str] = []
        self._dump = _dump(self.whole)
        self._turn = cycle([True] * 9 + [False])  # every tenth is looked at all the same
        with open_map(self._path) as universal:
            assert universal.verify(jobs=1).sound
            self._outputs = outputs(universal, folder)
        assert not [said for said in self._outputs.values() if "Error" in said], self._outputs

    def try_one(self, damaged: Damaged) -> str:
        """What came of it, in a word or two."""
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
        try:
            return self._outcome(damaged)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is kept and told
            kept = Path("build") / "damaged" / f"{len(self.failures)}.gpkg"
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(damaged.data)
            said = "".join(traceback.format_exception(error, limit=-4))
            self.failures.append(f"{damaged.what} at {damaged.place}; the map is {kept}\n{said}")
            assert len(self.failures) < MOST_FAILURES, "\n".join(self.failures)
            return "NOT AS ASKED"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)

    def _outcome(self, damaged: Damaged) -> str:
        for old in self._folder.glob("map.gpkg*"):
            old.unlink()
        self._path.write_bytes(damaged.data)
        is_same = damaged.data[:100] == self.whole[:100] and _dump(damaged.data) == self._dump
        if is_same and next(self._turn):
            return "no cell is another"
        try:
            with open_map(self._path) as universal:
                health = universal.verify(jobs=1)
                if health.sound:
                    found = outputs(universal, self._folder)
                    assert found == self._outputs, _differing(found, self._outputs)
                    return "without consequence"
                _check_sentences(*health.problems)
                outputs(universal)
        except FieldgridError as error:
            _check_sentences(str(error))
            return f"refused when opened, {self._repaired()}"
        return self._repaired()

    def _repaired(self) -> str:
        before = self._path.read_bytes()
        try:
            with open_map(self._path, writable=True) as universal:
                left = universal.repair(jobs=1)
        except FieldgridError as error:
            _check_sentences(str(error))
            assert _evidence(self._path.read_bytes()) == _evidence(before), "evidence was lost"
            return "found"
        if left:
            return "found, and repaired but for a session that was taken out"
        with open_map(self._path) as universal:  # which repair has verified
            found = outputs(universal, self._folder)
        assert found == self._outputs, _differing(found, self._outputs)
        return "found and repaired"


def _dump(data: bytes) -> list[tuple[object, ...]] | None:
    """All that a program can read of a database; None where it cannot."""
    try:
        with closing(sqlite3.connect(":memory:")) as database:
            database.deserialize(data)
            rows = database.execute("SELECT * FROM sqlite_schema ORDER BY name").fetchall()
            for name in [row[1] for row in rows if row[0] == "table"]:
                rows += database.execute(f"SELECT rowid, * FROM {name} ORDER BY 1").fetchall()
            return [*rows, *database.execute("PRAGMA integrity_check")]
    except (sqlite3.Error, UnicodeDecodeError):
        return None


def _check_sentences(*said: str) -> None:
    for text in said:
        assert text.endswith("."), text
        assert text.isprintable(), text
        assert len(text) < MOST_CHARACTERS, text


def _differing(found: dict[str, str], expected: dict[str, str]) -> str:
    return f"other outputs: {[(k, v) for k, v in found.items() if v != expected.get(k)]}"


def _evidence(data: bytes) -> bytes:
    """What must not change where a repair is refused: all but the counter of changes, the version
    of the library and the mode of the journal, which SQLite itself keeps in the first page."""
    return data[:18] + data[20:24] + data[28:92] + data[100:]


def at_random(whole: bytes, random: np.random.Generator) -> Damaged:
    """A map with bytes, pages or its end damaged."""
    data, pages = bytearray(whole), len(whole) // PAGE
    at = int(random.integers(len(whole)))
    page = PAGE * int(random.integers(pages))
    kind = str(random.choice(["bit", "byte", "run", "zeros", "page zeroed", "page swapped", "end"],
                             p=[0.4, 0.25, 0.15, 0.05, 0.06, 0.06, 0.03]))  # fmt: skip
    if kind == "bit":
        data[at] ^= 1 << int(random.integers(8))
    elif kind == "byte":
        data[at] = int(random.integers(256))
    elif kind == "run":
        some = random.bytes(int(random.integers(2, 65)))[: len(data) - at]
        data[at : at + len(some)] = some
    elif kind == "zeros":
        data[at : at + 512] = bytes(len(data[at : at + 512]))
    elif kind == "page zeroed":
        data[page : page + PAGE] = bytes(PAGE)
    elif kind == "page swapped":
        other = PAGE * int(random.integers(pages))
        data[page : page + PAGE] = whole[other : other + PAGE]
    else:
        del data[at:]
    return Damaged(kind, f"byte {at}, page {page // PAGE}", bytes(data))


def in_cells(whole: bytes) -> Iterator[Damaged]:
    """Each cell of each table in ten ways, and each row twice, past all constraints."""
    for table, columns, rows in _cells(whole):
        for row in rows:
            yield from _row_twice(whole, table, columns, row)
            for column in columns:
                relative = (
                    f"(SELECT {column} FROM {table} WHERE rowid <> {row} LIMIT 1)",
                    f"CASE typeof({column}) WHEN 'integer' THEN {column} + 1 WHEN 'real' THEN "
                    f"{column} + 1e-3 WHEN 'null' THEN 1 ELSE {column} || 'a' END",
                    f"CASE typeof({column}) WHEN 'blob' THEN substr({column}, 1, "
                    f"length({column}) - 1) WHEN 'text' THEN upper({column}) ELSE -{column} END",
                )
                for value in (*ABSOLUTE, *relative):
                    data = _spoilt(whole, table, f"UPDATE OR IGNORE {table} SET {column} = {value} "
                                                 f"WHERE rowid = {row}")  # fmt: skip
                    if data is not None:
                        yield Damaged("cell", f"{table}.{column}, row {row}: {value}", data)


def _row_twice(whole: bytes, table: str, columns: list[str], row: int) -> Iterator[Damaged]:
    for what, statement in (
        ("row missing", f"DELETE FROM {table} WHERE rowid = {row}"),
        (
            "row twice",
            f"INSERT OR IGNORE INTO {table} ({', '.join(columns)}) SELECT {', '.join(columns)} "
            f"FROM {table} WHERE rowid = {row}",
        ),
    ):
        data = _spoilt(whole, table, statement)
        if data is not None:
            yield Damaged(what, f"{table}, row {row}", data)


def _cells(whole: bytes) -> list[tuple[str, list[str], list[int]]]:
    with closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(whole)
        tables = [name for (name,) in database.execute(
            "SELECT name FROM sqlite_schema WHERE type = 'table' AND sql NOT LIKE '%VIRTUAL%' "
            "ORDER BY 1")]  # fmt: skip
        return [
            (
                table,
                [row[1] for row in database.execute(f"PRAGMA table_info({table})")],
                [row[0] for row in database.execute(f"SELECT rowid FROM {table} ORDER BY 1")],
            )
            for table in tables
        ]


def _spoilt(whole: bytes, table: str, statement: str) -> bytes | None:
    """The map after a statement that no constraint holds up; None where nothing has changed."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as database:
        database.deserialize(whole)
        database.text_factory = bytes  # not all that is put in is a text
        rewrite = "UPDATE sqlite_schema SET sql = ? WHERE name = ?"
        (sql,) = database.execute(
            "SELECT sql FROM sqlite_schema WHERE name = ?", (table,)
        ).fetchone()
        sql = sql.decode()
        is_plain = table != "sqlite_sequence"
        if is_plain:
            database.execute("PRAGMA writable_schema = ON")
            database.execute(rewrite, (sql.replace(" NOT NULL", ""), table))
            database.execute("PRAGMA writable_schema = RESET")
            database.execute("PRAGMA ignore_check_constraints = ON")
        before = database.execute(f"SELECT * FROM {table}").fetchall()
        with suppress(sqlite3.IntegrityError):  # of the number of a row
            database.execute(statement)
        if database.execute(f"SELECT * FROM {table}").fetchall() == before:
            return None
        if is_plain:
            database.execute("PRAGMA writable_schema = ON")
            database.execute(rewrite, (sql, table))
        return bytes(database.serialize())


def run_random(trial: Trial, count: int, seed: int) -> Counter[str]:
    """Damage so many maps at random; returns what came of them by kind of damage."""
    random = np.random.default_rng(seed)
    total: Counter[str] = Counter()
    for number in range(count):
        if number and number % 1000 == 0:
            print(f"  {number}: {dict(total)}", flush=True)
        damaged = at_random(trial.whole, random)
        if damaged.data == trial.whole:
            continue
        total[f"{damaged.what}: {trial.try_one(damaged)}"] += 1
    return total


def _too_long(*_: object) -> None:
    raise TimeoutError(f"a damaged map took over {LONGEST_S} s of processor time")


def _range(text: str) -> slice:
    """FIRST:END:STEP, each of which may be missing."""
    return slice(*(int(part) if part else None for part in f"{text}:".split(":")[:3]))


def main() -> None:
    """Run as a program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=1000, help="maps damaged at random")
    parser.add_argument("--seed", type=int, default=1, help="of these; another one, other damages")
    parser.add_argument("--cells", type=_range, default=slice(None), help="FIRST:END:STEP")
    given = parser.parse_args()
    signal.signal(signal.SIGPROF, _too_long)
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder))
        start = time.perf_counter()
        total = run_random(trial, given.count, given.seed)
        print(f"{total.total()} maps damaged at random in {time.perf_counter() - start:.0f} s:")
        for what, number in sorted(total.items()):
            print(f"  {what} {number}")
        start, cells = time.perf_counter(), Counter[str]()
        part = given.cells
        for damaged in islice(in_cells(trial.whole), part.start, part.stop, part.step):
            cells[f"{damaged.what}: {trial.try_one(damaged)}"] += 1
            if cells.total() % 250 == 0:
                print(f"  {cells.total()}: {damaged.place}", flush=True)
        print(f"{cells.total()} damaged cells and rows in {time.perf_counter() - start:.0f} s:")
        for what, number in sorted(cells.items()):
            print(f"  {what} {number}")
    for failure in trial.failures:
        print(failure)
    peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert peak_kb < MOST_KB, f"{peak_kb} kB"
    assert not trial.failures, f"{len(trial.failures)} are not as asked"
    print(f"  none passed for sound that says something else; {peak_kb / 1000:.0f} MB at most")


if __name__ == "__main__":
    main()
