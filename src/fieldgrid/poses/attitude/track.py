"""Where an antenna was and where its vehicle headed, as far as that is known before its lean."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64

WANDER_SHARE = np.array([1.2, 1.2, 2.5])
"""How the slow errors east, north and up compare with the stated one of a horizontal axis: few
satellites are seen near the horizon, and none below it."""

HEADING_GAP_NS = 1_500_000_000
"""Between headings that are farther apart a vehicle may have turned anyhow."""


class KnownHeadings(NamedTuple):
    """The vehicle's headings at two or more instants in order of time, degrees, with their sigmas.
    They count turns on: 370° follows 350° of a vehicle that turned to the right."""

    time_ns: Int64
    heading_deg: Float64
    sigma_deg: Float64

    def at(self, time_ns: Int64) -> tuple[Float64, Float64]:
        """Headings and sigmas at other instants. Inside a gap nobody knows how the vehicle turned:
        there the sigma is infinite."""
        heading_deg = np.interp(time_ns, self.time_ns, self.heading_deg)
        sigma_deg = np.interp(time_ns, self.time_ns, self.sigma_deg)
        after = np.clip(np.searchsorted(self.time_ns, time_ns), 1, len(self.time_ns) - 1)
        before_ns, after_ns = self.time_ns[after - 1], self.time_ns[after]
        inside = (before_ns < time_ns) & (time_ns < after_ns)
        sigma_deg[inside & (after_ns - before_ns > HEADING_GAP_NS)] = np.inf
        return heading_deg, sigma_deg


class AntennaTrack(NamedTuple):
    """The antenna by accepted fixes, n in order of time: LTP metres `enu_m` [n, 3], the white part
    `noise_m` [n, 3] of their error along each axis, the stated slow error `wander_m` [n] of a
    horizontal one; and the vehicle's headings."""

    time_ns: Int64
    enu_m: Float64
    noise_m: Float64
    wander_m: Float64
    headings: KnownHeadings
