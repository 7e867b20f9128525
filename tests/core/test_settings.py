"""Defaults, over them a file, over that what was given by hand; and what cannot be."""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import BuildSettings, ConfigError, MatcherKind, resolve
from fieldgrid.geometry import GridSpec
from fieldgrid.maps import Transfer


def written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "field.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def fails(message: str, path: Path | None, overrides: dict[str, dict[str, Any]]) -> str:
    with pytest.raises(ConfigError, match=message) as caught:
        resolve(path, overrides)
    text = str(caught.value)
    assert "\n" not in text
    assert text.endswith(".")
    return text


def test_without_a_file_and_flags_there_are_the_defaults() -> None:
    assert resolve(None, {}) == BuildSettings()


def test_a_flag_beats_the_file_and_the_file_beats_the_default(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "[grid]\nwidth_m = 6.65\nlength_m = 14.0\n[density]\nmax_range_m = 9.0\n"
        "[stereo]\nmatcher = 'bm'\n[map]\ntransfer = 'area'\n",
    )
    settings = resolve(path, {"grid": {"length_m": 12.0}, "stereo": {"matcher": "sgbm"}})
    assert GridSpec.of(settings.grid) == GridSpec(6.65, 12.0, 0.05)
    assert settings.stereo.matcher is MatcherKind.SGBM
    assert settings.density.max_range_m == 9.0
    assert settings.map.transfer is Transfer.AREA
    assert settings.density.slice_bottom_m == BuildSettings().density.slice_bottom_m


def test_a_flag_that_was_not_given_does_not_beat_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, "[pose]\nheading = 'constant:10'\n")
    given = {"pose": {"heading": None}, "grid": {"width_m": None}, "map": {"cell_m": None}}
    assert resolve(path, given).pose.heading == "constant:10"
    assert resolve(None, given) == BuildSettings()


def test_a_flag_of_zero_was_given() -> None:
    fails(r"map\.cell_m = 0\.0 \(--cell\) is not possible", None, {"map": {"cell_m": 0.0}})


def test_what_was_passed_in_is_not_changed(tmp_path: Path) -> None:
    overrides = {"grid": {"width_m": 8.0, "cell_m": None}}
    before = copy.deepcopy(overrides)
    resolve(written(tmp_path, "[grid]\nlength_m = 10.0\n"), overrides)
    assert overrides == before


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("speed = 3", "speed"),
        ("[stero]\nmatcher = 'bm'", "stero"),
        ("[stereo]\nmatchr = 'bm'", r"stereo\.matchr"),
        ("[density]\nslice = [0.2, 2.2]", r"density\.slice"),
        ("[pose.heading_]\na = 1", r"pose\.heading_"),
        ("width_m = 6.65", "width_m"),
    ],
)
def test_an_unknown_key_is_named_with_its_table_and_file(
    text: str, name: str, tmp_path: Path
) -> None:
    fails(rf"There is no setting {name} in .*field\.toml", written(tmp_path, text), {})


def test_an_unknown_key_beside_flags_is_still_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "[grid]\nwidth = 6.65\n")
    fails(r"no setting grid\.width in", path, {"grid": {"width_m": 6.65}})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[grid]\ncell_m = 'fine'",
            r"grid\.cell_m = 'fine' in .*toml is not possible: input should be a",
        ),
        ("[grid]\ncell_m = nan", "cell of nan m is outside"),
        ("[grid]\ncell_m = 0", r"cell of 0\.0 m is outside"),
        ("[grid]\nwidth_m = inf", "width of inf m is outside"),
        ("[grid]\nwidth_m = 0.0", r"width of 0\.0 m is outside"),
        ("[grid]\nlength_m = 15.03", r"length of 15\.03 m is not a whole number of cells of 0\.05"),
        ("[grid]\ncell_m = 0.01\nwidth_m = 150.0\nlength_m = 150.0", "over 4 million cells"),
        (
            "[stereo]\nmatcher = 'orb'",
            "'orb' in .* is not possible: input should be 'sgbm3way', 'sgbm'",
        ),
        (
            "[stereo]\nmatcher = 'bm'\nrow_step = 2",
            r"Setting stereo\.matcher = 'bm', stereo\.row_step = 2 in .* is not possible: row_step",
        ),
        ("[stereo]\nspeckle_px = 1.5", r"stereo\.speckle_px = 1\.5 in"),
        ("[stereo]\nmin_range_m = 0", r"stereo\.min_range_m = 0 in"),
        ("[density]\nslice_bottom_m = 2.0\nslice_top_m = 1.0", r"slice from 2\.0 to 1\.0 m has no"),
        ("[density]\nmax_range_m = nan", r"density\.max_range_m = nan in"),
        ("[density]\nmin_points = 0", r"density\.min_points = 0 in"),
        ("[map]\ncell_m = -0.05", r"map\.cell_m = -0\.05 in"),
        ("[map]\ntransfer = 'centroid'", r"map\.transfer = 'centroid' in .* 'centre' or 'area'"),
        ("[pose]\nmax_heading_sigma_deg = 400", r"pose\.max_heading_sigma_deg = 400 in"),
        ("[pose]\nheading = 3", r"pose\.heading = 3 in .* valid string"),
        ("stereo = 'bm'", r"Setting stereo = 'bm' in"),
        ("grid = [1, 2]", r"Setting grid = \[1, 2\] in"),
    ],
)
def test_an_impossible_value_is_named(text: str, message: str, tmp_path: Path) -> None:
    fails(message, written(tmp_path, text), {})


def test_a_table_that_is_none_is_an_error_also_beside_flags(tmp_path: Path) -> None:
    path = written(tmp_path, "stereo = 'bm'\n")
    fails("Setting stereo = 'bm'", path, {"stereo": {"matcher": "sgbm"}})


def test_a_flag_and_a_file_that_are_at_odds_are_an_error(tmp_path: Path) -> None:
    path = written(tmp_path, "[density]\nslice_bottom_m = 1.5\n")
    fails(r"slice from 1\.5 to 1\.0 m has no", path, {"density": {"slice_top_m": 1.0}})


@pytest.mark.parametrize(
    "text", ["[grid", "width_m = ", "[grid]\n[grid]\n", "a = 1\na = 2", b"\xff\xfe", b"a = '\xe9'"]
)
def test_a_file_that_is_no_toml(text: str | bytes, tmp_path: Path) -> None:
    fails(r"settings file .*field\.toml is not TOML", written(tmp_path, text), {})


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    fails(r"nowhere\.toml cannot be read \(No such file", tmp_path / "nowhere.toml", {})
    fails(r"cannot be read \(it is a folder\)", tmp_path, {})


def test_universal_cells_are_those_of_the_local_grid_unless_given() -> None:
    assert resolve(None, {"grid": {"cell_m": 0.1}}).universal_cell_m == 0.1
    both = resolve(None, {"grid": {"cell_m": 0.1}, "map": {"cell_m": 0.25}})
    assert both.universal_cell_m == 0.25


def test_what_is_kept_with_a_session_makes_the_same_settings_again() -> None:
    given = {"stereo": {"matcher": "bm"}, "map": {"transfer": "area", "cell_m": 0.2}}
    settings = resolve(None, given)
    assert BuildSettings.model_validate(settings.model_dump(mode="json")) == settings


def test_settings_do_not_change() -> None:
    settings = resolve(None, {})
    with pytest.raises(ValueError, match="frozen"):
        settings.grid.width_m = 3.0  # type: ignore[misc]


def toml_lines(table: str, values: dict[str, Any]) -> Iterator[str]:
    """A table and those within it; TOML's strings, lists, numbers are JSON's, and so are true
    and false."""
    yield f"[{table}]"
    inner = {key: value for key, value in values.items() if isinstance(value, dict)}
    for key, value in values.items():
        if value is not None and key not in inner:
            yield f"{key} = {json.dumps(value)}"
    for key, value in inner.items():
        yield from toml_lines(f"{table}.{key}", value)


def test_every_setting_can_stand_in_a_file(tmp_path: Path) -> None:
    tables = BuildSettings().model_dump(mode="json")
    text = "\n".join(line for table in tables.items() for line in toml_lines(*table))
    assert "visual_odometry = true" in text
    assert "[pose.gnss]" in text
    assert sum(len(values) for values in tomllib.loads(text).values()) > 20
    assert resolve(written(tmp_path, text), {}) == BuildSettings()
