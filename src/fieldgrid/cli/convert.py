"""`fieldgrid convert`: a recording as one standard MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import output, progress, recording_options

if TYPE_CHECKING:
    from fieldgrid.convert import Converted


def command(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The file to write.")],
    gnss: recording_options.Gnss = None,
    topic: recording_options.Topic = None,
    mounting: recording_options.MountingFile = None,
    time_offset: recording_options.TimeOffset = None,
    images: Annotated[
        str,
        typer.Option(
            metavar="raw|compressed|none",
            help="Images as pixels, as the JPEG or PNG files that they are, or not at all; raw "
            "pairs are rectified.",
        ),
    ] = "compressed",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file.")
    ] = False,
    as_json: recording_options.AsJson = False,
) -> None:
    """Write what was understood of a drive as one MCAP, for Foxglove and ROS 2.

    Images with calibration, fixes, gyro, wheels, the estimated poses and where everything sits.

    Examples:

        fieldgrid convert june-03 june-03.mcap --gnss rtk.nmea
    """
    from fieldgrid.convert import Images, convert_recording

    if images not in list(Images):
        raise typer.BadParameter(
            f"{images!r} is none of {', '.join(Images)}", param_hint="--images"
        )
    if out.suffix.lower() != ".mcap":
        raise typer.BadParameter(f"{out.name} does not end in .mcap", param_hint="OUT.mcap")
    options = recording_options.given(gnss, topic, mounting, time_offset)
    with progress.counting("frames") as show:
        converted = convert_recording(
            recording, out, options, images=images, overwrite=overwrite, progress=show
        )
    if as_json:
        output.print_json(converted.as_dict())
    else:
        _print(converted)


def _print(converted: Converted) -> None:
    rows = [(topic, str(count)) for topic, count in converted.topics.items()]
    output.print_table(("topic", "messages"), rows, title=f"convert {converted.recording}")
    for note in converted.notes:
        print(f"note: {note}")
    print(f"mcap {converted.path}")
