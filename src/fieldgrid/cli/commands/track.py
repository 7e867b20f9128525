"""`fieldgrid track`: the trajectory of a drive, without a map and without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.drive_options import Drive, Span
from fieldgrid.cli.pose_flags import Poses
from fieldgrid.cli.settings_flags import SettingsFlags
from fieldgrid.core import Overrides

if TYPE_CHECKING:
    from fieldgrid.pipeline import TrackedDrive
    from fieldgrid.poses import Spread, TrackSummary

_LOG = "A GNSS log alone"
_MOST_REASONS = 6
_SETTINGS = (
    *("pose.heading", "pose.accuracy_m", "pose.quality", "pose.starts"),
    *("pose.frame_origin", "pose.frame_heading_deg"),
)


def command(
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING|LOG", help="A recording, or a GNSS log.")
    ],
    drive: Drive,
    span: Span,
    poses: Poses,
    settings: Annotated[Overrides, SettingsFlags(*_SETTINGS)],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE.csv|gpx|geojson|tum",
            help="Write the track; without it only the summary is printed.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    gear: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Known gears: columns from, to (UTC), gear (forward, reverse).",
            rich_help_panel="Poses",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="KEY=COLUMN,...",
            help="Names of the columns of a table, as in lat=Breite,lon=Laenge.",
            rich_help_panel=_LOG,
        ),
    ] = None,
    antenna_ahead: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Distance of the antenna ahead of the non-steering axle.",
            rich_help_panel=_LOG,
        ),
    ] = None,
    heading_offset: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Recorded heading minus the vehicle's heading, clockwise.",
            rich_help_panel=_LOG,
        ),
    ] = None,
    datum: options.DatumText = None,
    config: options.Config = None,
    figure: options.Figure = None,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Estimate position, heading and gear of the vehicle with their sigmas, one row per GNSS fix.

    Examples:

        fieldgrid track june-03

        fieldgrid track june-03 -o track.csv --gnss rtk.nmea --figure track.png

        fieldgrid track tractor.csv -o track.gpx --columns lat=Breite,lon=Laenge

        fieldgrid track mower.nmea -o track.gpx --quality rtk-fixed

        fieldgrid track june-03 -o track.csv --poses slam.tum --poses-axes rdf
    """
    options.check_figure(figure)
    from fieldgrid.core import GnssError, resolve
    from fieldgrid.geometry import Carrier
    from fieldgrid.pipeline import track_drive
    from fieldgrid.poses import check_target, summarise_track, write_track
    from fieldgrid.recordings import read_gear_spans

    origin = options.datum(datum)
    opening = replace(span.of(drive.options(columns)), poses=poses.source())
    if gear is not None:
        known = {**settings.get("pose", {}), "gear_spans": read_gear_spans(gear)}
        settings = {**settings, "pose": known}
    chosen = resolve(config, settings)
    is_given = antenna_ahead is not None or heading_offset is not None
    carrier = Carrier(antenna_ahead, heading_offset) if is_given else None
    if out is not None:
        check_target(out)
    path = progress.fetched(recording)
    options.check_outputs([out, figure], [path], overwrite=overwrite)
    with progress.working(f"{path.name}: reading and estimating"):
        tracked = track_drive(path, chosen, opening, datum=origin, carrier=carrier)
    if out is not None:
        write_track(tracked.estimate, out)
    if figure is not None:
        from fieldgrid.export import figures

        limit_deg = chosen.pose.max_heading_sigma_deg
        figures.save(
            figures.track_figure(
                tracked.estimate.trajectory, title=tracked.name, max_sigma_deg=limit_deg
            ),
            figure,
        )
    summary = summarise_track(tracked.estimate)
    if as_json:
        output.print_json(
            {
                "track": None if out is None else str(out),
                "figure": None if figure is None else str(figure),
                "drive": tracked.name,
                "gnss": tracked.gnss_source,
                **summary.as_dict(),
                "findings": [one.as_dict() for one in tracked.findings],
            }
        )
    else:
        _report(out, figure, tracked, summary)
    if not summary.ok + summary.held:
        rejected, why = summary.reasons[0]
        raise GnssError(
            f"{tracked.name} has no usable pose; {rejected} of {summary.fixes} fixes: {why}."
        )


def _report(
    out: Path | None, figure: Path | None, drive: TrackedDrive, summary: TrackSummary
) -> None:
    from fieldgrid.core import in_order

    output.report_table(
        ("", ""),
        [*_fix_rows(summary), *_way_rows(summary), *_sensor_rows(summary)],
        title=f"track {drive.name}",
    )
    for count, example in summary.reasons[:_MOST_REASONS]:
        output.report_line(f"rejected {count}: {example}")
    if more := summary.reasons[_MOST_REASONS:]:
        count = sum(count for count, _ in more)
        reasons = "another reason" if len(more) == 1 else f"{len(more)} other reasons"
        output.report_line(f"rejected {count}: for {reasons}")
    for finding in in_order(drive.findings):
        output.report_line(output.finding_line(finding))
    if out is not None:
        output.report_line(f"track {out}")
    if figure is not None:
        output.report_line(f"figure {figure}")


def _fix_rows(summary: TrackSummary) -> list[tuple[str, str]]:
    log = summary.report.conditioning
    longest_s = max((gap.seconds for gap in log.gaps), default=0.0)
    longest = f", the longest {longest_s:.1f} s" if log.gaps else ""
    return [
        ("fixes", str(summary.fixes)),
        ("accepted, moving / held at rest", f"{summary.ok} / {summary.held}"),
        ("written twice / rejected", f"{summary.repeated} / {summary.rejected}"),
        ("rate", output.number(log.rate_hz, 1, "Hz")),
        ("gaps without a usable fix", f"{len(log.gaps)}{longest}"),
        ("seams (shifts of the solution)", str(len(log.seams))),
    ]


def _way_rows(summary: TrackSummary) -> list[tuple[str, str]]:
    gears, datum = summary.gears, summary.datum
    times = (gears.forward_s, gears.reverse_s, gears.standing_s)
    return [
        ("duration", output.number(summary.duration_s, 1, "s")),
        ("forward / reverse / at rest", " / ".join(f"{t:.1f}" for t in times) + " s"),
        ("changes between forward and reverse", str(gears.reversals)),
        ("distance", output.number(summary.distance_m, 1, "m")),
        (
            f"heading sigma, median / 95 % ({summary.heading_source})",
            _spread(summary.heading_sigma_deg, 2, "°"),
        ),
        ("position sigma, median / 95 %", _spread(summary.position_sigma_m, 3, "m")),
        (
            "datum: latitude, longitude, height",
            f"{datum.lat_deg!r}, {datum.lon_deg!r}, {datum.height_m!r}",
        ),
    ]


def _sensor_rows(summary: TrackSummary) -> Iterator[tuple[str, str]]:
    """What was found out about the sensors that the drive has."""
    report = summary.report
    if report.offset is not None:
        lasting_m, sigmas = report.offset.lasting_m, report.offset.lasting_sigmas
        told = f"{lasting_m:.3f} m, {sigmas:.2f} of the stated error"
        yield "pose minus fix, 20 s mean", told
    frame = report.georeference
    if frame is not None:
        unsure = "" if frame.by == "declared" else f" ± {frame.frame_heading_sigma_deg:.2f}"
        yield (
            f"heading of the poses' frame ({frame.by})",
            f"{frame.frame_heading_deg:.2f}{unsure} °",
        )
    if frame is not None and frame.fixes:
        off_m = (frame.residual_median_m, frame.residual_p95_m, frame.residual_most_m)
        words = " / ".join(f"{one:.3f}" for one in off_m)
        yield f"poses minus {frame.fixes} fixes, median / 95 % / most", f"{words} m"
    if report.gyro_bias_dps == report.gyro_bias_dps:  # not NaN: there is a gyro
        yield "gyro bias", f"{report.gyro_bias_dps:.3f} °/s"
    if report.recorded is not None:
        offset, sigma = report.recorded.offset_deg, report.recorded.offset_sigma_deg
        yield "recorded minus estimated heading", f"{offset:+.2f} ± {sigma:.2f} °"
    if report.clock is not None:
        yield "image clock", f"{report.clock.offset_s:+.3f} ± {report.clock.sigma_s:.3f} s"


def _spread(spread: Spread | None, digits: int, unit: str) -> str:
    if spread is None:
        return "-"
    return f"{spread.median:.{digits}f} / {spread.p95:.{digits}f} {unit}"
