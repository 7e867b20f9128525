"""How drives lie above each other, from the ground that they saw.

A receiver's height wanders as its position does, by twice as much. Each submap has one height to
be found; where two submaps saw the ground of one place, of the same drive or of two, these differ
by what the ground seen from them does. The ground itself is an unknown of each place, which is
eliminated; the receiver's stated error is the prior.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.field.align.drives import UNKNOWN_SIGMA_M, WANDER_SHARE, Role, SubmapDrive
from fieldgrid.field.align.network import HELD_M, wander_chain
from fieldgrid.field.align.submaps import SUBMAP_M, Submap
from fieldgrid.geometry import GROUND_CHANNEL, HEIGHT_SHARE, NO_GROUND_CM, Lattice
from fieldgrid.maps import HeightCorrection, Transform, to_universal

PLACE_M = 0.5
"""Heights are compared in cells of this side: the ground is followed in patches of it."""

PLACE_SIGMA_M = 0.2
"""What the height of one place counts for. A frame's heights err together, by its tilt and plane:
a hundred of them are good to 2 cm."""

LEAST_SIGMA_M = 0.02
"""No receiver's heights are better."""

FAR_M = 100.0
"""Farther off no height is: a log without heights, or with another zero."""

FAR_SIGMAS = 3.0
"""A receiver that is off by more than this number of its stated errors states too little."""

LOOSE = 0.01
"""What priors count for at first."""

FREEDOM, SCATTER_M = 2.0, 0.05
"""Of Student's distribution of what places differ by: a canopy taken for ground counts little."""

ROUNDS, SETTLED_M = 20, 0.001

MOST_SUBMAPS, MOST_SHARED = 10_000, 3_000_000
"""The equations of more submaps are not solved, nor of more pairs of them (each counted twice) that
share ground: these take up to 1 GB."""


class _GroundHeights(NamedTuple):
    """Heights of places, metres as driven: by which submap, of all drives in order, and where."""

    submap: Int64
    place: Int64
    up_m: Float64


class HeightCorrections(NamedTuple):
    """What to add to the heights of each drive, None for those that keep theirs; `kept` says why of
    those that ground was looked for."""

    corrections: tuple[HeightCorrection | None, ...]
    kept: Mapping[int, str]


def level(
    drives: Sequence[SubmapDrive], transforms: Sequence[Transform], doubtful: Collection[int] = ()
) -> HeightCorrections:
    """What to add to the heights of each drive that moves, placed by its transform.

    Nothing to those of one that saw no ground which another submap saw, too, of the `doubtful`,
    which may lie elsewhere, and of those that are farther off than heights can be (another zero, or
    none).
    """
    moving = {
        n
        for n, drive in enumerate(drives)
        if drive.role is Role.MOVES
        and any(GROUND_CHANNEL in frame.cells().channels for frame in drive.submaps[0].frames)
    }
    kept = dict.fromkeys(moving & {*doubtful}, "it is in doubt where the drive lies")
    count = sum(len(drive.submaps) for n, drive in enumerate(drives) if n not in doubtful)
    if count > MOST_SUBMAPS:
        why = f"{count} pieces of {SUBMAP_M:.0f} m are more than the {MOST_SUBMAPS} that are solved"
        return HeightCorrections(
            (None,) * len(drives), kept | dict.fromkeys(moving - {*doubtful}, why)
        )
    corrections, far, shared = _corrections(drives, transforms, doubtful)
    if shared > MOST_SHARED:
        why = (
            f"{shared} times two pieces of {SUBMAP_M:.0f} m share ground, more than the "
            f"{MOST_SHARED} that are solved"
        )
        return HeightCorrections(
            tuple(corrections), kept | dict.fromkeys(moving - {*doubtful}, why)
        )
    if far:
        why = f"they are over {FAR_M:.0f} m off: another zero, or none"
        found = level(drives, transforms, {*doubtful, *far})
        return found._replace(kept={**found.kept, **kept, **dict.fromkeys(far & moving, why)})
    return HeightCorrections(tuple(corrections), kept)


def _corrections(
    drives: Sequence[SubmapDrive], transforms: Sequence[Transform], doubtful: Collection[int]
) -> tuple[list[HeightCorrection | None], set[int], int]:
    """What to add to the heights of each drive, those that are too far off, and how many pairs of
    submaps share ground; nothing where these are more than `MOST_SHARED`."""
    corrections: list[HeightCorrection | None] = [None] * len(drives)
    chosen = [n for n in range(len(drives)) if n not in doubtful]
    own = [drives[n] for n in chosen]
    count = sum(len(drive.submaps) for drive in own)
    if not count:
        return corrections, set(), 0
    placed = [transforms[n] for n in chosen]
    seen = _ground(own, placed)
    if not len(seen.place):
        return corrections, set(), 0
    ones = np.ones(len(seen.place), np.bool_)
    each = sparse.csr_array((ones, (seen.submap, seen.place)), shape=(count, seen.place.max() + 1))
    shared = int((each @ each.T).nnz) - len(np.unique(seen.submap))
    if shared > MOST_SHARED:
        return corrections, set(), shared
    parts = np.split(np.arange(count), np.cumsum([len(drive.submaps) for drive in own])[:-1])
    stated_m = np.concatenate([_stated_m(*one) for one in zip(own, placed, strict=True)])
    up_m, normal = _solve(seen, own, stated_m, parts)
    far = {n for n, part in zip(chosen, parts, strict=True) if np.abs(up_m[part]).max() > FAR_M}
    if far:
        return corrections, far, shared
    # Which drives saw ground of one place, by what the ground says of their submaps.
    drive_of = np.repeat(np.arange(len(parts)), [*map(len, parts)])
    of_drive = sparse.csr_array((np.ones(count), (drive_of, np.arange(count))))
    least_m = _turned_out(
        np.array([np.sqrt(np.mean(up_m[part] ** 2)) for part in parts]),
        np.array([np.median(stated_m[part]) for part in parts]),
        np.asarray((of_drive @ abs(normal) @ of_drive.T).toarray() > 0.0),
    )
    met = normal.diagonal() > 0.0
    for n, drive, part, sigma_m in zip(chosen, own, parts, least_m.tolist(), strict=True):
        if drive.role is Role.MOVES and met[part].any():
            corrections[n] = HeightCorrection(
                tuple(drive.time_ns.tolist()), tuple(up_m[part].tolist()), sigma_m
            )
    return corrections, set(), shared


def _turned_out(found_m: Float64, stated_m: Float64, shares: Bool) -> Float64:
    """What the heights of each drive err by at least, as it turned out: 0 where that is what its
    receiver states. `shares` [n, n] are the drives that saw ground of one place.

    Heights come to those of better receivers, but how good these are nobody measures. And of drives
    that contradict each other, without two that agree, each may be the wrong one.
    """
    least_m = np.where(found_m > stated_m, found_m, 0.0)
    wrong = found_m > FAR_SIGMAS * stated_m
    for n in np.flatnonzero(wrong):
        others = shares[n] & ~wrong
        if np.count_nonzero(others) < 2:
            alike = others & (FAR_SIGMAS * stated_m >= stated_m[n])
            least_m[alike] = np.maximum(least_m[alike], found_m[n])
    return least_m


def _stated_m(drive: SubmapDrive, transform: Transform) -> Float64:
    """What poses state of the heights of each submap [n], as driven or, of a drive that stays, as
    placed; of one that holds nothing is open."""
    if drive.role is Role.HOLDS:
        return np.full(len(drive.submaps), HELD_M)
    moves, found = drive.role is Role.MOVES, []
    for submap in drive.submaps:
        poses = [f.driven if moves else transform.pose(f.driven) for f in submap.frames]
        known = [pose.up_sigma_m for pose in poses if np.isfinite(pose.up_sigma_m)]
        usual = HEIGHT_SHARE * UNKNOWN_SIGMA_M
        found.append(max(float(np.median(known)), LEAST_SIGMA_M) if known else usual)
    return np.array(found)


def _solve(
    seen: _GroundHeights, drives: Sequence[SubmapDrive], stated_m: Float64, parts: Sequence[Int64]
) -> tuple[Float64, sparse.csr_array]:
    """The heights of submaps [count], and what the ground says of them [count, count], not 0 of
    two that share a place; `parts` are the submaps of each drive."""
    count = len(stated_m)
    prior = _prior(drives, stated_m, parts)
    unknowns = prior.shape[0]
    up_m: Float64 = np.zeros(count)
    held = np.array([drive.role is Role.HOLDS for drive in drives])
    # At first the ground is believed, so that a receiver that is far off is told as such.
    trust = np.where(held, 1.0, LOOSE)
    drive_of = np.concatenate(
        [np.repeat(np.arange(len(parts)), [*map(len, parts)]), np.arange(len(parts))]
    )
    weights: Float64 = np.full(len(seen.place), PLACE_SIGMA_M**-2.0)
    normal = sparse.csr_array((count, count))
    for _ in range(ROUNDS):
        normal, side = _without_places(seen, weights, count)
        before = up_m
        ground = normal.copy()
        ground.resize((unknowns, unknowns))
        every = (sparse.diags_array(trust[drive_of]) @ prior + ground).tocsc()
        factor = splu(every, "MMD_AT_PLUS_A", options={"SymmetricMode": True})
        up_m = np.asarray(factor.solve(np.append(side, np.zeros(len(parts)))), np.float64)[:count]
        if np.abs(up_m - before).max() < SETTLED_M:
            break
        moved = seen.up_m + up_m[seen.submap]
        mean = np.bincount(seen.place, weights * moved) / np.bincount(seen.place, weights)
        misfit = np.asarray(moved - mean[seen.place]) / SCATTER_M
        weights = PLACE_SIGMA_M**-2.0 * (FREEDOM + 1.0) / (FREEDOM + misfit**2)
        for n in np.flatnonzero(~held).tolist():
            off = np.mean((up_m[parts[n]] / stated_m[parts[n]]) ** 2)
            trust[n] = (FREEDOM + 1.0) / (FREEDOM + off)
    return up_m, normal


def _ground(drives: Sequence[SubmapDrive], transforms: Sequence[Transform]) -> _GroundHeights:
    """The ground of places that more than one submap saw; submaps are counted over all drives."""
    submaps, places, heights = [], [], []
    for drive, transform in zip(drives, transforms, strict=True):
        for submap in drive.submaps:
            place, up_m = _ground_of(submap, transform, placed=drive.role is not Role.MOVES)
            places.append(place)
            heights.append(up_m)
            submaps.append(len(place))
    numbers = np.repeat(np.arange(len(submaps)), submaps)
    _, place_of, times = np.unique(np.concatenate(places), return_inverse=True, return_counts=True)
    shared = times[place_of] > 1
    _, place_of = np.unique(place_of[shared], return_inverse=True)
    return _GroundHeights(
        numbers[shared], place_of.astype(np.int64), np.concatenate(heights)[shared]
    )


def _ground_of(submap: Submap, transform: Transform, *, placed: bool) -> tuple[Int64, Float64]:
    """The places that the frames of a submap saw the ground of, each once, and its height, as
    driven or as it is placed: the mean of what falls there."""
    lattice = Lattice(PLACE_M)
    places, heights = [np.zeros(0, np.int64)], [np.zeros(0)]
    for frame in submap.frames:
        ground_cm = frame.cells().channels.get(GROUND_CHANNEL)
        if ground_cm is None or not np.isfinite(frame.driven.up_m):
            continue
        step = max(round(PLACE_M / 2.0 / frame.spec.cell_m), 1)
        some = slice(step // 2, None, step)
        x, y = np.meshgrid(*(at[some] for at in frame.spec.centres_m()))
        known = ground_cm[some, some] != NO_GROUND_CM
        pose = transform.pose(frame.driven)
        east, north = to_universal(x[known], y[known], pose)
        i, j = lattice.index(east, north)
        places.append((np.asarray(i, np.int64) << 32) + j)
        up_m = pose.up_m if placed else frame.driven.up_m
        heights.append(up_m + ground_cm[some, some][known] / 100.0)
    place, inverse, times = np.unique(
        np.concatenate(places), return_inverse=True, return_counts=True
    )
    return place, np.bincount(inverse, np.concatenate(heights), len(place)) / times


def _prior(
    drives: Sequence[SubmapDrive], stated_m: Float64, parts: Sequence[Int64]
) -> sparse.csr_array:
    """The information [count + drives, count + drives] of what receivers err in height, by
    `stated_m` of each submap: a part that stays for a drive, and one that wanders over some
    minutes. The part that stays is an unknown of its own, in stated errors, behind the heights of
    all submaps, so that what is left is a chain."""
    blocks = []
    constants, columns = list[float](), list[Float64]()
    for drive, part in zip(drives, parts, strict=True):
        chain = wander_chain(drive.time_ns, WANDER_SHARE**2)
        k = np.arange(len(part))
        where = np.concatenate([k, k[:-1], k[1:]]), np.concatenate([k, k[1:], k[:-1]])
        each = sparse.csr_array(
            (np.concatenate([chain.diagonal, chain.beside, chain.beside]), where)
        )
        by_error = sparse.diags_array(1.0 / stated_m[part])
        blocks.append(by_error @ each @ by_error)
        along = each @ np.ones(len(part))
        columns.append(-along / stated_m[part])
        constants.append(1.0 / (1.0 - WANDER_SHARE**2) + float(along.sum()))
    beside = sparse.block_diag([column[:, None] for column in columns])
    return sparse.block_array(
        [[sparse.block_diag(blocks), beside], [beside.T, sparse.diags_array(constants)]],
        format="csr",
    )


def _without_places(
    seen: _GroundHeights, weights: Float64, count: int
) -> tuple[sparse.csr_array, Float64]:
    """The normal equations [count, count], [count] of the heights of submaps; those of the places
    are eliminated."""
    places = int(seen.place.max()) + 1
    each = sparse.csr_array((weights, (seen.submap, seen.place)), shape=(count, places))
    of_place = np.bincount(seen.place, weights, places)
    own = sparse.diags_array(np.asarray(each.sum(axis=1)))
    normal = own - (each @ sparse.diags_array(1.0 / of_place)) @ each.T
    off_m = (
        seen.up_m - (np.bincount(seen.place, weights * seen.up_m, places) / of_place)[seen.place]
    )
    return normal.tocsr(), np.asarray(-np.bincount(seen.submap, weights * off_m, count), np.float64)
