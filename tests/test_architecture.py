"""Twelve rooms, what each may use of the others, and what no file may contain."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "fieldgrid"
SOURCE = ROOT / "src" / PACKAGE

ROOMS = (
    "core",
    "geometry",
    "perception",
    "poses",
    "recordings",
    "maps",
    "field",
    "pipeline",
    "export",
    "view",
    "live",
    "cli",
)
"""A room imports only rooms before it, and of those what their `__init__` hands out."""

STRANGERS = {
    "poses": {"perception"},
    "maps": {"perception", "poses", "recordings"},
}
"""Rooms before it that a room does not know either."""

ROOT_FILES = {"__init__.py", "__main__.py", "version.py", "py.typed"}

LIBRARY_HOMES = {"pyproj": "geometry.geodesy"}
"""Libraries that a single module may import, so that each question has one answer."""


def modules(src: Path) -> Iterator[tuple[str, Path]]:
    """The dotted name and the file of every module of the package."""
    for path in sorted((src / PACKAGE).rglob("*.py")):
        parts = path.relative_to(src).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def imports(name: str, path: Path) -> Iterator[tuple[int, str, str]]:
    """The line of everything a module imports, the module that it is of, and its name."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name, ""
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                yield node.lineno, source, alias.name


def door_names(src: Path, room: str) -> set[str]:
    """What the `__init__` of a room hands out."""
    path = src / PACKAGE / room / "__init__.py"
    return {name for _, _, name in imports(f"{PACKAGE}.{room}", path)} if path.exists() else set()


def problem(src: Path, room: str, module: str, name: str) -> str:
    """Why a module of a room may not import a name of a module; empty where it may."""
    first, *inner = module.split(".")
    importer = room.partition(".")[0]
    if first != PACKAGE:
        home = LIBRARY_HOMES.get(first, room)
        return "" if room == home else f"only {home} may import {first}"
    other = inner[0] if inner else name
    if other == "version" or inner == ["core", "doors"]:
        return ""  # the version of the package, and what makes doors
    if other not in ROOMS:
        return f"{other} is no room"
    if other == importer:
        beside = src / PACKAGE / importer / name
        is_module = beside.with_suffix(".py").exists() or beside.is_dir()
        return "" if len(inner) > 1 or is_module or room == importer else "imports its own door"
    if ROOMS.index(other) > ROOMS.index(importer) or other in STRANGERS.get(importer, ()):
        return f"{importer} may not import {other}"
    if len(inner) > 1 or name not in door_names(src, other):
        return f"the door of {other} does not hand out {'.'.join([*inner[1:], name])}"
    return ""


def violations(src: Path) -> list[str]:
    return [
        f"{path.relative_to(src)}:{line}: {why}"
        for name, path in modules(src)
        if path.parent != src / PACKAGE  # what the package offers may come from any room
        for line, module, imported in imports(name, path)
        if (why := problem(src, name.removeprefix(f"{PACKAGE}."), module, imported))
    ]


def test_rooms_import_rooms_above_them_by_their_doors() -> None:
    assert violations(ROOT / "src") == []


def test_the_package_holds_the_rooms_and_no_more() -> None:
    found = {path.name for path in SOURCE.iterdir() if path.name != "__pycache__"}
    assert found == {*ROOMS, *ROOT_FILES}


def test_folders_lie_at_most_two_deep_and_say_what_they_hold() -> None:
    folders = {path.parent for path in SOURCE.rglob("*.py")} - {SOURCE}
    assert max(len(folder.relative_to(SOURCE).parts) for folder in folders) <= 3
    assert not [folder for folder in folders if folder.name == "build"]
    undescribed = [
        folder
        for folder in folders
        if not ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    ]
    assert undescribed == []


def test_no_modules_import_each_other() -> None:
    found = dict(modules(ROOT / "src"))
    doors = {f"{PACKAGE}.{room}" for room in ROOMS} | {PACKAGE}
    graph: dict[str, set[str]] = {}
    for name, path in found.items():
        targets = {
            f"{module}.{imported}" if f"{module}.{imported}" in found else module
            for _, module, imported in imports(name, path)
        }
        graph[name] = (targets & set(found)) - doors - {name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"import each other: {error.args[1]}")


@pytest.mark.parametrize("room", [room for room in ROOMS if room != "cli"])
def test_what_a_door_names_is_there(room: str) -> None:
    door = import_module(f"{PACKAGE}.{room}")
    assert dir(door) == door.__all__
    assert all(hasattr(door, name) for name in door.__all__)
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        door.nothing_of_this_name  # noqa: B018


def package_with(file: str, code: str, src: Path) -> Path:
    """A package with one module, and rooms that each hand out `Thing`."""
    for room in ROOMS:
        folder = src / PACKAGE / room
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text(f"from fieldgrid.{room}.things import Thing\n")
    path = src / PACKAGE / file
    path.parent.mkdir(exist_ok=True)
    path.write_text(code + "\n")
    return src


@pytest.mark.parametrize(
    ("file", "code"),
    [
        ("pipeline/drives.py", "from fieldgrid.poses import Thing"),
        ("pipeline/drives.py", "def f():\n    from fieldgrid.field import Thing"),
        ("pipeline/drives.py", "from fieldgrid.pipeline.staging.parts import open_parts"),
        ("pipeline/staging/parts.py", "from ..poses import estimate\nfrom . import pool"),
        ("cli/listing.py", "from fieldgrid.core import Thing\nimport numpy"),
        ("geometry/geodesy.py", "from pyproj import Transformer"),
        ("__init__.py", "from fieldgrid.cli.listing import load"),
    ],
)
def test_what_is_allowed_passes(file: str, code: str, tmp_path: Path) -> None:
    assert violations(package_with(file, code, tmp_path)) == []


@pytest.mark.parametrize(
    ("file", "code", "message"),
    [
        ("core/errors.py", "from fieldgrid.geometry import Thing", "core may not import geometry"),
        (
            "poses/estimate.py",
            "from fieldgrid.perception import Thing",
            "may not import perception",
        ),
        ("maps/costmap.py", "from ..recordings import Thing", "maps may not import recordings"),
        (
            "maps/costmap.py",
            "def f():\n    from fieldgrid.field.rows import find",
            "maps may not import field",
        ),
        ("field/rows/find.py", "from fieldgrid.maps.things import Thing", "does not hand out"),
        ("field/rows/find.py", "from fieldgrid.maps import Other", "does not hand out Other"),
        ("field/rows/find.py", "import fieldgrid.maps", "does not hand out"),
        ("field/rows/find.py", "from fieldgrid.field import Thing", "imports its own door"),
        ("field/rows/find.py", "from fieldgrid import open_map", "open_map is no room"),
        ("field/rows/find.py", "from fieldgrid.helpers import text", "helpers is no room"),
        ("maps/costmap.py", "import pyproj.crs", "only geometry.geodesy may import pyproj"),
    ],
)
def test_what_is_not_allowed_is_found(file: str, code: str, message: str, tmp_path: Path) -> None:
    (found,) = violations(package_with(file, code, tmp_path))
    assert message in found


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


NUMBERS_BY_REPR = {
    *("png.py", "points.py", "formats.py", "geodesy.py", "track.py", "declare.py"),
    "doors.py",  # names of Python
}
"""Modules that write numbers to their last digit, or values of settings."""


def test_what_messages_quote_is_bounded() -> None:
    """By `quoted` or `shortened`: `!r` shows all of a text that may come from anybody."""
    unbounded = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for _, path in modules(ROOT / "src")
        if path.name not in NUMBERS_BY_REPR
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FormattedValue) and node.conversion == ord("r")
    ]
    assert unbounded == []


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
