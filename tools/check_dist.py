"""Check a wheel the way a stranger meets it: in an empty environment, with no repository.

Installs it outside the repository with the newest, or with --lowest the lowest, versions that its
metadata allows; imports every module and every public name, and goes through the tutorial with an
empty home folder.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from fieldgrid.view.page import TYPES

ROOT = Path(__file__).resolve().parents[1]
TUTORIAL = ROOT / "docs" / "tutorial.md"

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


def run(*command: str | Path, cwd: Path, home: Path | None = None) -> str:
    """Run a command, perhaps with a home of its own; what it prints, or an exit with that."""
    environment = dict(os.environ)
    if home is not None:
        environment = {name: value for name, value in environment.items() if "PYTHON" not in name}
        environment["HOME"] = environment["XDG_CACHE_HOME"] = str(home)
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def use(wheel: Path, uv: Path, *, lowest: bool) -> None:
    """Install a wheel into a new environment and go through the tutorial there."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        home = place / "home"
        home.mkdir()
        run(uv, "venv", "--quiet", "--python", sys.executable, "env", cwd=place)
        resolution = "lowest-direct" if lowest else "highest"
        python = place / "env/bin/python"
        run(
            uv, "pip", "install", "--quiet", "--python", python, "--resolution", resolution, wheel,
            cwd=place,
        )  # fmt: skip
        version = run(python, "-c", IMPORT_ALL, cwd=place, home=home).strip()
        done = run(python, ROOT / "tools" / "check_docs.py", TUTORIAL, cwd=place, home=home)
        print(f"{wheel.name}, {resolution} dependencies: version {version}, {done.strip()}")


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
