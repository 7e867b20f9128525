"""`fieldgrid diff`: what changed between two drives, or two dates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import options, output


def command(
    map_: options.MapArgument,
    from_: Annotated[
        str, typer.Option("--from", metavar="SESSION|DATE", help="What was known by then.")
    ],
    to: Annotated[
        str, typer.Option("--to", metavar="SESSION|DATE", help="What drives after it found.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="A picture (.png) or a layer (.tif)."),
    ] = None,
    cell: options.Cell = None,
    bounds: options.BoundsValues = None,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Compare what drives up to one date knew with what later ones found, cell by cell.

    In each cell the latest drive that observed it counts, on either side.

    Examples:

        fieldgrid diff vineyard.gpkg --from june-03 --to june-17 -o change.png

        fieldgrid diff vineyard.gpkg --from 2026-06-03 --to 2026-09-30
    """
    is_layer = out is not None and out.suffix.lower() in {".tif", ".tiff"}
    if overwrite and not is_layer:
        raise typer.BadParameter("it is for a layer, --out FILE.tif", param_hint="--overwrite")
    from fieldgrid.lattice import check_inside
    from fieldgrid.mapfile import MEANING, open_map

    crop = options.bounds(bounds)
    with open_map(map_) as universal:
        if crop is not None:
            check_inside(crop, universal.bounds)
        view = universal.diff(from_, to, crop, cell)
    if out is not None:
        if is_layer:
            from fieldgrid.export import export_change

            export_change(view, out, overwrite=overwrite)
        else:
            from fieldgrid.figures import change, save

            save(change(view), out)
    areas = {kind: view.area_m2(kind) for kind in MEANING}
    if as_json:
        output.print_json(
            {
                "map": str(map_),
                "before": list(view.before),
                "after": list(view.after),
                "area_m2": {kind.name.lower(): area for kind, area in areas.items()},
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
    if out is not None:
        output.print_line(f"{'layer' if is_layer else 'figure'} {out}")
