"""Many recordings to one map: staged side by side, put into the map one after the other.

Everything is checked before the first image is read. Processes or a cluster stage shares of
drives; poses and the fold belong to this process. A drive that fails is left out.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fieldgrid.core import (
    BuildSettings,
    ClusterError,
    ConfigError,
    FieldgridError,
    MapError,
    quoted,
    refuse_input,
)
from fieldgrid.geometry import Datum
from fieldgrid.maps import MapFile, Patience, kept_groups, read_datum
from fieldgrid.pipeline.report import DRIVE_ERRORS, PartlyBuiltError, Progress, SessionReport
from fieldgrid.pipeline.session import NewSession
from fieldgrid.pipeline.staging.drive_start import check_same
from fieldgrid.pipeline.staging.kept_frames import drop_journal, work_folder
from fieldgrid.pipeline.staging.parts import (
    SHARE_FRAMES,
    WAYS,
    DriveParts,
    left_behind,
    settle_left_behind,
)
from fieldgrid.pipeline.staging.remote import StagedShare, packed, place_of
from fieldgrid.pipeline.staging.staging import Processes, ShareTask, Staging, Workers
from fieldgrid.pipeline.targets import check_names, check_output, made_map, opened_map
from fieldgrid.recordings import DriveOptions, Recording, open_drive

if TYPE_CHECKING:
    from distributed import Client

WORTH_FRAMES = 128
"""Frames from which on processes pay: each takes a second to start, and threads do without."""


@dataclass(slots=True)
class _DriveBuild:
    """A recording on its way into the map."""

    number: int
    path: str | Path
    name: str
    recording: Recording = field(init=False)
    session: NewSession = field(init=False)
    parts: DriveParts = field(init=False)
    began_s: float | None = None
    error: FieldgridError | None = None


def build_map(
    paths: Sequence[str | Path],
    out: str | Path,
    settings: BuildSettings | None = None,
    options: DriveOptions | None = None,
    *,
    datum: Datum | None = None,
    append: bool = False,
    overwrite: bool = False,
    name: str | None = None,
    every: int = 1,
    jobs: int | None = None,
    scheduler: str | Client | None = None,
    resume: bool | None = None,
    skip_bad: int | float = 0,
    fail_fast: bool = False,
    patience: Patience | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> list[SessionReport]:
    """Make the map `out` from recordings, a session each, or append them to it.

    Each is opened with `options` as by `open_drive`, and checked before the first image is read.
    `jobs` is the number of processes or, for few frames, of threads (all cores if None); the map's
    bits do not depend on it. With a `scheduler`, the address of a Dask scheduler or its client, its
    workers stage the frames instead. Of frames that cannot be read at most `skip_bad` are left out:
    a number, or below 1 a share of each drive. `patience` is how long to wait for another writer.

    Of several drives those that fail are left out: when the others are in the map, PartlyBuiltError
    names them. With `fail_fast`, and for a single drive, its error is raised at once. On an error a
    new map does not come to be and an existing one stays as it was, but for the sessions already
    appended. What was staged then stays in `MAP.work`, but for that of the drive that failed:
    `resume` uses it, or refuses it where it is of other inputs or settings. Where there is such a
    folder, None refuses to build and False removes it.
    """
    if scheduler is not None and jobs is not None:
        raise ConfigError("With a scheduler its workers stage the frames; leave out --jobs.")
    settings = settings or BuildSettings()
    jobs = jobs or os.cpu_count() or 1
    build = _Build(Path(out), settings, every, jobs, skip_bad, fail_fast, progress)
    check_output(build.out, append=append, overwrite=overwrite)
    if not append:
        refuse_input(build.out, [Path(path) for path in paths])
    build.drives = [_DriveBuild(number, path, str(path)) for number, path in enumerate(paths)]
    is_there = bool(resume) and build.out.exists() and not (append or overwrite)
    with ExitStack() as opened:
        settle_left_behind(build.out, resume)
        if skip_bad > 0:
            options = replace(options or DriveOptions(), incomplete=True)
        build.open(opened, options, name)
        if append or is_there:
            datum = datum or read_datum(build.out)
            universal = opened.enter_context(opened_map(build.out, settings, datum, patience))
        taken = [info.name for info in universal.sessions()] if append or is_there else []
        check_names([one.name for one in build.drives if not one.error], () if resume else taken)
        if scheduler is not None:
            from fieldgrid.core import connected  # late: few builds have a cluster

            build.client = opened.enter_context(connected(scheduler))
        elif not resume:
            build.start_processes(opened)
        datum = build.estimate(datum)
        if not (append or is_there):
            universal = opened.enter_context(
                made_map(build.out, settings, datum, overwrite=overwrite)
            )
        with ExitStack() as held:
            build.find_parts(held, datum, resume=bool(resume))
            reports = build.run(universal, taken, is_there=is_there)
    for path in build.staged:
        drop_journal(path)
    failed = [(drive.name, str(drive.error)) for drive in build.drives if drive.error]
    if failed:
        raise PartlyBuiltError(reports, failed)
    return reports


@dataclass(slots=True)
class _Build:
    """A build while it runs."""

    out: Path
    settings: BuildSettings
    every: int
    jobs: int
    skip_bad: int | float
    fail_fast: bool
    progress: Callable[[Progress], None] | None
    drives: list[_DriveBuild] = field(default_factory=list)
    staged: list[Path] = field(default_factory=list)
    client: Client | None = None
    staging: Staging | None = None

    def open(self, opened: ExitStack, options: DriveOptions | None, name: str | None) -> None:
        """Open the recordings, once the layers that the map keeps are known."""
        kept_groups(self.settings.map.kept_layers())
        for drive in self._good():
            try:
                drive.recording = opened.enter_context(open_drive(drive.path, options)).recording()
                drive.name = drive.recording.name if name is None else name
            except FieldgridError as error:
                self._fail(drive, error)

    def start_processes(self, opened: ExitStack, shares: int | None = None) -> None:
        """Start the processes that stage, where `shares` are worth it; the shares of all drives if
        None, while the drives are checked."""
        if shares is None:
            counts = [-(-drive.recording.frame_count // self.every) for drive in self._good()]
            shares = sum(-(-count // SHARE_FRAMES) for count in counts)
        if self.jobs > 1 and shares * SHARE_FRAMES >= WORTH_FRAMES:
            self.staging = opened.enter_context(Staging(Processes(min(self.jobs, shares))))

    def estimate(self, datum: Datum | None) -> Datum:
        """The datum of the map, after a look at what no image has to be read for."""
        for drive in self._good():
            try:
                drive.session = NewSession(
                    *(drive.recording, self.settings, datum, drive.name),
                    every=self.every,
                    skip_bad=self.skip_bad,
                )
                datum = drive.session.datum
            except FieldgridError as error:
                self._fail(drive, error)
        assert datum is not None  # there is a drive, or _good would have raised
        return datum

    def find_parts(self, held: ExitStack, datum: Datum, *, resume: bool) -> None:
        """The parts of the drives that are there already; ConfigError for others."""
        for drive in self._good():
            drive.parts = held.enter_context(drive.session.parts(self.out, datum, self.progress))
            self.staged.append(drive.parts.path)
        starts = [drive.parts.start for drive in self._good()]
        for path, begun in left_behind(self.out).items() if resume else ():
            if path not in self.staged:
                check_same(path, begun, starts, WAYS)

    def run(self, universal: MapFile, taken: list[str], *, is_there: bool) -> list[SessionReport]:
        """Stage the drives and put them into the map, in their order."""
        reports: list[SessionReport] = []
        missing = sum(
            sum(1 for _ in drive.parts.missing()) for drive in self.drives if not drive.error
        )
        with ExitStack() as running:
            if self.client is not None and missing:
                self.staging = running.enter_context(Staging(Workers(self.client)))
            elif self.staging is None:
                self.start_processes(running, missing)
            for drive in self._good():
                self._begin(drive, universal, taken, adds=not is_there)
            for drive in self._good():
                try:
                    report = self._finish(drive, universal)
                except DRIVE_ERRORS as error:
                    self._fail(drive, error)
                except (MapError, ClusterError) as error:
                    if not any(one.parts.done for one in self.drives if not one.error):
                        raise
                    raise type(error)(
                        f"{error} What was staged is kept in {work_folder(self.out)}; the same "
                        "command with --resume goes on from there."
                    ) from error
                else:
                    reports.append(report)
        return reports

    def _begin(
        self, drive: _DriveBuild, universal: MapFile, taken: list[str], *, adds: bool
    ) -> None:
        """Let the drive be staged, when it is its turn."""
        if drive.name in taken and len(drive.parts.done) < drive.session.work.total:
            raise ConfigError(
                f"{self.out} has a session {quoted(drive.name)} already, and no staged frame "
                "of it to go on with: that build had finished. Leave the recording out, or give "
                "--name."
            )
        try:
            drive.session.check(universal, adds=adds)
        except DRIVE_ERRORS as error:
            self._fail(drive, error)
            return
        drive.parts.tell()
        if self.staging is not None:
            place = None if self.client is None else place_of(drive.recording.path)
            work = packed(drive.session.work, place)
            self.staging.add(drive.number, drive.name, work, place, drive.parts.missing())

    def _finish(self, drive: _DriveBuild, universal: MapFile) -> SessionReport:
        """Wait until the drive is staged, or stage it here, and put it into the map."""
        session, parts = drive.session, drive.parts
        start = time.perf_counter()
        if self.staging is None:
            parts.stage(self.jobs)
        while drive.error is None and len(parts.done) < session.work.total:
            assert self.staging is not None
            result = self.staging.next()
            if result is not None:
                self._take(*result)
        if drive.error is not None:
            raise drive.error
        session.put(universal, parts.staged())
        began_s = start if drive.began_s is None else drive.began_s
        session.report.wall_s = time.perf_counter() - began_s
        return session.report

    def _take(self, task: ShareTask, staged: StagedShare | Exception) -> None:
        """Keep a share that another process has staged, or leave its drive out."""
        drive = self.drives[task.drive]
        if drive.error is not None:
            return
        try:
            if isinstance(staged, Exception):
                raise staged
            if drive.began_s is None:
                drive.began_s = time.perf_counter() - staged.took_s
            for number, looked in enumerate(staged.frames, task.share.first):
                drive.parts.add(number, looked)
        except DRIVE_ERRORS as error:
            self._fail(drive, error)

    def _good(self) -> Iterator[_DriveBuild]:
        """The drives that have not failed; raises when there is none."""
        for drive in self.drives:
            if drive.error is None:
                yield drive
        if all(drive.error is not None for drive in self.drives):
            raise PartlyBuiltError([], [(one.name, str(one.error)) for one in self.drives])

    def _fail(self, drive: _DriveBuild, error: FieldgridError) -> None:
        """Leave a drive out, or end the build."""
        drive.error = error
        if self.staging is not None:
            self.staging.drop(drive.number)
        if hasattr(drive, "parts"):
            drive.parts.remove()
        if self.fail_fast or len(self.drives) == 1:
            raise error
