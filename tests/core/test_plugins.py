"""What packages beside fieldgrid add by their entry points: found by every command, and by the
processes that it starts."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from fieldgrid.maps import open_map
from tests.cli.conftest import in_a_process
from tests.maps.file.maps import drive, write_map

LAYERS = """
import numpy as np
from fieldgrid.layers import LAYERS, Channel, ChannelGroup, Colours, Fold, Layer
from fieldgrid.layers import register_group, register_layer

assert "density" in LAYERS  # what is there can be asked for already
register_layer(
    Layer("thick", "uint8", "", "1 where the mean density is above 200", ("density",),
          lambda cells: cells["sum"] > np.uint64(200) * cells["weight"], None,
          Colours(("#ffffff", "#800080"), 0.0, 1.0))
)
"""

RECORDINGS = """
from fieldgrid.fixes import FixColumns
from fieldgrid.recording import Drive, FixLog, Format, register_format

def open_plain(path, options):
    rows = [[float(cell) for cell in line.split()] for line in path.read_text().splitlines()]
    seconds, lat, lon = zip(*rows)
    fixes = FixColumns.of([int(s * 1e9) for s in seconds], lat_deg=lat, lon_deg=lon, quality=4)
    return Drive(path=path, name=path.stem, log=FixLog(fixes), gnss_source=path.name)

register_format(
    Format("plain", "a .plain file", lambda path: path.suffix == ".plain", open_plain)
)
"""

EXPORTS = """
from fieldgrid.export import Exported, ExportFormat, register_export_format
from fieldgrid.core import replacing

def write(universal, path, selection, options, *, overwrite):
    with replacing(path, overwrite=overwrite) as file:
        file.write_text(f"{int(selection.view(universal).observed.sum())} cells")
    return Exported((path,))

register_export_format(ExportFormat("count", (".count",), "how many cells", write))
"""

MODULES = {
    "fieldgrid.layers": ("own_layers", LAYERS),
    "fieldgrid.recording_formats": ("own_recordings", RECORDINGS),
    "fieldgrid.export_formats": ("own_exports", EXPORTS),
}


def run(site: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A command where a folder holds packages, too."""
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    return subprocess.run(
        in_a_process(*arguments), env={**os.environ, "PYTHONPATH": path},
        capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder with a package that adds one of each."""
    folder = tmp_path / "site"
    about = folder / "vineyard_tools-1.2.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: vineyard-tools\nVersion: 1.2\n")
    (about / "entry_points.txt").write_text(
        "".join(f"[{group}]\nmine = {module}\n" for group, (module, _) in MODULES.items())
    )
    for module, text in MODULES.values():
        (folder / f"{module}.py").write_text(text)
    return folder


def test_layers_and_formats_of_another_package_are_found(site: Path, tmp_path: Path) -> None:
    map_ = write_map(tmp_path / "map.gpkg", [drive(3)])
    shown = run(site, "show", map_, "-o", tmp_path / "thick.png", "--layer", "thick")
    assert shown.returncode == 0, shown.stderr
    exported = run(site, "export", map_, tmp_path / "map.count")
    assert exported.returncode == 0, exported.stderr
    with open_map(map_) as universal:
        seen = int(universal.read().observed.sum())
    assert (tmp_path / "map.count").read_text() == f"{seen} cells"
    (tmp_path / "june.plain").write_text("1717243200.0 41.65 -4.72\n1717243200.5 41.65 -4.72\n")
    inspected = run(site, "inspect", tmp_path / "june.plain", "--json")
    assert json.loads(inspected.stdout)["kind"] == "plain"
    about = json.loads(run(site, "info", "--json").stdout)
    assert about["plugins"] == {group: [module] for group, (module, _) in MODULES.items()}
    assert "vineyard-tools 1.2" in run(site, "info").stdout
    # Without the package they are not there.
    assert (
        "There is no layer 'thick'"
        in run(tmp_path, "show", map_, "-o", tmp_path / "again.png", "--layer", "thick").stderr
    )
    about = json.loads(run(tmp_path, "info", "--json").stdout)
    assert about["plugins"] == {group: [] for group in MODULES}


@pytest.mark.parametrize("group", MODULES)
def test_a_package_that_cannot_be_imported_is_named(group: str, site: Path, tmp_path: Path) -> None:
    map_ = write_map(tmp_path / "map.gpkg", [drive(1)])
    module, _ = MODULES[group]
    (site / f"{module}.py").write_text("import nothing_of_this_name\n")
    command = {
        "fieldgrid.layers": ("show", map_, "-o", tmp_path / "a.png"),
        "fieldgrid.recording_formats": ("track", tmp_path / "june.plain", "-o", tmp_path / "a.csv"),
        "fieldgrid.export_formats": ("export", map_, tmp_path / "a.tif"),
    }[group]
    (tmp_path / "june.plain").write_text("")
    refused = run(site, *command)
    assert refused.returncode == 1
    assert refused.stderr.count("\n") == 1
    assert f"{module}, which the package vineyard-tools adds to fieldgrid ({group})" in (
        refused.stderr
    )
    assert "No module named 'nothing_of_this_name'; install a version that works" in refused.stderr
    assert run(site, "info").returncode == 0
