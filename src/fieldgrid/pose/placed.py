"""The fixes of a drive in the plane: columns instead of records, with their verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.errors import GnssError
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import Fix, Verdict, position_sigma_m, quantum_m, short_term_sigma_m
from fieldgrid.trajectory import Status

UNSTATED_HEADING_SIGMA_DEG = 1.0
"""The error of a recorded heading whose source does not state one."""

LEAST_NOISE_SHARE = 0.05
"""At least this share of a receiver's stated error changes from fix to fix."""


class Placed(NamedTuple):
    """Fixes in order of time, length n. Positions are the antenna's, LTP metres.

    `ok` marks the accepted ones. `sigma_m` is the stated error of one axis, `noise_m` the part
    of it that changes from fix to fix. NaN stands for what a fix does not say; a recorded
    heading is the nose's, as the source means it.
    """

    time_ns: Int64
    east_m: Float64
    north_m: Float64
    up_m: Float64
    sigma_m: Float64
    noise_m: Float64
    quality: Int64
    speed_mps: Float64
    recorded_deg: Float64
    recorded_sigma_deg: Float64
    ok: Bool
    verdicts: tuple[Verdict, ...]

    def accepted(self) -> Placed:
        """The accepted fixes alone."""
        keep = np.flatnonzero(self.ok)
        return Placed(
            self.time_ns[keep],
            self.east_m[keep],
            self.north_m[keep],
            self.up_m[keep],
            self.sigma_m[keep],
            self.noise_m[keep],
            self.quality[keep],
            self.speed_mps[keep],
            self.recorded_deg[keep],
            self.recorded_sigma_deg[keep],
            self.ok[keep],
            tuple(self.verdicts[k] for k in keep.tolist()),
        )


def place(fixes: Sequence[Fix], verdicts: Sequence[Verdict], datum: Datum) -> Placed:
    """Fixes, ordered by time, in the plane of a datum."""
    ok = np.array([verdict.status is Status.OK for verdict in verdicts])
    with np.errstate(invalid="ignore"):  # rejected fixes may hold anything
        lat, lon = _column(fixes, "lat_deg"), _column(fixes, "lon_deg")
        east, north, up = datum.to_enu(lat, lon, _column(fixes, "height_m"))
    time_ns = np.array([fix.time_ns for fix in fixes], dtype=np.int64)
    sigma_m = np.array([position_sigma_m(fix) for fix in fixes])
    short_m = short_term_sigma_m(east[ok], north[ok], time_ns[ok], quantum_m(lat[ok], lon[ok]))
    heading_sigma = _column(fixes, "heading_sigma_deg")
    return Placed(
        time_ns,
        east,
        north,
        up,
        sigma_m,
        np.maximum(short_m, LEAST_NOISE_SHARE * sigma_m),
        np.array([fix.quality for fix in fixes], dtype=np.int64),
        _column(fixes, "speed_mps"),
        np.asarray(wrap_deg(_column(fixes, "heading_deg"))),
        np.where(np.isnan(heading_sigma), UNSTATED_HEADING_SIGMA_DEG, heading_sigma),
        ok,
        tuple(verdicts),
    )


def _column(fixes: Sequence[Fix], name: str) -> Float64:
    values = [getattr(fix, name) for fix in fixes]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def datum_of(fixes: Sequence[Fix], verdicts: Sequence[Verdict]) -> Datum:
    """The datum of a first map: the first accepted fix, rounded to 1e-7 degrees and 1 mm."""
    for fix, verdict in zip(fixes, verdicts, strict=True):
        if verdict.status is Status.OK:
            return Datum(round(fix.lat_deg, 7), round(fix.lon_deg, 7), round(fix.height_m, 3))
    raise GnssError(no_fix_sentence(fixes, verdicts))


def no_fix_sentence(fixes: Sequence[Fix], verdicts: Sequence[Verdict]) -> str:
    """Why there is nothing to place images with: how many fixes, and the commonest reason."""
    if not fixes:
        return "The GNSS log holds no position at all; record one, or choose another with --gnss."
    reasons = [verdict.reason for verdict in verdicts]
    commonest = max(set(reasons), key=reasons.count)
    return (
        f"None of the {len(fixes)} fixes can be used, mostly because: {commonest}; "
        "choose another log with --gnss."
    )
