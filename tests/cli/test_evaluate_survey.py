"""`fieldgrid evaluate` against a survey."""

from __future__ import annotations

import json
from pathlib import Path

from tests.cli.conftest import Run

SURVEY = """kind,id,east_m,north_m,radius_m
person,a,-3.3,61.48,0.3
person,nobody,-14.5,54.0,0.3
row,r3,-13.2,43.4,0.5
row,r3,4.85,67.35,0.5
"""


def test_a_survey_on_the_command_line(two_lanes_map: Path, tmp_path: Path, fieldgrid: Run) -> None:
    survey = tmp_path / "survey.csv"
    survey.write_text(SURVEY)
    shown = fieldgrid("evaluate", two_lanes_map, survey, "--things")
    assert shown.status == 0
    assert "false objects are not counted" in shown.out
    result = json.loads(fieldgrid("evaluate", two_lanes_map, survey, "--json").out)
    person, row = result["kinds"]
    assert (person["found"], person["surveyed"], row["found"]) == (1, 2, 1)
    assert row["error_max_m"] < 0.1
    other = fieldgrid("evaluate", two_lanes_map, survey, "--frames")
    assert other.status == 2
    assert "is a survey, which does not take it" in other.err


def test_a_survey_that_is_none_and_a_crop_that_is_none(
    two_lanes_map: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    survey = tmp_path / "posts.csv"
    asked = ("evaluate", two_lanes_map, survey)
    assert fieldgrid(*asked).sentence() == f"There is no survey {survey}; check the name."
    survey.write_text("kind,east_m,north_m\npost,0,60\n")
    assert "'corn' is no crop" in fieldgrid(*asked, "--crop", "corn").sentence()
