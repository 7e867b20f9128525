"""What a log is like and what conditioning made of it, in numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.gnss.fix import Fix
from fieldgrid.gnss.scatter import scatter
from fieldgrid.gnss.verdict import Kind, Verdict
from fieldgrid.trajectory import MAX_GAP_NS, Status


class ReasonCount(NamedTuple):
    """How many fixes were rejected for one kind of reason, when, and one of the sentences."""

    kind: Kind
    fixes: int
    first_ns: int
    last_ns: int
    example: str


class Seam(NamedTuple):
    """Where the solution has moved: the first fix after it."""

    time_ns: int
    lat_deg: float
    lon_deg: float
    reason: str


class Gap(NamedTuple):
    """A stretch without an accepted fix: from which one, and how long."""

    time_ns: int
    lat_deg: float
    lon_deg: float
    seconds: float


class ConditioningSummary(NamedTuple):
    """A log and its verdicts. `rate_hz` is that of the fixes, repeats left out; 0 if unknown.

    `quality` counts the fixes of each GGA code, rejected ones included. `quantum_m` is the
    spacing of the positions as written (0: none seen) and `short_term_sigma_m` the white part
    of the error along one axis.
    """

    fixes: int
    accepted: int
    rejected: tuple[ReasonCount, ...]
    seams: tuple[Seam, ...]
    quality: tuple[tuple[int, int], ...]
    gaps: tuple[Gap, ...]
    rate_hz: float
    quantum_m: float
    short_term_sigma_m: float

    def as_dict(self) -> dict[str, Any]:
        """The same as JSON can hold it: a dict of numbers, strings, lists and dicts."""
        return {
            "fixes": self.fixes,
            "accepted": self.accepted,
            "rejected": [{**r._asdict(), "kind": r.kind.value} for r in self.rejected],
            "seams": [seam._asdict() for seam in self.seams],
            "quality": {str(code): count for code, count in self.quality},
            "gaps": [gap._asdict() for gap in self.gaps],
            "rate_hz": self.rate_hz,
            "quantum_m": self.quantum_m,
            "short_term_sigma_m": self.short_term_sigma_m,
        }


def summarise(fixes: Sequence[Fix], verdicts: Sequence[Verdict]) -> ConditioningSummary:
    """Count what was rejected and why, the commonest kind first, and measure what is left."""
    used = [f for f, v in zip(fixes, verdicts, strict=True) if v.status is Status.OK]
    spread = scatter(fixes, verdicts)
    return ConditioningSummary(
        fixes=len(fixes),
        accepted=len(used),
        rejected=_reasons(fixes, verdicts),
        seams=tuple(
            Seam(fix.time_ns, fix.lat_deg, fix.lon_deg, verdict.reason)
            for fix, verdict in zip(fixes, verdicts, strict=True)
            if verdict.kind is Kind.SEAM
        ),
        quality=tuple(sorted(Counter(fix.quality for fix in fixes).items())),
        gaps=tuple(
            Gap(a.time_ns, a.lat_deg, a.lon_deg, (b.time_ns - a.time_ns) / 1e9)
            for a, b in pairwise(used)
            if b.time_ns - a.time_ns > MAX_GAP_NS
        ),
        rate_hz=_rate_hz(used),
        quantum_m=spread.quantum_m,
        short_term_sigma_m=spread.short_term_sigma_m,
    )


def _reasons(fixes: Sequence[Fix], verdicts: Sequence[Verdict]) -> tuple[ReasonCount, ...]:
    by_kind: dict[Kind, list[int]] = {}
    for k, verdict in enumerate(verdicts):
        if verdict.status is Status.REJECTED:
            by_kind.setdefault(verdict.kind, []).append(k)
    counts = [
        ReasonCount(
            kind,
            len(rows),
            min(fixes[k].time_ns for k in rows),
            max(fixes[k].time_ns for k in rows),
            verdicts[rows[0]].reason,
        )
        for kind, rows in by_kind.items()
    ]
    return tuple(sorted(counts, key=lambda reason: (-reason.fixes, reason.kind)))


def _rate_hz(used: Sequence[Fix]) -> float:
    steps_ns = np.diff(np.array([fix.time_ns for fix in used], dtype=np.int64))
    return 1e9 / float(np.median(steps_ns)) if steps_ns.size else 0.0
