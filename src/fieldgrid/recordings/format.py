"""The formats of recordings: each is one module that says what it recognises and opens it.

A format of one's own is added with :func:`register_format`; its module is found when the entry
points of its package name it in the group `fieldgrid.recording_formats`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import ConfigError, Group, load, quoted
from fieldgrid.recordings.calibration.mounting import MOUNTING
from fieldgrid.recordings.drive import Drive
from fieldgrid.recordings.options import DriveOptions


def _mounting_in(path: Path) -> Path:
    return path / MOUNTING


class Format(NamedTuple):
    """One kind of drive.

    `name` is its name in words, `looks_for` says what it looks for at a path. `recognises` looks
    no further than names and first bytes. `open` gives a `Recording`,
    or, of a drive without frames that can be used, a `Drive`; it
    raises RecordingError, GnssError or ConfigError, each one sentence. `mounting_path` is where
    the drive's `mounting.json` is, or would be.
    """

    name: str
    looks_for: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, DriveOptions], Drive]
    mounting_path: Callable[[Path], Path] = _mounting_in


_FORMATS: dict[str, Format] = {}


def register_format(added: Format) -> None:
    """Add a format; it is asked before those that are there already. ConfigError for a name that
    is taken."""
    if added.name in _FORMATS:
        raise ConfigError(f"There is a format {quoted(added.name)} already; give another name.")
    others = dict(_FORMATS)
    _FORMATS.clear()
    _FORMATS.update({added.name: added}, **others)


def unregister_format(name: str) -> None:
    """Remove a format that was added."""
    _FORMATS.pop(name, None)


def formats() -> Iterator[Format]:
    """All formats, in the order in which they are asked, those of other packages first."""
    load(Group.RECORDING_FORMATS)
    return iter(tuple(_FORMATS.values()))


def find_format(path: Path) -> Format | None:
    """The first format that recognises a path."""
    return next((one for one in formats() if one.recognises(path)), None)


def mounting_path(recording: Path) -> Path:
    """The `mounting.json` that a recording is opened with, or where its own would be."""
    found = find_format(recording)
    return _mounting_in(recording) if found is None else found.mounting_path(recording)
