"""`fieldgrid route`: a way that a vehicle can drive over a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output

if TYPE_CHECKING:
    from fieldgrid.route import Route

_FORM, _EXAMPLE = "E,N or E,N,HEADING", "12.5,-40 or 12.5,-40,90"


def command(
    map_: options.MapArgument,
    start: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="E,N[,HEADING]",
            help="Start: metres of the map, and degrees clockwise from north.",
        ),
    ],
    goal: Annotated[
        str,
        typer.Option("--to", metavar="E,N[,HEADING]", help="Goal; without a heading any will do."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FILE",
            help="Write .geojson, .csv, .gpx, .mcap, .gpkg, .kml or .dxf.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="The vehicle [default: 1 m wide, 1.8 m long]."),
    ] = None,
    allow_unknown: Annotated[
        bool, typer.Option("--allow-unknown", help="Drive over ground that was not seen, too.")
    ] = False,
    obstacle_above: Annotated[
        int, typer.Option(metavar="N", help="Density above which a cell is an obstacle.")
    ] = 100,
    least_seen: Annotated[
        float,
        typer.Option(
            metavar="SHARE", help="Share of the map's own cells that must be seen in a larger one."
        ),
    ] = 0.5,
    cell: Annotated[
        float | None,
        typer.Option(
            "--cell",
            metavar="M",
            help="Cells to plan on [default: the map's, or a multiple from 0.2 m up].",
            rich_help_panel=options.PART,
        ),
    ] = None,
    bounds: options.BoundsValues = None,
    at: options.At = None,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Plan a route that a vehicle can drive.

    What it sweeps touches no obstacle and no ground that was not seen. Where there is no route,
    it says why and where, with exit status 1.

    Examples:

        fieldgrid route vineyard.gpkg --from -14,50,37 --to 6,76 -o route.csv

        fieldgrid route vineyard.gpkg --from -14,50 --to 2,72 --vehicle my.toml -o r.mcap
    """
    from fieldgrid.cost import CostCurve
    from fieldgrid.errors import NoRouteError
    from fieldgrid.grids import FREE_UP_TO
    from fieldgrid.publish import refuse_input
    from fieldgrid.route import Vehicle, plan_route, read_vehicle
    from fieldgrid.route.output import check_target, write_route

    places = _place("--from", start), _place("--to", goal)
    if out is not None:
        check_target(out)
        refuse_input(out, [map_, *([vehicle] if vehicle else [])])
    driven = Vehicle() if vehicle is None else read_vehicle(vehicle)
    curve = CostCurve(
        min(FREE_UP_TO, obstacle_above), obstacle_above=obstacle_above, least_seen=least_seen
    )
    try:
        route = plan_route(
            map_,
            *places,
            driven,
            allow_unknown=allow_unknown,
            cell_m=cell,
            bounds=options.bounds(bounds),
            curve=curve,
            at=at,
        )
    except NoRouteError as none:
        if as_json:
            blocked = {"east_m": none.east_m, "north_m": none.north_m}
            said = {"map": str(map_), "found": False, "reason": str(none), "blocked_at": blocked}
            output.print_json(said)
        raise
    if out is not None:
        write_route(route, out, overwrite=overwrite)
    if as_json:
        output.print_json({"map": str(map_), "found": True, **_as_dict(route, out)})
        return
    output.print_table(
        ("route", ""),
        (
            ("length", output.number(route.length_m, 1, "m")),
            ("turning", output.percent(route.turning_share, 0)),
            ("in reverse", output.percent(route.reverse_share, 0)),
            ("changes of gear", str(route.cusps)),
            ("least clearance", output.number(route.least_clearance_m, 2, "m")),
        ),
    )
    if out is not None:
        output.print_line(f"{out}")


def _place(flag: str, text: str) -> tuple[float, ...]:
    """The metres and, where it is given, the heading of a place."""
    form = "E,N,HEADING" if text.count(",") == 2 else "E,N"
    try:
        return tuple(options.numbers(flag, text, ",", form, "12.5,-40"))
    except typer.BadParameter:
        message = f"{text!r} is not {_FORM}, as in {_EXAMPLE}"
        raise typer.BadParameter(message, param_hint=flag) from None


def _as_dict(route: Route, out: Path | None) -> dict[str, Any]:
    return {
        "length_m": route.length_m,
        "turning_share": route.turning_share,
        "reverse_share": route.reverse_share,
        "gear_changes": route.cusps,
        "least_clearance_m": route.least_clearance_m,
        "poses": len(route.east_m),
        "file": None if out is None else str(out),
    }
