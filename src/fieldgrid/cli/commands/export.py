"""`fieldgrid export`: the map for those who do not read GeoPackage."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output
from fieldgrid.cli.farms import MapOrFarm, opened
from fieldgrid.cli.settings_flags import by_flag, flag_option, flag_values
from fieldgrid.core import DeclaredSetting, Flag

if TYPE_CHECKING:
    from fieldgrid.export import ExportFormat

_FORMAT = "Format"
Given = dict[Flag, tuple[str, Any]]


class FormatFlags:
    """The flags of the options of all formats; the command gets what was given: the option and
    its value, by flag."""

    @cached_property
    def _flags(self) -> dict[Flag, list[DeclaredSetting]]:
        found = by_flag(one for known in _formats().values() for one in known.declared())
        return {flag: settings[:1] for flag, settings in found.items()}

    def parameters(self) -> Iterable[inspect.Parameter]:
        """An option a flag, with the formats that take it."""
        for flag, settings in self._flags.items():
            takers = ", ".join(
                known.name
                for known in _formats().values()
                if any(one.flag == flag for one in known.declared())
            )
            yield flag_option(flag, settings, _FORMAT, f" ({takers})")

    def value(self, given: Mapping[str, Any]) -> Given:
        """What was given."""
        values = flag_values(self._flags, given)
        return {one.flag: (one.path[-1], value) for one, value in values if one.flag is not None}


def command(
    map_: MapOrFarm,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="A file or folder; its extension determines the format."
        ),
    ],
    *,
    format_: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Format, if the extension does not determine it.",
            rich_help_panel=_FORMAT,
            autocompletion=lambda: list(_formats()),
        ),
    ] = None,
    given: Annotated[Given, FormatFlags()],
    layer: Annotated[
        str | None,
        typer.Option(
            metavar="LAYER",
            help="Which layer of the map [default: density].",
            rich_help_panel=options.PART,
            autocompletion=lambda: list(_layers()),
        ),
    ] = None,
    bounds: options.BoundsValues = None,
    cell: options.Cell = None,
    at: options.At = None,
    datum_from: options.DatumFrom = None,
    overwrite: options.Overwrite = False,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    as_json: options.AsJson = False,
) -> None:
    """Write a map for another program. The output is complete, or nothing is changed.

    {formats}

    Layers of a map; density is the 3D density of the paper's universal grid:

    {layers}

    Examples:

        fieldgrid export vineyard.gpkg density.tif --cell 0.25

        fieldgrid export vineyard.gpkg posts.tif --layer max --at 2026-06-03

        fieldgrid export vineyard.gpkg vineyard.png --epsg 25830

        fieldgrid export maps farm.tif --cell 0.25

        fieldgrid export maps slopes.tif --scheduler tcp://10.0.0.5:8786
    """
    from fieldgrid.export import Selection, export_map, format_of

    options.refuse(str(out) == "-", "OUT", "it is the name of a file or a folder")
    options.check_scheduler(scheduler, jobs)
    chosen = format_of(out, format_)
    _refuse_others(chosen, given)
    selection = Selection(
        options.bounds(bounds), cell, layer or "density", at, jobs=jobs, scheduler=scheduler
    )
    with opened(map_, datum_from) as universal:
        done = export_map(
            universal,
            out,
            selection,
            format=chosen.name,
            overwrite=overwrite,
            options=dict(given.values()),
        )
    sizes = {path: _bytes(path) for path in done.paths}
    if as_json:
        output.print_json(
            {
                "map": str(map_),
                "format": chosen.name,
                "files": [{"path": str(path), "bytes": size} for path, size in sizes.items()],
                "about": dict(done.about),
            }
        )
        return
    written = [
        (path.name, f"{size / 1e6:.2f} MB" if size >= 10_000 else f"{size} bytes")
        for path, size in sizes.items()
    ]
    output.report_table(("", ""), [("format", chosen.name), *done.rows, *written])


def help_text(text: str) -> str:
    """The help, with the formats and layers that there are."""
    from fieldgrid.maps import layers_by_subject

    rows = [(one.name, " ".join(one.endings), one.says) for one in _formats().values()]
    width, wider = (max(len(row[k]) for row in rows) for k in (0, 1))
    table = "\n".join(f"  {name:{width}}  {end:{wider}}  {says}" for name, end, says in rows)
    listed = f"Formats, by their names and endings:\n\n\b\n{table}"
    layers = "\n".join(
        f"  {title}:\n    {' '.join(names)}" for title, names in layers_by_subject().items()
    )
    return text.format(formats=listed, layers=f"\b\n{layers}")


def _formats() -> Mapping[str, ExportFormat]:
    from fieldgrid.export import formats

    return formats()


def _layers() -> Iterable[str]:
    from fieldgrid.maps import LAYERS

    return dict.fromkeys(("density", *LAYERS))


def _refuse_others(chosen: ExportFormat, given: Given) -> None:
    """A usage error for an option that the format does not take."""
    taken = [one.flag for one in chosen.declared() if one.flag is not None]
    for flag in given:
        if flag not in taken:
            names = ", ".join(one.name for one in taken)
            raise typer.BadParameter(
                f"the format {chosen.name} does not take it{f', but {names}' if names else ''}",
                param_hint=flag.name,
            )


def _bytes(path: Path) -> int:
    """The size of a file, or of all files in a folder."""
    if path.is_dir():
        return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return path.stat().st_size
