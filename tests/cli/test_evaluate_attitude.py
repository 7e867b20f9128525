"""`fieldgrid evaluate` where roll and pitch of a session cannot be estimated again."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import GnssError
from fieldgrid.pipeline import repose
from tests.cli.conftest import Run
from tests.conftest import TWO_LANES

TRUTH = TWO_LANES / "truth"


@pytest.fixture
def foreign_map(two_lanes_map: Path, tmp_path: Path) -> Path:
    """The example's map with a setting of another version."""
    path = tmp_path / "foreign.gpkg"
    shutil.copyfile(two_lanes_map, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        (text,) = connection.execute("SELECT config FROM fieldgrid_session").fetchone()
        config = json.loads(text)
        config["settings"]["pose"]["of_another_version"] = 7
        connection.execute("UPDATE fieldgrid_session SET config = ?", (json.dumps(config),))
    return path


def test_settings_of_another_version(foreign_map: Path, fieldgrid: Run) -> None:
    (text,) = [
        line
        for line in fieldgrid("evaluate", foreign_map, TRUTH).output().splitlines()
        if line.startswith("note: ")
    ]
    assert text.startswith("note: roll and pitch of two_lanes are not compared: ")
    assert "pose.of_another_version = 7" in text
    result = json.loads(fieldgrid("evaluate", foreign_map, TRUTH, "--json").output())
    assert result["attitude"] is None
    assert result["notes"] == [text.removeprefix("note: ")]
    assert len(result["frames"]) == 50


def test_an_estimate_that_fails(
    two_lanes_map: Path, fieldgrid: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise GnssError("No fix is accepted; look at the log.")

    monkeypatch.setattr(repose, "estimate_poses", fails)
    result = json.loads(fieldgrid("evaluate", two_lanes_map, TRUTH, "--json").output())
    assert result["attitude"] is None
    assert result["notes"] == [
        "roll and pitch of two_lanes are not compared: No fix is accepted; look at the log."
    ]


def test_a_truth_without_roll_and_pitch_has_nothing_to_compare(
    foreign_map: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    folder = tmp_path / "truth"
    shutil.copytree(TRUTH, folder)
    table = folder / "poses_frames.csv"
    rows = [line.split(",") for line in table.read_text().splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if name not in ("roll_deg", "pitch_deg")]
    assert len(kept) == len(rows[0]) - 2
    table.write_text("".join(",".join(row[k] for k in kept) + "\n" for row in rows))
    result = json.loads(fieldgrid("evaluate", foreign_map, folder, "--json").output())
    assert (result["attitude"], result["notes"]) == (None, [])
