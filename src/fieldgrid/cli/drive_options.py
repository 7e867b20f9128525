"""The options of every command that opens a recording."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from fieldgrid.cli.groups import FieldsOf
from fieldgrid.cli.options import refuse
from fieldgrid.core import ConfigError, quoted

if TYPE_CHECKING:
    from fieldgrid.recordings import DriveOptions

_PANEL = "Recording"
_TOPIC = re.compile(r"([a-z_]+)=(\S+)")


class DriveFlags(NamedTuple):
    """What a user says about a recording that it leaves open, or says wrong."""

    gnss: Annotated[
        str | None,
        typer.Option(
            "--gnss",
            metavar="FILE",
            help="GNSS log: its name in the recording, or the path of another log.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    topic: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            metavar="ROLE=TOPIC",
            help="Topic of a bag for a role: left, right, fix, imu and so on [default: by type "
            "and name].",
            rich_help_panel=_PANEL,
        ),
    ] = None
    mounting: Annotated[
        Path | None,
        typer.Option(
            "--mounting",
            metavar="FILE.json",
            help="Mounting of the sensor [default: the recording's own mounting.json].",
            rich_help_panel=_PANEL,
        ),
    ] = None
    time_offset: Annotated[
        float | None,
        typer.Option(
            "--time-offset",
            metavar="S",
            help="Seconds to add to image times to give GNSS time [default: the recording's own].",
            rich_help_panel=_PANEL,
        ),
    ] = None

    gnss_offset: Annotated[
        float | None,
        typer.Option(
            "--gnss-offset",
            metavar="S",
            help="Seconds to add to GNSS times to give the time of images, gyro and wheels "
            "[default: the recording's own].",
            rich_help_panel=_PANEL,
        ),
    ] = None

    epoch: Annotated[
        str | None,
        typer.Option(
            "--epoch",
            metavar="TIME",
            help="From when a clock without a date counts, in UTC, like 2026-05-14T07:30:00Z: that "
            "of a simulation, or of an NMEA log without RMC, for which the day is enough.",
            rich_help_panel=_PANEL,
        ),
    ] = None

    def options(self, columns: str | None = None) -> DriveOptions:
        """The options as `open_drive` takes them, with what `--columns` says; a usage error for
        what is none."""
        from fieldgrid.recordings import DriveOptions, columns_from_text

        topics: dict[str, str] = {}
        for text in self.topic or []:
            match = _TOPIC.fullmatch(text)
            if not match:
                raise typer.BadParameter(
                    f"{quoted(text)} is not ROLE=TOPIC, as in left=/camera/left/image_raw",
                    param_hint="--topic",
                )
            refuse(match[1] in topics, "--topic", f"{match[1]} is given twice")
            topics[match[1]] = match[2]
        return DriveOptions(
            self.gnss,
            None if columns is None else columns_from_text(columns),
            topics,
            self.mounting,
            nanoseconds(self.time_offset, "--time-offset"),
            nanoseconds(self.gnss_offset, "--gnss-offset"),
            epoch_ns=None if self.epoch is None else _moment_ns(self.epoch, "--epoch"),
        )


def _moment_ns(text: str, flag: str) -> int:
    from fieldgrid.recordings import epoch_s

    try:
        return epoch_s(text, "the moment") * 10**9
    except ConfigError as error:
        raise typer.BadParameter(str(error), param_hint=flag) from error


def nanoseconds(offset_s: float | None, flag: str) -> int | None:
    """The seconds of a flag in nanoseconds; a usage error for what is no number."""
    if offset_s is None:
        return None
    refuse(not math.isfinite(offset_s * 1e9), flag, f"{offset_s} is no number of seconds")
    return round(offset_s * 1e9)


Drive = Annotated[DriveFlags, FieldsOf(DriveFlags)]


class SpanFlags(NamedTuple):
    """The part of a drive that is used."""

    from_: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="TIME|S",
            help="Use the drive from here on: a time of UTC, like 2026-05-14T07:30:00Z, or seconds "
            "from its start.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    until: Annotated[
        str | None,
        typer.Option(
            "--until",
            metavar="TIME|S",
            help="Use the drive to before this time, in the same form.",
            rich_help_panel=_PANEL,
        ),
    ] = None

    def of(self, options: DriveOptions) -> DriveOptions:
        """The options with the part; a usage error for what is no time."""
        return replace(
            options,
            from_ns=_seconds_or_moment_ns(self.from_, "--from"),
            until_ns=_seconds_or_moment_ns(self.until, "--until"),
        )


def _seconds_or_moment_ns(text: str | None, flag: str) -> int | None:
    if text is None:
        return None
    try:
        seconds = float(text)
    except ValueError:
        return _moment_ns(text, flag)
    return nanoseconds(seconds, flag)


Span = Annotated[SpanFlags, FieldsOf(SpanFlags)]
