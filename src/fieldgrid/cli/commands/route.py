"""`fieldgrid route`: a way that a vehicle can drive over a map, from place to place, along lanes,
or to see what the map lacks."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress, route_report
from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.geometry import Datum

_FORM = "E,N or E,N,HEADING or a lane"
_EXAMPLE = "12.5,-40 or 12.5,-40,90 or B1-L2"
_COVER, _TRACKS = "Along lanes", "Along tracks, with --cover --tracks"
_LANE = re.compile(r"[A-Z]\d*-\S+")
_SURVEY = "To see what is not known"
_OF_TRACKS = {"width", "overlap", "direction", "along", "boundary", "headland_passes"}
_TASKDATA = (".taskdata", ".taskdata.zip")
_OF_LANES = {"crop", "spacing"}
_OF_COVER = {"lanes", "tracks"} | _OF_TRACKS
_OF_TOURS = {"agopengps", "swaths", "speed_limit"}
_OF_SURVEY = {"needs", "older_than"}


def command(
    ctx: typer.Context,
    map_: options.MapArgument,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="E,N[,HEADING]|LANE",
            help="Start: metres of the map, and degrees clockwise from north; or a lane's middle.",
        ),
    ] = None,
    goal: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="E,N[,HEADING]|LANE",
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
    survey: Annotated[
        bool,
        typer.Option(
            "--survey",
            help="Drive the lanes that see most of what is not known.",
            rich_help_panel=_SURVEY,
        ),
    ] = False,
    needs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write what is not known, as areas: .geojson, .gpkg, .csv, .kml, .dxf.",
            rich_help_panel=_SURVEY,
        ),
    ] = None,
    older_than: Annotated[
        float | None,
        typer.Option(
            metavar="DAYS",
            help="Drive again where the last drive is older [default: never].",
            rich_help_panel=_SURVEY,
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
            help="Write the lanes or tracks: .geojson, .gpkg, .csv, .kml, .dxf; their network: "
            ".osm for Lanelet2, .graph.geojson for Nav2; .taskdata.zip for a terminal.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        options.out_file(".geojson, .csv, .gpx, .mcap, .plan, .gpkg, .kml or .dxf"),
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
    With --survey it drives lanes and sides of rows that were not seen, over unknown ground.

    Examples:

        fieldgrid route vineyard.gpkg --from -14,50,37 --to 6,76 -o route.csv

        fieldgrid route field.gpkg --cover --lanes B1-L1,B1-L2 --allow-unknown

        fieldgrid route field.gpkg --cover --tracks --width 3 -o work.csv

        fieldgrid route field.gpkg --cover --tracks --along edge --swaths x.kml

        fieldgrid route vineyard.gpkg --survey -o next.gpx --needs needs.geojson
    """
    from fieldgrid.core import NoRouteError
    from fieldgrid.export import Selection, TaskdataOptions, export_taskdata
    from fieldgrid.field import (
        Tracks,
        Vehicle,
        check_route_target,
        check_rows_target,
        crop_named,
        find_rows,
        need_features,
        network_of,
        plan_coverage,
        plan_route,
        plan_survey,
        read_vehicle,
        write_agopengps,
        write_planting,
        write_route,
    )
    from fieldgrid.geometry import FEATURE_SUFFIXES, FREE_UP_TO, write_features
    from fieldgrid.maps import CostCurve, open_map, read_datum

    places: list[Any] = [_place("--from", start), _place("--to", goal)]
    is_named = any(isinstance(place, str) for place in places)
    options.refuse(cover and survey, "--survey", "it has an order of its own; leave --cover out")
    if not cover and not survey:
        for flag, given in (("--from", start), ("--to", goal)):
            options.refuse(given is None, flag, "it is needed, unless there is --cover")
        options.refuse_idle(ctx, _OF_TOURS, "it is for --cover and --survey only")
    if not cover:
        options.refuse_idle(ctx, _OF_COVER, "it is for --cover only")
        if not survey and not is_named:
            options.refuse_idle(ctx, _OF_LANES, "it is for lanes only")
    elif tracks:
        options.refuse_idle(ctx, _OF_LANES, "it is for lanes, without --tracks")
        options.refuse(is_named, "--from", "tracks have no names before they are laid")
    else:
        options.refuse_idle(ctx, _OF_TRACKS, "it is for --tracks only")
    if not survey:
        options.refuse_idle(ctx, _OF_SURVEY, "it is for --survey only")
    written = [path for path in (out, swaths, agopengps, needs) if path is not None]
    if swaths is None:
        options.refuse_idle(ctx, {"speed_limit"}, "it is for a file with lanes; give --swaths")
    low, high = options.spacing(spacing)
    crops = crop_named(crop).changed(min_spacing_m=low, max_spacing_m=high)
    guide = None if along in (None, "edge") else Path(str(along))
    inputs = [path for path in (map_, vehicle, boundary, guide) if path is not None]
    if out is not None:
        check_route_target(out)
    if swaths is not None and not swaths.name.lower().endswith(_TASKDATA):
        check_rows_target(swaths, speed_limit)
    elif swaths is not None and speed_limit is not None:
        raise typer.BadParameter("task data cannot hold it", param_hint="--speed-limit")
    if needs is not None and needs.suffix.lower() not in FEATURE_SUFFIXES:
        ways = f"{needs.name} ends in none of {', '.join(FEATURE_SUFFIXES)}"
        raise typer.BadParameter(ways, param_hint="--needs")
    options.check_outputs(written, inputs, overwrite=overwrite)
    driven = Vehicle() if vehicle is None else read_vehicle(vehicle)
    ground: dict[str, Any] = {
        "cell_m": cell,
        "bounds": options.bounds(bounds),
        "curve": CostCurve(
            min(FREE_UP_TO, obstacle_above), obstacle_above=obstacle_above, least_seen=least_seen
        ),
        "at": at,
    }
    coverage, found, asked, planting = None, None, None, None
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
    if is_named:
        planting = find_rows(
            map_, crop=crops, bounds=ground["bounds"], obstacle_above=obstacle_above, at=at
        )
        network = network_of(planting)
        places = [network.place(one) if isinstance(one, str) else one for one in places]
    try:
        if survey or cover:
            with progress.counting("lanes, and ways between them") as said:
                tour = {**ground, "start": places[0], "goal": places[1], "crop": crops,
                        "progress": said}  # fmt: skip
                if survey:
                    found = plan_survey(map_, driven, older_than_days=older_than, **tour)
                    coverage = found.coverage
                else:
                    coverage = plan_coverage(
                        map_,
                        driven,
                        lanes=None
                        if lanes is None
                        else [name.strip() for name in lanes.split(",")],
                        planting=planting,
                        tracks=asked,
                        allow_unknown=allow_unknown,
                        **tour,
                    )
            route = coverage.route
        else:
            route = plan_route(
                map_, places[0], places[1], driven, allow_unknown=allow_unknown, **ground
            )
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
    if found is not None and needs is not None:
        write_features(needs, need_features(found), route.datum, overwrite=overwrite)
    if as_json:
        told = route_report.as_dict(route, coverage, found, out)
        output.print_json({"map": str(map_), "found": True, **told})
    else:
        route_report.show(route, coverage, found)
        for file in written:
            output.print_line(f"{file}")
    if coverage is not None and coverage.left_out and not survey:
        one, covered = coverage.left_out[0], sorted(lane.lane for lane in coverage.lanes)
        is_one = len(coverage.left_out) == 1
        fewer = "" if headland_passes == 0 else ", or fewer --headland-passes"
        raise NoRouteError(
            f"{len(coverage.left_out)} of {len(coverage.left_out) + len(covered)} lanes "
            f"{'is' if is_one else 'are'} not covered; of {one.lane}: {one.reason}",
            one.east_m,
            one.north_m,
            f"{coverage.remedy}; --lanes {','.join(covered)} asks for the others alone"
            if coverage.swaths is None
            else f"the others are driven; {coverage.remedy}{fewer}",
        )


def _place(flag: str, text: str | None) -> tuple[float, ...] | str | None:
    """The metres and, where it is given, the heading of a place, or the name of a lane."""
    if text is None or _LANE.fullmatch(text):
        return text
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
