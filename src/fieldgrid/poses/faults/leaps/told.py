"""Leaps of a receiver's solution that the estimate of a drive tells.

Two decimetres from one fix to the next, or half a metre over a hole under trees, may be driven as
far as fixes can tell; what else saw the vehicle move, and its own laws, may deny it. A leap is one
large increment of the slow error: the drive with it is compared with the drive without it.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.geometry import least_sigma_m
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.faults.leaps.seams import LEAST_M, SeenLeap
from fieldgrid.poses.nodes import Nodes
from fieldgrid.poses.smoother.batch import SmoothedDrive, refine
from fieldgrid.poses.smoother.declared import LIKELY
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.model import BIAS_E
from fieldgrid.poses.smoother.slow_error import APART_S, TOLD_SHARE, rare_nats

MOST_ROUNDS, STATED_SIGMAS = 3, 3.0
"""So often a drive with the leaps that were found is asked for others; and a leap is more sigmas
than fixes of their kinds are good for."""

FAR_SIGMAS = 10.0
"""A fix that is off by more sigmas of its noise does not fit."""


def told_leaps(
    known: SmoothedDrive, measured: Measurements, at: Nodes, fixes: AcceptedFixes, axle: Axle
) -> tuple[SeenLeap, ...]:
    """Where the receiver's solution goes on elsewhere by more than it states, and the drive is
    likelier so."""
    found, fix_s = known, measured.time_s[at.fix >= 0]
    usual_m = np.maximum(fixes.sigma_m, least_sigma_m(fixes.quality))
    candidates = found.leaps.likeliest(measured.time_s, fix_s)
    for _ in range(MOST_ROUNDS):
        more = np.union1d(measured.leapt, candidates)
        if len(more) == len(measured.leapt):
            break
        leapt = measured._replace(leapt=more)
        tried = refine(found, leapt, *axle.frame(), axle.sigma_m)
        off_m = np.diff(tried.state[:, BIAS_E:], axis=0)[more]
        after = np.searchsorted(fix_s, measured.time_s[more], side="right")
        least_m = STATED_SIGMAS * np.hypot(usual_m[after - 1], usual_m[after])
        clear = np.hypot(*off_m.T) > np.maximum(least_m, LEAST_M)
        # By positions alone, beside fixes that fit neither side it is rather an excursion.
        away = np.hypot(*(tried.fix_off_m / measured.fix_sigma_m).T) > FAR_SIGMAS
        near_s = measured.time_s[away] - measured.time_s[more, None]
        clear &= measured.sees_turns() | ~(np.abs(near_s) < APART_S).any(axis=1)
        if not clear.all():
            candidates = np.intersect1d(candidates, more[clear])
            continue
        gain = (tried.nats - found.nats) / TOLD_SHARE  # few fixes tell it, beside all the others
        rare = rare_nats(leapt, fix_s) - rare_nats(measured, fix_s)
        if gain + rare < np.log(LIKELY / (1.0 - LIKELY)):
            break
        found, measured = tried, leapt
        candidates = found.leaps.likeliest(measured.time_s, fix_s)
    k = measured.leapt
    if not len(k) or found.declared.contradicts:  # then it is something else
        return ()
    off_m, sigma_m = np.diff(found.state[:, BIAS_E:], axis=0)[k], found.leaps.sigma_m[k]
    after_ns = fixes.time_ns[np.searchsorted(fixes.time_ns, at.time_ns[k], side="right")]
    columns = (column.tolist() for column in (after_ns, *off_m.T, sigma_m))
    return tuple(SeenLeap(*leap) for leap in zip(*columns, strict=True))
