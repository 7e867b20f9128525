"""What a log is like and what conditioning made of it, in numbers."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Quality
from fieldgrid.geometry import MAX_GAP_NS, FixColumns
from fieldgrid.poses.gates.scatter import M_PER_DEG, quantum_m, short_term_sigma_m
from fieldgrid.poses.gates.verdict import Gate, Verdicts


class ReasonCount(NamedTuple):
    """How many fixes one gate rejected, when, and one of the sentences."""

    gate: Gate
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


class FixGap(NamedTuple):
    """A stretch without an accepted fix: from which one, and how long."""

    time_ns: int
    lat_deg: float
    lon_deg: float
    seconds: float


class ConditioningSummary(NamedTuple):
    """A log and its verdicts. `rate_hz` is that of the fixes, repeats left out; 0 if unknown.

    `quality` counts the fixes of each, rejected ones included. `quantum_m` is the
    spacing of the positions as written (0: none seen) and `short_term_sigma_m` the white part
    of the error along one axis.
    """

    fixes: int
    accepted: int
    rejected: tuple[ReasonCount, ...]
    seams: tuple[Seam, ...]
    quality: tuple[tuple[Quality, int], ...]
    gaps: tuple[FixGap, ...]
    rate_hz: float
    quantum_m: float
    short_term_sigma_m: float

    def as_dict(self) -> dict[str, Any]:
        """The summary as JSON holds it: a dict of numbers, strings, lists and dicts."""
        return {
            "fixes": self.fixes,
            "accepted": self.accepted,
            "rejected": [{**r._asdict(), "gate": r.gate.value} for r in self.rejected],
            "seams": [seam._asdict() for seam in self.seams],
            "quality": {quality.label: count for quality, count in self.quality},
            "gaps": [gap._asdict() for gap in self.gaps],
            "rate_hz": self.rate_hz,
            "quantum_m": self.quantum_m,
            "short_term_sigma_m": self.short_term_sigma_m,
        }


def summarise(fixes: FixColumns, verdicts: Verdicts) -> ConditioningSummary:
    """Count what was rejected and why, the commonest gate first, and measure what is left."""
    used = fixes[verdicts.ok]
    spacing_m = quantum_m(used.lat_deg, used.lon_deg)
    steps_ns = np.diff(used.time_ns)
    seams = [k for k in np.flatnonzero(verdicts.ok).tolist() if verdicts.gate[k] is Gate.SEAM]
    codes, counts = np.unique(fixes.quality, return_counts=True)
    return ConditioningSummary(
        fixes=len(fixes),
        accepted=len(used),
        rejected=_reasons(fixes, verdicts),
        seams=tuple(Seam(*_place(fixes, k), verdicts.reason[k]) for k in seams),
        quality=tuple(zip(map(Quality, codes.tolist()), counts.tolist(), strict=True)),
        gaps=tuple(
            FixGap(*_place(used, k), float(steps_ns[k]) / 1e9)
            for k in np.flatnonzero(steps_ns > MAX_GAP_NS).tolist()
        ),
        rate_hz=1e9 / float(np.median(steps_ns)) if steps_ns.size else 0.0,
        quantum_m=spacing_m,
        short_term_sigma_m=_short_term_sigma_m(used, spacing_m),
    )


def _short_term_sigma_m(used: FixColumns, spacing_m: float) -> float:
    """The noise of accepted fixes, at most what the receiver states; 0 of none."""
    if not len(used):
        return 0.0
    shrink = math.cos(math.radians(float(used.lat_deg[0])))
    east_m = (used.lon_deg - used.lon_deg[0]) * M_PER_DEG * shrink
    north_m = (used.lat_deg - used.lat_deg[0]) * M_PER_DEG
    measured_m = short_term_sigma_m(east_m, north_m, used.time_ns, spacing_m)
    stated_m = float(np.median(used.position_sigma_m()))
    return max(min(measured_m, stated_m), spacing_m / math.sqrt(12.0))


def _place(fixes: FixColumns, k: int) -> tuple[int, float, float]:
    return int(fixes.time_ns[k]), float(fixes.lat_deg[k]), float(fixes.lon_deg[k])


def _reasons(fixes: FixColumns, verdicts: Verdicts) -> tuple[ReasonCount, ...]:
    by_gate: dict[Gate, list[int]] = {}
    for k in np.flatnonzero(~verdicts.ok).tolist():
        by_gate.setdefault(verdicts.gate[k], []).append(k)
    counts = [
        ReasonCount(
            gate,
            len(rows),
            int(fixes.time_ns[rows].min()),
            int(fixes.time_ns[rows].max()),
            verdicts.reason[rows[0]],
        )
        for gate, rows in by_gate.items()
    ]
    return tuple(sorted(counts, key=lambda reason: (-reason.fixes, reason.gate)))
