"""`fieldgrid convert`: a recording as one standard MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.drive_options import Drive
from fieldgrid.core import quoted


def command(
    recording: Annotated[str, typer.Argument(metavar="RECORDING")],
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap")],
    drive: Drive,
    images: Annotated[
        str,
        typer.Option(
            metavar="raw|compressed|none",
            help="Images as raw pixels, as compressed JPEG or PNG, or none; raw pairs are "
            "rectified [default: compressed].",
            show_default=False,
        ),
    ] = "compressed",
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Write a drive as one MCAP file, for Foxglove and ROS 2.

    It has images with calibration, fixes, gyro, wheel odometry, the estimated poses and the
    mounting as static transforms.

    Examples:

        fieldgrid convert june-03 june-03.mcap --gnss rtk.nmea
    """
    from fieldgrid.pipeline import Images, convert_recording

    options.refuse(
        images not in list(Images), "--images", f"{quoted(images)} is none of {', '.join(Images)}"
    )
    options.refuse(out.suffix.lower() != ".mcap", "OUT.mcap", f"{out.name} does not end in .mcap")
    path = progress.fetched(recording)
    with progress.counting("frames") as show:
        converted = convert_recording(
            path, out, drive.options(), images=images, overwrite=overwrite, progress=show
        )
    if as_json:
        output.print_json(converted.as_dict())
        return
    output.report_table(
        ("topic", "messages"),
        [(topic, str(count)) for topic, count in converted.topics.items()],
        title=f"convert {converted.recording}",
    )
    for note in converted.notes:
        output.report_line(f"note: {note}")
    output.report_line(f"mcap {converted.path}")
