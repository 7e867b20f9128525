"""What is inspected: a recording, a folder or a bag without images, or a log alone."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fieldgrid.build.tracking import refuse_options
from fieldgrid.errors import CalibrationError, ConfigError, FieldgridError, RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.motion import Motion
from fieldgrid.recording import (
    Options,
    Recording,
    Stream,
    bag,
    is_bag,
    is_recording,
    kind_of,
    open_log,
    open_recording,
    open_unmounted,
)
from fieldgrid.recording.bare import BareDrive, open_bare, recognises
from fieldgrid.recording.isoxml import is_time_log
from fieldgrid.rig import Rig


@dataclass(frozen=True, slots=True)
class Subject:
    """A drive as far as it could be opened; a context manager.

    `recording` is None of a drive without frames, and `refusal` what a build says of it; `rig` is
    None where nothing says what carried it.
    """

    path: str
    kind: str
    name: str
    fixes: FixColumns
    motion: Motion
    streams: Sequence[Stream]
    gnss_source: str
    recording: Recording | None = None
    refusal: FieldgridError | None = None
    rig: Rig | None = None
    datum_hint: Datum | None = None
    notes: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    _open: ExitStack = field(default_factory=ExitStack, repr=False, compare=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._open.close()


def open_subject(path: Path, options: Options) -> Subject:
    """Whatever holds a drive at a path; raises what opening it raises."""
    if not path.exists():
        raise RecordingError(
            f"{path} does not exist; give the folder of a recording, a bag, or a GNSS log."
        )
    if is_bag(path):
        drive = bag.open_drive(path, options)
        if isinstance(drive, BareDrive):
            return _of_bare(path, "ROS bag without frames", drive, options)
        return of_recording(drive, str(path), kind_of(path))
    if is_recording(path):
        return _of_frames(path, options)
    refuse_options(path, options)
    if recognises(path):
        bare = open_bare(path, options.gnss, options.columns)
        return _of_bare(path, "folder without images", bare, options)
    if path.is_dir() and not is_time_log(path):
        return of_recording(_open(path, options), str(path), kind_of(path))
    if options.gnss is not None:
        raise ConfigError(
            f"{path} is a log already, so {str(options.gnss)!r} cannot be picked in it; leave "
            "--gnss out."
        )
    log = open_log(path, options.columns)
    alone = BareDrive(log.fixes, log.motion, None, path.name, log.notes)
    return _of_bare(path, "GNSS log", alone, options)


def of_recording(recording: Recording, path: str = "", kind: str = "recording") -> Subject:
    """A recording that is open; it is closed with the subject only if the subject opened it."""
    closing = ExitStack()
    if path:
        closing.enter_context(recording)
    return Subject(
        path=path,
        kind=kind,
        name=recording.name,
        fixes=recording.fixes(),
        motion=recording.motion(),
        streams=recording.streams(),
        gnss_source=recording.gnss_source,
        recording=recording,
        rig=recording.rig,
        datum_hint=recording.datum_hint,
        notes=tuple(recording.notes),
        losses=tuple(recording.losses),
        _open=closing,
    )


def _open(path: Path, options: Options) -> Recording:
    return open_recording(path, **_opening(options))


def _opening(options: Options) -> dict[str, Any]:
    return {
        "gnss": options.gnss,
        "columns": options.columns,
        "topics": options.topics,
        "mounting": options.mounting,
        "image_time_offset_ns": options.image_time_offset_ns,
    }


def _of_frames(path: Path, options: Options) -> Subject:
    """A folder with frames; where it lacks a mounting only, all of it but a rig."""
    try:
        return of_recording(_open(path, options), str(path), kind_of(path))
    except CalibrationError as problem:
        with open_unmounted(path, **_opening(options))[0] as recording:
            found = of_recording(recording)
            return replace(
                found,
                path=str(path),
                kind=kind_of(path),
                recording=None,
                rig=None,
                refusal=problem,
            )


def _refusal(path: Path, options: Options) -> FieldgridError | None:
    """What a build says of a path that is no recording with frames."""
    try:
        with _open(path, options):
            return None
    except FieldgridError as problem:
        return problem


def _of_bare(path: Path, kind: str, drive: BareDrive, options: Options) -> Subject:
    fixes_ns = drive.fixes.time_ns
    streams = [Stream(drive.gnss_source, "fixes", "fix", len(fixes_ns), fixes_ns)]
    gyro, wheels, _ = drive.motion
    if gyro is not None:
        streams.append(Stream("gyro", "gyro", "gyro", len(gyro.time_ns), gyro.time_ns))
    if wheels is not None:
        streams.append(Stream("wheels", "speed", "wheels", len(wheels.time_ns), wheels.time_ns))
    return Subject(
        path=str(path),
        kind=kind,
        name=path.resolve().stem,
        fixes=drive.fixes,
        motion=drive.motion,
        streams=drive.streams or streams,
        gnss_source=drive.gnss_source,
        refusal=_refusal(path, options),
        rig=drive.rig,
        notes=drive.notes,
    )
