"""`fieldgrid serve-ros`: a map as topics of ROS 2."""

from __future__ import annotations

from contextlib import ExitStack
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
    as_json: options.AsJson = False,
) -> None:
    """Publish a map for Nav2 and RViz until Ctrl+C: /map, the keep-out mask, drives, the datum.

    Each path on /plan is answered on /plan_clear, /plan_clearance and /plan_blocked_at.

    Examples:

        fieldgrid serve-ros vineyard.gpkg --cell 0.1 --bounds -20 -20 60 80
    """
    from fieldgrid.live import PathCheck, RosNode, publish_map
    from fieldgrid.maps import Costmap, Selection, open_map

    part = options.bounds(bounds), cell
    with ended_by_signals() as stop, ExitStack() as stack:
        with open_map(map_) as universal:
            costmap = Costmap.from_map(universal, *part, at=at, robot_radius_m=robot_radius)
            ros = stack.enter_context(RosNode())
            publish_map(ros, universal, Selection(*part, at=at))
        PathCheck(ros, costmap)
        if as_json:
            output.print_json_line({"serving": str(map_)})
        else:
            output.report_line(f"serving {map_}")
        stop.wait()
