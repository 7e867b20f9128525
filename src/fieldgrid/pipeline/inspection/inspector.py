"""The inspection itself: open whatever is there, and put down what is wrong; nothing is changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fieldgrid.core import (
    BuildSettings,
    CalibrationError,
    FieldgridError,
    NoFramesError,
    RecordingError,
    error,
    in_order,
)
from fieldgrid.pipeline.inspection.drive import told_of_poses, with_fixes, with_frames
from fieldgrid.pipeline.inspection.fixes import fix_findings
from fieldgrid.pipeline.inspection.frame_pass import Tell
from fieldgrid.pipeline.inspection.refusals import noted, refusal, refusals
from fieldgrid.pipeline.inspection.report import Inspection
from fieldgrid.pipeline.inspection.rigs import rig_findings
from fieldgrid.pipeline.inspection.streams import stream_findings, summarise_stream
from fieldgrid.pipeline.poses import estimate_drive, told_of
from fieldgrid.recordings import Drive, DriveOptions, Recording, Stream, open_drive


def inspect_recording(
    drive: Drive | str | Path,
    settings: BuildSettings | None = None,
    options: DriveOptions | None = None,
    *,
    tell: Tell | None = None,
) -> Inspection:
    """What is in a drive and what a build with these settings would meet.

    A path is opened with `options` as by `open_drive`; it may also be a log, or a folder or bag
    without images. Nothing that is wrong with the drive is raised: it becomes a finding. `tell` is
    told how many frames of how many were looked at.
    """
    settings = settings or BuildSettings()
    if not isinstance(drive, str | Path):
        return _inspected(drive, settings, tell, drive.streams())
    path = Path(drive)
    try:
        with open_drive(path, options) as opened, _unmounted(opened, options) as seen:
            return _inspected(opened, settings, tell, seen.streams())
    except FieldgridError as problem:
        return Inspection(str(path), "", path.name, tuple(refusals(problem)))
    except OSError as problem:
        sentence = f"{problem.filename or path} cannot be read: {problem.strerror or problem}."
        found = error("recording", sentence, "Check the path, its permissions and the disk.")
        return Inspection(str(path), "", path.name, (found,))


def _unmounted(drive: Drive, options: DriveOptions | None) -> Drive:
    """The drive, opened for what it holds: with its frames, also where no mounting is known."""
    if not isinstance(drive.refusal, CalibrationError):
        return drive
    return open_drive(drive.path, replace(options or DriveOptions(), unmounted=True))


def _inspected(
    drive: Drive, settings: BuildSettings, tell: Tell | None, streams: Sequence[Stream]
) -> Inspection:
    found = Inspection(
        path=str(drive.path),
        kind=drive.kind or "recording",
        name=drive.name,
        findings=(),
        streams=tuple(summarise_stream(stream) for stream in streams),
        gnss_source=drive.gnss_source,
        rig=drive.rig,
    )
    findings = [
        *told_of(drive),
        *stream_findings(streams),
        *([] if drive.rig is None else rig_findings(drive.rig)),
    ]
    recording: Recording | None = None
    try:
        recording = drive.recording()
    except NoFramesError as problem:
        findings.append(refusal(problem, "no-images"))
    except RecordingError as problem:
        findings += refusals(problem)
        found = replace(found, frames=None)
    if recording is not None and recording.frame_count > 0:
        times_ns = recording.frame_times_ns()
        found = with_frames(recording, settings, found, findings, tell)
    else:
        times_ns = drive.fixes().time_ns
        if recording is not None:
            findings.append(
                error(
                    "no-images",
                    f"{drive.name} holds no frame, and a map is made of frames.",
                    "`fieldgrid track` needs none.",
                )
            )
        with noted(findings):
            estimate = estimate_drive(drive, settings)
            found = with_fixes(found, estimate, drive)
            findings += told_of_poses(estimate)
    if found.fixes is not None:
        findings += fix_findings(found.fixes)
    return replace(
        found,
        duration_s=float(times_ns.max() - times_ns.min()) / 1e9 if len(times_ns) else None,
        findings=in_order(findings),
    )
