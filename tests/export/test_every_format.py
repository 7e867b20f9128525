"""What holds of every format: whole or not at all, one sentence, nobody's file replaced unasked."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.errors import ConfigError, FieldgridError, MapExistsError
from fieldgrid.export import FORMATS, Selection, export_map
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import MapFile, open_map
from tests.export.asymmetric import COARSE_M, write_asymmetric_map

# A file may grow to so many bytes only: a disk that fills up, for every library alike.
FULL = """
import json, resource, signal, sys
from pathlib import Path
from fieldgrid.errors import FieldgridError
from fieldgrid.export import FORMATS, export_map
from fieldgrid.mapfile import open_map

path, folder, limit = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
names = json.loads(sys.argv[4])
result = {}
with open_map(path) as universal:
    for key, name in names.items():
        export_map(universal, folder / name, format=key)  # what it imports may write caches
        export_map(universal, folder / name, format=key, overwrite=True)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    for key, name in names.items():
        target = folder / "full" / name
        target.parent.mkdir(exist_ok=True)
        try:
            export_map(universal, target, format=key)
            result[key] = ["written", ""]
        except FieldgridError as error:
            result[key] = [type(error).__name__, str(error)]
        except BaseException as error:
            result[key] = ["TRACEBACK", repr(error)]
        result[key].append(sorted(str(p.relative_to(folder)) for p in (folder / "full").rglob("*")))
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        import shutil
        shutil.rmtree(folder / "full")
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
print(json.dumps(result))
"""


def name_of(key: str) -> str:
    return f"out{FORMATS[key].endings[0]}"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg")


@pytest.fixture(scope="module")
def universal(path: Path) -> MapFile:
    return open_map(path)


@pytest.fixture(scope="module")
def on_a_full_disk(path: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    names = {key: name_of(key) for key in FORMATS}
    folder = tmp_path_factory.mktemp("disk")
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path), str(folder), "700", json.dumps(names)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, list[Any]] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("key", FORMATS)
def test_a_disk_that_fills_up(on_a_full_disk: dict[str, list[Any]], key: str) -> None:
    error, message, left = on_a_full_disk[key]
    assert error == "MapWriteError", message
    assert name_of(key) in message
    assert ".partial" not in message  # a name that nobody knows of
    assert "\n" not in message
    assert left == []


@pytest.mark.parametrize("key", FORMATS)
def test_what_is_there_stays_unless_told_otherwise(
    universal: MapFile, tmp_path: Path, key: str
) -> None:
    out = tmp_path / name_of(key)
    part = Selection(cell_m=COARSE_M)
    done = export_map(universal, out, part, format=key)
    assert out in done.paths
    assert all(path.exists() for path in done.paths)
    listed = sorted(tmp_path.iterdir())
    assert listed == sorted(done.paths)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(MapExistsError, match="--overwrite"):
        export_map(universal, out, part, format=key)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    export_map(universal, out, Selection(), format=key, overwrite=True)
    assert sorted(tmp_path.iterdir()) == listed


@pytest.mark.parametrize("key", FORMATS)
def test_bad_requests(universal: MapFile, tmp_path: Path, key: str) -> None:
    out = tmp_path / name_of(key)
    for selection, message in (
        (Selection(Bounds(100.0, 0.0, 110.0, 10.0)), "hold nothing of the map"),
        (Selection(cell_m=0.02), "0.02 m"),
        (Selection(at="winter"), "winter"),
    ):
        with pytest.raises(ConfigError, match=message):
            export_map(universal, out, selection, format=key)
    with pytest.raises(ConfigError, match="has no option 'colour'"):
        export_map(universal, out, format=key, options={"colour": "red"})
    with pytest.raises(FieldgridError, match="folder does not exist"):
        export_map(universal, tmp_path / "nowhere" / out.name, format=key)
    assert list(tmp_path.iterdir()) == []
