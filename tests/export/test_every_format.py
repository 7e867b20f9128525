"""What holds of every format: whole or not at all, one sentence, nobody's file replaced unasked."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import subprocess
import sys
import zipfile
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import xarray
import zarr
from mcap.writer import Writer
from rosbags.rosbag2 import Writer as RosbagsWriter

from fieldgrid.core import ConfigError, FieldgridError, MapExistsError
from fieldgrid.export import Selection, export_map, formats
from fieldgrid.export.figures import heading, save
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.conftest import TWO_LANES
from tests.export.asymmetric import COARSE_M, write_asymmetric_map
from tests.once import made_once

# A file may grow to so many bytes only: a disk that fills up, for every library alike.
FULL = """
import json, resource, signal, sys
from pathlib import Path
from fieldgrid.core import FieldgridError
from fieldgrid.export import export_map
from fieldgrid.maps import open_map

path, folder, limit = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
names = json.loads(sys.argv[4])
result = {}
with open_map(path) as universal:
    for key, name in names.items():
        export_map(universal, folder / name, format=key)  # what it imports may write caches
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
    return f"out{formats()[key].endings[0]}"


def coarse(key: str) -> Selection:
    """Few cells, where a format does not show the map's own."""
    return Selection() if key == "qgz" else Selection(cell_m=COARSE_M)


def texts_in(value: Any) -> list[str]:
    """The strings among the values of what JSON holds."""
    if isinstance(value, dict):
        return [text for one in value.values() for text in texts_in(one)]
    if isinstance(value, list):
        return [text for one in value for text in texts_in(one)]
    return [value] if isinstance(value, str) else []


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg")


@pytest.fixture(scope="module")
def universal(path: Path) -> MapFile:
    return open_map(path)


@pytest.fixture(scope="module")
def on_a_full_disk(path: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    names = {key: name_of(key) for key in formats()}

    def fill(folder: Path) -> dict[str, list[Any]]:
        done = subprocess.run(
            [sys.executable, "-c", FULL, str(path), str(folder), "700", json.dumps(names)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        found: dict[str, list[Any]] = json.loads(done.stdout)
        return found

    return made_once(tmp_path_factory, "full_disk", fill)[1]


@pytest.mark.parametrize("key", formats())
def test_a_disk_that_fills_up(on_a_full_disk: dict[str, list[Any]], key: str) -> None:
    error, message, left = on_a_full_disk[key]
    assert error == "MapWriteError", message
    assert name_of(key) in message
    assert ".partial" not in message  # a name that nobody knows of
    assert "\n" not in message
    assert left == []


@pytest.mark.parametrize("key", formats())
def test_what_is_there_stays_unless_told_otherwise(
    universal: MapFile, tmp_path: Path, key: str
) -> None:
    out = tmp_path / name_of(key)
    part = coarse(key)
    done = export_map(universal, out, part, format=key)
    assert out in done.paths
    assert all(path.exists() for path in done.paths)
    listed = sorted(tmp_path.iterdir())
    assert listed == sorted(done.paths)
    # A program is told in numbers what a reader is told in words.
    about = json.loads(json.dumps(dict(done.about)))
    assert about or not done.rows
    assert [text for text in texts_in(about) if re.search(r"\d", text)] in ([], ["WGS84"])
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(MapExistsError, match="--overwrite"):
        export_map(universal, out, part, format=key)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    export_map(universal, out, Selection(), format=key, overwrite=True)
    assert sorted(tmp_path.iterdir()) == listed


@pytest.mark.parametrize("key", formats())
def test_bad_requests(universal: MapFile, tmp_path: Path, key: str) -> None:
    out = tmp_path / name_of(key)
    for selection, message in (
        (Selection(Bounds(100.0, 0.0, 110.0, 10.0)), "hold nothing of the map"),
        (Selection(cell_m=0.02), "--cell" if key == "qgz" else "0.02 m"),
        (Selection(at="winter"), "--at" if key == "qgz" else "winter"),
    ):
        with pytest.raises(ConfigError, match=message):
            export_map(universal, out, selection, format=key)
    with pytest.raises(ConfigError, match="has no option 'colour'"):
        export_map(universal, out, format=key, options={"colour": "red"})
    with pytest.raises(FieldgridError, match="folder does not exist"):
        export_map(universal, tmp_path / "nowhere" / out.name, format=key)
    assert list(tmp_path.iterdir()) == []


PICTURE = np.zeros((8, 8), dtype=np.uint8)


def written_by_others(path: Path) -> None:
    """A file, or a folder, of the same kind that is not ours."""
    match "".join(path.suffixes):
        case ".png" | ".tif":
            cv2.imwrite(str(path), PICTURE)
        case ".gpkg":
            with closing(sqlite3.connect(path)) as database:
                database.execute("create table roads (id)")
                database.commit()
        case ".kmz" | ".shp.zip" | ".npz" | ".qgz":
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("doc.kml", "<kml/>")
        case ".mcap":
            with path.open("wb") as file:
                writer = Writer(file)
                writer.start(library="a robot")
                writer.finish()
        case ".rosbag2":
            with RosbagsWriter(path, version=8):
                pass
        case ".zarr":
            zarr.open_group(path, mode="w", zarr_format=2).create_array("a", shape=(2,), dtype="u1")
        case "":
            path.mkdir()
            (path / "TASKDATA.XML").write_text("<a/>")
            (path / "TLG00001.bin").write_text("work")
        case ".nc":
            xarray.Dataset({"a": ("x", [1])}).to_netcdf(path, engine="h5netcdf")
        case ".parquet":
            pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), path)
        case _:
            path.write_text('{"type": "FeatureCollection", "features": []}')


@pytest.mark.parametrize("key", formats())
def test_what_others_have_written_is_never_replaced(
    universal: MapFile, tmp_path: Path, key: str
) -> None:
    out = tmp_path / name_of(key)
    written_by_others(out)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(MapExistsError, match="give another name"):
        export_map(universal, out, coarse(key), format=key, overwrite=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_a_figure_replaces_figures_only(tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"x.{ending}"
    for _ in range(2):
        save(heading([]), out)
    shutil.copy(TWO_LANES / "left" / "000000.jpg", out)
    with pytest.raises(MapExistsError, match="is not a figure that fieldgrid has written"):
        save(heading([]), out)
