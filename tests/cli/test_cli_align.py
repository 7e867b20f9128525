"""`fieldgrid align` and `build --align`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import fieldgrid.field as fieldgrid_field
from fieldgrid.cli.new_drives import report_offsets
from fieldgrid.field import block_quality, find_rows
from fieldgrid.maps import Transform, open_map
from tests.cli.conftest import Run
from tests.conftest import TWO_LANES
from tests.field.align.field import SPACING_M, Field, along_one_lane, mixed, write_field


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of which the later is off, and one that is far away."""
    field = Field()
    off, away = Transform(0.9, -0.7), Transform(0.0, 900.0)
    return write_field(
        tmp_path_factory.mktemp("align") / "map.gpkg",
        {
            "june": field.drive([0.0], sigma_m=0.02),
            "july": field.drive([0.0], by=off, seed=7, start_s=1e5),
            "far": field.drive([0.0], by=away, seed=8, start_s=2e5),
        },
        0.5,
    )


@pytest.fixture
def path(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(made, tmp_path / "map.gpkg"))


def root(path: Path) -> str:
    with open_map(path) as universal:
        return universal.root_sha256


def test_a_dry_run_reports_and_draws_and_changes_nothing(fieldgrid: Run, path: Path) -> None:
    before = path.read_bytes()
    figure = path.with_suffix(".png")
    text = fieldgrid("align", path, "--dry-run", "--figure", figure).output()
    assert path.read_bytes() == before
    lines = text.splitlines()
    assert lines[0].split() == [
        "session",
        "east",
        "north",
        "sigma",
        "turn",
        "wander",
        "up",
        "matches",
    ]
    rows = {line.split()[0]: line for line in lines[1:4]}
    assert float(rows["july"].split()[1]) == pytest.approx(-0.9, abs=0.1)
    assert "nothing to compare with" in rows["far"]
    pair = next(line.split() for line in lines[4:] if line.split()[:2] == ["july", "june"])
    assert [float(value) for value in pair[2:4]] == pytest.approx([0.9, -0.7], abs=0.1)
    assert "nothing was changed (--dry-run)" in text
    picture = cv2.imread(str(figure))
    assert picture is not None
    assert picture.std() > 10.0


def test_drives_are_moved_told_of_and_put_back(fieldgrid: Run, path: Path) -> None:
    before = root(path)
    found = json.loads(fieldgrid("align", path, "--json").output())
    assert found["applied"] is True
    (pair,) = found["pairs"]
    assert (pair["of"], pair["against"], pair["doubt"]) == ("july", "june", None)
    assert pair["lay_apart_m"] == pytest.approx([0.9, -0.7], abs=0.1)
    moved = {one["name"]: one["transform"] for one in found["sessions"] if one["moved"]}
    assert set(moved) == {"june", "july"}
    listed = json.loads(fieldgrid("sessions", path, "--json").output())["sessions"]
    assert listed[1]["transform"] == moved["july"]
    assert "aligned: -0." in fieldgrid("sessions", path).output()
    assert "sound" in fieldgrid("verify", path).output()
    assert fieldgrid("align", path, "--undo").output() == "june, july: as before alignment\n"
    assert root(path) == before
    assert "No session of" in fieldgrid("align", path, "--undo").sentence()


def test_rows_before_and_after_are_a_check_that_needs_no_truth(fieldgrid: Run, path: Path) -> None:
    """Plants that two drives saw a metre apart stand in no rows."""
    text = fieldgrid("align", path, "--dry-run", "--rows").output()
    assert "no rows of plants before" in text
    assert "after" not in text
    found = json.loads(fieldgrid("align", path, "--rows", "--json").output())["rows"]
    assert found["before"] == []
    (after,) = found["after"]
    with open_map(path) as universal:
        (block,) = block_quality(find_rows(universal))
    assert after["spacing_m"] == pytest.approx(block.spacing_m)
    assert after["spacing_m"] == pytest.approx(SPACING_M, abs=0.35)
    table = fieldgrid("align", path, "--dry-run", "--rows").output().splitlines()
    header = next(k for k, line in enumerate(table) if line.startswith("rows "))
    assert table[header].split()[:5] == ["rows", "block", "rows", "lanes", "heading"]
    assert table[header + 1].split()[:4] == ["before", "B1", "2", "1"]


def test_who_moves_and_who_holds(fieldgrid: Run, path: Path) -> None:
    given = ("--session", "june", "--to", "july", "--json")
    found = json.loads(fieldgrid("align", path, *given).output())
    assert [one["name"] for one in found["sessions"]] == ["june", "july"]
    assert [one["moved"] for one in found["sessions"]] == [True, False]
    undone = json.loads(fieldgrid("align", path, "--undo", "--session", "june", "--json").output())
    assert undone["undone"] == ["june"]


def test_where_a_drive_contradicts_the_others_is_reported(fieldgrid: Run, tmp_path: Path) -> None:
    drives = along_one_lane("abc")
    drives["c"] = mixed(drives["c"], Transform(0.6), 0.02, slice(10, 20))
    path = write_field(tmp_path / "leap.gpkg", drives, 0.5)
    lines = fieldgrid("align", path, "--dry-run").output().splitlines()
    said = [line for line in lines if "places contradict the others" in line]
    assert [line.split(":")[0] for line in said] == ["c against a", "c against b"]
    assert all("(does a receiver leap" in line for line in said)
    found = json.loads(fieldgrid("align", path, "--dry-run", "--json").output())
    by_pair = {(pair["of"], pair["against"]): pair for pair in found["pairs"]}
    assert by_pair["b", "a"]["contradictions"] == []
    (east_m, north_m), *_ = (one["at_m"] for one in by_pair["c", "a"]["contradictions"])
    assert f"about {east_m:.1f} m east, {north_m:.1f} m north" in said[0]
    assert by_pair["c", "a"]["left_sigmas"] > 3.0


def test_a_doubt_is_put_into_words(fieldgrid: Run, path: Path) -> None:
    before = root(path)
    text = fieldgrid("align", path, "--reach", "0.5").output()
    assert "july against june: they agree best" in text
    assert "beyond the 0.5 m that --reach allows; not used" in text
    assert root(path) == before


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (("--session", "may"), 1, "has no session 'may'"),
        (("--reach", "-1"), 1, "A reach of -1 m cannot be"),
        (("--undo", "--dry-run"), 2, "--undo cannot use it"),
        (("--undo", "--session", "june"), 1, "is not aligned"),
        (("--figure", "x.txt"), 2, "ends in none of"),
        (("--session", "june", "--to", "june"), 1, "is to move and to hold"),
    ],
)
def test_what_cannot_be_done(
    fieldgrid: Run, path: Path, arguments: tuple[str, ...], status: int, says: str
) -> None:
    result = fieldgrid("align", path, *arguments)
    assert says in (result.sentence() if status == 1 else result.usage())


def test_rows_are_read_here_when_a_cluster_compares(
    fieldgrid: Run, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a cluster that is gone after the change would leave it without a report."""
    align = fieldgrid_field.align_map
    monkeypatch.setattr(
        fieldgrid_field, "align_map", lambda *given, scheduler, **more: align(*given, **more)
    )
    asked = "align", path, "--rows", "--json", "--scheduler", "tcp://127.0.0.1:1"
    found = json.loads(fieldgrid(*asked).output())
    assert found["applied"] is True
    assert len(found["rows"]["after"]) == 1


def test_of_many_pairs_those_that_agree_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    def pair(n: int, east_m: float, doubt: str | None = None) -> dict[str, Any]:
        lies = {"of": f"d{n}", "against": "june", "lay_apart_m": [east_m, 0.0], "sigma_m": 0.1}
        return lies | {"doubt": doubt, "aligned": False}

    few = [pair(n, 0.1) for n in range(9)] + [pair(9, 0.5)]
    report_offsets(few, Path("m.gpkg"))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert [line for line in lines if "makes them coincide" in line] == lines[9:]
    report_offsets([*few, pair(10, 0.0, "they share little")], Path("m.gpkg"))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["d9", "d10", "pairs"]
    assert lines[2].endswith("two standard errors: 9")


def test_so_many_others_are_compared(tmp_path: Path) -> None:
    with open_map(write_field(tmp_path / "m.gpkg", along_one_lane("abcd"), 0.5)) as universal:
        every = fieldgrid_field.align_map(universal, rounds=0).pairs
        few = fieldgrid_field.align_map(universal, rounds=0, most_others=1).pairs
    assert len(every) == 6
    assert 2 <= len(few) <= 4
    assert {(one.a, one.b) for one in few} <= {(one.a, one.b) for one in every}


def test_a_drive_that_is_appended_says_how_it_lies_and_is_aligned_when_asked(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    """The example drive again, with its poor receiver; every third frame."""
    path = Path(shutil.copy(two_lanes_map, tmp_path / "map.gpkg"))
    again = ("build", TWO_LANES, "-o", path, "--append", "--every", "3", "--gnss", "gnss_sf1.nmea")
    text = fieldgrid(*again, "--name", "poor").output()
    said = next(line for line in text.splitlines() if line.startswith("poor against two_lanes"))
    assert said.endswith(f"`fieldgrid align {path}` makes them coincide")
    east_m = float(said.split(": ")[1].split()[0])
    assert east_m == pytest.approx(0.30, abs=0.12)
    found = json.loads(fieldgrid(*again, "--name", "aligned", "--align", "--json").output())
    by_pair = {one["against"]: one for one in found["alignment"]}
    assert by_pair["two_lanes"]["aligned"] is True
    with open_map(path) as universal:
        assert universal.transform("aligned").aligned is not None
        assert universal.transform("two_lanes").is_identity
        first, last = (
            {frame.frame_id: frame.pose for frame in universal.frames(name) if frame.accepted}
            for name in ("two_lanes", "aligned")
        )
        off = [
            (pose.east_m - first[name].east_m, pose.north_m - first[name].north_m)
            for name, pose in last.items()
        ]
    assert np.hypot(*np.mean(off, axis=0)) < 0.06


def test_a_drive_that_has_nothing_to_be_aligned_with_says_so(
    fieldgrid: Run, make_drive: Callable[..., Path], tmp_path: Path
) -> None:
    text = fieldgrid("build", make_drive(), "-o", tmp_path / "map.gpkg", "--align").output()
    assert "no other drive of the map saw the same ground; nothing was aligned" in text
