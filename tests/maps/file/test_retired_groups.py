"""Maps with channel groups that others replace: read from their frames, brought up to date with
the next change."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import GROUND_CHANNEL, STEP_CHANNEL, LocalGrid, Pose
from fieldgrid.maps import (
    RETIRED_GROUPS,
    create_map,
    open_map,
    register_group,
    stored_groups,
    unregister,
)
from fieldgrid.maps.file.root import seal
from fieldgrid.maps.file.schema import DERIVED_TABLES
from fieldgrid.maps.health.row_digest import of_rows
from fieldgrid.maps.health.row_sums import begin_sums, fits, kept_sums
from tests.maps.file.content import content
from tests.maps.file.maps import DATUM, drive, grid_of, write_session
from tests.maps.file.test_own_layer import GROUP

LAYERS = ("ground", "ground_sigma", "slope", "roughness", "step", "height", "traversability")


def write(path: Path) -> Path:
    """Two drives over ground that rises to the north, and one without ground."""
    spec = grid_of(0).spec
    rise = np.broadcast_to(np.arange(spec.n_y)[:, None], spec.shape).astype(np.int16)
    seen = LocalGrid(spec, np.zeros(spec.shape, np.uint8), np.ones(spec.shape, np.bool_))
    channels = {GROUND_CHANNEL: rise, STEP_CHANNEL: np.full(spec.shape, 12, np.uint8)}
    with create_map(path, DATUM, cell_m=0.1) as universal:
        for number in range(2):
            with universal.add_session(f"s{number}") as session:
                for k in range(3):
                    pose = Pose(k, 9.7 * k, 0.3 * number, 4.0 + k, 12.0 * k, 0.02, 0.3, 1.0)
                    session.add(seen, pose, frame_id=str(k), channels=channels)
        write_session(universal, "bare", drive(3))
    return path


def aged(path: Path) -> Path:
    """The map as an older program left it: other groups, of which nothing can be read now."""
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for old, new in RETIRED_GROUPS.items():
            for table in ("fieldgrid_session_tile", "fieldgrid_tile"):
                database.execute(
                    f"UPDATE {table} SET channels = ?, data = x'00' WHERE channels = ?", (old, new)
                )
        back = {new: old for old, new in RETIRED_GROUPS.items()}
        groups = json.dumps([back.get(name, name) for name in stored_groups()])
        database.execute(
            "UPDATE fieldgrid_meta SET value = ? WHERE key = 'channel_groups'", (groups,)
        )
        seal(database)
        begin_sums(database)
    return path


def test_they_are_read_from_the_frames(tmp_path: Path) -> None:
    new, old = write(tmp_path / "new.gpkg"), aged(write(tmp_path / "old.gpkg"))
    before = old.read_bytes()
    for cell_m in (0.1, 0.4, 0.25):
        views = [open_map(path).read(cell_m=cell_m, layers=LAYERS) for path in (new, old)]
        for name in LAYERS:
            assert np.isfinite(views[0].layer(name)).any()
            np.testing.assert_array_equal(views[0].layer(name), views[1].layer(name), name)
    with open_map(old) as universal:
        for deep in (False, True):
            found = universal.verify(deep=deep)
            assert found.sound
            # What tells in one reading that nothing was changed does not look into tiles.
            assert deep == ("height, ground, relief were not checked" in " ".join(found.notes))
    assert old.read_bytes() == before


def test_the_next_change_replaces_them(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "fieldgrid")
    new, old = write(tmp_path / "new.gpkg"), aged(write(tmp_path / "old.gpkg"))
    other = aged(write(tmp_path / "other.gpkg"))
    for path in (new, old):
        with open_map(path, writable=True) as universal:
            universal.remove_session("s0")
    with open_map(other, writable=True) as universal:
        assert universal.upgrade()
        assert not universal.upgrade()
        universal.remove_session("s0")
    for path in (old, other):
        assert f"{path} is brought up to date" in caplog.text
        assert content(path) == content(new)
        with open_map(path) as universal:
            for deep in (False, True):
                found = universal.verify(deep=deep)
                assert (found.problems, found.notes) == ((), ())


def test_a_drive_that_is_added_replaces_them(tmp_path: Path) -> None:
    new, old = write(tmp_path / "new.gpkg"), aged(write(tmp_path / "old.gpkg"))
    for path in (new, old):
        with open_map(path, datum=DATUM) as universal:
            write_session(universal, "more", drive(4, heading_deg=80.0))
    assert content(old) == content(new)


def damaged(path: Path, name: str = "s0") -> Path:
    """The map after the frames of a drive have become unreadable."""
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(
            "UPDATE fieldgrid_grid SET data = x'00' WHERE channel = 'ground_cm' AND frame IN ("
            "SELECT id FROM fieldgrid_frame WHERE session_id = ("
            "SELECT id FROM fieldgrid_session WHERE name = ?))",
            (name,),
        )
    return path


def groups(path: Path) -> set[str]:
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT value FROM fieldgrid_meta WHERE key = 'channel_groups'"
        return set(json.loads(database.execute(query).fetchone()[0]))


def test_an_upgrade_that_is_refused_leaves_the_map_as_it_is(tmp_path: Path) -> None:
    old = damaged(aged(write(tmp_path / "old.gpkg")))
    before = old.read_bytes()
    refused = pytest.raises(MapError, match=r"Session 's0': .* damaged.*Take that session out")
    with open_map(old, writable=True) as universal, refused:
        universal.upgrade()
    assert old.read_bytes() == before
    with open_map(old) as universal:
        assert [info.name for info in universal.sessions()] == ["s0", "s1", "bare"]


def test_a_drive_whose_frames_are_damaged_can_be_taken_out(tmp_path: Path) -> None:
    new, old = write(tmp_path / "new.gpkg"), damaged(aged(write(tmp_path / "old.gpkg")))
    for path in (new, old):
        with open_map(path, writable=True) as universal:
            universal.remove_session("s0")
    assert content(old) == content(new)
    assert groups(old) == set(stored_groups())


def test_no_change_is_refused_because_of_damaged_frames(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    new, old = write(tmp_path / "new.gpkg"), damaged(aged(write(tmp_path / "old.gpkg")), "s1")
    for path in (new, old):
        with open_map(path, datum=DATUM) as universal:
            write_session(universal, "more", drive(4, heading_deg=80.0))
    assert "Session 's1'" in caplog.text
    assert "`fieldgrid repair`" in caplog.text
    assert groups(old) == set(stored_groups()) - set(RETIRED_GROUPS.values())
    with closing(sqlite3.connect(old)) as database:  # also what was begun and given up is counted
        kept = kept_sums(database)
        for table in DERIVED_TABLES:
            assert fits(kept[table], of_rows(database, table)), table
    for path in (new, old):
        with open_map(path, writable=True) as universal:
            universal.rename_session("s0", "other")
            universal.remove_session("s1")
    views = [open_map(path).read(layers=LAYERS) for path in (new, old)]
    for name in LAYERS:
        np.testing.assert_array_equal(views[0].layer(name), views[1].layer(name), name)
    with open_map(old, writable=True) as universal:
        left = universal.verify(deep=True).problems
        assert left
        assert all("'s1'" in problem for problem in left)
        assert universal.repair() == left
    assert content(old) == content(new)


def test_the_map_closes_after_a_change_that_was_refused(tmp_path: Path) -> None:
    old = aged(write(tmp_path / "old.gpkg"))
    before = old.read_bytes()
    with open_map(old, writable=True) as universal, pytest.raises(ConfigError, match="no session"):
        universal.remove_session("nope")
    assert old.read_bytes() == before


def test_a_handle_of_before_changes_what_another_one_brought_up_to_date(tmp_path: Path) -> None:
    new, old = write(tmp_path / "new.gpkg"), aged(write(tmp_path / "old.gpkg"))
    with open_map(old, datum=DATUM) as first, open_map(old, writable=True) as second:
        with first.add_session("more") as session:
            assert second.upgrade()
            for frame in drive(2):
                session.add(*frame)
        first.remove_session("s0")
        assert not first.upgrade()
        second.rename_session("s1", "other")
    with open_map(new, datum=DATUM) as universal:
        write_session(universal, "more", drive(2))
        universal.remove_session("s0")
        universal.rename_session("s1", "other")
    assert content(old) == content(new)
    with open_map(old) as universal:
        assert universal.verify(deep=True).problems == ()


def test_a_drive_gets_the_groups_that_another_handle_added(tmp_path: Path) -> None:
    path = write(tmp_path / "map.gpkg")
    register_group(GROUP)
    try:
        with (
            open_map(path, datum=DATUM) as first,
            open_map(path, writable=True) as second,
            first.add_session("more") as session,
        ):
            second.repair()
            for frame in drive(2):
                session.add(*frame)
        with open_map(path) as universal:
            assert universal.verify(deep=True).problems == ()
    finally:
        unregister(GROUP.name)
