"""The parts of a drive between leaps of its receiver's solution, each a drive of its own.

Where no pose of a whole drive can be used, a leap in it may be why: headings that have to go
through it are unsure everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64, GnssError, Int64, utc_text
from fieldgrid.geometry import MAX_GAP_NS, FixColumns, Motion, Status, Trajectory
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.attitude.attitude import Attitude
from fieldgrid.poses.report import PoseReport, leap_note, leaps_ns

BESIDE_LEAP = f"within {MAX_GAP_NS / 1e9:.1f} s after a leap of the solution"


class Estimate(NamedTuple):
    """A trajectory, the row of each input fix in it (in order of time), the report, and for each
    row the probability that the gear is the other one. Of given poses without fixes, `fix_row` has
    all rows."""

    trajectory: Trajectory
    fix_row: Int64
    report: PoseReport
    gear_doubt: Float64


def by_parts(
    whole: Estimate,
    accepted: AcceptedFixes,
    fixes: FixColumns,
    motion: Motion,
    frame_ns: Int64 | None,
    estimate: Callable[..., Estimate],
    max_position_sigma_m: float,
) -> Estimate:
    """The poses of a drive whose parts between leaps were estimated one by one; the `whole` as it
    is where a part cannot be estimated, or none has a pose that can be used.

    Headings and their verdicts are those of the parts. Which side of a leap lies right they do not
    tell: positions are as unsure as the leap shows, and refused above `max_position_sigma_m`. What
    the report says of sensors is that of the part with the most usable poses; what may change from
    part to part, such as a clock, of the whole.
    """
    leaps = leaps_ns(accepted)
    parts: list[Estimate] = []
    for from_ns, until_ns in pairwise([-(2**63), *(leaps + 1).tolist(), 2**63 - 1]):
        own = fixes[(fixes.time_ns >= from_ns) & (fixes.time_ns < until_ns)]
        shown_ns = (
            None if frame_ns is None else frame_ns[(frame_ns >= from_ns) & (frame_ns < until_ns)]
        )
        try:
            parts.append(estimate(own, motion=motion.between(from_ns, until_ns), frame_ns=shown_ns))
        except GnssError:
            return whole
    attitudes = [part.report.attitude for part in parts]
    levelled = [attitude for attitude in attitudes if attitude is not None]
    if len(levelled) not in (0, len(parts)):
        return whole
    rows = _rows([part.trajectory for part in parts])
    firsts = np.cumsum([0, *(len(part.trajectory) for part in parts[:-1])])
    fix_row = [part.fix_row + first for part, first in zip(parts, firsts, strict=True)]
    # No pose between two parts: it would be interpolated over the leap.
    since_ns = rows.time_ns - np.append(-(2**62), leaps)[np.searchsorted(leaps, rows.time_ns)]
    beside = since_ns <= MAX_GAP_NS
    unsure_m = np.interp(rows.time_ns, accepted.time_ns, accepted.sigma_m)
    sigma_m = np.fmax(rows.position_sigma_m, unsure_m)
    status, reason = list(rows.status), list(rows.reason)
    for k in np.flatnonzero(rows.accepted & (beside | (sigma_m > max_position_sigma_m))).tolist():
        status[k], reason[k] = Status.REJECTED, BESIDE_LEAP
        if not beside[k]:
            reason[k] = f"position sigma {sigma_m[k]:.2f} m > {max_position_sigma_m:g} m"
    trajectory = replace(rows, position_sigma_m=sigma_m, status=tuple(status), reason=tuple(reason))
    if not trajectory.accepted.any():
        # The parts may do by themselves, but nobody can tell which of them lies right.
        choice = [_choice_note(int(leaps[0]), parts)] if rows.accepted.any() else []
        return whole._replace(report=replace(whole.report, notes=(*whole.report.notes, *choice)))
    usable = [int(np.count_nonzero(own)) for own in np.split(trajectory.accepted, firsts[1:])]
    used = [part.report for part, count in zip(parts, usable, strict=True) if count]
    notes = chain.from_iterable(report.notes for report in used)
    report = replace(
        parts[int(np.argmax(usable))].report,
        conditioning=whole.report.conditioning,
        contradiction=whole.report.contradiction,
        clock_change=whole.report.clock_change,
        attitude=_attitude(levelled) if levelled else None,
        notes=(leap_note(accepted), _cut_note(accepted, usable), *dict.fromkeys(notes)),
    )
    doubt = np.concatenate([part.gear_doubt for part in parts])
    return Estimate(trajectory, np.concatenate(fix_row), report, doubt)


def _rows(tracks: Sequence[Trajectory]) -> Trajectory:
    """The rows of trajectories that follow each other."""
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(track, name) for track in tracks])
        for name in (one.name for one in fields(Trajectory) if one.init)
        if isinstance(getattr(tracks[0], name), np.ndarray)
    }
    return replace(
        tracks[0],
        status=tuple(chain.from_iterable(track.status for track in tracks)),
        reason=tuple(chain.from_iterable(track.reason for track in tracks)),
        **columns,
    )


def _attitude(parts: Sequence[Attitude]) -> Attitude:
    """The attitude over parts that follow each other, with the doubt of the worst."""
    columns = zip(*(part[:7] for part in parts), strict=True)
    time_ns, roll, pitch, roll_sigma, pitch_sigma, heading, up = map(np.concatenate, columns)
    return Attitude(
        *(time_ns, roll, pitch, roll_sigma, pitch_sigma),
        np.unwrap(heading, period=360.0),
        up,
        max(part.slope_sigma_deg for part in parts),
        float(np.max([part.push_misfit for part in parts])),
        tuple(dict.fromkeys(chain.from_iterable(part.notes for part in parts))),
        frozenset.intersection(*(part.bodies for part in parts)),
    )


def _choice_note(leap_ns: int, parts: Sequence[Estimate]) -> str:
    """How to keep the part of a drive that lies right."""
    usable = [np.count_nonzero(part.trajectory.accepted[part.fix_row]) for part in parts]
    moment = utc_text(leap_ns + 1, "ms")
    return (
        f"By themselves the parts between leaps have {', '.join(map(str, usable))} fixes that can "
        f"be used; if you know which part lies right, keep it alone: --until or --from {moment} "
        "cuts at the first leap."
    )


def _cut_note(accepted: AcceptedFixes, usable: Sequence[int]) -> str:
    """That a drive was cut, and by how much its parts do not fit together."""
    after = np.searchsorted(accepted.time_ns, leaps_ns(accepted)) + 1
    step_m = np.hypot(*(accepted.points_m()[after] - accepted.points_m()[after - 1]).T)
    return (
        f"No pose of the whole drive could be used, so it was cut where the solution leaps: "
        f"{np.count_nonzero(usable)} of its {len(usable)} parts have poses that can be used. The "
        f"parts do not fit together by up to {step_m.max():.1f} m; to use one of them alone, give "
        "--from and --until."
    )
