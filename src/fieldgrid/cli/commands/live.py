"""`fieldgrid live`: a map while it is driven."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.build_report import report_session
from fieldgrid.cli.drive_options import DriveFlags
from fieldgrid.cli.groups import FieldsOf
from fieldgrid.cli.live_sources import (
    GNSS,
    LiveInput,
    SourceFlags,
    of_recording,
    of_ros,
    of_sources,
    speed,
)
from fieldgrid.cli.live_watch import Watch, open_feed_at, open_foxglove, open_page
from fieldgrid.cli.new_drives import compare, report_offsets
from fieldgrid.cli.pose_flags import PoseFlags, Poses
from fieldgrid.cli.settings_flags import SettingsFlags
from fieldgrid.core import ConfigError, FieldgridError, Overrides, quoted

if TYPE_CHECKING:
    from fieldgrid.live import Counts, Live, RosSession
    from fieldgrid.pipeline import SessionReport


import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# What Ctrl-C and SIGTERM do to `fieldgrid live`.


@contextmanager
def kept_when_interrupted(folder: Path, out: Path, way: str = "--finish") -> Iterator[None]:
    """Say where the drive is when Ctrl-C or SIGTERM ends the making of its map; `way` is the option
    that makes it."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        # Where the end had begun, it has noted what became of the drive.
        if folder.exists() and not hasattr(end, "__notes__"):
            end.add_note(
                f"What is kept of the drive is in {folder}; fieldgrid live -o {out} {way} makes "
                "the map of it."
            )
        raise


@contextmanager
def ended_by_signals() -> Iterator[threading.Event]:
    """In the block Ctrl-C and SIGTERM set an event, and interrupt nothing."""
    stop = threading.Event()
    before = {
        one: signal.signal(one, lambda *_: stop.set()) for one in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


_SESSION = options.MAP_FILE
_AT_THE_END = {"out", "finish", "finish_from", "wait_s", "as_json", "quiet", "verbose"}


def command(
    ctx: typer.Context,
    *,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="MAP.gpkg",
            help="The map file. MAP.gpkg.work beside it stores the drive until it is in the map.",
            rich_help_panel=_SESSION,
            show_default=False,
        ),
    ],
    sources: Annotated[SourceFlags, FieldsOf(SourceFlags)],
    replay: Annotated[
        Path | None,
        typer.Option(
            "--replay",
            metavar="RECORDING",
            help="Play a recording as if it were driven now.",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    rate: Annotated[
        str,
        typer.Option(
            metavar="X|max",
            help="Speed of --replay relative to the drive; max: as fast as possible, without "
            "dropping a frame.",
            rich_help_panel=_SESSION,
        ),
    ] = "1",
    finish: Annotated[
        bool,
        typer.Option(
            "--finish",
            help="Put an interrupted drive into the map.",
            rich_help_panel=_SESSION,
        ),
    ] = False,
    finish_from: Annotated[
        Path | None,
        typer.Option(
            "--finish-from",
            metavar="RECORDING",
            help="Build an interrupted drive again from its recording, dropped frames included.",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    discard: Annotated[
        bool,
        typer.Option(
            "--discard",
            help="Remove the stored data of an interrupted session.",
            rich_help_panel=_SESSION,
        ),
    ] = False,
    append: Annotated[
        bool,
        typer.Option("--append", help="Add to an existing map.", rich_help_panel=_SESSION),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The session's name [default: that of the recording or the folder].",
            rich_help_panel=_SESSION,
        ),
    ] = None,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    datum: options.DatumText = None,
    drive: Annotated[DriveFlags, FieldsOf(DriveFlags, gnss=GNSS)],
    poses: Poses,
    settings: Annotated[Overrides, SettingsFlags()],
    config: options.Config = None,
    as_json: Annotated[
        bool,
        typer.Option(
            "--json",
            help="Print one JSON object per line: grids, poses, windows and events as they "
            "occur, then the report.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
) -> None:
    """Map during the drive: local grids, poses and a costmap now, the map of `build` at the end.

    Ctrl-C and SIGTERM end the drive and make its map. After a kill, the same command continues
    the session.

    Examples:

        fieldgrid live -o row.gpkg --images june --gnss tcp://10.0.0.7:9001

        fieldgrid live -o row.gpkg --camera 0 --rig zed --gnss gpsd://localhost

        ssh robot record | fieldgrid live -o row.gpkg --mcap - --rig zed

        fieldgrid live -o row.gpkg --replay june --feed tcp://127.0.0.1:7007

        fieldgrid live -o row.gpkg --replay june --view 8080 --foxglove 8765

        fieldgrid live -o row.gpkg --finish --accept clock-offset
    """
    driving = [one is not None for one in (replay, sources.images, sources.camera, sources.mcap)]
    driving.append(sources.ros)
    if sum([*driving, finish, finish_from is not None, discard]) != 1:
        raise typer.BadParameter(
            "give one of --images, --camera, --mcap, --replay, --ros, --finish, --finish-from "
            "and --discard",
            param_hint="--images",
        )
    if discard:
        options.refuse_given(
            ctx, {"out", "discard", "quiet", "verbose"}, "--discard only removes; leave it out"
        )
        from fieldgrid.live import discard_session

        session, frames = discard_session(out)
        what = f"the session {session} with {frames} frames" if session else "an unreadable session"
        output.report_line(f"removed {what}")
        return
    if not any(driving):
        flags = set(SettingsFlags("pose", "checks").names())
        if finish_from is not None:
            flags |= {*DriveFlags._fields, *PoseFlags._fields}
        why = "the drive is over, and this cannot be changed any more; leave it out"
        options.refuse_given(ctx, _AT_THE_END | flags, why)
        report = _finished(out, finish_from, drive, poses, settings, wait_s)
        _report(report, None, out, wait_s, as_json=as_json)
        return
    _refuse_idle(ctx, sources, replay)
    options.check_new_map(out)
    with ExitStack() as stack:
        ros = None
        if sources.ros:
            from fieldgrid.live import RosSession

            ros = stack.enter_context(RosSession(out, drive.options(), output.message))
            output.message("listening to the topics of ROS")
            driven = of_ros(ros)
        elif replay is None:
            driven = of_sources(sources, drive, poses)
        else:
            from fieldgrid.recordings import open_drive

            opening = replace(drive.options(), poses=poses.source())
            opened = stack.enter_context(open_drive(replay, opening))
            driven = of_recording(opened.recording(), speed(rate))
        report, counts = _drive(
            *(driven, out, append, name, datum, sources, settings, config, wait_s),
            ros=ros,
            as_json=as_json,
        )
        _report(report, counts, out, wait_s, as_json=as_json)
        if ros is not None:
            with ended_by_signals() as stop:
                ros.finished(stop)


def _refuse_idle(ctx: typer.Context, sources: SourceFlags, replay: Path | None) -> None:
    """A usage error for what would be ignored with this source."""
    idle = {"rate"} if replay is None else {"gnss_log"}
    idle |= {"topic"} if replay is None and sources.mcap is None and not sources.ros else set()
    idle |= {"camera_fps"} if sources.camera is None else set()
    idle |= set(PoseFlags._fields) if replay is None and sources.mcap is None else set()
    idle |= {"poses", "poses_times"} if sources.mcap is not None else set()
    idle |= {"rig"} if sources.camera is None and sources.mcap is None else set()
    options.refuse_idle(ctx, idle, "this source does not take it; leave it out")


def _drive(
    driven: LiveInput,
    out: Path,
    append: bool,
    name: str | None,
    datum: str | None,
    sources: SourceFlags,
    settings: Overrides,
    config: Path | None,
    wait_s: float,
    *,
    ros: RosSession | None,
    as_json: bool,
) -> tuple[SessionReport, Counts]:
    from fieldgrid.core import resolve
    from fieldgrid.live import Live, LiveOptions
    from fieldgrid.maps import Patience

    resolved, limit_gb = resolve(config, settings), sources.points_gb
    with ExitStack() as stack:
        line = stack.enter_context(progress.living())
        watch = Watch(line, as_json=as_json)
        if sources.feed is not None:
            watch.feed = open_feed_at(sources.feed, watch)
            stack.enter_context(watch.feed)
        if sources.view is not None:
            page = open_page(sources.view, name or driven.name)
            watch.servers.append(stack.enter_context(page))
        if sources.foxglove is not None:
            server = open_foxglove(sources.foxglove, name or driven.name, watch)
            watch.servers.append(stack.enter_context(server))
        if ros is not None:
            watch.servers.append(ros)
        live = Live(
            out,
            driven.rig,
            resolved,
            name=name or driven.name,
            datum=options.datum(datum),
            datum_hint=driven.datum_hint,
            append=append,
            source=driven.source,
            source_sha256=driven.source_sha256,
            notes=driven.notes,
            poses=driven.poses,
            options=LiveOptions() if limit_gb is None else LiveOptions(points_gb=limit_gb),
            on_result=watch.take,
        )
        watch.live = live
        with ended_by_signals() as stop:
            try:
                all_of_it = driven.run(live, stop)
            except BaseException:
                live.stop()
                raise
            if not all_of_it:
                output.message("ending the drive and making its map; interrupt again to cancel")
        watch.making_the_map()
        patience = Patience(wait_s, progress.waits_for(out, wait_s))
        with kept_when_interrupted(live.folder, out):
            _refuse_frameless(live)
            report = live.finish(progress=watch.making_the_map, patience=patience)
            return report, live.counts  # with the frames that still waited


def _refuse_frameless(live: Live) -> None:
    """End a session to which neither a frame nor a fix ever came, as where an address is wrong:
    what it began would only be in the way of the next one."""
    live.drain()
    counts = live.counts
    came = counts.frames + counts.dropped + counts.late + counts.bad + counts.fixes
    if not live.is_resumed and not came:
        live.close()
        raise ConfigError(
            f"No frame came, so there is no map of the session {quoted(live.name)}, and nothing of "
            "it is kept; check where the images come from."
        )


def _finished(
    out: Path,
    recording: Path | None,
    drive: DriveFlags,
    poses: PoseFlags,
    settings: Overrides,
    wait_s: float,
) -> SessionReport:
    from fieldgrid.live import finish_from, finish_session, live_folder
    from fieldgrid.maps import Patience

    way = "--finish" if recording is None else f"--finish-from {recording}"
    kept = kept_when_interrupted(live_folder(out), out, way)
    with kept, progress.building(out, wait_s) as tell:
        patience = Patience(wait_s, tell.waiting)
        if recording is None:
            return finish_session(out, settings, progress=tell.show, patience=patience)
        opening = replace(drive.options(), poses=poses.source())
        return finish_from(out, recording, opening, settings, progress=tell.show, patience=patience)


def _report(
    report: SessionReport, counts: Counts | None, out: Path, wait_s: float, *, as_json: bool
) -> None:
    offsets, lost = list[dict[str, Any]](), None
    try:
        offsets = compare(out, [report.session], wait_s)
    except FieldgridError as problem:  # the drive is in the map, and is reported first
        lost = problem
    if as_json:
        pushed = None if counts is None else counts._asdict()
        about = {"map": str(out), "session": report.as_dict(), "pushed": pushed}
        output.print_json_line({**about, "alignment": offsets})
    else:
        _print_report(report, counts)
        report_offsets(offsets, out)
        output.report_line(f"map {out}")
    if lost is not None:
        raise lost


def _print_report(report: SessionReport, counts: Counts | None) -> None:
    if counts is not None:
        rows = [
            ("frames kept", str(counts.frames)),
            ("frames dropped", str(counts.dropped)),
            ("frames late or twice", str(counts.late)),
            ("frames that cannot be read", str(counts.bad)),
            ("fixes", str(counts.fixes)),
        ]
        output.report_table(("", ""), rows, title=f"live {report.session}")
    report_session(report, rate=False)
