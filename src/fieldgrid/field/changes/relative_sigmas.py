"""Position sigmas of drives relative to those that they are compared with.

Two aligned drives coincide better than either knows its absolute position. Their relative variance
is split between them, so that the variances of any two compared drives add up to at least it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.maps import WORSE_TIMES, MapFile, Transform, placing


class RelativeSigma(NamedTuple):
    """The position sigma of a drive relative to others, metres, for its poses that do not state
    more than `worse_m`."""

    sigma_m: float
    worse_m: float

    def of(self, stated_m: float) -> float:
        """That of a pose."""
        return stated_m if stated_m > self.worse_m else min(stated_m, self.sigma_m)


def relative_sigmas(
    universal: MapFile, before: Sequence[str], after: Sequence[str]
) -> dict[str, RelativeSigma]:
    """The position sigma of drives relative to those of the other side of a comparison. Only
    for drives that were aligned with all of these, and while none of these has been moved."""
    infos = {info.name: info for info in universal.sessions()}
    transforms = {name: infos[name].transform for name in (*before, *after)}
    if all(one.aligned is None for one in transforms.values()):
        return {}
    placings, own_m = dict[str, str](), dict[str, float]()
    for name, transform in transforms.items():
        frames = [f for f in universal.frames(name) if f.accepted]
        placings[name] = placing(transform, (f.driven for f in frames))
        sigmas = [f.pose.position_sigma_m for f in frames]
        own_m[name] = float(np.median(sigmas)) if sigmas else np.inf
    found = dict[str, RelativeSigma]()
    for names, others in ((before, after), (after, before)):
        for name in names:
            variances = [
                np.inf
                if (apart := _apart_m(name, other, transforms, placings)) is None
                # Half each, or what the other one's own error leaves.
                else max(apart**2 / 2.0, apart**2 - own_m[other] ** 2)
                for other in others
            ]
            if max(variances, default=np.inf) < own_m[name] ** 2:
                found[name] = RelativeSigma(
                    float(np.sqrt(max(variances))), WORSE_TIMES * own_m[name]
                )
    return found


def _apart_m(
    a: str, b: str, transforms: Mapping[str, Transform], placings: Mapping[str, str]
) -> float | None:
    """The sigma between two drives, where either says so of the other as that lies now."""
    for one, other in ((a, b), (b, a)):
        aligned = transforms[one].aligned
        for beside in aligned.beside if aligned is not None else ():
            if (beside.name, beside.placing) == (other, placings[other]):
                return beside.sigma_m
    return None
