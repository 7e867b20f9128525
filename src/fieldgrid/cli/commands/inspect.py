"""`fieldgrid inspect`: what is in a recording, and what would go wrong with it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.drive_options import Drive, Span

if TYPE_CHECKING:
    from fieldgrid.pipeline import Inspection, StreamSummary

_MOST_QUALITIES = 3


def command(
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING|LOG", help="A recording, or a GNSS log.")
    ],
    drive: Drive,
    span: Span,
    figure: options.Figure = None,
    overwrite: options.Overwrite = False,
    config: options.Config = None,
    as_json: options.AsJson = False,
) -> None:
    """Show what is in a recording and what would go wrong; exit 1 if a build would fail.

    Each finding has a severity (error: the build fails or the map is wrong; warning: the map is
    poorer than the drive allows; info) and a remedy.

    Examples:

        fieldgrid inspect june-03 --gnss rtk.nmea

        fieldgrid inspect june-03.mcap --json
    """
    options.check_figure(figure)
    options.check_outputs([figure], [], overwrite=overwrite)
    from fieldgrid.core import RecordingError, resolve
    from fieldgrid.pipeline import inspect_recording

    path = progress.fetched(recording)
    with progress.counting("frames") as tell:
        found = inspect_recording(path, resolve(config, {}), span.of(drive.options()), tell=tell)
    if figure is not None:
        from fieldgrid.export import figures
        from fieldgrid.pipeline import inspection_figure

        figures.save(inspection_figure(found), figure)
    if as_json:
        output.print_json({**found.as_dict(), "figure": None if figure is None else str(figure)})
    else:
        _print(found, figure)
    if not found.builds:
        wrong = dict.fromkeys(one.code for one in found.findings if one.severity.value == "error")
        raise RecordingError(
            f"a build of {found.name} would fail ({', '.join(wrong)}); the findings say what to do."
        )


def _print(found: Inspection, figure: Path | None) -> None:
    rows = [*_drive_rows(found), *_rig_rows(found), *_fix_rows(found)]
    rows += [*_image_rows(found), *_map_rows(found)]
    if rows:
        output.print_table(("", ""), rows, title=f"inspect {found.name}")
    if found.streams:
        columns = ("stream", "kind", "used as", "count", "rate", "longest gap", "jitter")
        output.print_line("")
        output.print_table(columns, [_stream_row(stream) for stream in found.streams])
    output.print_line("")
    for finding in found.findings:
        print(output.finding_line(finding))
    verdict = "a build would succeed" if found.builds else "a build would fail"
    output.print_line(f"inspect {found.path or found.name}: {verdict}")
    if figure is not None:
        output.print_line(f"figure {figure}")


def _drive_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    if not found.kind:
        return
    yield "kind", found.kind
    yield "duration", output.number(found.duration_s, 1, "s")
    yield "frames", output.number(found.frames, 0)
    if found.frames:
        yield "frames examined / tracked", f"{found.looked} / {found.followed}"
    yield "GNSS", found.gnss_source or "-"


def _rig_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    from fieldgrid.pipeline import describe_sensor

    rig = found.rig
    if rig is None:
        return
    mount, lever, seen = rig.mount, rig.antenna, found.mount
    yield "sensor", describe_sensor(rig.sensor)
    yield (
        "mount: height, tilt, roll, yaw",
        f"{mount.height_m:g} m, {mount.tilt_deg:.1f}°, {mount.roll_deg:.1f}°, {mount.yaw_deg:.1f}°",
    )
    if seen is not None:
        yield (
            f"mount by the {seen.method}",
            f"{seen.height_m.value:.2f} ± {seen.height_m.sigma:.2f} m, "
            f"{seen.tilt_deg.value:.2f} ± {seen.tilt_deg.sigma:.2f}°, "
            f"{seen.roll_deg.value:.2f} ± {seen.roll_deg.sigma:.2f}°",
        )
    yield from (
        (
            "antenna: right, forward, up",
            f"{lever.right_m:.2f}, {lever.forward_m:.2f}, {lever.up_m:.2f} m",
        ),
        ("non-steering axle: forward", output.number(rig.rear_axle_forward_m, 2, "m")),
        ("image time offset, declared", f"{found.declared_offset_s:+.3f} s"),
    )


def _fix_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    if found.fixes is not None:
        fixes = found.fixes
        best = list(fixes.quality.items())[:_MOST_QUALITIES]
        medians = (
            output.number(fixes.satellites, 0),
            output.number(fixes.hdop, 1),
            output.number(fixes.age_s, 1, "s"),
        )
        yield from (
            ("fixes accepted", f"{fixes.accepted} of {fixes.log.fixes}"),
            ("quality", ", ".join(f"{name} {output.percent(share, 0)}" for name, share in best)),
            ("satellites / hdop / age, median", " / ".join(medians)),
            ("sigma of a fix, median", output.number(fixes.sigma_m, 3, "m")),
        )
    if found.sync is not None:
        sync = found.sync
        yield "image to nearest fix, median / most", f"{sync.median_s:.3f} / {sync.most_s:.3f} s"
        yield "images outside of fixes", output.percent(sync.without_share)
    if found.clock is not None:
        yield "image clock", f"{found.clock.offset_s:+.3f} ± {found.clock.sigma_s:.3f} s"


def _image_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    looks = found.looks
    if looks:
        middle = sorted(look.images.blur for look in looks)[len(looks) // 2]
        points = sorted(look.points for look in looks)[len(looks) // 2]
        yield "blur, median", f"{middle:.2f}"
        yield "points with depth, median", str(points)
    if found.misalignment is not None:
        rows = found.misalignment
        yield "row offset, median / vertical", f"{rows.median_px:+.2f} / {rows.residual_px:.2f} px"
    if found.camera_pairs:
        yield "camera steps", f"{found.camera_steps} of {found.camera_pairs}"
    if found.scale is not None:
        yield "distance, camera / fixes", f"{found.scale.ratio:.3f} ± {found.scale.sigma:.3f}"


def _map_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    if found.frames_usable is not None and found.frames:
        yield "frames with a usable pose", f"{found.frames_usable} of {found.frames}"
    if found.coverage is not None:
        cover = found.coverage
        spacing = output.number(cover.spacing_m, 2, "m")
        yield from (
            ("expected area", output.number(cover.area_m2, 0, "m²")),
            ("frame spacing / grid length", f"{spacing} / {cover.grid_m:.1f} m"),
            ("supported cell size", output.number(cover.cell_m, 2, "m")),
        )


def _stream_row(stream: StreamSummary) -> tuple[str, ...]:
    jitter_ms = None if stream.jitter_s is None else 1000.0 * stream.jitter_s
    return (
        stream.name,
        stream.kind,
        stream.role or "-",
        str(stream.messages),
        output.number(stream.rate_hz, 2, "Hz"),
        output.number(stream.longest_gap_s, 3, "s"),
        output.number(jitter_ms, 1, "ms"),
    )
