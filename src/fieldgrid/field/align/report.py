"""What alignment found: of each drive, of each two, and of the map."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.field.align.agreement import Agreement
from fieldgrid.field.align.disagreement import (
    CONTRADICTS_SIGMAS,
    bent_m,
    contradict,
)
from fieldgrid.field.align.drives import Role, SubmapDrive
from fieldgrid.field.align.matches import Match, information_of
from fieldgrid.field.align.network import NetworkSolution
from fieldgrid.maps import AlignmentRecord, Transform


class DriveAlignment(NamedTuple):
    """What became of a drive: its transforms `before` and `after`, the 1-sigma errors of shift and
    turn, from how many matches. By its `role` it was to move or not; without matches it does not.
    `heights_kept` says why its heights were not aligned although it saw the ground, None where they
    were, or where nothing is said of them.
    """

    name: str
    before: Transform
    after: Transform
    sigma_m: float
    turn_sigma_deg: float
    matches: int
    role: Role
    heights_kept: str | None = None

    @property
    def moved(self) -> bool:
        """Whether it gets another place."""
        return self.after is not self.before


class Contradiction(NamedTuple):
    """A place `at_m` [2], east and north, where a match of two drives contradicts how they lie
    after alignment: by `left_m` [2]. `sigmas` is that distance in standard deviations of the match.
    """

    at_m: Float64
    left_m: Float64
    sigmas: float


class PairAlignment(NamedTuple):
    """How drive `b` lay against drive `a` where both saw the same ground, on the mean, about `at_m`
    [2]: metres east and north (of b less of a), as they were placed and as they are after
    alignment, with the error of the shift, and degrees clockwise, as they were placed. What is left
    is `left_sigmas` of what their matches tell; beyond a few of them the two contradict other
    pairs. The places where single matches do so are `contradictions`, the worst first. Of a pair
    with a `doubt` nothing was used.

    What they saw tells the shift worst along `weak_axis_deg` (a heading), to `weak_sigma_m`,
    infinite where not at all: there the receivers alone have a say.
    """

    a: str
    b: str
    at_m: Float64
    before_m: Float64
    after_m: Float64
    turn_before_deg: float
    sigma_m: float
    weak_axis_deg: float
    weak_sigma_m: float
    matches: int
    doubt: str | None
    agreement: Agreement
    left_sigmas: float
    contradictions: tuple[Contradiction, ...]


class MapAlignment(NamedTuple):
    """How the drives of a map lie against each other. `misfit` is the median normalised residual
    of all matches, 1.2 where they scatter as they say; `face_m` lies between the two faces of a
    row, and all looks nearer by `view_m` than it is."""

    drives: tuple[DriveAlignment, ...]
    pairs: tuple[PairAlignment, ...]
    misfit: float
    face_m: float
    view_m: float

    @property
    def transforms(self) -> dict[str, Transform]:
        """Of the drives that get another place, for `MapFile.set_transforms`."""
        return {drive.name: drive.after for drive in self.drives if drive.moved}


def summed_up(
    drives: Sequence[SubmapDrive],
    before: Sequence[Transform],
    agreements: Sequence[Agreement],
    matches: Sequence[Match],
    solution: NetworkSolution,
    rough_m: float,
    heights_kept: Mapping[int, str],
) -> MapAlignment:
    """The outcome of drives that were placed `before`, from the last matches and what fits them;
    `rough_m` is what the way in which they were compared adds to the errors of shifts,
    `heights_kept` why those of some drives were not aligned."""
    sigma_m = np.hypot(solution.sigma_m, rough_m)
    with_ = defaultdict[int, set[int]](set)
    counts = defaultdict[tuple[int, int], int](int)
    for match in matches:
        counts[match.a, match.b] += 1
        with_[match.a].add(match.b)
        with_[match.b].add(match.a)
    results = []
    for n, drive in enumerate(drives):
        after = solution.transforms[n]
        if drive.role is Role.MOVES:
            earlier = before[n].aligned
            after = replace(
                after,
                aligned=AlignmentRecord(
                    float(sigma_m[n, n]),
                    float(solution.turn_sigma_deg[n]),
                    tuple(drives[k].name for k in sorted(with_[n] - {n})),
                    before[n].to_text() if earlier is None else earlier.before,
                    stated_m=drive.stated_m,
                ),
            )
        results.append(
            DriveAlignment(
                drive.name,
                before[n],
                after,
                float(sigma_m[n, n]),
                float(solution.turn_sigma_deg[n]),
                sum(count for pair, count in counts.items() if n in pair),
                drive.role,
                heights_kept.get(n),
            )
        )
    pairs = [
        _pair(
            drives,
            before,
            solution,
            one,
            [k for k, match in enumerate(matches) if (match.a, match.b) == (one.a, one.b)],
            matches,
            float(sigma_m[one.a, one.b]),
        )
        for one in agreements
    ]
    misfit = float(np.median(solution.misfit)) if len(matches) else float("nan")
    return MapAlignment(tuple(results), tuple(pairs), misfit, solution.face_m, solution.view_m)


def _pair(
    drives: Sequence[SubmapDrive],
    before: Sequence[Transform],
    solution: NetworkSolution,
    one: Agreement,
    own: Sequence[int],
    matches: Sequence[Match],
    sigma_m: float,
) -> PairAlignment:
    """What a pair lay apart is what alignment moved one against the other where both were seen, on
    the mean of their matches, for those that agree."""
    a, b = one.a, one.b
    zero = np.zeros(2)
    moves = [
        _moved(drives[a], before[a], solution.transforms[a], matches[k].k, matches[k].at_m)
        - _moved(drives[b], before[b], solution.transforms[b], matches[k].l, matches[k].at_m)
        for k in own
    ]
    moved = np.mean(moves, axis=0) if moves else one.shift_m
    turned = sum(
        sign * (solution.transforms[n].turn_deg - before[n].turn_deg)
        for sign, n in ((1.0, a), (-1.0, b))
    )
    trusted = one.doubt is None
    information = information_of([matches[k] for k in own], [len(own)] * len(own))
    total = information.sum(axis=0)
    pulled = sum(
        (told @ solution.left_m[k] for told, k in zip(information, own, strict=True)), zero
    )
    left = np.linalg.pinv(total, hermitian=True) @ pulled
    told, axes = np.linalg.eigh(total)
    # Against the drives as their receivers have them, which may be bent where one leaps.
    bent = {n: bent_m(drives[n], solution.transforms[n]) for n in (a, b)}
    contradictions = []
    for k, information_of_one in zip(own, information, strict=True):
        apart_m = bent[a][matches[k].k] - bent[b][matches[k].l]
        if solution.misfit[k] > CONTRADICTS_SIGMAS or contradict(drives[a], drives[b], apart_m):
            off_m = solution.left_m[k] + apart_m
            sigmas = float(np.sqrt(off_m @ information_of_one @ off_m))
            contradictions.append(Contradiction(matches[k].at_m, off_m, sigmas))
    return PairAlignment(
        drives[a].name, drives[b].name, one.at_m,
        moved + left if trusted else one.shift_m, left if trusted else one.shift_m,
        turned if trusted else one.turn_deg,
        sigma_m, float(np.degrees(np.arctan2(*axes[:, 0])) % 180.0),
        float(told[0] ** -0.5) if told[0] > 0.0 else np.inf, len(own), one.doubt, one,
        float(np.sqrt(max(left @ total @ left, 0.0))),
        tuple(sorted(contradictions, key=lambda one: -one.sigmas)),
    )  # fmt: skip


def _moved(
    drive: SubmapDrive, before: Transform, after: Transform, submap: int, at_m: Float64
) -> Float64:
    """By how much a place [2] that a submap saw is moved, east and north."""
    time_ns = int(drive.time_ns[submap])
    east_m, north_m = at_m
    driven = 2.0 * at_m - np.array(before.points(east_m, north_m, time_ns))
    now, was = (np.array(t.points(driven[0], driven[1], time_ns)) for t in (after, before))
    return np.asarray(now - was)
