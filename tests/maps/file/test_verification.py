"""What `verify` finds, and what `repair` can make good."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import MapError
from fieldgrid.maps import MapFile, merge_maps, open_map
from fieldgrid.maps.health import feature_check, tile_check, verification
from fieldgrid.maps.writing.placing import TileSquares
from fieldgrid.maps.writing.subject import Subject
from tests.maps.file.content import content
from tests.maps.file.maps import drive, track, write_map, write_session


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "map.gpkg"
    write_map(
        path,
        [drive(6, step_m=4.0), drive(5, 1.5, -70.0), drive(4, heading_deg=200.0)],
        trajectory=track(9),
    )
    with open_map(path, writable=True) as universal:
        universal.remove_session("2")
    return path


def changed(sound: Path, tmp_path: Path, statement: str) -> Path:
    copy = tmp_path / "changed.gpkg"
    shutil.copy(sound, copy)
    database = sqlite3.connect(copy, isolation_level=None)
    assert database.execute(statement).rowcount != 0, "the statement changes nothing"
    database.close()
    return copy


def problems(path: Path) -> tuple[str, ...]:
    """What is wrong with a map; nothing is, where its sums fit."""
    with open_map(path) as universal:
        verdict = universal.verify()
        if verdict.deep:  # the sums did not fit, and everything was made again
            return verdict.problems
        assert universal.verify(deep=True).problems == ()
        return ()


def test_a_map_as_written_is_sound(sound: Path) -> None:
    with open_map(sound) as universal:
        verdict = universal.verify(deep=True)
    assert verdict.sound
    assert (verdict.sessions, verdict.removed, verdict.frames) == (3, 1, 15)
    assert verdict.tiles > 1


LAST_DENSITY_TILE = "rowid = (SELECT max(rowid) FROM fieldgrid_tile WHERE channels = 'density')"
DERIVED = [
    "UPDATE fieldgrid_tile SET data = (SELECT data FROM fieldgrid_tile WHERE channels = 'count' "
    "LIMIT 1) WHERE rowid = (SELECT max(rowid) FROM fieldgrid_tile WHERE channels = 'count')",
    f"DELETE FROM fieldgrid_tile WHERE {LAST_DENSITY_TILE}",
    "DELETE FROM fieldgrid_tile WHERE ty = 0",
    "UPDATE fieldgrid_tile SET data = zeroblob(20) WHERE ty = 0 AND channels = 'drop'",
    "UPDATE density SET tile_data = (SELECT tile_data FROM density WHERE id = 1)",
    "DELETE FROM density WHERE id = 2",
    "DELETE FROM gpkg_tile_matrix WHERE zoom_level = (SELECT min(zoom_level) FROM density)",
    "UPDATE gpkg_tile_matrix_set SET min_x = 0",
    "UPDATE gpkg_contents SET max_x = 0 WHERE table_name = 'density'",
    "DELETE FROM fieldgrid_meta WHERE key = 'data_window'",
    "UPDATE trajectory SET heading_deg = 0 WHERE fid = 3",
    "DELETE FROM frame_position",
    "UPDATE footprint SET geom = NULL WHERE fid = 1",
    "DELETE FROM fieldgrid_extent",
    "UPDATE gpkg_contents SET srs_id = 4326 WHERE table_name = 'density'",
    "UPDATE gpkg_geometry_columns SET srs_id = 4326 WHERE table_name = 'trajectory'",
    "UPDATE gpkg_spatial_ref_sys SET definition = replace(definition, '41', '42') "
    "WHERE srs_id = 100001",
    "UPDATE fieldgrid_session SET accepted = accepted - 1 WHERE name = '1'",
    "UPDATE fieldgrid_session SET first_time_ns = first_time_ns + 1",
    "UPDATE fieldgrid_meta SET value = 'x' || value WHERE key = 'root_sha256'",
    "UPDATE gpkg_contents SET description = 'drives' WHERE table_name = 'fieldgrid_session'",
]
MORE_DERIVED = [
    f"UPDATE fieldgrid_tile SET data = 'text' WHERE {LAST_DENSITY_TILE}",
    "DELETE FROM fieldgrid_tile",
    f"UPDATE fieldgrid_tile SET ty = ty + 90 WHERE {LAST_DENSITY_TILE}",
    "UPDATE density SET tile_data = x'00' WHERE id = 2",
    "INSERT INTO density SELECT NULL, zoom_level, tile_column + 7, tile_row, tile_data "
    "FROM density LIMIT 1",
    "UPDATE gpkg_tile_matrix SET pixel_x_size = 1",
    "UPDATE gpkg_contents SET min_x = 0 WHERE table_name = 'layer_styles'",
    "UPDATE gpkg_contents SET min_y = 0 WHERE table_name = 'footprint'",
    "DELETE FROM gpkg_contents WHERE table_name = 'trajectory'",
    "UPDATE fieldgrid_meta SET value = '[0, 0, 1, 1]' WHERE key = 'data_window'",
    "DELETE FROM trajectory WHERE fid = 3",
    "UPDATE frame_position SET status = 'rejected' WHERE fid = 1",
    "DELETE FROM fieldgrid_tile WHERE channels = 'count'",
    "UPDATE fieldgrid_tile SET zoom = zoom - 9 WHERE zoom = (SELECT min(zoom) FROM fieldgrid_tile)",
    "UPDATE gpkg_contents SET data_type = 'tiles' WHERE table_name = 'footprint'",
    "UPDATE gpkg_tile_matrix_set SET srs_id = 4326",
    "UPDATE gpkg_geometry_columns SET geometry_type_name = 'LINESTRING'",
    "UPDATE gpkg_spatial_ref_sys SET organization_coordsys_id = 4258 WHERE srs_id = 4326",
    "UPDATE fieldgrid_extent SET west_m = west_m - 1",
    "UPDATE fieldgrid_session SET last_time_ns = 0",
]

ROOT = [
    "UPDATE fieldgrid_session SET removed = NULL WHERE name = '2'",
    "UPDATE fieldgrid_session SET removed = 'now' WHERE name = '1'",
    "UPDATE fieldgrid_session SET name = 'one' WHERE name = '1'",
    "UPDATE fieldgrid_session SET created = '2020-01-01' WHERE name = '1'",
    'UPDATE fieldgrid_session SET transform = \'{"rigid": {"shift_east_m": 1.0, '
    '"shift_north_m": 0.0, "turn_deg": 0.0, "pivot_east_m": 0.0, '
    "\"pivot_north_m\": 0.0}}' WHERE name = '1'",
    "UPDATE fieldgrid_session SET id = id + 10",
    "UPDATE fieldgrid_meta SET value = '39.407121235' WHERE key = 'datum_lat_deg'",
    "UPDATE fieldgrid_meta SET value = '700.0' WHERE key = 'datum_height_m'",
    "UPDATE fieldgrid_meta SET value = '0.2' WHERE key = 'cell_m'",
    "UPDATE fieldgrid_meta SET value = 'area' WHERE key = 'transfer'",
    "UPDATE fieldgrid_meta SET value = '[\"density\"]' WHERE key = 'channel_groups'",
]


@pytest.mark.parametrize("statement", ROOT)
def test_what_nothing_else_tells_is_under_the_root_digest(
    sound: Path, tmp_path: Path, statement: str
) -> None:
    path = changed(sound, tmp_path, statement)
    assert any("root digest" in problem for problem in problems(path))
    before = path.read_bytes()
    for change in (MapFile.repair, lambda universal: universal.remove_session("0")):
        with (
            open_map(path, writable=True) as universal,
            pytest.raises(MapError, match="not as it was written"),
        ):
            change(universal)
    assert path.read_bytes() == before


def test_the_root_digest_changes_with_each_commit_and_comes_back(
    sound: Path, tmp_path: Path
) -> None:
    path = tmp_path / "map.gpkg"
    shutil.copy(sound, path)
    with open_map(path, writable=True) as universal:
        seen = [universal.root_sha256]
        universal.set_transform("1", 0.5, 0.0)
        seen.append(universal.root_sha256)
        universal.remove_session("0")
        seen.append(universal.root_sha256)
        universal.restore_session("0")
        universal.set_transform("1", 0.0, 0.0)
        assert universal.root_sha256 == seen[0]
    assert len(set(seen)) == 3


@pytest.mark.parametrize(
    ("statement", "problem"),
    [
        (
            "CREATE TRIGGER gone AFTER UPDATE ON fieldgrid_session BEGIN DELETE FROM "
            "fieldgrid_frame; END",
            "trigger gone of fieldgrid_session changes the map",
        ),
        (
            'CREATE TRIGGER gone AFTER INSERT ON layer_styles BEGIN DELETE FROM "FIELDGRID_FRAME"; '
            "END",
            "trigger gone of layer_styles changes the map",
        ),
        ("CREATE UNIQUE INDEX one ON layer_styles (f_table_name)", "index one of layer_styles"),
        ("CREATE UNIQUE INDEX once ON fieldgrid_session (accepted)", "index once of fieldgrid_ses"),
        ("CREATE INDEX one ON fieldgrid_frame (abs(east_m))", "index one of fieldgrid_frame"),
        ("CREATE INDEX one ON fieldgrid_frame (id) WHERE abs(id)", "index one of fieldgrid_frame"),
        ("CREATE INDEX one ON fieldgrid_frame (id) WHERE quality", "index one of fieldgrid_frame"),
        ("CREATE INDEX one ON density (tile_row /* ) */, abs(id))", "index one of density"),
        ("DROP INDEX trajectory_by_session", "index trajectory_by_session is not laid out"),
        ("ALTER TABLE fieldgrid_frame ADD COLUMN more TEXT", "table fieldgrid_frame is not laid"),
    ],
)
def test_the_layout_of_the_tables_is_checked(
    sound: Path, tmp_path: Path, statement: str, problem: str
) -> None:
    path = tmp_path / "changed.gpkg"
    shutil.copy(sound, path)
    with closing(sqlite3.connect(path)) as database:
        database.execute(statement)
        database.commit()
    assert problem in problems(path)[0]


@pytest.mark.parametrize(
    "index",
    [
        'one ON fieldgrid_frame ("east_m", north_m DESC)',
        "one ON frame_position ([fid])",
        "one ON frame_position (frame_id COLLATE nocase)",
        '"one(1)" ON frame_position (`fid`) -- of another program',
        "one/**/ON frame_position (session)",
    ],
)
def test_an_index_of_another_program_that_takes_any_row_is_none_of_ours(
    sound: Path, tmp_path: Path, index: str
) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(f"CREATE INDEX {index}")
    assert problems(path) == ()


def test_an_index_in_an_order_that_only_another_program_has_is_told_of(
    sound: Path, tmp_path: Path
) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.create_collation("theirs", lambda a, b: (a > b) - (a < b))
        database.execute("CREATE INDEX one ON frame_position (frame_id COLLATE theirs)")
    assert any("index one of frame_position" in problem for problem in problems(path))


def test_a_map_whose_rows_gdal_counts_can_be_changed(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("CREATE TABLE gpkg_ogr_contents (table_name TEXT, feature_count INTEGER)")
        database.execute(
            'CREATE TRIGGER "trigger_insert_feature_count_fieldgrid_session" AFTER INSERT ON '
            '"fieldgrid_session" BEGIN UPDATE gpkg_ogr_contents SET feature_count = feature_count '
            "+ 1 WHERE lower(table_name) = lower('fieldgrid_session'); END"
        )
    assert problems(path) == ()
    with open_map(path, writable=True) as universal:
        before = len(universal.sessions())
        write_session(universal, "more", drive(1))
        assert len(universal.sessions()) == before + 1


def test_a_trigger_that_looks_up_another_layer_is_none_of_ours(sound: Path, tmp_path: Path) -> None:
    """As GDAL makes it for tiles that it adds to the file."""
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("CREATE TABLE photo (zoom_level INTEGER)")
        database.execute(
            "CREATE TRIGGER photo_zoom_insert BEFORE INSERT ON photo BEGIN SELECT RAISE(ABORT, "
            "'no such level') WHERE NOT (NEW.zoom_level IN (SELECT zoom_level FROM "
            "gpkg_tile_matrix WHERE lower(table_name) = lower('photo'))); END"
        )
    assert problems(path) == ()
    with open_map(path, writable=True) as universal:
        universal.remove_session("0")


def test_a_map_whose_frames_a_trigger_would_delete_is_not_changed(
    sound: Path, tmp_path: Path
) -> None:
    """Also where the trigger is one of another program's own table, or of a view."""
    for setting_off, deletes in (
        ("UPDATE ON gpkg_contents", "fieldgrid_frame"),
        ("INSERT ON more", "fieldgrid_frame"),
        ("UPDATE ON gpkg_spatial_ref_sys", "more"),
        ("DELETE ON more", '"Density"'),
    ):
        path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute("CREATE TABLE more (a)")
            database.execute(
                f"CREATE TRIGGER gone AFTER {setting_off} BEGIN DELETE FROM {deletes}; END"
            )
        before = path.read_bytes()
        with open_map(path, writable=True) as universal:
            for change in (
                lambda universal: universal.remove_session("0"),
                lambda universal: write_session(universal, "more", drive(1)),
                MapFile.repair,
            ):
                with pytest.raises(MapError, match="gone"):
                    change(universal)
        assert path.read_bytes()[100:] == before[100:]
        assert "trigger gone" in problems(path)[0]


def test_a_trigger_of_a_layer_is_gone_when_the_layer_is_made_again(
    sound: Path, tmp_path: Path
) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(
            "CREATE TRIGGER gone AFTER DELETE ON FRAME_POSITION BEGIN DELETE FROM density; END"
        )
    with open_map(path, writable=True) as universal:
        with pytest.raises(MapError, match="gone"):
            universal.remove_session("0")
        assert "trigger gone" in universal.verify().problems[0]
        assert universal.repair() == ()
        universal.remove_session("0")
        assert universal.verify().sound


@pytest.mark.parametrize(
    "statement", [*DERIVED, *(pytest.param(one, marks=pytest.mark.long) for one in MORE_DERIVED)]
)
def test_what_does_not_follow_from_the_evidence_is_found_and_repaired(
    sound: Path, tmp_path: Path, statement: str
) -> None:
    path = changed(sound, tmp_path, statement)
    found = problems(path)
    # Not by the sums alone: that rows were changed does not say that they are wrong.
    assert any(not problem.startswith("The rows of ") for problem in found), found
    assert all(problem.endswith(".") for problem in found), found
    with open_map(path, writable=True) as universal:
        universal.repair()
    assert problems(path) == ()
    assert content(path) == content(sound)


@pytest.mark.parametrize("statement", MORE_DERIVED)
def test_more_that_does_not_follow_from_the_evidence_is_found(
    sound: Path, tmp_path: Path, statement: str
) -> None:
    assert problems(changed(sound, tmp_path, statement))


EVIDENCE = [
    "UPDATE fieldgrid_frame SET east_m = east_m + 1e-9 WHERE id = 2",
    "UPDATE fieldgrid_frame SET east_m = east_m + 5 WHERE id = 2",
    "UPDATE fieldgrid_frame SET status = 'rejected' WHERE id = 2",
    "UPDATE fieldgrid_frame SET reason = 'why' WHERE id = 2",
    "UPDATE fieldgrid_frame SET images = '[\"a\"]' WHERE id = 2",
    "UPDATE fieldgrid_frame SET quality = 9 WHERE id = 2",
    "UPDATE fieldgrid_frame SET digest = 'x' WHERE id = 2",
    "UPDATE fieldgrid_grid SET data = (SELECT data FROM fieldgrid_grid WHERE frame = 1) "
    "WHERE frame = 2 AND channel = 'density'",
    "UPDATE fieldgrid_grid SET data = zeroblob(9) WHERE frame = 2 AND channel = 'observed'",
    "UPDATE fieldgrid_grid SET dtype = '|i1' WHERE frame = 2 AND channel = 'density'",
    "DELETE FROM fieldgrid_grid WHERE frame = 2",
    "UPDATE fieldgrid_frame SET cells_sha256 = 'x' WHERE id = 2",
    "DELETE FROM fieldgrid_frame WHERE id = 2",
    "DELETE FROM fieldgrid_frame WHERE session_id = 3",
    "UPDATE fieldgrid_frame SET session_id = 2 WHERE id = 6",
    "UPDATE fieldgrid_session SET config = '{\"a\": 1}' WHERE id = 1",
    "UPDATE fieldgrid_session SET config = '{' WHERE id = 1",
    "UPDATE fieldgrid_session SET source = 'other' WHERE id = 1",
    "UPDATE fieldgrid_array SET data = zeroblob(5) WHERE name = 'east_m' AND session_id = 1",
    "DELETE FROM fieldgrid_array WHERE name = 'up_m' AND session_id = 3",
]


@pytest.mark.parametrize("statement", EVIDENCE)
def test_damage_of_the_evidence_is_found_and_not_repaired(
    sound: Path, tmp_path: Path, statement: str
) -> None:
    path = changed(sound, tmp_path, statement)
    before = content(path, "tiles", "pictures", "fixes")
    assert problems(path)
    if "session_id = 3" in statement:  # of a session that is removed, and not needed for repair
        with open_map(path, writable=True) as universal:
            universal.repair()
            assert universal.verify(deep=True).problems
        return
    with (
        open_map(path, writable=True) as universal,
        pytest.raises(MapError, match="its evidence is damaged"),
    ):
        universal.repair()
    assert content(path, "tiles", "pictures", "fixes") == before


# Not settings that are no JSON: without them the session cannot even be listed.
OF_SESSION_0 = [one for one in EVIDENCE if "session_id = 3" not in one and "'{'" not in one]


@pytest.mark.parametrize("statement", OF_SESSION_0)
def test_a_session_whose_evidence_is_damaged_can_be_taken_out(
    sound: Path, tmp_path: Path, statement: str
) -> None:
    path = changed(sound, tmp_path, statement)
    with open_map(path, writable=True) as universal:
        universal.remove_session("0")
        if "session_id = 2" in statement:  # a frame that came to another session damages both
            universal.remove_session("1")
            return
    kinds = ("tiles", "pictures", "extents", "levels", "window")
    merge_maps([path], tmp_path / "without.gpkg")
    assert content(path, *kinds) == content(tmp_path / "without.gpkg", *kinds)
    with open_map(path, writable=True) as universal:
        universal.repair()
        assert universal.verify(deep=True).problems  # that it is out does not make it sound
    merge_maps([path], tmp_path / "rest.gpkg")
    assert problems(tmp_path / "rest.gpkg") == ()
    assert content(tmp_path / "rest.gpkg") == content(path)


def test_repair_checks_and_folds_the_frames_once(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def counted(owner: object, name: str) -> None:
        original = getattr(owner, name)

        def counting(*arguments: object) -> object:
            done.append(name)
            return original(*arguments)

        monkeypatch.setattr(owner, name, counting)

    path = shutil.copy(sound, tmp_path / "copy.gpkg")
    with open_map(path) as universal:
        counted(verification, "is_row_as_written")
        counted(TileSquares, "fold")
        frames = universal.verify(1, deep=True).frames
    once = sorted(done)
    assert once.count("is_row_as_written") == frames
    assert "fold" in once
    done.clear()
    with open_map(path, writable=True) as universal:
        universal.repair(1)
    assert sorted(done) == once


def test_a_full_place_for_temporary_files_is_no_damage(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def small(subject: Subject) -> sqlite3.Connection:
        scratch = feature_check.empty_map(subject)
        (pages,) = scratch.execute("PRAGMA page_count").fetchone()
        scratch.execute(f"PRAGMA max_page_count = {pages}")
        return scratch

    monkeypatch.setattr(tile_check, "empty_map", small)
    with open_map(sound) as universal, pytest.raises(MapError, match=r"full.*SQLITE_TMPDIR"):
        universal.verify(deep=True)


def test_noise_in_the_file_never_passes_for_sound(sound: Path, tmp_path: Path) -> None:
    """Whatever bytes are overwritten: what passes is the map as it was."""
    whole = sound.read_bytes()
    expected = content(sound)
    random = np.random.default_rng(3)
    path = tmp_path / "noise.gpkg"
    passed = 0
    for _ in range(12):
        noise = bytearray(whole)
        start = int(random.integers(100, len(whole) - 600))
        noise[start : start + 512] = random.bytes(512)
        path.write_bytes(noise)
        try:
            if not problems(path):
                assert content(path) == expected
                passed += 1
        except MapError:
            pass
    assert passed < 12
