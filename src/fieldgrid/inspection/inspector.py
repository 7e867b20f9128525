"""The inspection itself: open whatever is there, and put down what is wrong; nothing is changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fieldgrid.errors import CalibrationError, FieldgridError
from fieldgrid.inspection.drive import with_fixes, with_frames
from fieldgrid.inspection.findings import Finding, in_order, info, stop, warning
from fieldgrid.inspection.looking import Tell
from fieldgrid.inspection.refusals import noted, refusal
from fieldgrid.inspection.report import Inspection
from fieldgrid.inspection.rigs import rig_findings
from fieldgrid.inspection.streams import stream_findings, summarise_stream
from fieldgrid.inspection.subject import Subject, of_recording, open_subject
from fieldgrid.pose import estimate_poses
from fieldgrid.recording import Columns, Mounting, Options, Recording
from fieldgrid.settings import BuildSettings


def inspect_recording(
    recording: Recording | str | Path,
    settings: BuildSettings | None = None,
    *,
    gnss: str | Path | None = None,
    columns: Columns | None = None,
    topics: Mapping[str, str] | None = None,
    mounting: str | Path | Mounting | None = None,
    image_time_offset_ns: int | None = None,
    tell: Tell | None = None,
) -> Inspection:
    """What is in a recording and what a build with these settings would meet.

    A path may also be a log, or a folder or bag without images. The rest is what
    `open_recording` takes, and only for a path. Nothing that is wrong with the recording is
    raised: it becomes a finding. `tell` is told how many frames of how many were looked at.
    """
    settings = settings or BuildSettings()
    if not isinstance(recording, str | Path):
        return _inspected(of_recording(recording), settings, tell)
    path = Path(recording)
    own = mounting if isinstance(mounting, Mounting | None) else Path(mounting)
    try:
        options = Options(gnss, columns, topics or {}, own, image_time_offset_ns)
        with open_subject(path, options) as subject:
            return _inspected(subject, settings, tell)
    except FieldgridError as problem:
        return Inspection(str(path), "", path.name, (refusal(problem),))
    except OSError as problem:
        sentence = f"{problem.filename or path} cannot be read: {problem.strerror or problem}."
        found = stop("recording", sentence, "Check the path, its permissions and the disk.")
        return Inspection(str(path), "", path.name, (found,))


def _inspected(subject: Subject, settings: BuildSettings, tell: Tell | None) -> Inspection:
    found = Inspection(
        path=subject.path,
        kind=subject.kind,
        name=subject.name,
        findings=(),
        duration_s=_duration_s(subject),
        streams=tuple(summarise_stream(stream) for stream in subject.streams),
        gnss_source=subject.gnss_source,
        rig=subject.rig,
    )
    findings = [
        *(warning("losses", loss, "Copy or record it again.") for loss in subject.losses),
        *stream_findings(subject.streams),
        *([] if subject.rig is None else rig_findings(subject.rig)),
    ]
    if subject.recording is None or subject.recording.frame_count == 0:
        found = _without_images(subject, settings, found, findings)
    else:
        found = with_frames(subject, subject.recording, settings, found, findings, tell)
    findings += [info("note", note) for note in subject.notes]
    return replace(found, findings=in_order(list(dict.fromkeys(findings))))


def _duration_s(subject: Subject) -> float | None:
    """From the first image, or fix, to the last, by their stamps."""
    recording = subject.recording
    times_ns = (
        recording.frame_times_ns()
        if recording is not None and recording.frame_count
        else subject.fixes.time_ns
    )
    return float(times_ns.max() - times_ns.min()) / 1e9 if len(times_ns) else None


def _without_images(
    subject: Subject, settings: BuildSettings, found: Inspection, findings: list[Finding]
) -> Inspection:
    """The fixes of a drive that has nothing else, and why there is nothing to build."""
    if subject.refusal is None:
        message = f"{subject.name} holds no frame, and a map is made of frames."
        findings.append(stop("no-images", message, "`fieldgrid track` needs none."))
    else:
        has_frames = isinstance(subject.refusal, CalibrationError)
        findings.append(refusal(subject.refusal, "" if has_frames else "no-images"))
    with noted(findings):
        estimate = estimate_poses(
            subject.fixes, subject.rig, subject.datum_hint, settings.pose, subject.motion
        )
        found = with_fixes(found, estimate, subject, findings)
    return found
