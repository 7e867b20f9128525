"""How often a vehicle backs up, and how far: what a hole may hide, by what the drive itself shows.

Some never back up, and who shunts does it every few metres. What is usual is not known before, so
that each of some habits is tried on the whole drive, and counts by how well it fits it: a drive
that is seen to turn back often does so in its holes, too. While nobody sees it the gear is a Markov
chain along the way: whoever backs up soon drives forward again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64

USUAL = (
    (1000.0, 5.0, 0.30),
    (300.0, 5.0, 0.25),
    (100.0, 5.0, 0.20),
    (30.0, 5.0, 0.15),
    (30.0, 12.0, 0.02),
    (15.0, 8.0, 0.01),
)
"""Mean ways forward and in reverse, metres, and how many vehicles have them: most back up a few
metres and seldom, some at each headland, and a few load or push, as far back as forth."""


class Habits(NamedTuple):
    """Habits [h], each with the log of its share: changes of gear a metre, forward and back."""

    share: Float64
    back_per_m: Float64
    forth_per_m: Float64

    @classmethod
    def usual(cls) -> Habits:
        """Those of all vehicles."""
        forward_m, reverse_m, vehicles = np.array(USUAL).T
        return cls(np.log(vehicles / vehicles.sum()), 1.0 / forward_m, 1.0 / reverse_m)

    def leg(self, length_m: float, cap: float) -> Float64:
        """Log weights [h, 2] of a way that is driven forward, and in reverse, which is at most by
        `cap` less likely."""
        rarer = np.minimum((self.forth_per_m - self.back_per_m) * length_m, cap)
        forward = -self.back_per_m * length_m
        return np.stack([forward, forward - rarer], axis=1)

    def cusp(self) -> Float64:
        """Log weight [h] of a change of gear that is seen, beside its mean over all vehicles. It is
        the same both ways: nothing but the beginning tells a drive from its mirror in time."""
        rates = np.stack([self.back_per_m, self.forth_per_m], axis=1)
        return np.asarray((np.log(rates) - np.log(np.exp(self.share) @ rates)).mean(axis=1))

    def hole(self, way_m: float, carried: float) -> tuple[Float64, Float64]:
        """Log weights of the same gear after a hole [h, 2], from forward and from reverse, and of
        the other one [h], the same both ways. `carried` are the nats by which positions say that it
        drove on in it, rather than that it turned back, be it once or twice."""
        rates = np.stack([self.back_per_m, self.forth_per_m], axis=1)
        total = rates.sum(axis=1, keepdims=True)
        changed = rates / total * -np.expm1(-total * way_m)
        drove_on = -rates * way_m
        twice = np.maximum(1.0 - changed - np.exp(drove_on), 1e-12)
        stay = np.logaddexp(drove_on + carried, np.log(twice))
        return stay, np.log(np.maximum(changed, 1e-12)).mean(axis=1)
