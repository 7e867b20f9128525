"""`fieldgrid route`: a way that a vehicle can drive over a map, from place to place or along
lanes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress

if TYPE_CHECKING:
    from fieldgrid.coverage import Coverage
    from fieldgrid.route import Route

_FORM, _EXAMPLE = "E,N or E,N,HEADING", "12.5,-40 or 12.5,-40,90"
_COVER = "Along lanes"


def command(
    ctx: typer.Context,
    map_: options.MapArgument,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="E,N[,HEADING]",
            help="Start: metres of the map, and degrees clockwise from north.",
        ),
    ] = None,
    goal: Annotated[
        str | None,
        typer.Option("--to", metavar="E,N[,HEADING]", help="Goal; without a heading any will do."),
    ] = None,
    cover: Annotated[
        bool,
        typer.Option("--cover", help="Drive along all lanes, once each.", rich_help_panel=_COVER),
    ] = False,
    lanes: Annotated[
        str | None,
        typer.Option(
            metavar="ID,ID",
            help="Only these, by the names of `fieldgrid rows`.",
            rich_help_panel=_COVER,
        ),
    ] = None,
    crop: options.CropName = "vineyard",
    spacing: options.Spacing = None,
    out: Annotated[
        Path | None,
        options.out_file(".geojson, .csv, .gpx, .mcap, .plan, .graph.geojson, .gpkg, .kml or .dxf"),
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="The vehicle [default: 1 m wide, 1.8 m long]."),
    ] = None,
    allow_unknown: Annotated[
        bool, typer.Option("--allow-unknown", help="Drive over ground that was not seen, too.")
    ] = False,
    obstacle_above: options.ObstacleAbove = 100,
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

    With --cover it works the lanes between rows; --from and --to may be left out. Lanes that
    cannot be covered are listed with the reason, and the exit status is 1; the route of the
    others is written.

    Examples:

        fieldgrid route vineyard.gpkg --from -14,50,37 --to 6,76 -o route.csv

        fieldgrid route vineyard.gpkg --cover --lanes B1-L1,B1-L2 -o all.csv
    """
    from fieldgrid.cost import CostCurve
    from fieldgrid.coverage import plan_coverage
    from fieldgrid.errors import NoRouteError
    from fieldgrid.grids import FREE_UP_TO
    from fieldgrid.publish import refuse_input
    from fieldgrid.route import Vehicle, plan_route, read_vehicle
    from fieldgrid.route.output import check_target, write_route
    from fieldgrid.rows import crop_named

    if not cover:
        for flag, given in (("--from", start), ("--to", goal)):
            if given is None:
                raise typer.BadParameter("it is needed, unless there is --cover", param_hint=flag)
        every = {str(one.name) for one in ctx.command.params}
        options.refuse_given(ctx, every - {"lanes", "crop", "spacing"}, "it is for --cover only")
    origin, target = _place("--from", start), _place("--to", goal)
    low, high = options.spacing(spacing)
    if out is not None:
        check_target(out)
        refuse_input(out, [map_, *([vehicle] if vehicle else [])])
    driven = Vehicle() if vehicle is None else read_vehicle(vehicle)
    ground: dict[str, Any] = {
        "allow_unknown": allow_unknown,
        "cell_m": cell,
        "bounds": options.bounds(bounds),
        "curve": CostCurve(
            min(FREE_UP_TO, obstacle_above), obstacle_above=obstacle_above, least_seen=least_seen
        ),
        "at": at,
    }
    coverage = None
    try:
        if cover:
            with progress.counting("lanes, and ways between them") as said:
                coverage = plan_coverage(
                    map_,
                    driven,
                    lanes=None if lanes is None else [name.strip() for name in lanes.split(",")],
                    start=origin,
                    goal=target,
                    crop=crop_named(crop).changed(min_spacing_m=low, max_spacing_m=high),
                    progress=said,
                    **ground,
                )
            route = coverage.route
        else:
            assert origin is not None
            assert target is not None
            route = plan_route(map_, origin, target, driven, **ground)
    except NoRouteError as none:
        if as_json:
            blocked = {"east_m": none.east_m, "north_m": none.north_m}
            said_no = {"map": str(map_), "found": False, "reason": str(none), "blocked_at": blocked}
            output.print_json(said_no)
        raise
    if out is not None:
        write_route(route, out, overwrite=overwrite)
    if as_json:
        output.print_json({"map": str(map_), "found": True, **_as_dict(route, coverage, out)})
    else:
        _print(route, coverage)
        if out is not None:
            output.print_line(f"{out}")
    if coverage is not None and coverage.left_out:
        first = coverage.left_out[0]
        raise NoRouteError(
            f"{len(coverage.left_out)} of {len(coverage.left_out) + len(coverage.lanes)} lanes are "
            f"not covered; of {first.lane}: {first.reason}",
            first.east_m,
            first.north_m,
            f"--lanes {','.join(sorted(lane.lane for lane in coverage.lanes))} asks for the others "
            "alone",
        )


def _place(flag: str, text: str | None) -> tuple[float, ...] | None:
    """The metres and, where it is given, the heading of a place."""
    if text is None:
        return None
    form = "E,N,HEADING" if text.count(",") == 2 else "E,N"
    try:
        return tuple(options.numbers(flag, text, ",", form, "12.5,-40"))
    except typer.BadParameter:
        message = f"{text!r} is not {_FORM}, as in {_EXAMPLE}"
        raise typer.BadParameter(message, param_hint=flag) from None


def _print(route: Route, coverage: Coverage | None) -> None:
    share = route.turning_share if coverage is None else coverage.turning_share
    summary = [
        ("length", output.number(route.length_m, 1, "m")),
        ("turning", output.percent(share, 0)),
        ("in reverse", output.percent(route.reverse_share, 0)),
        ("changes of gear", str(route.cusps)),
        ("least clearance", output.number(route.least_clearance_m, 2, "m")),
    ]
    if coverage is not None:
        count = len(coverage.lanes)
        summary.append(("lanes covered", f"{count} of {count + len(coverage.left_out)}"))
    output.print_table(("route", ""), summary)
    if coverage is None:
        return
    output.print_table(
        ("lane", "direction", "from", "to"),
        [
            (
                lane.lane,
                "against its line" if lane.against else "along its line",
                output.number(lane.from_m, 1, "m"),
                output.number(lane.to_m, 1, "m"),
            )
            for lane in coverage.lanes
        ],
    )
    if coverage.left_out:
        output.print_table(
            ("not covered", "east,north", "reason"),
            [
                (lane.lane, f"{lane.east_m:.2f},{lane.north_m:.2f}", lane.reason)
                for lane in coverage.left_out
            ],
        )


def _as_dict(route: Route, coverage: Coverage | None, out: Path | None) -> dict[str, Any]:
    found: dict[str, Any] = {
        "length_m": route.length_m,
        "turning_share": route.turning_share,
        "reverse_share": route.reverse_share,
        "gear_changes": route.cusps,
        "least_clearance_m": route.least_clearance_m,
        "poses": len(route.east_m),
        "file": None if out is None else str(out),
    }
    if coverage is not None:
        found["turning_share"] = coverage.turning_share
        found["lanes"] = [lane._asdict() for lane in coverage.lanes]
        found["left_out"] = [lane._asdict() for lane in coverage.left_out]
    return found
