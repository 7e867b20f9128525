"""`fieldgrid serve-ros`: a map as topics of ROS 2."""

from __future__ import annotations

from fieldgrid.cli import options, output
from fieldgrid.cli.commands.live import ended_by_signals


def command(
    map_: options.MapArgument,
    cell: options.Cell = None,
    bounds: options.BoundsValues = None,
    at: options.At = None,
) -> None:
    """Publish a map for Nav2 and RViz until Ctrl+C: /map, the keep-out mask, drives, the datum.

    Examples:

        fieldgrid serve-ros vineyard.gpkg --cell 0.1 --bounds -20 -20 60 80

        fieldgrid serve-ros vineyard.gpkg --ros-args -r map:=/field/map
    """
    from fieldgrid.live import RosNode, publish_map
    from fieldgrid.maps import Selection, open_map

    selection = Selection(options.bounds(bounds), cell, at=at)
    with ended_by_signals() as stop, RosNode() as ros:
        with open_map(map_) as universal:
            publish_map(ros, universal, selection)
        output.report_line(f"serving {map_}")
        stop.wait()
