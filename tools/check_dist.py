"""Check a wheel the way a stranger meets it: in an empty environment, with no repository.

Installs it outside the repository with the newest, or with --lowest the lowest, versions that its
metadata allows; imports every module and every public name, and maps some frames of the example.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from fieldgrid.view.page import TYPES

ROOT = Path(__file__).resolve().parents[1]
FRAMES = 4

IMPORT_ALL = """
import importlib, pkgutil, fieldgrid
for module in pkgutil.walk_packages(fieldgrid.__path__, "fieldgrid."):
    importlib.import_module(module.name)
for name in fieldgrid.__all__:
    getattr(fieldgrid, name)
print(fieldgrid.__version__)
"""


def contents(wheel: Path) -> list[str]:
    """What a wheel lacks or should not hold, a sentence each."""
    names = zipfile.ZipFile(wheel).namelist()
    page = (f"fieldgrid/view/static/{name}" for name in TYPES)
    wanted = ("fieldgrid/py.typed", "fieldgrid/cli/__init__.py", *page)
    problems = [f"{wheel.name} lacks {name}" for name in wanted if name not in names]
    problems += [
        f"{wheel.name} holds {name}"
        for name in names
        if not name.startswith(("fieldgrid/", "fieldgrid-")) or "__pycache__" in name
    ]
    if not any(name.endswith("/licenses/LICENSE") for name in names):
        problems.append(f"{wheel.name} lacks the licence")
    return problems


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command; what it prints, or an exit with what it said."""
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def use(wheel: Path, uv: Path, *, lowest: bool) -> None:
    """Install a wheel into a new environment and use it there."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        run(uv, "venv", "--quiet", "--python", sys.executable, "env", cwd=place)
        resolution = "lowest-direct" if lowest else "highest"
        python, command = place / "env/bin/python", place / "env/bin/fieldgrid"
        run(
            uv, "pip", "install", "--quiet", "--python", python, "--resolution", resolution, wheel,
            cwd=place,
        )  # fmt: skip
        version = run(python, "-c", IMPORT_ALL, cwd=place).strip()
        shutil.copytree(ROOT / "examples/two_lanes", place / "drive")
        table = (place / "drive/frames.csv").read_text().splitlines()
        (place / "drive/frames.csv").write_text("\n".join(table[: 1 + FRAMES]) + "\n")
        run(command, "build", "drive", "-o", "map.gpkg", "--gnss", "gnss_rtk.nmea", cwd=place)
        run(command, "show", "map.gpkg", "-o", "map.png", cwd=place)
        sound = run(command, "verify", "map.gpkg", cwd=place).strip()
        print(f"{wheel.name}, {resolution} dependencies: version {version}, {sound}")


def main() -> None:
    """Check dist/'s only wheel; exit 1 with the reason when something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--uv", type=Path, required=True)
    parser.add_argument("--lowest", action="store_true")
    arguments = parser.parse_args()
    wheel = arguments.wheel.resolve()
    problems = contents(wheel)
    if problems:
        sys.exit("\n".join(problems))
    use(wheel, arguments.uv.resolve(), lowest=arguments.lowest)


if __name__ == "__main__":
    main()
