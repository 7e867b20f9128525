"""`fieldgrid build`: the main job."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import output, parse, recording_options

if TYPE_CHECKING:
    from fieldgrid.build import Progress, SessionReport
    from fieldgrid.geodesy import Datum
    from fieldgrid.recording import DriveOptions
    from fieldgrid.settings import BuildSettings


def command(
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="RECORDING...", help="Recordings.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="MAP.gpkg", help="The map file.")
    ] = None,
    repose: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP.gpkg",
            help="Instead: estimate the poses of this map's drives again, without images.",
        ),
    ] = None,
    gnss: recording_options.Gnss = None,
    topic: recording_options.Topic = None,
    mounting: recording_options.MountingFile = None,
    time_offset: recording_options.TimeOffset = None,
    heading: recording_options.Heading = None,
    visual_odometry: Annotated[
        bool | None,
        typer.Option(help="Whether the camera's own motion helps to find the poses."),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="How far off a cell at the far end may be, 1-sigma [the cell, at least 0.25].",
        ),
    ] = None,
    append: Annotated[bool, typer.Option("--append", help="Add to an existing map.")] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing map.")
    ] = False,
    name: Annotated[
        str | None, typer.Option(help="The session's name, for a single recording.")
    ] = None,
    datum: recording_options.DatumText = None,
    datum_from: Annotated[
        Path | None,
        typer.Option(metavar="MAP.gpkg", help="Take the origin of another map, to merge with it."),
    ] = None,
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Universal cell, L_U [that of --local-cell].")
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="WxL", help="Local grid, metres [10x15].")
    ] = None,
    local_cell: Annotated[
        float | None, typer.Option(metavar="M", help="Local cell, L_L [0.05].")
    ] = None,
    slice_: Annotated[
        str | None,
        typer.Option("--slice", metavar="BOTTOM:TOP", help="Above the local ground [0.2:2.2]."),
    ] = None,
    max_range: Annotated[
        float | None,
        typer.Option(metavar="M", help="Farthest points used [15, less where range is unsure]."),
    ] = None,
    matcher: Annotated[
        str | None, typer.Option(metavar="sgbm3way|sgbm|bm", help="Stereo matcher [sgbm3way].")
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(metavar="centre|area", help="Local to universal cells [centre]."),
    ] = None,
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Take every N-th frame.")] = 1,
    config: recording_options.Config = None,
    jobs: Annotated[int | None, typer.Option(min=1, max=256, help="Threads [one a core].")] = None,
    as_json: recording_options.AsJson = False,
) -> None:
    """Make a map from recordings (stereo pairs and GNSS), or append them to one.

    Examples:

        fieldgrid build june-03 -o vineyard.gpkg --gnss rtk.nmea

        fieldgrid build june-10 june-17 -o vineyard.gpkg --append

        fieldgrid build 2011_09_30_drive_0020_sync -o road.gpkg --grid 20x15

        fieldgrid build --repose vineyard.gpkg --name june-10 --heading course
    """
    if repose is not None:
        if recordings or out is not None:
            raise typer.BadParameter(
                "it takes neither recordings nor --out: a map keeps what poses come from",
                param_hint="--repose",
            )
        _repose(repose, name, config, _pose_overrides(heading, visual_odometry, budget), as_json)
        return
    if not recordings or out is None:
        missing = "RECORDING..." if not recordings else "--out"
        raise typer.BadParameter("it is needed, unless there is --repose", param_hint=missing)
    if name is not None and len(recordings) > 1:
        raise typer.BadParameter("--name is for a single recording", param_hint="--name")
    settings = _settings(
        config,
        heading,
        visual_odometry,
        budget,
        cell,
        grid,
        local_cell,
        slice_,
        max_range,
        matcher,
        transfer,
    )
    try:
        reports = _run(
            recordings,
            out,
            recording_options.given(gnss, topic, mounting, time_offset),
            settings,
            _datum(datum, datum_from),
            append,
            overwrite,
            name,
            every,
            jobs,
        )
    except KeyboardInterrupt:
        typer.echo("fieldgrid: interrupted; the drive is not in the map.", err=True)
        raise typer.Exit(130) from None
    if as_json:
        output.print_json({"map": str(out), "sessions": [report.as_dict() for report in reports]})
    else:
        _print_reports(out, reports)


def _pose_overrides(
    heading: str | None, visual_odometry: bool | None, budget_m: float | None
) -> dict[str, Any]:
    return {"heading": heading, "visual_odometry": visual_odometry, "cell_budget_m": budget_m}


def _repose(
    path: Path,
    name: str | None,
    config: Path | None,
    overrides: dict[str, Any],
    as_json: bool,
) -> None:
    from fieldgrid.build.repose import repose_map
    from fieldgrid.settings import resolve
    from fieldgrid.track import grouped_reasons

    given = {key: value for key, value in overrides.items() if value is not None}
    if config is not None:
        chosen = resolve(config, {"pose": given}).pose
        given = {key: getattr(chosen, key) for key in chosen.model_fields_set}
    reports = repose_map(path, given, name)
    if as_json:
        output.print_json({"map": str(path), "sessions": [r.as_dict() for r in reports]})
        return
    for report in reports:
        rows = [
            ("frames used before", f"{report.used_before} of {report.frames}"),
            ("frames used now", f"{report.used} of {report.frames}"),
            (f"heading sigma, median ({report.heading_source})",
             output.number(report.heading_sigma_deg, 2, "°")),
            ("moved, median / most", _change(report.moved_m, 3, "m")),
            ("turned, median / most", _change(report.turned_deg, 2, "°")),
        ]  # fmt: skip
        output.print_table(("", ""), rows, title=f"session {report.session}")
        for count, example in grouped_reasons(report.reasons):
            print(f"rejected {count}: {example}")
        for note in report.notes:
            print(f"note: {note}")
    print(f"map {path}")


def _change(values: tuple[float, float] | None, decimals: int, unit: str) -> str:
    return "-" if values is None else f"{values[0]:.{decimals}f} / {values[1]:.{decimals}f} {unit}"


def _datum(text: str | None, other: Path | None) -> Datum | None:
    if text is not None and other is not None:
        raise typer.BadParameter(
            "--datum and --datum-from exclude each other", param_hint="--datum-from"
        )
    if other is None:
        return parse.datum(text)
    from fieldgrid.mapfile import read_datum

    return read_datum(other)


def _settings(
    config: Path | None,
    heading: str | None,
    visual_odometry: bool | None,
    budget_m: float | None,
    cell: float | None,
    grid: str | None,
    local_cell: float | None,
    slice_: str | None,
    max_range: float | None,
    matcher: str | None,
    transfer: str | None,
) -> BuildSettings:
    from fieldgrid.settings import resolve

    width_m, length_m = parse.size(grid) or (None, None)
    bottom_m, top_m = parse.span(slice_) or (None, None)
    overrides: dict[str, dict[str, Any]] = {
        "grid": {"width_m": width_m, "length_m": length_m, "cell_m": local_cell},
        "stereo": {"matcher": matcher},
        "density": {
            "slice_bottom_m": bottom_m,
            "slice_top_m": top_m,
            "max_range_m": max_range,
        },
        "pose": _pose_overrides(heading, visual_odometry, budget_m),
        "map": {"cell_m": cell, "transfer": transfer},
    }
    return resolve(config, overrides)


def _run(
    paths: list[Path],
    out: Path,
    options: DriveOptions,
    settings: BuildSettings,
    datum: Any,
    append: bool,
    overwrite: bool,
    name: str | None,
    every: int,
    jobs: int | None,
) -> list[SessionReport]:
    from fieldgrid.build import build_map

    with _progress() as show:
        return build_map(
            paths,
            out,
            settings,
            options,
            datum=datum,
            append=append,
            overwrite=overwrite,
            name=name,
            every=every,
            jobs=jobs or os.cpu_count(),
            progress=show,
        )


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[Progress], None] | None]:
    """A progress line on stderr: frames, rate, distance; None where no terminal watches."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    with Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}  {task.fields[distance]}"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        tasks: dict[str, Any] = {}

        def show(now: Progress) -> None:
            if now.session not in tasks:
                tasks[now.session] = bar.add_task(
                    now.session, total=now.frames_total, rate="", distance=""
                )
            task = tasks[now.session]
            speed = bar.tasks[task].speed
            bar.update(
                task,
                completed=now.frames_done,
                rate=f"{speed:.1f} frames/s" if speed else "",
                distance="" if now.distance_m is None else f"{now.distance_m:.0f} m",
            )

        yield show


def _print_reports(out: Path, reports: list[SessionReport]) -> None:
    from fieldgrid.track import grouped_reasons

    for report in reports:
        rows = [
            ("frames used", f"{report.used} of {report.frames}"),
            ("fixes accepted", f"{report.fixes_accepted} of {report.fixes}"),
            ("distance mapped", output.number(report.distance_m, 1, "m")),
            (f"heading sigma, median ({report.heading_source})",
             output.number(report.heading_sigma_deg, 2, "°")),
            ("position sigma, median", output.number(report.position_sigma_m, 3, "m")),
            ("camera steps", _steps(report)),
            ("points used up to", output.number(report.max_range_m, 1, "m")),
            ("ground plane refined in", f"{report.ground_refined} frames"),
            # As wide for a slow machine as for a fast one, so that tables can be compared.
            ("rate", f"{report.frames_per_s:7.1f} frames/s"),
        ]  # fmt: skip
        output.print_table(("", ""), rows, title=f"session {report.session}")
        for count, example in grouped_reasons(report.reasons):
            print(f"rejected {count}: {example}")
        for note in report.notes:
            print(f"note: {note}")
    print(f"map {out}")


def _steps(report: SessionReport) -> str:
    tried = report.camera_steps + report.camera_refusals
    return f"{report.camera_steps} of {tried}" if tried else "not used"
