"""How often a vehicle backs up, and how far: what a hole may hide, by what the drive itself shows.

Some never back up, and who shunts does it every few metres. What is usual is not known before, so
that each of some habits is tried on the whole drive, and counts by how well it fits it: a drive
that is seen to turn back often does so in its holes, too. While nobody sees it the gear is a Markov
chain along the way: whoever backs up soon drives forward again.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64

FORWARD_M = {30.0: 0.25, 100.0: 0.25, 300.0: 0.25, 1000.0: 0.25}
REVERSE_M = {5.0: 0.6, 15.0: 0.25, 50.0: 0.15}
"""Mean ways forward and in reverse, each with the share of drives that are taken to have it."""


class Habits(NamedTuple):
    """Habits [h], each with the log of its share: changes of gear a metre, forward and back."""

    share: Float64
    back_per_m: Float64
    forth_per_m: Float64

    @classmethod
    def usual(cls) -> Habits:
        """Those of all vehicles."""
        all_of = list(product(FORWARD_M.items(), REVERSE_M.items()))
        return cls(
            np.log([one[1] * other[1] for one, other in all_of]),
            np.array([1.0 / one[0] for one, _ in all_of]),
            np.array([1.0 / other[0] for _, other in all_of]),
        )

    def leg(self, length_m: float, cap: float) -> Float64:
        """Log weights [h, 2] of a way that is driven forward, and in reverse."""
        return -np.minimum(np.stack([self.back_per_m, self.forth_per_m], axis=1) * length_m, cap)

    def cusp(self) -> Float64:
        """Log weights [h, 2] of a change of gear that is seen, from forward and from reverse,
        beside those that all vehicles have together."""
        rates = np.stack([self.back_per_m, self.forth_per_m], axis=1)
        return np.asarray(np.log(rates / (np.exp(self.share) @ rates)))

    def hole(self, way_m: float, carried: float) -> tuple[Float64, Float64]:
        """Log weights [h, 2] of the same gear after a hole, and of the other one, from forward and
        from reverse. `carried` are the nats by which positions say that it drove on in it, rather
        than that it turned back, be it once or twice."""
        rates = np.stack([self.back_per_m, self.forth_per_m], axis=1)
        total = rates.sum(axis=1, keepdims=True)
        changed = rates / total * -np.expm1(-total * way_m)
        drove_on = -rates * way_m
        twice = np.maximum(1.0 - changed - np.exp(drove_on), 1e-12)
        return (
            np.logaddexp(drove_on + carried, np.log(twice)),
            np.log(np.maximum(changed, 1e-12)),
        )
