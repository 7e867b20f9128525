"""The end of a live session: the drive smoothed as a whole, and placed by the code of a build."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from fieldgrid.core import (
    BuildSettings,
    ConfigError,
    FieldgridError,
    Finding,
    MapWriteError,
    Overrides,
    info,
    quoted,
    resolve,
    warning,
)
from fieldgrid.live.gridding_again import gridded_again
from fieldgrid.live.kept.kept_drive import PushedDrive, live_folder, live_journal
from fieldgrid.live.kept.session_folder import AGAIN, SessionFolder
from fieldgrid.maps import Patience, check_cell_sizes, open_map, read_datum
from fieldgrid.pipeline import (
    DriveStart,
    KeptDrive,
    NewSession,
    Progress,
    SessionReport,
    Store,
    build_map,
    check_names,
    check_output,
    exists_already,
    made_map,
    opened_map,
)
from fieldgrid.recordings import DriveOptions, Recording, open_drive

NOT_LEVELLED = info(
    "not-levelled",
    "The drive has roll and pitch, but the points of its frames were not kept, so its grids are "
    "perpendicular to the ground ahead. They are placed by the full attitude.",
    "For level grids, build the drive from a recording (fieldgrid build RECORDING).",
)

AT_THE_END = frozenset({"pose", "checks"})
"""Tables of settings that may be others at the end: grids do not depend on them."""


def check_begin(out: Path, about: DriveStart) -> None:
    """Raise what the map would refuse at the end, where a session begins, also again. The error
    tells of a session whose end was killed when the drive was in the map already, or before."""
    chosen, taken = about.settings.map, list[str]()
    try:
        check_output(out, append=about.append, overwrite=False)
        if about.append:
            with open_map(out, cell_m=chosen.cell_m, transfer=chosen.transfer) as universal:
                taken = [one.name for one in universal.sessions()]
                check_cell_sizes(universal.cell_m, about.settings.grid.cell_m)
        elif out.exists():
            raise exists_already(out)
        check_names([about.name], taken)
    except FieldgridError as error:
        if not live_journal(out).exists():
            raise
        raise type(error)(
            f"{error} {live_folder(out)} holds a session whose end was interrupted: fieldgrid live "
            f"-o {out} --finish completes it."
        ) from error


def finish_session(
    out: str | Path,
    overrides: Overrides | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    patience: Patience | None = None,
) -> SessionReport:
    """Put what a live session has kept for the map `out` into it, and remove what was kept.

    `overrides` are settings of poses and checks that replace those of the session, `patience` is
    how long another writer of the map is waited for. `progress` is called after each grid that is
    made again. On an error the drive stays where it is kept, and the error says how to finish it.
    """
    with SessionFolder(Path(out), None) as kept:
        return finish(kept, overrides or {}, progress, patience)


def finish_from(
    out: str | Path,
    recording: str | Path,
    options: DriveOptions | None = None,
    overrides: Overrides | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    patience: Patience | None = None,
) -> SessionReport:
    """Build the drive of a live session from a recording of it, under the session's name and by its
    settings, and remove what the session has kept: the map has the frames that were dropped, too.
    ConfigError for a recording that lacks a frame of the session: it is of another drive."""
    with SessionFolder(Path(out), None) as kept:
        about = kept.about
        with open_drive(recording, options) as drive:
            found = drive.recording()
            if about.poses is not None and not found.pose_name:
                raise ConfigError(
                    f"The session {quoted(about.name)} was driven by poses of {about.poses.name}; "
                    "say with --poses or --poses-topic where they are recorded."
                )
            times_ns = found.frame_times_ns() + found.rig.image_time_offset_ns
            for _, entry, *_ in kept.drive.frames:
                if entry.time_ns not in times_ns:
                    raise ConfigError(
                        f"{recording} has no frame of the time {entry.time_ns} ns, as the session "
                        f"{quoted(about.name)} in {kept.folder} has; give the recording of that "
                        "drive."
                    )
        with _telling_where(kept, f"--finish-from {recording}"):
            (report,) = build_map(
                [recording],
                kept.out,
                with_overrides(about.settings, overrides or {}),
                options,
                datum=about.datum,
                append=about.append,
                name=about.name,
                progress=progress,
                patience=patience,
            )
            kept.remove()
    return report


def discard_session(out: str | Path) -> tuple[str, int]:
    """Remove what a session that was ended has kept; its name, and how many frames it had: an empty
    name and 0 where that cannot be read."""
    name, frames, journal = "", 0, live_journal(Path(out))
    try:
        with SessionFolder(Path(out), None) as kept:
            name, frames = kept.about.name, len(kept.drive.frames)
            kept.remove()
    except FieldgridError:  # it is given up: what is wrong with it does not matter
        if not journal.is_file():
            raise
        Store(Path(out), journal.name, KeptDrive).remove()
    if journal.exists():
        raise MapWriteError(f"{journal} could not be removed; check its permissions.")
    return name, frames


def finish(
    kept: SessionFolder,
    overrides: Overrides,
    progress: Callable[[Progress], None] | None = None,
    patience: Patience | None = None,
) -> SessionReport:
    """Put what the open folder of a session has kept into its map, and remove it."""
    started = time.perf_counter()
    about = kept.about
    settings = with_overrides(about.settings, overrides)
    again = f"fieldgrid live -o {kept.out} --finish"
    ways = f"{again} tries again, with pose options or --accept, and --discard gives it up"
    with _telling_where(kept, "--finish"):
        try:
            drive = kept.drive
            if not drive.frames:
                ways = (
                    f"the command that began it goes on with it, {again}-from RECORDING builds it "
                    "from a recording, and --discard gives it up"
                )
                raise ConfigError(
                    f"The session {quoted(about.name)} has no frame, so there is no map of it."
                )
            recording = kept.recording(drive)
            drive.let_go()
            report = _placed(kept, drive, recording, settings, progress, patience or Patience())
        except FieldgridError as error:
            sentence = str(error).removesuffix(".")
            raise type(error)(f"{sentence}. {kept.what_is_kept(ways)}") from error
        lost = {_NO_POINTS: len(report.bad) - len(drive.bad), _NO_GRIDS: drive.unreadable}
        report.findings += tuple(_still_kept(kept, lost[why], why) for why in lost if lost[why])
        if not any(lost.values()):
            kept.remove()
    report.wall_s = time.perf_counter() - started
    return report


@contextmanager
def _telling_where(kept: SessionFolder, way: str) -> Iterator[None]:
    """Give Ctrl-C and SIGTERM a note on where the drive is, and by which option it goes on."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        end.add_note(kept.what_is_kept(f"fieldgrid live -o {kept.out} {way} makes the map of it"))
        raise


_NO_POINTS = "their points are not there and it was not known while driving how the vehicle leaned"
_NO_GRIDS = "their grids were damaged on the disk, which should be checked"


def _still_kept(kept: SessionFolder, left_out: int, why: str) -> Finding:
    """The remark on a drive that is in the map without some of its frames."""
    name = kept.about.name
    first = f"remove {kept.out}"
    if kept.about.append:
        first = f"remove the session from it (fieldgrid sessions {kept.out} --remove {name})"
    return warning(
        "frames-left-out",
        f"{left_out} frames are left out of the map, since {why}.",
        f"The drive stays in {kept.folder}: with a recording, {first} and run fieldgrid live "
        f"-o {kept.out} --finish-from RECORDING; without one, --discard removes what is kept.",
    )


def _placed(
    kept: SessionFolder,
    drive: PushedDrive,
    recording: Recording,
    settings: BuildSettings,
    progress: Callable[[Progress], None] | None,
    patience: Patience,
) -> SessionReport:
    """Put the drive into the map."""
    about, out, levels = kept.about, kept.out, kept.points.is_levelling
    with ExitStack() as opened:
        made = opened.enter_context(Store(out, AGAIN, KeptDrive))
        opened.callback(made.remove)
        datum, is_there = about.datum, out.exists()
        if is_there:
            datum = datum or read_datum(out)
            universal = opened.enter_context(opened_map(out, settings, datum, patience))
        session = NewSession(recording, settings, datum, about.name, skip_bad=1.0, levels=levels)
        if not is_there:
            check_output(out, append=about.append, overwrite=False)
            universal = opened.enter_context(made_map(out, settings, session.datum))
        session.check(universal, adds=about.append or not is_there)
        if session.attitude is not None and not levels:
            session.report.findings += (NOT_LEVELLED,)
        session.put(universal, gridded_again(kept, drive, made, session, progress))
    return session.report


def with_overrides(settings: BuildSettings, overrides: Overrides) -> BuildSettings:
    """The settings of a session with those that may be others at its end; ConfigError for such as
    may not."""
    tables: dict[str, Any] = settings.model_dump(mode="json")
    for table, values in overrides.items():
        given = {key: value for key, value in values.items() if value is not None}
        if given and table not in AT_THE_END:
            raise ConfigError(
                f"The setting {table}.{next(iter(given))} is that of the grids, which are made; "
                "build the drive from a recording to change it."
            )
        tables[table] |= given
    return resolve(None, tables)
