"""The accepted fixes of a drive in the plane of its datum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, GnssError, Int64, commonest_reason
from fieldgrid.geometry import Datum, FixColumns, wrap_deg
from fieldgrid.poses.faults.leaps.seams import SeamDoubt, SeenLeap, seam_doubt
from fieldgrid.poses.gates.scatter import FixNoise, fix_noise, quantum_m
from fieldgrid.poses.gates.verdict import Gate, Verdicts

_BY_MOTION = (Gate.JUMP, Gate.ACCELERATION, Gate.TURN_RATE)
_OF_ANOTHER = (*_BY_MOTION, Gate.ALONE, Gate.SEAM)

UNSTATED_HEADING_SIGMA_DEG = 1.0
"""The error of a recorded heading whose source does not state one."""


class AcceptedFixes(NamedTuple):
    """Accepted fixes in order of time, length n. Positions are the antenna's, LTP metres.

    `sigma_m` is the error of one axis, mostly slow: the stated one, what seams show beyond it, and
    that of the digits that a log holds; `stated_m` is the receiver's own figure, NaN where it has
    none; `lasting_s` is for how long that of seams stays the same,
    and `noise` what changes from fix to fix. `disputed` are those after fixes that were refused for
    how they lie: one of the two sides may be the wrong one. NaN stands for what a fix does not say;
    a recorded heading is as the source means it.
    """

    time_ns: Int64
    east_m: Float64
    north_m: Float64
    up_m: Float64
    sigma_m: Float64
    stated_m: Float64
    lasting_s: Float64
    noise: FixNoise
    quality: Int64
    speed_mps: Float64
    recorded_deg: Float64
    recorded_sigma_deg: Float64
    stamp_sigma_s: Float64
    disputed: Bool

    def points_m(self) -> Float64:
        """East and north [n, 2]."""
        return np.stack([self.east_m, self.north_m], axis=1)

    def part(self, rows: Int64) -> AcceptedFixes:
        """Some of the fixes."""
        noise = self.noise._replace(
            across_m=self.noise.across_m[rows], second_m=self.noise.second_m[rows]
        )
        columns = {name: getattr(self, name)[rows] for name in self._fields if name != "noise"}
        return AcceptedFixes(noise=noise, **columns)


def accepted_fixes(
    fixes: FixColumns, verdicts: Verdicts, datum: Datum, seen: Sequence[SeenLeap] = ()
) -> AcceptedFixes:
    """The accepted ones of fixes in order of time; `seen` are leaps that something else saw.

    Raises GnssError where there is none.
    """
    if not verdicts.ok.any():
        raise GnssError(no_fix_sentence(fixes, verdicts))
    used = fixes[verdicts.ok]
    east, north, up = datum.to_enu(used.lat_deg, used.lon_deg, used.height_m)
    stated_m = used.position_sigma_m()
    quantum = quantum_m(used.lat_deg, used.lon_deg)
    noise = fix_noise(east, north, used.time_ns, stated_m, used.quality, quantum)
    doubt = _seam_doubt(fixes, verdicts, datum, noise, seen)
    # Digits that a log cuts off instead of rounding leave all fixes half a step south and west.
    cut_m = quantum / math.sqrt(12.0)
    heading_sigma = used.heading_sigma_deg
    refused = np.array([gate in _BY_MOTION for gate in verdicts.gate], dtype=np.bool_)
    before = np.concatenate([[0], np.cumsum(refused & ~verdicts.ok)])[:-1][verdicts.ok]
    return AcceptedFixes(
        used.time_ns,
        east,
        north,
        up,
        np.sqrt(stated_m**2 + doubt.sigma_m**2 + cut_m**2),
        used.sigma_m,
        doubt.lasting_s,
        noise,
        used.quality,
        used.speed_mps,
        np.asarray(wrap_deg(used.heading_deg)),
        np.where(np.isnan(heading_sigma), UNSTATED_HEADING_SIGMA_DEG, heading_sigma),
        used.stamp_sigma_s,
        np.diff(before, prepend=0) > 0,
    )


def _seam_doubt(
    fixes: FixColumns,
    verdicts: Verdicts,
    datum: Datum,
    noise: FixNoise,
    seen: Sequence[SeenLeap],
) -> SeamDoubt:
    """What leaps of the solution say of the accepted fixes; those that were refused for how they
    lie are another solution."""
    denied = np.array([gate in _OF_ANOTHER for gate in verdicts.gate], dtype=np.bool_)
    rows = np.flatnonzero(verdicts.ok | denied)
    fit, ok = fixes[rows], verdicts.ok[rows]
    east, north, _ = datum.to_enu(fit.lat_deg, fit.lon_deg, fit.height_m)
    found = seam_doubt(
        np.stack([east, north], axis=1),
        (fit.time_ns - fit.time_ns[0]) / 1e9,
        fit.position_sigma_m(),
        float(np.median(noise.across_m)),
        denied[rows],
        {int(np.searchsorted(fit.time_ns, leap.time_ns)): leap for leap in seen},
    )
    return found._replace(
        sigma_m=found.sigma_m[ok],
        lasting_s=np.asarray(np.minimum.reduceat(found.lasting_s, np.flatnonzero(ok))),
    )


OFFSET_S = 20.0
"""Over so long, pose and fixes lie beside each other by what the receiver states at most."""


def fix_offsets(time_ns: Int64, fixes: AcceptedFixes, offset_m: Float64) -> tuple[Float64, Float64]:
    """How far the antenna lies from its fixes, on average over :data:`OFFSET_S` around some
    instants, and the error that these fixes state along one axis, metres; `offset_m` [fixes, 2] is
    how far it lies from each."""
    half_ns = round(OFFSET_S / 2.0 * 1e9)
    first = np.searchsorted(fixes.time_ns, time_ns - half_ns)
    last = np.searchsorted(fixes.time_ns, time_ns + half_ns, side="right")
    count = np.maximum(last - first, 1)
    sums = [np.concatenate([[0.0], np.cumsum(column)]) for column in (*offset_m.T, fixes.sigma_m)]
    east, north, stated = ((one[last] - one[first]) / count for one in sums)
    return np.hypot(east, north), np.where(last > first, stated, np.inf)


def datum_of(fixes: FixColumns, verdicts: Verdicts) -> Datum:
    """The datum of a first map: the first accepted fix, rounded to 1e-7 degrees and 1 mm."""
    if not verdicts.ok.any():
        raise GnssError(no_fix_sentence(fixes, verdicts))
    first = fixes[int(np.argmax(verdicts.ok))]
    return Datum(round(first.lat_deg, 7), round(first.lon_deg, 7), round(first.height_m, 3))


def _with_limit(name: str) -> str:
    return f"allow it with {name} of the table pose.gnss in --config"


_COLUMNS = (
    "if a column of a table is taken for what it is not, name columns and units in [gnss.columns] "
    "of recording.toml"
)
_REMEDIES = {
    Gate.PLACE: _COLUMNS,
    Gate.TIME: _COLUMNS,
    Gate.QUALITY: "declare its quality with --quality",
    Gate.SATELLITES: _with_limit("min_satellites"),
    Gate.HDOP: _with_limit("max_hdop"),
    Gate.AGE: f"{_with_limit('max_age_s')} (max_code_age_s without carrier phase)",
}
"""What helps against what refuses all fixes."""


def no_fix_sentence(fixes: FixColumns, verdicts: Verdicts) -> str:
    """Why there is nothing to place images with: how many fixes, and the commonest reason."""
    if not len(fixes):
        return "The GNSS log holds no position at all; record one, or choose another with --gnss."
    commonest = commonest_reason(verdicts.reason)
    remedy = _REMEDIES.get(verdicts.gate[verdicts.reason.index(commonest)])
    other = "choose another log with --gnss"
    return (
        f"None of the {len(fixes)} fixes can be used, mostly because: {commonest}; "
        f"{other if remedy is None else f'{other}, or {remedy}'}."
    )
