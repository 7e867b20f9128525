"""`fieldgrid build`: the main job."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.build_report import report_drives, report_remarks, report_session
from fieldgrid.cli.drive_options import Drive, Span
from fieldgrid.cli.new_drives import compare, report_offsets
from fieldgrid.cli.pose_flags import Poses
from fieldgrid.cli.settings_flags import SettingsFlags
from fieldgrid.core import FieldgridError, Overrides, printable, quoted

if TYPE_CHECKING:
    from fieldgrid.pipeline import PartlyBuiltError

_SESSION = options.MAP_FILE


def command(
    ctx: typer.Context,
    recordings: Annotated[
        list[str] | None, typer.Argument(metavar="RECORDING...", show_default=False)
    ] = None,
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="MAP.gpkg", help="The map file.", rich_help_panel=_SESSION
        ),
    ] = None,
    append: Annotated[
        bool,
        typer.Option("--append", help="Add to an existing map.", rich_help_panel=_SESSION),
    ] = False,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Replace an existing map.", rich_help_panel=_SESSION),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The session's name, for a single recording [default: the recording's own].",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    datum: options.DatumText = None,
    datum_from: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP.gpkg",
            help="Use the datum of another map, so that the two can be merged.",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    repose: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP.gpkg",
            help="Estimate the poses of this map's drives again, without images; takes only "
            "pose options.",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    drive: Drive,
    span: Span,
    poses: Poses,
    settings: Annotated[Overrides, SettingsFlags()],
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="Align the new drives with the map afterwards, as `align` does.",
            rich_help_panel=_SESSION,
        ),
    ] = False,
    every: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="Take every N-th frame [default: 1].", show_default=False
        ),
    ] = 1,
    resume: Annotated[
        bool | None,
        typer.Option(
            "--resume/--no-resume",
            help="Continue an interrupted build of the same command, or remove its staged "
            "frames [default: refuse if there are any].",
            rich_help_panel=_SESSION,
            show_default=False,
        ),
    ] = None,
    skip_bad: Annotated[
        str | None,
        typer.Option(
            "--skip-bad",
            metavar="N|SHARE",
            help="Leave out unreadable frames, per drive at most a number (3) or a share (2%) "
            "[default: none].",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    fail_fast: Annotated[
        bool,
        typer.Option(
            "--fail-fast",
            help="Stop at the first drive that fails [default: leave it out and build the others].",
            rich_help_panel=_SESSION,
        ),
    ] = False,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    config: options.Config = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            min=1,
            max=256,
            metavar="N",
            help="Processes, or threads for few frames [default: one per core].",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:8786",
            help="Dask scheduler; its workers do the work and need the recordings at the "
            "same paths.",
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Make a map from recordings (stereo pairs and GNSS), or append them to one.

    Examples:

        fieldgrid build june-03 -o vineyard.gpkg --gnss rtk.nmea

        fieldgrid build june-10 june-17 -o vineyard.gpkg --append

        fieldgrid build 2011_09_30_drive_0020_sync -o road.gpkg --grid 20x15

        fieldgrid build orchard -o trees.gpkg --poses slam.tum --poses-axes rdf

        fieldgrid build june-24 -o vineyard.gpkg --append --align

        fieldgrid build 2026-06-*/ -o season.gpkg --skip-bad 2%

        fieldgrid build 2026-06-*/ -o season.gpkg --resume

        fieldgrid build june-*/ -o all.gpkg --scheduler tcp://10.0.0.5:8786

        fieldgrid build --repose vineyard.gpkg --name june-10 --heading course
    """
    if repose is not None:
        taken = {"repose", "name", "config", "wait_s", "as_json", "quiet", "verbose"}
        taken |= set(SettingsFlags("pose").names())
        why = "--repose estimates poses from what the map keeps and cannot use this; leave it out"
        options.refuse_given(ctx, taken, why)
        _repose(repose, name, config, settings, wait_s, as_json)
        return
    if not recordings or out is None:
        missing = "RECORDING..." if not recordings else "--out"
        raise typer.BadParameter("it is needed, unless there is --repose", param_hint=missing)
    options.refuse(
        name is not None and len(recordings) > 1, "--name", "--name is for a single recording"
    )
    options.check_new_map(out)
    options.check_scheduler(scheduler, jobs)
    source = poses.source()
    options.refuse(
        source is not None and len(recordings) > 1,
        "--poses",
        "poses are those of a single recording",
    )
    from fieldgrid.core import resolve
    from fieldgrid.maps import Patience
    from fieldgrid.pipeline import PartlyBuiltError, build_map, left_behind, work_folder

    partly: PartlyBuiltError | None = None
    paths = [progress.fetched_or_url(recording) for recording in recordings]
    try:
        with progress.building(out, wait_s) as tell:
            reports = build_map(
                paths,
                out,
                resolve(config, settings),
                replace(span.of(drive.options()), poses=source),
                datum=options.datum_or_from(datum, datum_from),
                append=append,
                overwrite=overwrite,
                name=name,
                every=every,
                jobs=jobs,
                scheduler=scheduler,
                resume=resume,
                skip_bad=_bad(skip_bad),
                fail_fast=fail_fast,
                patience=Patience(wait_s, tell.waiting),
                progress=tell.show,
            )
    except (KeyboardInterrupt, SystemExit) as end:
        kept = ""
        if left_behind(out):
            kept = (
                f" What was staged is kept in {work_folder(out)}; the same command with --resume "
                "goes on from there."
            )
        what = "drive is" if len(recordings) == 1 else "drives that were not finished are"
        end.add_note(f"The {what} not in the map.{kept}")
        raise
    except PartlyBuiltError as problem:
        partly, reports = problem, list(problem.reports)
        if not reports:
            raise
    offsets, lost = list[dict[str, Any]](), None
    try:
        # Without --align it is little work, and no cluster is needed for it.
        there = scheduler if align else None
        offsets = compare(
            out,
            [report.session for report in reports],
            wait_s,
            align=align,
            jobs=jobs,
            scheduler=there,
        )
    except FieldgridError as problem:  # the drives are in the map, and are reported first
        lost = problem
    if as_json:
        sessions = [report.as_dict() for report in reports]
        failed = [] if partly is None else partly.failed
        output.print_json(
            {
                "map": str(out),
                "sessions": sessions,
                "failed": [{"session": name, "reason": reason} for name, reason in failed],
                "alignment": offsets,
            }
        )
        _raise(partly, lost)
        return
    for report in reports:
        report_session(report)
    if len(recordings) > 1:
        report_drives(reports, partly)
    report_offsets(offsets, out)
    if align and not offsets and lost is None:
        output.report_line("no other drive of the map saw the same ground; nothing was aligned")
    output.report_line(f"map {out}")
    _raise(partly, lost)


def _raise(partly: PartlyBuiltError | None, lost: FieldgridError | None) -> None:
    """Raise what went wrong, after all was reported: drives that failed, or their comparison."""
    if partly is not None:
        if lost is not None:
            typer.echo(printable(f"fieldgrid: {lost}"), err=True)
        raise partly
    if lost is not None:
        raise lost


def _bad(text: str | None) -> int | float:
    """How many frames may be bad: a number, or below 1 a share."""
    if text is None:
        return 0
    match = re.fullmatch(r"(\d+)|(\d+(?:\.\d+)?)%|(0?\.\d+)", text.strip())
    share = float(match[2]) / 100.0 if match and match[2] else None
    if match is None or (share is not None and share > 1.0):
        raise typer.BadParameter(
            f"{quoted(text)} is neither a number of frames, as in 3, nor a share, as in 2%",
            param_hint="--skip-bad",
        )
    return int(match[1]) if match[1] else float(match[3]) if share is None else share


def _repose(
    path: Path,
    name: str | None,
    config: Path | None,
    settings: Overrides,
    wait_s: float,
    as_json: bool,
) -> None:
    from fieldgrid.core import resolve
    from fieldgrid.maps import Patience
    from fieldgrid.pipeline import repose_map

    chosen = resolve(config, settings).pose
    given = {key: getattr(chosen, key) for key in chosen.model_fields_set}
    reports = repose_map(
        path, given, name, patience=Patience(wait_s, progress.waits_for(path, wait_s))
    )
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
        output.report_table(("", ""), rows, title=f"session {report.session}")
        report_remarks(report)
    output.report_line(f"map {path}")


def _change(values: tuple[float, float] | None, decimals: int, unit: str) -> str:
    return "-" if values is None else f"{values[0]:.{decimals}f} / {values[1]:.{decimals}f} {unit}"
