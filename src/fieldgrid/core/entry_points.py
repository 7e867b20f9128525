"""Modules of other packages that add layers, formats of recordings or formats of exports.

Such a module calls `register_layer`, `register_format` or `register_export_format` when it is
imported, and the entry points of its package name it::

    [project.entry-points."fieldgrid.layers"]
    canopy = "vineyard_tools.canopy"

Each group is loaded when something of it is first asked for, in every process.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from enum import StrEnum
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from fieldgrid.core.errors import ConfigError, printable

_Entry = TypeVar("_Entry")


class Group(StrEnum):
    """The groups of entry points."""

    LAYERS = "fieldgrid.layers"
    RECORDING_FORMATS = "fieldgrid.recording_formats"
    EXPORT_FORMATS = "fieldgrid.export_formats"


_lock = threading.RLock()
_begun: set[Group] = set()
_done: set[Group] = set()


def load(group: Group) -> None:
    """Import the modules that other packages name in a group, once.

    ConfigError for one that cannot be imported: without it maps would lack, unnoticed, what the
    user wants them to have.
    """
    if group in _done:
        return
    with _lock:
        # Begun it is by this thread: a module asks for what is there while it is imported.
        if group in _done or group in _begun:
            return
        _begun.add(group)
        try:
            for found in plugins(group):
                try:
                    found.load()
                except Exception as problem:
                    raise ConfigError(_not_imported(found, problem)) from problem
            _done.add(group)
        finally:
            _begun.discard(group)


def plugins(group: Group) -> list[EntryPoint]:
    """The modules that other packages name in a group, in the order in which they are imported."""
    return sorted(entry_points(group=group), key=lambda one: (one.name, one.value))


def _not_imported(found: EntryPoint, problem: Exception) -> str:
    whose = "a package" if found.dist is None else f"the package {found.dist.name}"
    why = printable(f"{type(problem).__name__}: {problem}").removesuffix(".")
    return (
        f"{found.value}, which {whose} adds to fieldgrid ({found.group}), cannot be imported: "
        f"{why}; install a version that works with this fieldgrid, or uninstall it."
    )


class PluginRegistry(Mapping[str, _Entry]):
    """What is registered by name, with what the modules of a group add; it cannot be changed."""

    def __init__(self, entries: Mapping[str, _Entry], group: Group) -> None:
        self._entries, self._group = entries, group

    def __getitem__(self, name: str) -> _Entry:
        load(self._group)
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        load(self._group)
        return iter(self._entries)

    def __len__(self) -> int:
        load(self._group)
        return len(self._entries)
