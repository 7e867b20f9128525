"""The formats that a map is exported to, each declared once by the module that writes it.

A module of another package can add one::

    from fieldgrid.export.registry import Exported, ExportFormat, register_export_format

    def write(universal, path, selection, options, *, overwrite):
        ...
        return Exported((path,))

    register_export_format(ExportFormat("mine", (".mine",), "what it is", write))

and is found when the entry points of its package name it in the group `fieldgrid.export_formats`.
The flags of `fieldgrid export`, its help, its errors and `docs/exports.md` follow from the
declarations.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from pydantic import ValidationError

from fieldgrid.core import (
    ConfigError,
    DeclaredSetting,
    Group,
    MapError,
    MapExistsError,
    Settings,
    check_place,
    declared,
    first_problem,
    load,
    quoted,
)
from fieldgrid.geometry import check_inside
from fieldgrid.maps import DENSITIES, LAYERS, MapFile, Readable, Selection, read_datum

_BUILT_IN = (
    "cells.geotiff",
    "cells.png",
    "cells.mbtiles",
    "cells.kmz",
    "shapes.vector",
    "shapes.taskdata",
    "robots.nav2",
    "robots.rosbag",
    "cells.tables",
    "cells.arrays",
    "cells.points",
    "shapes.qgz",
)
"""The modules of this room that register formats, in the order of their listing."""


class Exported(NamedTuple):
    """What an export has written: its files or folders, rows (label, value) for a reader, and the
    same as numbers for a program."""

    paths: tuple[Path, ...]
    rows: tuple[tuple[str, str], ...] = ()
    about: Mapping[str, Any] = MappingProxyType({})


class Holds(StrEnum):
    """Which layers of a map a format can hold."""

    ANY = "any layer"
    GREY = "layers of whole numbers from 0 to 255"
    OCCUPANCY = "the layers density, lasting and max"
    SHAPES = "what is traced from the density"
    MAP = "the density of the map as it is"


class Writer(Protocol):
    """What writes a format; `options` are an instance of the format's own."""

    def __call__(
        self,
        universal: MapFile,
        path: Path,
        selection: Selection,
        options: Any,
        /,
        *,
        overwrite: bool,
    ) -> Exported:
        """Write the selection to `path`, whole or not at all."""


class ExportFormat(NamedTuple):
    """A format: its name, the endings of file names that ask for it, what it is in a few words,
    and what writes it.

    `options` are the settings that it takes, `holds` the layers that it can have; `folder` says
    that it is a folder of files, `several` that it can be of several maps: all that it takes of a
    map is what `Readable` has. `readers`, `extras` (of pip) and `limits` are for the documents.
    """

    name: str
    endings: tuple[str, ...]
    says: str
    write: Writer
    options: type[Settings] = Settings
    holds: Holds = Holds.ANY
    folder: bool = False
    several: bool = False
    readers: str = ""
    extras: tuple[str, ...] = ()
    limits: str = ""

    def declared(self) -> tuple[DeclaredSetting, ...]:
        """The options, each with its flag and meaning."""
        return tuple(declared(self.options))


_formats: dict[str, ExportFormat] = {}


def register_export_format(*formats: ExportFormat) -> None:
    """Add formats. ConfigError for a name or an ending that is taken."""
    for one in formats:
        others = [known for known in _formats.values() if set(known.endings) & set(one.endings)]
        if one.name in _formats or others:
            raise ConfigError(
                f"The format {one.name} or one of its endings {', '.join(one.endings)} is "
                "registered already; choose others."
            )
        _formats[one.name] = one


def unregister_export_format(name: str) -> None:
    """Take a format out again."""
    del _formats[name]


def formats() -> Mapping[str, ExportFormat]:
    """All formats by their names: those of fieldgrid, then those of other packages."""
    for module in _BUILT_IN:
        importlib.import_module(f"fieldgrid.export.{module}")
    load(Group.EXPORT_FORMATS)
    order = {f"fieldgrid.export.{module}": k for k, module in enumerate(_BUILT_IN)}
    found = sorted(_formats.values(), key=lambda one: order.get(one.write.__module__, len(order)))
    return {one.name: one for one in found}


def format_of(path: Path, name: str | None = None) -> ExportFormat:
    """The format by its name, or else by the ending of a path.

    ConfigError for neither, and for a path that looks like something else.
    """
    by_ending = [one for one in formats().values() if path.name.lower().endswith(one.endings)]
    if name is None:
        if not by_ending:
            endings = ", ".join(e for known in formats().values() for e in known.endings)
            raise ConfigError(
                f"{path.name} ends in none of {endings}; choose one of them, or give --format."
            )
        return by_ending[0]
    if name not in formats():
        raise ConfigError(f"{quoted(name)} is no format; known are {', '.join(formats())}.")
    chosen = formats()[name]
    if chosen not in by_ending:
        if by_ending:
            raise ConfigError(
                f"{path.name} is the name of a file of format {by_ending[0].name}, not {name}; "
                f"end it in {' or '.join(chosen.endings)}, or leave --format out."
            )
        if chosen.folder and re.fullmatch(r"\.[a-z]\w*", path.suffix.lower()):
            raise ConfigError(
                f"{path.name} is the name of a file, and the format {name} is a folder; give a "
                f"name that ends in {' or '.join(chosen.endings)}, or in nothing."
            )
    return chosen


def export_map(
    universal: Readable,
    path: str | Path,
    selection: Selection | None = None,
    *,
    format: str | None = None,
    overwrite: bool = False,
    options: Mapping[str, Any] | None = None,
) -> Exported:
    """Write a part of a map in the format that `path` ends in, or that `format` names.

    Formats that are `several` can be of a `Farm`, too. The output appears when it is complete, or
    not at all. `options` are those of the format. Raises ConfigError for what cannot be asked,
    MapExistsError when `path` exists and may not be overwritten, MapWriteError when it cannot be
    written.
    """
    path, selection = Path(path), selection or Selection()
    chosen = format_of(path, format)
    checked = _checked(chosen, options or {})
    _check_layer(chosen, selection.layer)
    check_place(path)
    _refuse_map(path)
    if selection.bounds is not None:
        check_inside(selection.bounds, universal.bounds)
    if not (chosen.several or isinstance(universal, MapFile)):
        others = ", ".join(one.name for one in formats().values() if one.several)
        raise ConfigError(
            f"The format {chosen.name} is of one map; export the maps one by one, make one of them "
            f"with `fieldgrid merge`, or choose one of the formats {others}."
        )
    return chosen.write(
        universal,  # type: ignore[arg-type]
        path,
        selection,
        checked,
        overwrite=overwrite,
    )


def _checked(chosen: ExportFormat, options: Mapping[str, Any]) -> Settings:
    given = {name: value for name, value in options.items() if value is not None}
    try:
        return chosen.options.model_validate(given)
    except ValidationError as error:
        problem = first_problem(error)
    if problem.unknown:
        takes = ", ".join(chosen.options.model_fields) or "none"
        raise ConfigError(
            f"The format {chosen.name} has no option {quoted(problem.name)}; it takes {takes}."
        )
    raise ConfigError(
        f"The option {problem.setting} of the format {chosen.name} is not possible: {problem.why}."
    )


def require(what: str, extra: str, *names: str) -> None:
    """Raise ConfigError unless the libraries that an extra of pip brings are installed; `what`
    needs them."""
    try:
        for name in names:
            __import__(name)
    except ImportError as error:
        is_one = len(names) == 1
        raise ConfigError(
            f"{what} needs {' and '.join(names)}, which {'is' if is_one else 'are'} not installed; "
            f"run: pip install 'fieldgrid[{extra}]'"
        ) from error


def _check_layer(chosen: ExportFormat, layer: str) -> None:
    fits = {
        Holds.ANY: True,
        Holds.GREY: LAYERS[layer].dtype == "uint8",
        Holds.OCCUPANCY: layer in DENSITIES,
        Holds.SHAPES: layer == "density",
        Holds.MAP: layer == "density",
    }
    if not fits[chosen.holds]:
        others = ", ".join(one.name for one in formats().values() if one.holds is Holds.ANY)
        raise ConfigError(
            f"The format {chosen.name} cannot hold the layer {quoted(layer)}, only "
            f"{chosen.holds.value}; leave --layer out, or choose one of the formats {others}."
        )


def _refuse_map(path: Path) -> None:
    """Raise MapExistsError when an export would replace a map: what that has is nowhere else."""
    if not path.is_file():
        return
    try:
        read_datum(path)
    except MapError:
        return
    raise MapExistsError(
        f"{path} is a map with its evidence, which no export replaces; give another name."
    )
