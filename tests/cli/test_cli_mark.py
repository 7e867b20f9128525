"""`fieldgrid mark`: add, list, remove, restore, write."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.maps.file.maps import drive, write_map


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(tmp_path_factory.mktemp("made") / "map.gpkg", [drive(1)])


@pytest.fixture
def field(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(made, tmp_path / "map.gpkg"))


def test_the_round_of_a_mark(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    assert fieldgrid("mark", field).output().split() == [
        "id", "kind", "name", "where,", "m", "area", "author", "created", "note",
    ]  # fmt: skip
    pond = ("--polygon", "-1,0;1,0; 1,2", "--kind", "keepout", "--name", "pond", "--author", "Ana")
    listed = fieldgrid("mark", field, *pond).output().splitlines()[1]
    assert listed.split()[:6] == ["1", "keepout", "pond", listed.split()[3], "2.00", "m²"]
    grass = ("--point", "2.1,-3.4", "--kind", "free", "--note", "tall grass")
    fieldgrid("mark", field, *grass).output()
    first = json.loads(fieldgrid("mark", field, "--json").output())
    assert [mark["corners_m"] for mark in first["marks"]] == [
        [[-1.0, 0.0], [1.0, 0.0], [1.0, 2.0]], [[2.1, -3.4]],
    ]  # fmt: skip
    assert "removed" in fieldgrid("mark", field, "--remove", 1, "--remove", 2).output()
    assert fieldgrid("mark", field, "--restore", 1, "--restore", 2).status == 0
    assert json.loads(fieldgrid("mark", field, "--json").output()) == first
    out = tmp_path / "marks.geojson"
    assert str(out) in fieldgrid("mark", field, "-o", out).output()
    again = json.loads(fieldgrid("mark", field, "--add", out, "--author", "Bob", "--json").output())
    assert [mark["kind"] for mark in again["marks"]] == ["keepout", "free"] * 2
    assert [mark["author"] for mark in again["marks"]] == ["Ana", "", "Ana", "Bob"]
    assert fieldgrid("verify", field).status == 0
    asked = fieldgrid("query", field, "0.5", "0.5").output()
    assert "mark id 1, kind keepout, name pond, author Ana, created 20" in asked
    asked = json.loads(fieldgrid("query", field, "2.1", "-3.4", "--json").output())
    assert [mark["note"] for mark in asked["marks"]] == ["tall grass"] * 2
    assert "mark" not in fieldgrid("query", field, "9", "9").output()


def test_what_cannot_be_is_one_sentence(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    before = field.read_bytes()
    broken = tmp_path / "broken.geojson"
    broken.write_text('{"type": "FeatureCollection", ')
    assert "is no GeoJSON" in fieldgrid("mark", field, "--add", broken).sentence()
    broken.write_text('{"type": "Point", "coordinates": [2, 41]}')
    assert "--kind" in fieldgrid("mark", field, "--add", broken).sentence()
    missing = fieldgrid("mark", field, "--add", tmp_path / "none.geojson").sentence()
    assert "cannot be read" in missing
    assert "has no mark 7" in fieldgrid("mark", field, "--remove", 7).sentence()
    crossing = ("--polygon", "0,0;1,1;1,0;0,1", "--kind", "free")
    assert "crosses itself" in fieldgrid("mark", field, *crossing).sentence()
    assert field.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--point", "1,2"], "--kind"),
        (["--point", "1,2", "--kind", "lake"], "'lake' is none of"),
        (["--point", "1", "--kind", "free"], "'1' is not E,N"),
        (["--polygon", "1,2;3,4", "--kind", "free"], "no polygon"),
        (["--polygon", "1,2", "--kind", "free"], "three or more"),
        (["--point", "1,2;3,4", "--kind", "free"], "no point"),
        (["--remove", "1", "--restore", "1"], "without --restore"),
        (["--author", "Ana"], "new mark only"),
    ],
)
def test_what_is_used_wrongly(
    fieldgrid: Run, field: Path, arguments: list[str], words: str
) -> None:
    assert words in " ".join(fieldgrid("mark", field, *arguments).usage().split())
