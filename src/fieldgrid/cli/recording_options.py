"""The options of every command that opens a recording, declared once."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fieldgrid.recording import DriveOptions

Gnss = Annotated[
    str | None, typer.Option("--gnss", metavar="FILE", help="Which GNSS log of the recording.")
]
Topic = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=TOPIC",
        help="Of a bag: which topic is left, right, fix, imu, ... [found by type and name].",
    ),
]
MountingFile = Annotated[
    Path | None,
    typer.Option(
        "--mounting", metavar="FILE.json", help="The mounting to take [the recording's own]."
    ),
]
TimeOffset = Annotated[
    float | None,
    typer.Option(
        "--time-offset",
        metavar="S",
        help="Seconds to add to image times to give GNSS time [the recording's own].",
    ),
]
Heading = Annotated[
    str | None,
    typer.Option(
        "--heading",
        metavar="smooth|course|recorded|constant:DEG",
        help="Where headings come from [smooth: all that the drive carries, at once].",
    ),
]
DatumText = Annotated[
    str | None,
    typer.Option(
        "--datum",
        metavar="LAT,LON,HEIGHT",
        help="Origin of east and north [recording's own, else its first accepted fix].",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE.toml", help="Settings; flags override them."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]

_TOPIC = re.compile(r"([a-z_]+)=(\S+)")


def given(
    gnss: str | None,
    topics: list[str] | None,
    mounting: Path | None,
    offset_s: float | None,
    columns: str | None = None,
) -> DriveOptions:
    """The values of these options; a usage error for what is none."""
    from fieldgrid.recording import DriveOptions, columns_from_text

    by_role: dict[str, str] = {}
    for text in topics or []:
        match = _TOPIC.fullmatch(text)
        if not match:
            raise typer.BadParameter(
                f"{text!r} is not ROLE=TOPIC, as in left=/camera/left/image_raw",
                param_hint="--topic",
            )
        if match[1] in by_role:
            raise typer.BadParameter(f"{match[1]} is given twice", param_hint="--topic")
        by_role[match[1]] = match[2]
    if offset_s is not None and not math.isfinite(offset_s * 1e9):  # as nanoseconds below
        raise typer.BadParameter(f"{offset_s} is no number of seconds", param_hint="--time-offset")
    return DriveOptions(
        gnss,
        None if columns is None else columns_from_text(columns),
        by_role,
        mounting,
        None if offset_s is None else round(offset_s * 1e9),
    )
