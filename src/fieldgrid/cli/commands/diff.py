"""`fieldgrid diff`: what changed between two drives, or two dates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output

if TYPE_CHECKING:
    from fieldgrid.field import Changes

_OBJECTS = "Objects"
_LAYER, _TABLES = (".tif", ".tiff"), (".geojson", ".json", ".gpkg", ".csv", ".kml", ".dxf")


def command(
    map_: options.MapArgument,
    from_: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="SESSION|DATE",
            help="The state before: drives up to this one or this date.",
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="SESSION|DATE",
            help="The state after: later drives up to this one or this date.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Write an image (.png), a layer of cells (.tif), or the objects (.geojson, "
            ".gpkg, .csv, .kml, .dxf).",
        ),
    ] = None,
    min_area: Annotated[
        float | None,
        typer.Option(
            metavar="M2", help="Smallest object [default: 0.05].", rich_help_panel=_OBJECTS
        ),
    ] = None,
    min_confidence: Annotated[
        float | None,
        typer.Option(
            metavar="P", help="Least confidence, 0 to 1 [default: 0.5].", rich_help_panel=_OBJECTS
        ),
    ] = None,
    sigmas: Annotated[
        float | None,
        typer.Option(
            metavar="K",
            help="Distance, in sigma of both positions, up to which two observations are the "
            "same object [default: 3].",
            rich_help_panel=_OBJECTS,
        ),
    ] = None,
    growth: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Largest distance of growth from the earlier object [default: 0.4].",
            rich_help_panel=_OBJECTS,
        ),
    ] = None,
    moved: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Largest distance that an object may have moved [default: 3].",
            rich_help_panel=_OBJECTS,
        ),
    ] = None,
    position_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="1-sigma error of each drive's positions [default: from the frames].",
            rich_help_panel=_OBJECTS,
        ),
    ] = None,
    cell: options.Cell = None,
    bounds: options.BoundsValues = None,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Compare the map at one date with what later drives found.

    Prints the ground that changed, cell by cell, and the objects that appeared, vanished, moved,
    grew or were cut back. In each cell, the latest drive that observed it counts.

    Examples:

        fieldgrid diff vineyard.gpkg --from june-03 --to june-17 -o change.png

        fieldgrid diff vineyard.gpkg --from june-03 --to 2026-09-30 -o new.kml
    """
    ending = "" if out is None else out.suffix.lower()
    options.check_outputs([out], [map_], overwrite=overwrite)
    from fieldgrid.field import find_changes
    from fieldgrid.geometry import check_inside
    from fieldgrid.maps import MEANING, open_map

    given = {
        "min_area_m2": min_area,
        "min_confidence": min_confidence,
        "sigmas": sigmas,
        "growth_m": growth,
        "moved_m": moved,
        "position_sigma_m": position_sigma,
    }
    crop = options.bounds(bounds)
    with open_map(map_) as universal:
        if crop is not None:
            check_inside(crop, universal.bounds)
        changes = find_changes(
            universal,
            from_,
            to,
            bounds=crop,
            cell_m=cell,
            **{name: value for name, value in given.items() if value is not None},
        )
    view = changes.view
    if out is not None:
        _write(changes, out, overwrite=overwrite)
    areas = {kind: view.area_m2(kind) for kind in MEANING}
    if as_json:
        from fieldgrid.field import change_features
        from fieldgrid.geometry import plain_properties

        output.print_json(
            {
                "map": str(map_),
                "before": list(view.before),
                "after": list(view.after),
                "area_m2": {kind.name.lower(): area for kind, area in areas.items()},
                "objects": [
                    {"kind": one.kind, **plain_properties(one)} for one in change_features(changes)
                ],
            }
        )
        return
    output.print_table(
        ("", "m²"),
        [
            (meaning, f"{areas[kind]:.1f}")
            for kind, meaning in MEANING.items()
            if meaning != MEANING[kind.UNKNOWN]
        ],
        title=f"{', '.join(view.after)} against {', '.join(view.before)}",
    )
    if not changes:
        output.print_line("no changed object was found")
    else:
        output.print_table(
            ("object", "change", "m²", "east", "north", "size", "sure", "seen by"),
            [
                (
                    o.id,
                    o.kind.value.replace("_", " "),
                    f"{o.area_m2:.2f}",
                    output.number(o.east_m, 2, "m"),
                    output.number(o.north_m, 2, "m"),
                    f"{o.length_m:.1f} x {o.width_m:.1f} m",
                    output.percent(o.confidence, 0),
                    ", ".join(dict.fromkeys((*o.stood, *o.freed))),
                )
                for o in changes
            ],
        )
    if out is not None:
        kind = "layer" if ending in _LAYER else "objects" if ending in _TABLES else "figure"
        output.print_line(f"{kind} {out}")


def _write(changes: Changes, out: Path, *, overwrite: bool) -> None:
    ending = out.suffix.lower()
    if ending in _LAYER:
        from fieldgrid.export import export_change

        export_change(changes.view, out, overwrite=overwrite)
    elif ending in _TABLES:
        from fieldgrid.field import write_changes

        write_changes(changes, out, overwrite=overwrite)
    else:
        from fieldgrid.export import figures

        figures.save(figures.change(changes.view, changes), out)
