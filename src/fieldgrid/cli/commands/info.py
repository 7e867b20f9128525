"""`fieldgrid info`: what a bug report needs to say of this machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import sys
from typing import Any

from fieldgrid.cli import output
from fieldgrid.cli.options import AsJson


def command(as_json: AsJson = False) -> None:
    """Print the versions of the program and its libraries, the installed extras, what other
    packages add, and the folders of caches.

    Example:

        fieldgrid info --json
    """
    from fieldgrid.core import Group, nothing, plugins
    from fieldgrid.recordings import cache_folder

    requirements = importlib.metadata.requires("fieldgrid") or []
    extras = importlib.metadata.metadata("fieldgrid").get_all("Provides-Extra") or []
    machine: dict[str, Any] = {
        "fieldgrid": importlib.metadata.version("fieldgrid"),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "installed_in": os.path.dirname(os.path.dirname(__file__)),
        "executable": sys.executable,
        "compiled_kernels_in": nothing.cache_folder(),
        "copies_of_recordings_in": str(cache_folder() / "recordings"),
    }
    libraries = {name: _version(name) for name in _names(requirements, "")}
    by_extra = {
        extra: {name: _version(name) for name in _names(requirements, extra)}
        for extra in extras
        if extra not in {"all", "dev"}
    }
    by_group = {group.value: plugins(group) for group in Group}
    if as_json:
        added = {group: [one.value for one in named] for group, named in by_group.items()}
        output.print_json({**machine, "libraries": libraries, "extras": by_extra, "plugins": added})
        return
    rows = [(key.replace("_", " "), _text(value)) for key, value in machine.items()]
    rows += [(name, _text(version)) for name, version in libraries.items()]
    for extra, versions in by_extra.items():
        missing = [name for name, version in versions.items() if version is None]
        state = f"lacks {', '.join(missing)}" if missing else "installed"
        rows.append((f"extra {extra}", state))
    for group, named in by_group.items():
        rows += [
            (
                f"{group}: {one.value}",
                "-" if one.dist is None else f"{one.dist.name} {one.dist.version}",
            )
            for one in named
        ]
    output.print_table(("", ""), rows)


def _names(requirements: list[str], extra: str) -> list[str]:
    """The libraries that an extra needs, or with none, that the program needs."""
    wanted = []
    for line in requirements:
        name = re.match(r"[\w.-]+", line)
        marked = re.search(r"extra == ['\"](\S+)['\"]", line)
        if name and name[0] != "fieldgrid" and (marked[1] if marked else "") == extra:
            wanted.append(name[0])
    return sorted(wanted, key=str.lower)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _text(value: Any) -> str:
    return "-" if value is None else str(value)
