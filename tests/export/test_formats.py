from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map, format_of, formats
from fieldgrid.geometry import Bounds
from fieldgrid.maps import LAYERS, MapFile, open_map
from tests.maps.file.maps import drive, write_map


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    path = tmp_path_factory.mktemp("map") / "m.gpkg"
    return open_map(write_map(path, [drive(2), drive(2, heading_deg=90.0)]))


@pytest.mark.parametrize("name", formats())
def test_a_format_says_what_it_is_and_has_a_writer(name: str) -> None:
    known = formats()[name]
    assert known.name == name
    assert known.endings
    assert known.says
    assert (known.write.__doc__ or "").startswith("Write")
    assert known.options()  # every option has a default
    for one in known.declared():
        assert one.flag is not None
        assert one.info.description
        assert one.usual
    for ending in known.endings:
        assert format_of(Path(f"field/My.Map{ending.upper()}")) is known
    assert format_of(Path("unknown"), name) is known


def test_a_flag_means_the_same_to_all_formats() -> None:
    found: dict[str, set[tuple[object, ...]]] = {}
    for known in formats().values():
        for one in known.declared():
            assert one.flag is not None
            meaning = (one.path, one.flag, one.info.description, one.usual, one.limits)
            found.setdefault(one.flag.name, set()).add(meaning)
    assert {flag: len(meanings) for flag, meanings in found.items()} == dict.fromkeys(found, 1)


def test_no_two_formats_share_an_ending() -> None:
    endings = [ending for known in formats().values() for ending in known.endings]
    assert len(set(endings)) == len(endings)
    for ending in endings:
        assert [one for one in endings if ending.endswith(one)] == [ending]


def test_a_name_counts_where_no_ending_does_and_the_last_ending_counts() -> None:
    assert format_of(Path("odd.name"), "png").name == "png"
    assert format_of(Path("x.png.tif")).name == "geotiff"


@pytest.mark.parametrize(
    ("path", "name", "message"),
    [
        ("x.foo", None, r"x\.foo ends in none of \.tif"),
        ("tif", None, "tif ends in none of"),
        ("x.tif", "GeoTIFF", "'GeoTIFF' is no format; known are geotiff"),
        ("x.tif", "png", "x.tif is the name of a file of format geotiff, not png; end it in .png"),
        ("foo.zip", "isoxml", "foo.zip is the name of a file, and the format isoxml is a folder"),
        ("foo.db3", "rosbag2", "ends in .rosbag2, or in nothing"),
    ],
)
def test_formats_that_are_none(path: str, name: str | None, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        format_of(Path(path), name)


def test_options_that_are_not_given_are_left_to_the_format(
    universal: MapFile, tmp_path: Path
) -> None:
    export_map(universal, tmp_path / "x.tif", options={"epsg": None, "mode": None})
    with pytest.raises(ConfigError, match="geotiff has no option 'mode'; it takes epsg"):
        export_map(universal, tmp_path / "y.tif", options={"mode": "raw"})
    assert sorted(file.name for file in tmp_path.iterdir()) == ["x.qml", "x.tif"]


def test_no_export_replaces_a_map(universal: MapFile, tmp_path: Path) -> None:
    other = write_map(tmp_path / "other.gpkg", [drive(1)])
    for target in (universal.path, other):
        before = target.read_bytes()
        with pytest.raises(MapExistsError, match="which no export replaces"):
            export_map(universal, target, overwrite=True)
        assert target.read_bytes() == before


# --- what is selected


def test_a_selection_of_no_layer_is_refused() -> None:
    with pytest.raises(ConfigError, match="There is no layer 'depth'; there are density"):
        Selection(layer="depth")
    for layer in LAYERS:
        assert Selection(layer=layer).layer == layer


def test_a_selection_names_its_sessions(universal: MapFile) -> None:
    assert Selection().names(universal) == ["0", "1"]
    assert Selection(at="0").names(universal) == ["0"]
    assert Selection(sessions=["1"]).names(universal) == ["1"]


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        (Bounds(1.0, 1.0, 1.0, 2.0), "are empty"),
        (Bounds(float("nan"), 1.0, 1.0, 2.0), "are empty"),
        (Bounds(500.0, 0.0, 510.0, 10.0), "hold nothing of the map"),
        (Bounds(0.0, -90.0, 10.0, -80.0), "hold nothing of the map"),
    ],
)
def test_bounds_that_select_nothing(
    universal: MapFile, bounds: Bounds, message: str, tmp_path: Path
) -> None:
    for name in ("map.png", "map.yaml"):
        with pytest.raises(ConfigError, match=message):
            export_map(universal, tmp_path / name, Selection(bounds))
    assert not list(tmp_path.iterdir())
