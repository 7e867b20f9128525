"""`fieldgrid serve-ros`: a map as topics of ROS 2."""

from __future__ import annotations

from typing import Annotated

import typer

from fieldgrid.cli import options, output
from fieldgrid.cli.commands.live import ended_by_signals


def command(
    map_: options.MapArgument,
    cell: options.Cell = None,
    bounds: options.BoundsValues = None,
    at: options.At = None,
    robot_radius: Annotated[
        float, typer.Option(metavar="M", min=0.0, help="Clearance that a path on /plan needs.")
    ] = 0.5,
    slow_percent: Annotated[
        int | None,
        typer.Option(
            metavar="1..99", min=1, max=99, help="Speed in slow zones; publishes a speed mask."
        ),
    ] = None,
    slow_within: Annotated[
        float,
        typer.Option(metavar="M", min=0.0, max=50.0, help="Slow within this of what is not free."),
    ] = 1.0,
    as_json: options.AsJson = False,
) -> None:
    """Publish a map for Nav2 and RViz until Ctrl+C: /map, masks, drives, the datum.

    Each path on /plan is answered on /plan_clear, /plan_clearance and /plan_blocked_at. The
    service /mark_keepout puts what was clicked on /clicked_point into the map.

    Examples:

        fieldgrid serve-ros vineyard.gpkg --cell 0.1 --bounds -20 -20 60 80
    """
    from fieldgrid.export import SpeedOptions
    from fieldgrid.live import MapServer, RosNode
    from fieldgrid.maps import Selection, open_map

    with open_map(map_):
        pass  # what is wrong with it is said before ROS is asked for
    part = Selection(options.bounds(bounds), cell, at=at)
    speed = SpeedOptions(slow_percent=slow_percent, slow_within_m=slow_within)
    with ended_by_signals() as stop, RosNode() as ros:
        server = MapServer(ros, map_, part, robot_radius, speed)
        ros.serve("save", server.publish)
        if as_json:
            output.print_json_line({"serving": str(map_)})
        else:
            output.report_line(f"serving {map_}")
        stop.wait()
