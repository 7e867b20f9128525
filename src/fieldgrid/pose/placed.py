"""The fixes of a drive in the plane: columns instead of records, with their verdicts."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.errors import GnssError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import Verdicts, quantum_m, short_term_sigma_m

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
    reason: tuple[str, ...]

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
            tuple(self.reason[k] for k in keep.tolist()),
        )


def place(fixes: FixColumns, verdicts: Verdicts, datum: Datum) -> Placed:
    """Fixes, ordered by time, in the plane of a datum."""
    ok, time_ns, sigma_m = verdicts.ok, fixes.time_ns, fixes.position_sigma_m()
    with np.errstate(invalid="ignore"):  # rejected fixes may hold anything
        lat, lon = fixes.lat_deg, fixes.lon_deg
        east, north, up = datum.to_enu(lat, lon, fixes.height_m)
    short_m = short_term_sigma_m(east[ok], north[ok], time_ns[ok], quantum_m(lat[ok], lon[ok]))
    heading_sigma = fixes.heading_sigma_deg
    return Placed(
        time_ns,
        east,
        north,
        up,
        sigma_m,
        np.maximum(short_m, LEAST_NOISE_SHARE * sigma_m),
        fixes.quality,
        fixes.speed_mps,
        np.asarray(wrap_deg(fixes.heading_deg)),
        np.where(np.isnan(heading_sigma), UNSTATED_HEADING_SIGMA_DEG, heading_sigma),
        ok,
        verdicts.reason,
    )


def datum_of(fixes: FixColumns, verdicts: Verdicts) -> Datum:
    """The datum of a first map: the first accepted fix, rounded to 1e-7 degrees and 1 mm."""
    if not verdicts.ok.any():
        raise GnssError(no_fix_sentence(fixes, verdicts))
    first = fixes[int(np.argmax(verdicts.ok))]
    return Datum(round(first.lat_deg, 7), round(first.lon_deg, 7), round(first.height_m, 3))


def no_fix_sentence(fixes: FixColumns, verdicts: Verdicts) -> str:
    """Why there is nothing to place images with: how many fixes, and the commonest reason."""
    if not len(fixes):
        return "The GNSS log holds no position at all; record one, or choose another with --gnss."
    commonest = Counter(verdicts.reason).most_common(1)[0][0]
    return (
        f"None of the {len(fixes)} fixes can be used, mostly because: {commonest}; "
        "choose another log with --gnss."
    )
