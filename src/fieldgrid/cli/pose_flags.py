"""The options of the commands that take poses of another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from fieldgrid.cli.drive_options import nanoseconds
from fieldgrid.cli.groups import FieldsOf
from fieldgrid.cli.options import numbers

if TYPE_CHECKING:
    from fieldgrid.recordings import PoseSource

_PANEL = "Poses of another program"


class PoseFlags(NamedTuple):
    """Where such poses are, and what their body is."""

    poses: Annotated[
        Path | None,
        typer.Option(
            "--poses",
            metavar="FILE",
            help="Poses of another program (SLAM, motion capture), used in place of the "
            "estimate: TUM, KITTI, or a bag with Odometry, PoseStamped or Path.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    poses_topic: Annotated[
        str | None,
        typer.Option(
            "--poses-topic",
            metavar="TOPIC",
            help="Topic of that bag; without --poses, a topic of the recording.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    poses_axes: Annotated[
        str | None,
        typer.Option(
            "--poses-axes",
            metavar="flu|rdf|...",
            help="Directions of the body's x, y and z: forward, left, up (ROS), or right, "
            "down, forward (camera) [default: flu].",
            rich_help_panel=_PANEL,
        ),
    ] = None
    poses_point: Annotated[
        str | None,
        typer.Option(
            "--poses-point",
            metavar="FORWARD,LEFT,UP",
            help="Position of the body, metres from the sensor [default: the ground below it; "
            "with rdf, the left camera].",
            rich_help_panel=_PANEL,
        ),
    ] = None
    poses_times: Annotated[
        Path | None,
        typer.Option(
            "--poses-times",
            metavar="FILE",
            help="Times of a KITTI file, one per line [default: those of the frames].",
            rich_help_panel=_PANEL,
        ),
    ] = None
    poses_offset: Annotated[
        float | None,
        typer.Option(
            "--poses-offset",
            metavar="S",
            help="Seconds to add to the times of the poses to give GNSS time [default: 0; with "
            "rdf, that of the images].",
            rich_help_panel=_PANEL,
        ),
    ] = None

    def source(self) -> PoseSource | None:
        """The poses as `open_drive` takes them; None where nothing is said."""
        if all(value is None for value in self):
            return None
        from fieldgrid.recordings import PoseSource

        point = None
        if self.poses_point is not None:
            form, example = "FORWARD,LEFT,UP", "0.3,-0.1,0"
            forward, left, up = numbers("--poses-point", self.poses_point, ",", form, example)
            point = (forward, left, up)
        return PoseSource(
            self.poses,
            self.poses_topic,
            self.poses_axes,
            point,
            self.poses_times,
            nanoseconds(self.poses_offset, "--poses-offset"),
        )


Poses = Annotated[PoseFlags, FieldsOf(PoseFlags)]
