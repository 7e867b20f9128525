"""Which part of the package may use which, and what no file may contain."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "fieldgrid"

# A room is a module or a package directly under `fieldgrid`. A room may import rooms of
# the layers above its own line, never one of its own line or below.
LAYERS = (
    ("array_types", "choices", "closing", "file_locks", "limits", "version"),
    (
        *("documents", "errors", "quality", "geodesy", "angles", "rotations", "kernel", "palette"),
        *("plane_fit", "plugins", "publish", "measured", "reasons", "utc"),
    ),
    ("lon_lat", "notebook", "settings", "workers"),
    (
        "fixes",
        "lattice",
        "rig",
        "trajectory",
        "grids",
        "motion",
        "qgis",
        "polyline",
        "curves",
        "vectors",
    ),
    ("cloud", "depth", "edges", "lens", "sweep", "travel"),
    (
        "gnss",
        "course",
        "gear",
        "smoother",
        "stereo",
        "vertical",
        "odometry",
        "ground",
        "binning",
        "standing",
        "transfer",
        "rectify",
        "ros",
    ),
    ("attitude", "frame_ground"),
    ("pose", "localgrid", "recording", "layers", "cost"),
    ("mapfile", "track_formats"),
    ("evidence", "farm", "quadtree"),
    ("align", "rows", "route", "changes"),
    ("coverage",),
    ("export", "costmap", "figures", "track", "evaluation"),
    ("build", "stac"),
    ("inspection", "mounting", "convert", "view", "live"),
    ("live_servers",),
    ("cli",),
    ("__main__",),
)
LEVEL = {room: level for level, rooms in enumerate(LAYERS) for room in rooms}

# Any room may import these, its own line notwithstanding.
FOR_ALL = {"errors"}

# Rooms of one layer that may import each other: {importer: {imported, ...}}. None so far;
# an entry needs a comment that says why the two are not one room, or in two layers.
SIBLINGS: dict[str, set[str]] = {}

# Libraries that a single room may import, so that each question has one answer.
ONLY_IN = {"pyproj": "geodesy"}


def modules(src: Path) -> Iterator[tuple[str, Path]]:
    """The dotted name and the file of every module of the package."""
    for path in sorted((src / PACKAGE).rglob("*.py")):
        parts = path.relative_to(src).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def imports(name: str, path: Path) -> Iterator[tuple[int, str]]:
    """The line and the absolute dotted name of everything a module imports, anywhere in it."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                yield node.lineno, f"{source}.{alias.name}"


def may_import(importer: str, imported: str) -> bool:
    return (
        importer == imported
        or imported in FOR_ALL
        or LEVEL[imported] < LEVEL[importer]
        or imported in SIBLINGS.get(importer, set())
    )


def violations(src: Path) -> list[str]:
    found: list[str] = []
    unknown: set[str] = set()
    for name, path in modules(src):
        if name == PACKAGE:
            continue  # What it offers may come from any room.
        room = name.split(".")[1]
        if room not in LEVEL:
            unknown.add(room)
            continue
        for line, target in imports(name, path):
            where = f"{path.relative_to(src)}:{line}"
            library, *inner = target.split(".")
            if library != PACKAGE:
                if ONLY_IN.get(library, room) != room:
                    found.append(f"{where}: only {ONLY_IN[library]} may import {library}")
            elif not inner or inner[0] not in LEVEL:
                found.append(f"{where}: {target} is in no room that {room} may import")
            elif not may_import(room, inner[0]):
                found.append(f"{where}: {room} may not import {inner[0]}")
    return found + [f"{room} is not in LAYERS" for room in sorted(unknown)]


def test_imports_point_down_the_layers() -> None:
    assert violations(ROOT / "src") == []


@pytest.mark.parametrize(
    ("file", "code"),
    [
        ("cli.py", "from fieldgrid.build import run"),
        ("cli.py", "from fieldgrid import build, geodesy"),
        ("angles.py", "from fieldgrid.errors import Error"),
        ("geodesy.py", "import pyproj"),
        ("geodesy/frames.py", "from pyproj import Transformer"),
        ("gnss/nmea.py", "from fieldgrid.gnss.ubx import x\nfrom . import ubx\nfrom .ubx import y"),
        ("gnss/nmea.py", "from ..trajectory import Fix"),
        ("__init__.py", "from fieldgrid.cli import main"),
    ],
)
def test_what_is_allowed_passes(file: str, code: str, tmp_path: Path) -> None:
    assert violations(package_with(file, code, tmp_path)) == []


@pytest.mark.parametrize(
    ("file", "code", "message"),
    [
        ("geodesy.py", "from fieldgrid.lattice import x", "geodesy may not import lattice"),
        ("geodesy.py", "import fieldgrid.angles", "geodesy may not import angles"),
        ("errors.py", "from fieldgrid.angles import x", "errors may not import angles"),
        ("build.py", "from fieldgrid import cli", "build may not import cli"),
        ("build.py", "from . import live", "build may not import live"),
        ("gnss/nmea.py", "from ..stereo.match import x", "gnss may not import stereo"),
        (
            "pose.py",
            "def f():\n    from fieldgrid.localgrid import x",
            "pose may not import localgrid",
        ),
        ("pose.py", "from fieldgrid import main", "fieldgrid.main is in no room"),
        ("pose.py", "import fieldgrid", "fieldgrid is in no room"),
        ("pose.py", "import pyproj.crs", "only geodesy may import pyproj"),
        ("pose.py", "from pyproj import CRS", "only geodesy may import pyproj"),
        ("helpers.py", "", "helpers is not in LAYERS"),
        ("helpers/text.py", "", "helpers is not in LAYERS"),
    ],
)
def test_what_is_not_allowed_is_found(file: str, code: str, message: str, tmp_path: Path) -> None:
    (found,) = violations(package_with(file, code, tmp_path))
    assert message in found


def package_with(file: str, code: str, src: Path) -> Path:
    path = src / PACKAGE / file
    path.parent.mkdir(parents=True)
    path.write_text(code + "\n")
    return src


# Put together from parts, so that this file holds none of what it looks for.
FORBIDDEN = {
    "a path of one machine": r"(?<![\w.~-])/(?:" + "|".join(["home", "root", "work"]) + r")/",
    "a package registry": "|".join(
        re.escape("".join(parts))
        for parts in [("files.", "pythonhosted"), ("pypi", ".org/simple"), ("--index", "-url")]
    ),
}


def forbidden_in(content: bytes) -> list[str]:
    return [what for what, pattern in FORBIDDEN.items() if re.search(pattern.encode(), content)]


def test_no_file_names_a_machine_or_a_registry() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    files = [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    found = {
        str(path.relative_to(ROOT)): what
        for path in files
        if path.is_file() and (what := forbidden_in(path.read_bytes()))
    }
    assert found == {}


@pytest.mark.parametrize("before", ["", " ", '"', "=", "file://"])
@pytest.mark.parametrize("top", ["home", "root", "work"])
def test_a_path_of_one_machine_is_found(before: str, top: str) -> None:
    assert forbidden_in(f"{before}/{top}/map.gpkg".encode()) == ["a path of one machine"]


@pytest.mark.parametrize("path", ["net/work", "example.org/home", "../home", "/framework"])
def test_a_relative_path_or_an_address_is_none(path: str) -> None:
    assert forbidden_in(f"see {path}/map.gpkg".encode()) == []


def test_a_package_registry_is_found() -> None:
    assert forbidden_in(("--index" + "-url x").encode()) == ["a package registry"]


def test_colours_are_those_of_the_palette() -> None:
    elsewhere = [
        f"{path.relative_to(ROOT)}: {found}"
        for _, path in modules(ROOT / "src")
        if path.name != "palette.py"
        for found in re.findall(r'"#?[0-9a-fA-F]{6}(?:[0-9a-fA-F]{2})?"', path.read_text())
        if re.search("[a-fA-F#]", found)
    ]
    assert elsewhere == []


def test_json_of_others_is_parsed_within_bounds() -> None:
    """By `documents`: `json.loads` fails with RecursionError where a document is deep."""
    elsewhere = [
        path.name
        for _, path in modules(ROOT / "src")
        if "json.load" in path.read_text(encoding="utf-8")
        # What shapely has just written.
        and path.name not in {"documents.py", "vectors.py"}
    ]
    assert elsewhere == []


def test_every_folder_of_tests_is_collected(request: pytest.FixtureRequest) -> None:
    """pytest leaves out folders of some names by itself, `build` among them."""
    left_out = request.config.getini("norecursedirs")
    folders = {path.parent.name for path in Path(__file__).parent.rglob("test_*.py")}
    assert "build" in folders
    assert not [name for name in folders for pattern in left_out if fnmatch(name, pattern)]


def test_no_two_public_classes_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for path in sorted((ROOT / "src").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in homes.items() if len(found) > 1} == {}


def test_no_module_has_more_than_400_lines() -> None:
    lines = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / "src").rglob("*.py")
    }
    assert {name: count for name, count in lines.items() if count > 400} == {}
