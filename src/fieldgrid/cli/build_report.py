"""What `build`, `live` and re-posing report of drives: tables and remarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from fieldgrid.cli import output

if TYPE_CHECKING:
    from fieldgrid.pipeline import PartlyBuiltError, SessionReport

_BAD_SHOWN = 10


def report_drives(reports: Sequence[SessionReport], partly: PartlyBuiltError | None) -> None:
    """One line a drive."""
    rows = [
        (report.session, "in the map", f"{report.used} of {report.frames}", str(len(report.bad)))
        for report in reports
    ]
    rows += [(name, "failed", "-", "-") for name, _ in (partly.failed if partly else ())]
    output.report_table(("drive", "", "frames used", "bad frames"), rows)


def report_session(report: SessionReport, *, rate: bool = True) -> None:
    """What became of a drive, as a table and remarks; with the `rate` of the work, or without."""
    tried = report.camera_steps + report.camera_refusals
    rows = [
        ("frames used", f"{report.used} of {report.frames}"),
        ("fixes accepted", f"{report.fixes_accepted} of {report.fixes}"),
        ("distance mapped", output.number(report.distance_m, 1, "m")),
        (f"heading sigma, median ({report.heading_source})",
         output.number(report.heading_sigma_deg, 2, "°")),
        ("position sigma, median", output.number(report.position_sigma_m, 3, "m")),
        ("camera steps", f"{report.camera_steps} of {tried}" if tried else "not used"),
        ("points used up to", output.number(report.max_range_m, 1, "m")),
        ("ground plane refined in", f"{report.ground_refined} frames"),
    ]  # fmt: skip
    if rate:
        # As wide for a slow machine as for a fast one, so that tables can be compared.
        rows.append(("rate", f"{report.frames_per_s:7.1f} frames/s"))
    output.report_table(("", ""), rows, title=f"session {report.session}")
    report_remarks(report)
    stages = asdict(report.stages).items()
    spent = ", ".join(f"{name.removesuffix('_s')} {value:.1f} s" for name, value in stages)
    output.log.info("processor time by stage: %s", spent)


def report_remarks(report: Any) -> None:
    """Why frames have no pose, which are left out, and what else there is to say of a drive."""
    from fieldgrid.core import grouped_reasons, in_order

    for count, example in grouped_reasons(report.reasons):
        output.report_line(f"rejected {count}: {example}")
    bad = getattr(report, "bad", ())
    for one in bad[:_BAD_SHOWN]:
        output.report_line(f"left out frame {one.frame_id}: {one.reason}")
    if len(bad) > _BAD_SHOWN:
        output.report_line(f"left out {len(bad) - _BAD_SHOWN} more frames; --json lists them all")
    for finding in in_order(report.findings):
        output.report_line(output.finding_line(finding))
