"""`fieldgrid route`: a way that a vehicle can drive over a map, from place to place or along
lanes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.field import Coverage, Route
    from fieldgrid.geometry import Datum

_FORM, _EXAMPLE = "E,N or E,N,HEADING", "12.5,-40 or 12.5,-40,90"
_COVER, _TRACKS = "Along lanes", "Along tracks, with --cover --tracks"
_OF_TRACKS = {"width", "overlap", "direction", "along", "boundary", "headland_passes"}
_TASKDATA = (".taskdata", ".taskdata.zip")
_OF_LANES = {"crop", "spacing"}
_OF_COVER = {"lanes", "tracks", "agopengps", "swaths", "speed_limit"} | _OF_LANES | _OF_TRACKS


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
        typer.Option(
            "--to",
            metavar="E,N[,HEADING]",
            help="Goal; without a heading, any heading is accepted.",
        ),
    ] = None,
    cover: Annotated[
        bool,
        typer.Option("--cover", help="Drive all lanes once.", rich_help_panel=_COVER),
    ] = False,
    lanes: Annotated[
        str | None,
        typer.Option(
            metavar="ID,ID",
            help="Only these lanes, named as by `fieldgrid rows`.",
            rich_help_panel=_COVER,
        ),
    ] = None,
    crop: options.CropName = "vineyard",
    spacing: options.Spacing = None,
    tracks: Annotated[
        bool,
        typer.Option(
            "--tracks",
            help="Parallel tracks over ground without rows, and passes around it.",
            rich_help_panel=_TRACKS,
        ),
    ] = False,
    width: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Working width [default: the vehicle's].", rich_help_panel=_TRACKS
        ),
    ] = None,
    overlap: Annotated[
        float,
        typer.Option(metavar="M", help="Overlap of neighbouring tracks.", rich_help_panel=_TRACKS),
    ] = 0.0,
    direction: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Heading of the tracks, clockwise from north [default: the shortest].",
            rich_help_panel=_TRACKS,
        ),
    ] = None,
    along: Annotated[
        str | None,
        typer.Option(
            metavar="edge|FILE",
            help="Follow the longest edge, or a line: .geojson, .csv.",
            rich_help_panel=_TRACKS,
        ),
    ] = None,
    boundary: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.geojson",
            help="Stay in this polygon [default: in observed ground].",
            rich_help_panel=_TRACKS,
        ),
    ] = None,
    headland_passes: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Passes around the ground [default: as many as a turn needs].",
            rich_help_panel=_TRACKS,
        ),
    ] = None,
    agopengps: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write a field of AgOpenGPS with the lanes or tracks.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    swaths: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the lanes or tracks: .geojson, .gpkg, .csv, .kml, .dxf, .osm for Lanelet2, "
            ".taskdata.zip for a terminal.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        options.out_file(".geojson, .csv, .gpx, .mcap, .plan, .graph.geojson, .gpkg, .kml or .dxf"),
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="The vehicle [default: 1 m wide, 1.8 m long]."),
    ] = None,
    allow_unknown: Annotated[
        bool, typer.Option("--allow-unknown", help="Also drive over unseen ground.")
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
            help="Cell size for planning [default: the map's, or a multiple of it, at least "
            "0.2 m].",
            rich_help_panel=options.PART,
        ),
    ] = None,
    bounds: options.BoundsValues = None,
    at: options.At = None,
    speed_limit: options.SpeedLimit = None,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Plan a route that a vehicle can drive.

    The swept area touches no obstacle and no unseen ground. If there is no route, the reason and
    the position are reported, with exit status 1.

    With --cover the route drives the lanes between rows; --from and --to are then optional. Lanes
    that cannot be covered are listed with the reason, and the exit status is 1; the route of the
    others is written. With --cover --tracks it drives parallel tracks over ground without rows.

    Examples:

        fieldgrid route vineyard.gpkg --from -14,50,37 --to 6,76 -o route.csv

        fieldgrid route field.gpkg --cover --lanes B1-L1,B1-L2 --allow-unknown

        fieldgrid route field.gpkg --cover --tracks --width 3 -o work.csv

        fieldgrid route field.gpkg --cover --tracks --along edge --swaths x.kml
    """
    from fieldgrid.core import NoRouteError
    from fieldgrid.export import Selection, TaskdataOptions, export_taskdata
    from fieldgrid.field import (
        Tracks,
        Vehicle,
        check_route_target,
        check_rows_target,
        crop_named,
        plan_coverage,
        plan_route,
        read_vehicle,
        write_agopengps,
        write_planting,
        write_route,
    )
    from fieldgrid.geometry import FREE_UP_TO
    from fieldgrid.maps import CostCurve, open_map, read_datum

    if not cover:
        for flag, given in (("--from", start), ("--to", goal)):
            options.refuse(given is None, flag, "it is needed, unless there is --cover")
        options.refuse_idle(ctx, _OF_COVER, "it is for --cover only")
    elif tracks:
        options.refuse_idle(ctx, _OF_LANES, "it is for lanes, without --tracks")
    else:
        options.refuse_idle(ctx, _OF_TRACKS, "it is for --tracks only")
    written = [path for path in (out, swaths, agopengps) if path is not None]
    if swaths is None:
        options.refuse_idle(ctx, {"speed_limit"}, "it is for a file with lanes; give --swaths")
    origin, target = _place("--from", start), _place("--to", goal)
    low, high = options.spacing(spacing)
    guide = None if along in (None, "edge") else Path(str(along))
    inputs = [path for path in (map_, vehicle, boundary, guide) if path is not None]
    if out is not None:
        check_route_target(out)
    if swaths is not None and not swaths.name.lower().endswith(_TASKDATA):
        check_rows_target(swaths, speed_limit)
    elif swaths is not None and speed_limit is not None:
        raise typer.BadParameter("task data cannot hold it", param_hint="--speed-limit")
    options.check_outputs(written, inputs, overwrite=overwrite)
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
    coverage, asked = None, None
    if tracks:
        datum = read_datum(map_)
        asked = Tracks(
            width_m=width,
            overlap_m=overlap,
            direction_deg=direction,
            along="edge" if along == "edge" else guide and _shape(guide, datum, "LineString"),
            boundary=boundary and _shape(boundary, datum, "Polygon"),
            headland_passes=headland_passes,
        )
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
                    tracks=asked,
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
            output.print_json(
                {
                    "map": str(map_),
                    "found": False,
                    "reason": str(none),
                    "blocked_at": {"east_m": none.east_m, "north_m": none.north_m},
                }
            )
        raise
    if out is not None:
        write_route(route, out, overwrite=overwrite)
    if coverage is not None and agopengps is not None:
        write_agopengps(coverage.planting, agopengps, overwrite=overwrite)
    if coverage is not None and swaths is not None:
        if swaths.name.lower().endswith(_TASKDATA):
            with open_map(map_) as opened:
                export_taskdata(
                    opened,
                    swaths,
                    Selection(ground["bounds"], at=at),
                    TaskdataOptions(obstacle_above=obstacle_above),
                    overwrite=overwrite,
                    planting=coverage.planting,
                )
        else:
            write_planting(
                coverage.planting, swaths, speed_limit_kmh=speed_limit, overwrite=overwrite
            )
    if as_json:
        output.print_json({"map": str(map_), "found": True, **_as_dict(route, coverage, out)})
    else:
        _print(route, coverage)
        for file in written:
            output.print_line(f"{file}")
    if coverage is not None and coverage.left_out:
        first, covered = coverage.left_out[0], sorted(lane.lane for lane in coverage.lanes)
        is_one = len(coverage.left_out) == 1
        fewer = "" if headland_passes == 0 else ", or fewer --headland-passes"
        raise NoRouteError(
            f"{len(coverage.left_out)} of {len(coverage.left_out) + len(covered)} lanes "
            f"{'is' if is_one else 'are'} not covered; of {first.lane}: {first.reason}",
            first.east_m,
            first.north_m,
            f"{coverage.remedy}; --lanes {','.join(covered)} asks for the others alone"
            if coverage.swaths is None
            else f"the others are driven; {coverage.remedy}{fewer}",
        )


def _place(flag: str, text: str | None) -> tuple[float, ...] | None:
    """The metres and, where it is given, the heading of a place."""
    if text is None:
        return None
    form = "E,N,HEADING" if text.count(",") == 2 else "E,N"
    try:
        return tuple(options.numbers(flag, text, ",", form, "12.5,-40"))
    except typer.BadParameter:
        raise typer.BadParameter(
            f"{quoted(text)} is not {_FORM}, as in {_EXAMPLE}", param_hint=flag
        ) from None


def _shape(path: Path, datum: Datum, kind: str) -> Any:
    """The one shape of a kind that a file has."""
    from fieldgrid.core import ConfigError
    from fieldgrid.geometry import read_shapes

    found = [shape for shape in read_shapes(path, datum) if shape.geom_type == kind]
    if len(found) != 1:
        raise ConfigError(f"{path} has {len(found)} shapes of the kind {kind}; give one with one.")
    return found[0]


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
        what = "lanes covered" if coverage.swaths is None else "tracks driven"
        summary.append((what, f"{count} of {count + len(coverage.left_out)}"))
        if coverage.swaths is not None:
            done = coverage.swaths
            headings = [block.heading_deg for block in coverage.planting.blocks]
            summary += [
                ("heading", ", ".join(output.number(value, 1, "°") for value in headings)),
                ("worked", output.number(done.worked_m2, 0, "m²")),
                ("of what can be reached", output.percent(done.worked_m2 / done.reachable_m2, 1)),
                ("crossing worked ground", output.number(done.crossing_m, 1, "m")),
            ]
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
    for lane in coverage.left_out:  # sentences, which are too long for the column of a table
        place = f"{lane.east_m:.2f},{lane.north_m:.2f}"
        output.print_line(f"not covered: {lane.lane}: {lane.reason} at {place}.")


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
    if coverage is None:
        return found
    swaths = {} if coverage.swaths is None else {"swaths": coverage.swaths._asdict()}
    return {
        **found,
        "turning_share": coverage.turning_share,
        "lanes": [lane._asdict() for lane in coverage.lanes],
        **swaths,
        "left_out": [lane._asdict() for lane in coverage.left_out],
        "remedy": coverage.remedy,
    }
