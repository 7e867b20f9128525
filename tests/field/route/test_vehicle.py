"""Vehicle files, good and bad."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from fieldgrid.core import ConfigError
from fieldgrid.field import Vehicle, read_vehicle


def test_a_file_gives_a_vehicle(tmp_path: Path) -> None:
    file = tmp_path / "tractor.toml"
    file.write_text("[vehicle]\nwidth_m = 1.5\nturning_radius_m = 4\nreverse = false\n")
    assert read_vehicle(file) == Vehicle(width_m=1.5, turning_radius_m=4, reverse=False)
    file.write_text("width_m = 1.5\n")
    assert read_vehicle(str(file)) == Vehicle(width_m=1.5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("width_m = ", "cannot be read as TOML"),
        ("width = 1.5", "unknown key 'width'; known are front_m"),
        ("vehicle = 3", "no table"),
        ("width_m = '2'", "is a number of metres, not '2'"),
        ("width_m = true", "is a number of metres, not True"),
        ("width_m = nan", "outside"),
        ("turning_radius_m = 0", "outside"),
        ("reverse = 1", "true or false, not 1"),
        ("clearance_m = -0.1", "outside"),
        ("slope_across_deg = 90", "outside 0.1..80.0 degrees"),
        ("slope_along_deg = 'steep'", "is a number of degrees, not 'steep'"),
        ("step_m = 0", "outside"),
        ("\x00", "cannot be read as TOML"),
        ("x = " + "[" * 50_000, "cannot be read as TOML"),
        ("#" * 200_000, "no vehicle is"),
    ],
)
def test_bad_files_get_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "tractor.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words) as refused:
        read_vehicle(file)
    assert "tractor.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_file_and_bytes(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="There is no vehicle file"):
        read_vehicle(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="cannot be read as TOML"):
        read_vehicle(tmp_path / "bytes.toml")


@pytest.mark.parametrize("implement_m", [0.0, 0.5, 3.0])
def test_the_footprint_is_convex_and_as_wide_as_it_says(implement_m: float) -> None:
    vehicle = Vehicle(front_m=2.0, rear_m=1.0, width_m=1.2, implement_width_m=implement_m)
    shape = shapely.Polygon(vehicle.footprint())
    assert shape.exterior.is_ccw
    assert shape.convex_hull.area == pytest.approx(shape.area)
    assert np.ptp(vehicle.footprint(), axis=0) == pytest.approx([3.0, max(1.2, implement_m)])
