"""Targets with names that not every library takes: written there, or refused with a remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid.core import MapWriteError
from fieldgrid.export import export_map, formats
from fieldgrid.maps import open_map
from tests.maps.file.maps import drive, write_map

KEYS = ("geojson", "gpkg", "csv", "png", "shapefile")
REMEDY = r"give another name or folder\.$|its name is too long; give a shorter one\.$"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(tmp_path_factory.mktemp("map") / "map.gpkg", [drive(2)])


@pytest.fixture(scope="module")
def plain_sizes(path: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[int]]:
    """How large the files of each format are under a plain name."""
    folder = tmp_path_factory.mktemp("plain")
    with open_map(path) as universal:
        return {
            key: _sizes(
                export_map(
                    universal, folder / f"{key}{formats()[key].endings[0]}", format=key
                ).paths
            )
            for key in KEYS
        }


@pytest.mark.parametrize(
    ("stem", "is_refused"),
    [
        ("a\nb", lambda key: key not in ("csv", "png")),
        ("a?b#c%41 {x} $1 <&'\"\\>:*|", lambda _: False),
        ("\x1b[2J", lambda _: False),
        ("é" * 125, lambda _: True),
    ],
)
def test_an_export_is_where_it_was_to_be_or_nowhere(
    path: Path,
    plain_sizes: dict[str, list[int]],
    tmp_path: Path,
    stem: str,
    is_refused: Callable[[str], bool],
) -> None:
    with open_map(path) as universal:
        for key in KEYS:
            folder = tmp_path / key
            folder.mkdir()
            target = folder / f"{stem}{formats()[key].endings[0]}"
            if is_refused(key):
                with pytest.raises(MapWriteError, match=REMEDY):
                    export_map(universal, target, format=key)
                assert not list(folder.iterdir())
            else:
                found = export_map(universal, target, format=key)
                assert {one.parent for one in found.paths} == {folder}
                assert len(list(folder.iterdir())) == len(found.paths)
                # Some hold the time, or the name.
                assert _sizes(found.paths) == pytest.approx(plain_sizes[key], rel=0.1, abs=600)


def _sizes(paths: tuple[Path, ...]) -> list[int]:
    return [one.stat().st_size for one in paths]
